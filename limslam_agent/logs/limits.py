"""How much of a log is read before it is refused."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Largest log that is read. A larger log is refused with a message that names the limit.

    Attributes
    ----------
    max_bytes
        Most bytes: of a text the unpacked ones, of a ``log.npz`` those of its arrays, of a bag those of the messages.
    max_events
        Most lines of a text, steps of a ``log.npz``, or messages of a bag.
    max_beams
        Most beams of a scan or columns of a table.

    Raises
    ------
    ValueError
        If a limit is not a positive whole number.
    """

    max_bytes: int = 256_000_000
    max_events: int = 1_000_000
    max_beams: int = 4096

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if type(value) is not int or value < 1:
                raise ValueError(f"{name} must be a positive whole number, not {value!r}")

    def check_bytes(self, count: int) -> None:
        """Refuse too many bytes.

        Raises
        ------
        ValueError
            If there are more than ``max_bytes``.
        """
        if count > self.max_bytes:
            raise ValueError(f"is larger than {self.max_bytes / 1e6:g} MB: --max-size raises this limit")

    def check_events(self, count: int, what: str) -> None:
        """Refuse too many lines, steps or messages, which ``what`` names.

        Raises
        ------
        ValueError
            If there are more than ``max_events``.
        """
        if count > self.max_events:
            raise ValueError(f"has more than {self.max_events} {what}: --max-events raises this limit")

    def check_beams(self, count: int) -> None:
        """Refuse too many beams.

        Raises
        ------
        ValueError
            If there are more than ``max_beams``.
        """
        if count > self.max_beams:
            raise ValueError(f"a scan has more than {self.max_beams} beams: --max-beams raises this limit")


DEFAULT_LIMITS = Limits()
