"""An emulated robot behind a UDP socket or a serial port."""

import os
import select
import socket
from contextlib import suppress

from limslam_agent.live.emulator.emulator import Emulator
from limslam_agent.live.transports import LineBuffer, datagrams

_MOST_BYTES = 65536


class UdpPort:
    """A UDP socket that sends to a host's port."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)  # noqa: FBT003 (the name says it)
        self._host = (host, port)
        self.name = f"UDP {host}:{port}"

    def receive(self, timeout: float) -> list[bytes]:
        """The lines of all datagrams that have arrived."""
        return LineBuffer().add(b"".join(data for data, _ in datagrams(self._socket, timeout)))

    def send(self, line: bytes) -> None:
        """Send a line to the host."""
        with suppress(OSError):
            self._socket.sendto(line, self._host)


class PtyPort:
    """A serial port of the operating system, which a program opens by its name like any other. Not
    on Windows. Raises a ValueError if the operating system has no such ports.
    """

    def __init__(self) -> None:
        try:
            import pty
            import tty
        except ImportError:
            raise ValueError("this operating system has no pty: use --udp") from None
        self._robot_end, self._host_end = pty.openpty()
        tty.setraw(self._host_end)  # nothing is echoed, and no byte is changed
        os.set_blocking(self._robot_end, False)
        self.name = os.ttyname(self._host_end)
        self._lines = LineBuffer()

    def receive(self, timeout: float) -> list[bytes]:
        """The lines that have arrived."""
        select.select([self._robot_end], [], [], timeout)
        try:
            return self._lines.add(os.read(self._robot_end, _MOST_BYTES))
        except BlockingIOError:
            return []

    def send(self, line: bytes) -> None:
        """Send a line. It is lost if nobody reads and the buffer is full."""
        with suppress(BlockingIOError):
            os.write(self._robot_end, line)


class RobotAtPort:
    """An emulated robot that sends its lines to a port, and hears those that come from there."""

    def __init__(self, emulator: Emulator, port: UdpPort | PtyPort) -> None:
        self._emulator = emulator
        self._port = port

    @property
    def truth(self) -> str:
        """The true pose as a line of text."""
        return self._emulator.truth

    @property
    def awaits_answer(self) -> bool:
        """Whether the host has not yet answered."""
        return self._emulator.firmware.awaits_answer

    def step(self) -> None:
        """Drive for a control period, and send what was measured."""
        for line in self._emulator.step():
            self._port.send(line)

    def listen(self, timeout: float) -> None:
        """Obey the host. Waits for its first line, at most ``timeout`` s."""
        for line in self._port.receive(timeout):
            self._emulator.hear(line)
