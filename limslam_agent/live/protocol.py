"""The line protocol between a robot and its host: pure functions from messages to lines and back.

A line is ``LETTER,field,...*CHECK`` and ends with a newline. The fields are decimal numbers.
``CHECK`` is the checksum of everything before the asterisk: CRC-16 with the polynomial 0x1021 and
the initial value 0xFFFF, as four hexadecimal digits. ``docs/live.md`` describes each message, and
``examples/live/limslam_link.c`` is the same in C.
"""

import binascii
import re
from dataclasses import dataclass, fields
from typing import Annotated, Any, TypeAlias

from limslam_agent.config.bounds import Bounds, bounds_of

VERSION = 2
"""Version of the protocol."""

OLDEST = 1
"""The oldest version that a robot may speak. Its telemetry has no headings."""

MAX_BEAMS = 64
LONGEST_LINE = 512
"""Most bytes of a line, with its end."""

NOTHING_SEEN = 65535
"""Range that says that a beam saw nothing up to its maximum, in place of mm."""

NO_READING = "-"
"""Stands in place of a range where a beam has no new reading."""

_SPAN = 1 << 32
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,24}", re.ASCII)
_NUMBER = re.compile(r"-?[0-9]{1,10}", re.ASCII)

_U8 = Annotated[int, Bounds(0, 255)]
_U32 = Annotated[int, Bounds(0, _SPAN - 1)]
_I16 = Annotated[int, Bounds(-(1 << 15), (1 << 15) - 1)]
_I32 = Annotated[int, Bounds(-(1 << 31), (1 << 31) - 1)]
_Amount = Annotated[int, Bounds(1, 65535)]


class BadLineError(ValueError):
    """A line is not a message: it is damaged, or something else was printed."""


@dataclass(frozen=True)
class Hello:
    """``H``, robot to host: what the robot is."""

    version: _U8  # of the protocol
    boot: _U32  # a number that differs each time the robot is switched on
    name: str  # of the robot: 1 to 24 letters, digits, ``_``, ``.`` or ``-``
    beams: Annotated[int, Bounds(1, MAX_BEAMS)]  # number of range readings in each telemetry line
    nm_per_tick: Annotated[int, Bounds(1, _SPAN - 1)]  # wheel travel for each tick, nm
    period_ms: _Amount  # time between two telemetry lines, ms
    # time without a line from the host after which the robot stops its wheels, ms
    watchdog_ms: _Amount
    # From version 2 on, what a host in a network knows its robots by: letters as in a name, or None
    token: str | None = None


@dataclass(frozen=True)
class Telemetry:
    """``S``, or ``T`` with a heading before the ranges, robot to host: what the robot has
    measured.
    """

    seq: _U32  # one more in each line
    time_ms: _U32  # clock of the robot at the measurement, ms
    # Ticks of the wheels since the robot was switched on. They count on, so that a lost line loses
    # no travel.
    left: _I32
    right: _I32
    ack: _U32  # sequence number of the newest command that the robot has obeyed
    stopped: Annotated[
        int, Bounds(0, 1)
    ]  # 1 if the watchdog has stopped the wheels since the last command of speeds
    # Reading of each beam, mm. None where there is no new reading, ``NOTHING_SEEN`` where nothing
    # was seen.
    ranges: tuple[int | None, ...]
    # Heading by an inertial measurement unit, thousandths of a degree, counter-clockwise from any
    # direction, that may count on beyond a full turn. None where there is no new reading.
    yaw: int | None = None


@dataclass(frozen=True)
class Greeting:
    """``Q``, host to robot: begin to send telemetry. Commands have larger sequence numbers than
    ``seq``.
    """

    version: _U8
    seq: _U32


@dataclass(frozen=True)
class Speeds:
    """``V``, host to robot: turn the wheels at ``left`` and ``right`` mm/s. It answers the
    telemetry ``answers``.
    """

    seq: _U32
    answers: _U32
    left: _I16
    right: _I16


@dataclass(frozen=True)
class Heartbeat:
    """``P``, host to robot: the host is alive, and the latest speeds still hold."""

    seq: _U32


@dataclass(frozen=True)
class Stop:
    """``X``, host to robot: stop the wheels. It is obeyed even if it is late."""

    seq: _U32


Message: TypeAlias = Hello | Telemetry | Greeting | Speeds | Heartbeat | Stop
Command: TypeAlias = Greeting | Speeds | Heartbeat | Stop

_KINDS: dict[str, type[Message]] = {
    "H": Hello,
    "S": Telemetry,
    "Q": Greeting,
    "V": Speeds,
    "P": Heartbeat,
    "X": Stop,
}
_LETTERS = {kind: letter for letter, kind in _KINDS.items()}
_FIELDS = {
    kind: [field.name for field in fields(kind) if field.name not in {"ranges", "yaw", "token"}]
    for kind in _LETTERS
}
_WITH_HEADING = "T"
_WORDS = {"name", "token"}

NAME_RULE = "a name of 1 to 24 letters, digits, '_', '.' or '-'"
"""What a robot may be called, and what a token may be, in words."""


def encode(message: Message) -> bytes:
    """The line of a message, with its checksum and its newline. Raises a BadLineError if a value is
    out of bounds.
    """
    kind = type(message)
    words = [_LETTERS[kind], *(str(getattr(message, name)) for name in _FIELDS[kind])]
    has_heading = isinstance(message, Telemetry) and message.yaw is not None
    if isinstance(message, Telemetry):
        if has_heading:
            words[0] = _WITH_HEADING
            words.append(str(message.yaw))
        words += [NO_READING if each is None else str(each) for each in message.ranges]
    if isinstance(message, Hello) and message.token is not None:
        words.append(message.token)
    _read(kind, words[1:], has_heading=has_heading)
    body = ",".join(words).encode("ascii")
    return b"%s*%04X\n" % (body, checksum(body))


def decode(line: bytes) -> Message:
    """The message of a line, with or without its newline. Raises a BadLineError if the line is not
    a message. Nothing else is raised, whatever the line holds.
    """
    line = line.removesuffix(b"\n").removesuffix(b"\r")
    body, asterisk, check = line.rpartition(b"*")
    if len(line) >= LONGEST_LINE:
        raise BadLineError(f"it has more than {LONGEST_LINE} bytes")
    right = b"%04X" % checksum(body if asterisk else line)
    if check != right or not asterisk:
        raise BadLineError(f"it must end with *{right.decode()}")
    letter, *words = body.decode("latin-1").split(",")
    if letter == _WITH_HEADING:
        return _read(Telemetry, words, has_heading=True)
    if letter not in _KINDS:
        raise BadLineError(f"there is no message {letter!r}")
    return _read(_KINDS[letter], words)


def _read(kind: type[Message], words: list[str], *, has_heading: bool = False) -> Message:
    """The message of a kind from the words of its line."""
    names = [*_FIELDS[kind], "yaw"] if has_heading else _FIELDS[kind]
    if kind is Hello and len(words) > len(names) and words[0] != str(OLDEST):
        names = [*names, "token"]
    count = len(words) - len(names)
    if not (1 <= count <= MAX_BEAMS if kind is Telemetry else count == 0):
        raise BadLineError(
            f"a message {_LETTERS[kind]} has {len(names)} fields; telemetry has 1 to {MAX_BEAMS} "
            "ranges"
        )
    values: dict[str, Any] = {
        name: word if name in _WORDS else _number(word)
        for name, word in zip(names, words, strict=False)
    }
    if kind is Telemetry:
        values["ranges"] = tuple(
            None if word == NO_READING else _number(word) for word in words[len(names) :]
        )
    for name in _WORDS & values.keys():
        if not is_name(values[name]):
            raise BadLineError(f"{values[name]!r} is not {NAME_RULE}")
    if any(each is not None and not 0 <= each <= NOTHING_SEEN for each in values.get("ranges", ())):
        raise BadLineError(f"a range is not a number from 0 to {NOTHING_SEEN}")
    if not -_SPAN // 2 <= values.get("yaw", 0) < _SPAN // 2:
        raise BadLineError("a heading has 32 bits with a sign")
    try:
        for name, bounds in bounds_of(kind):  # type: ignore[arg-type] # mypy takes a class for its object
            bounds.check(name, values[name])
    except ValueError as error:
        raise BadLineError(str(error)) from None
    return kind(**values)


def _number(word: str) -> int:
    if not _NUMBER.fullmatch(word):
        raise BadLineError(f"{word!r} is not a whole number of 10 digits at most")
    return int(word)


def is_name(word: str) -> bool:
    """Whether a word may be the name of a robot, or a token."""
    return _NAME.fullmatch(word) is not None


def checksum(body: bytes) -> int:
    """CRC-16 with the polynomial 0x1021 and the initial value 0xFFFF (CRC-16/CCITT-FALSE)."""
    return binascii.crc_hqx(body, 0xFFFF)


def difference(new: int, old: int) -> int:
    """How far a counter of 32 bits has come, from ``old`` to ``new``. It may have overflowed, or
    step back.
    """
    return (new - old + _SPAN // 2) % _SPAN - _SPAN // 2
