"""The line protocol between a robot and its host: pure functions from messages to lines and back.

A line is ``LETTER,field,...*CHECK`` and ends with a newline. The fields are decimal numbers. ``CHECK`` is the checksum
of everything before the asterisk: CRC-16 with the polynomial 0x1021 and the initial value 0xFFFF, as four hexadecimal
digits. ``docs/live.md`` describes each message, and ``examples/live/limslam_link.c`` is the same in C.
"""

import binascii
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

VERSION = 1
"""Version of the protocol. Robot and host must speak the same version."""

MAX_BEAMS = 64
LONGEST_LINE = 512
"""Most bytes of a line, with its end."""

NOTHING_SEEN = 65535
"""Range that says that a beam saw nothing up to its maximum, in place of mm."""

NO_READING = "-"
"""Stands in place of a range where a beam has no new reading."""

_SPAN = 1 << 32


class BadLineError(ValueError):
    """A line is not a message: it is damaged, or something else was printed."""


@dataclass(frozen=True)
class Hello:
    """``H``, robot to host: what the robot is.

    Attributes
    ----------
    version
        Version of the protocol.
    boot
        A number that differs each time the robot is switched on.
    name
        Name of the robot: 1 to 24 letters, digits, ``_``, ``.`` or ``-``.
    beams
        Number of range readings in each telemetry line.
    nm_per_tick
        Wheel travel for each tick, nm.
    period_ms
        Time between two telemetry lines, ms.
    watchdog_ms
        Time without a line from the host after which the robot stops its wheels, ms.
    """

    version: int
    boot: int
    name: str
    beams: int
    nm_per_tick: int
    period_ms: int
    watchdog_ms: int


@dataclass(frozen=True)
class Telemetry:
    """``S``, robot to host: what the robot has measured.

    Attributes
    ----------
    seq
        Sequence number, one more in each line.
    time_ms
        Clock of the robot at the measurement, ms.
    left, right
        Ticks of the wheels since the robot was switched on. They count on, so that a lost line loses no travel.
    ack
        Sequence number of the newest command that the robot has obeyed.
    stopped
        1 if the watchdog has stopped the wheels since the last command of speeds, else 0.
    ranges
        Reading of each beam, mm. None where there is no new reading, ``NOTHING_SEEN`` where nothing was seen.
    """

    seq: int
    time_ms: int
    left: int
    right: int
    ack: int
    stopped: int
    ranges: tuple[int | None, ...]


@dataclass(frozen=True)
class Greeting:
    """``Q``, host to robot: begin to send telemetry. Commands have larger sequence numbers than ``seq``."""

    version: int
    seq: int


@dataclass(frozen=True)
class Speeds:
    """``V``, host to robot: turn the wheels at ``left`` and ``right`` mm/s. It answers the telemetry ``answers``."""

    seq: int
    answers: int
    left: int
    right: int


@dataclass(frozen=True)
class Heartbeat:
    """``P``, host to robot: the host is alive, and the latest speeds still hold."""

    seq: int


@dataclass(frozen=True)
class Stop:
    """``X``, host to robot: stop the wheels. It is obeyed even if it is late."""

    seq: int


Message: TypeAlias = Hello | Telemetry | Greeting | Speeds | Heartbeat | Stop
Command: TypeAlias = Greeting | Speeds | Heartbeat | Stop


class _Number(NamedTuple):
    """A whole number within limits."""

    low: int
    high: int

    def read(self, word: str) -> int:
        if not re.fullmatch(r"-?[0-9]{1,10}", word, re.ASCII):
            raise BadLineError(f"{word!r} is not a whole number")
        return self.checked(int(word))

    def checked(self, value: object) -> int:
        if not isinstance(value, int) or not self.low <= value <= self.high:
            raise BadLineError(f"{value!r} is not a number from {self.low} to {self.high}")
        return value


class _Name(NamedTuple):
    """The name of a robot."""

    def read(self, word: str) -> str:
        return self.checked(word)

    def checked(self, value: object) -> str:
        if not isinstance(value, str) or not re.fullmatch(r"[A-Za-z0-9_.-]{1,24}", value, re.ASCII):
            raise BadLineError(f"{value!r} is not a name of 1 to 24 letters, digits, '_', '.' or '-'")
        return value


_U8, _U16, _U32 = _Number(0, 255), _Number(0, 65535), _Number(0, _SPAN - 1)
_I16, _I32 = _Number(-(1 << 15), (1 << 15) - 1), _Number(-(1 << 31), (1 << 31) - 1)
_AMOUNT = _Number(1, 65535)
_Layout: TypeAlias = dict[str, _Number | _Name]
_LAYOUTS: dict[str, tuple[Callable[..., Message], _Layout]] = {
    "H": (Hello, {
        "version": _U8, "boot": _U32, "name": _Name(), "beams": _Number(1, MAX_BEAMS),
        "nm_per_tick": _Number(1, _SPAN - 1), "period_ms": _AMOUNT, "watchdog_ms": _AMOUNT,
    }),
    "S": (Telemetry, {
        "seq": _U32, "time_ms": _U32, "left": _I32, "right": _I32, "ack": _U32, "stopped": _Number(0, 1),
    }),
    "Q": (Greeting, {"version": _U8, "seq": _U32}),
    "V": (Speeds, {"seq": _U32, "answers": _U32, "left": _I16, "right": _I16}),
    "P": (Heartbeat, {"seq": _U32}),
    "X": (Stop, {"seq": _U32}),
}  # fmt: skip
_LETTERS = {kind: letter for letter, (kind, _) in _LAYOUTS.items()}


def encode(message: Message) -> bytes:
    """The line of a message, with its checksum and its newline.

    Raises
    ------
    BadLineError
        If a value is out of bounds.
    """
    letter = _LETTERS[type(message)]
    words = [letter, *(str(kind.checked(getattr(message, name))) for name, kind in _LAYOUTS[letter][1].items())]
    if isinstance(message, Telemetry):
        _check_count(len(message.ranges))
        words += [NO_READING if each is None else str(_U16.checked(each)) for each in message.ranges]
    body = ",".join(words).encode("ascii")
    return b"%s*%04X\n" % (body, checksum(body))


def decode(line: bytes) -> Message:
    """The message of a line, with or without its newline.

    Raises
    ------
    BadLineError
        If the line is not a message. Nothing else is raised, whatever the line holds.
    """
    line = line.removesuffix(b"\n").removesuffix(b"\r")
    body, asterisk, check = line.rpartition(b"*")
    if len(line) >= LONGEST_LINE or not asterisk or check != b"%04X" % checksum(body):
        raise BadLineError("the checksum is wrong")
    letter, *words = body.decode("latin-1").split(",")
    if letter not in _LAYOUTS:
        raise BadLineError(f"there is no message {letter!r}")
    kind, layout = _LAYOUTS[letter]
    words, rest = words[: len(layout)], words[len(layout) :]
    if len(words) < len(layout) or (rest and kind is not Telemetry):
        raise BadLineError(f"a message {letter} has {len(layout)} fields")
    values: dict[str, Any] = {name: each.read(word) for (name, each), word in zip(layout.items(), words, strict=True)}
    if kind is not Telemetry:
        return kind(**values)
    _check_count(len(rest))
    return kind(**values, ranges=tuple(None if word == NO_READING else _U16.read(word) for word in rest))


def checksum(body: bytes) -> int:
    """CRC-16 with the polynomial 0x1021 and the initial value 0xFFFF (CRC-16/CCITT-FALSE)."""
    return binascii.crc_hqx(body, 0xFFFF)


def difference(new: int, old: int) -> int:
    """How far a counter of 32 bits has come, from ``old`` to ``new``. It may have overflowed, or step back."""
    return (new - old + _SPAN // 2) % _SPAN - _SPAN // 2


def _check_count(beams: int) -> None:
    if not 1 <= beams <= MAX_BEAMS:
        raise BadLineError(f"there are 1 to {MAX_BEAMS} ranges, not {beams}")
