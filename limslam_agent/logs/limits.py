"""How much of a log is read before it is refused."""

MAX_BYTES = 256_000_000
"""Largest log that is read by default: of a text its unpacked bytes, of a ``log.npz`` those of its arrays, of a bag
those of its messages.
"""

_LEAST_BYTES = 256  # that a line or a message counts for: short ones take as much memory
MOST_BEAMS = 4096
"""Most beams of a scan or columns of a table."""


class Counted:
    """The size of what has been read, in bytes, up to a largest one."""

    def __init__(self, most: int) -> None:
        self._most, self._count = most, 0

    def add(self, count: int) -> None:
        """Count a line or a message.

        Raises
        ------
        ValueError
            If the log is too large. The message names the option of the command line.
        """
        self._count += max(count, _LEAST_BYTES)
        if self._count > self._most:
            raise ValueError(f"is larger than {self._most / 1e6:g} MB: --max-size raises this limit")


def check_beams(count: int) -> None:
    """Refuse too many beams.

    Raises
    ------
    ValueError
        If there are more than ``MOST_BEAMS``.
    """
    if count > MOST_BEAMS:
        raise ValueError(f"a scan has {count} beams, more than {MOST_BEAMS}")
