"""Where lines come from and go to: a serial port, or a UDP socket."""

import select
import socket
import time
from contextlib import suppress
from typing import TYPE_CHECKING, TypeAlias

from limslam_agent.live.protocol import LONGEST_LINE

if TYPE_CHECKING:
    import serial

REOPEN_AFTER = 0.5
"""Time between two attempts to open a serial port that was unplugged, s."""

SILENT_AFTER = 1.0
"""Time after which a robot is no longer heard, so that another one may take its place, s."""

LAST_PORT = 65535

_MOST_BYTES = 65536


class LineBuffer:
    """Cuts a stream of bytes into lines. A line that is too long is cut, so that noise cannot fill
    the memory.
    """

    def __init__(self) -> None:
        self._rest = b""

    def add(self, data: bytes) -> list[bytes]:
        """The lines, without their ends, that are complete with these bytes. Empty lines are left
        out.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-LONGEST_LINE:]
        return [line.rstrip(b"\r") for line in lines if line.strip()]


def datagrams(source: socket.socket, timeout: float) -> list[tuple[bytes, tuple[str, int]]]:
    """The datagrams that have arrived, each ended as a line, and their senders. Waits at most
    ``timeout`` s.
    """
    select.select([source], [], [], timeout)
    found = []
    # On Windows, a datagram that could not be delivered is reported by the next read.
    with suppress(BlockingIOError, ConnectionError):
        while True:
            data, sender = source.recvfrom(_MOST_BYTES)
            found.append((data + b"\n", sender))
    return found


class UdpTransport:
    """A UDP socket on which the host listens. The robot finds the host, and says hello.

    The first robot that says hello is the one that is driven. Datagrams of other senders are
    ignored until that robot has been silent for a second. The host listens on all of its addresses;
    the port 0 chooses a free one. Raises a ValueError if it is no number of a port, and an OSError
    if the port cannot be used.
    """

    def __init__(self, port: int) -> None:
        if not 0 <= port <= LAST_PORT:
            raise ValueError(f"a UDP port is a number up to {LAST_PORT}, not {port}")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(("", port))
        except OSError as error:
            self._socket.close()
            raise OSError(error.errno, error.strerror, f"UDP port {port}") from error
        self._socket.setblocking(False)  # noqa: FBT003 (the name says it)
        self._robot: tuple[str, int] | None = None
        self._heard = 0.0
        self.port: int = self._socket.getsockname()[1]

    def receive(self, timeout: float) -> list[bytes]:
        """The lines of all datagrams that have arrived."""
        arrived = [
            data
            for data, sender in datagrams(self._socket, timeout)
            if self._is_robot(data, sender)
        ]
        return [line for data in arrived for line in LineBuffer().add(data)]

    def _is_robot(self, data: bytes, sender: tuple[str, int]) -> bool:
        now = time.monotonic()
        is_vacant = self._robot is None or now - self._heard > SILENT_AFTER
        if is_vacant and data.startswith(b"H,"):
            self._robot = sender
        if sender != self._robot:
            return False
        self._heard = now
        return True

    def send(self, line: bytes) -> None:
        """Send a line to the robot, if one has said hello."""
        with suppress(OSError):  # the network may be away
            if self._robot is not None:
                self._socket.sendto(line, self._robot)

    def close(self) -> None:
        """Free the port."""
        self._socket.close()


class SerialTransport:
    """A serial port, like ``/dev/ttyUSB0`` or ``COM3``. If it is unplugged, it is opened again as
    soon as it is back. Raises a ValueError if pyserial is not installed, or the port cannot be
    opened.
    """

    def __init__(self, port: str, baud: int) -> None:
        try:
            import serial
        except ImportError:
            raise ValueError("a serial port needs pyserial: pip install 'limslam[live]'") from None
        self._serial, self._name, self._baud = serial, port, baud
        self._lines, self._next_attempt = LineBuffer(), 0.0
        try:
            self._port: serial.Serial | None = self._opened()
        except (OSError, ValueError) as error:
            raise ValueError(f"{port}: cannot be opened: {error}") from error

    def receive(self, timeout: float) -> list[bytes]:
        """The lines that have arrived."""
        if self._port is None and not self._is_back(timeout):
            return []
        assert self._port is not None  # noqa: S101 (it is back)
        try:
            self._port.timeout = timeout
            data = self._port.read(1)
            return self._lines.add(data + self._port.read(self._port.in_waiting))
        except OSError:  # pyserial's own errors are of this kind
            self.close()
            return []

    def send(self, line: bytes) -> None:
        """Send a line, if the port is open."""
        try:
            if self._port is not None:
                self._port.write(line)
        except OSError:
            self.close()

    def close(self) -> None:
        """Free the port."""
        if self._port is not None:
            with suppress(OSError):
                self._port.close()
        self._port, self._lines = None, LineBuffer()

    def _opened(self) -> "serial.Serial":
        return self._serial.Serial(self._name, self._baud, timeout=0.0, write_timeout=0.2)

    def _is_back(self, timeout: float) -> bool:
        """Try to open the port again, at most twice a second."""
        if time.monotonic() >= self._next_attempt:
            self._next_attempt = time.monotonic() + REOPEN_AFTER
            with suppress(OSError, ValueError):
                self._port = self._opened()
                return True
        time.sleep(timeout)
        return False


Transport: TypeAlias = UdpTransport | SerialTransport
"""A connection to a robot. A lost connection is no error: nothing arrives until it is back."""
