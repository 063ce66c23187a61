"""Where the emulated robot is plugged in: a UDP socket, or a serial port of the operating system (pty)."""

import os
import select
import socket
from contextlib import suppress
from typing import TypeAlias

from limslam_agent.live.transports import LineBuffer

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
        select.select([self._socket], [], [], timeout)
        lines: list[bytes] = []
        with suppress(BlockingIOError, ConnectionError):
            while True:
                lines += LineBuffer().add(self._socket.recv(_MOST_BYTES) + b"\n")
        return lines

    def send(self, line: bytes) -> None:
        """Send a line to the host."""
        with suppress(OSError):
            self._socket.sendto(line, self._host)


class PtyPort:
    """A serial port of the operating system, which a program opens by its name like any other. Not on Windows. Raises a
    ValueError if the operating system has no such ports.
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
        self.name, self._lines = os.ttyname(self._host_end), LineBuffer()

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


Port: TypeAlias = UdpPort | PtyPort
"""The robot's end of a connection."""
