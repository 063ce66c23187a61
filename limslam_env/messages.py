"""Text from files and from users in messages: short, on one line, and without characters that
control a terminal.
"""

import functools
import os
import sys
from numbers import Real

QUIET = "LIMSLAM_QUIET"
"""Name of the environment variable that switches off the messages about what takes long, if it is
not empty.
"""

LONGEST_MESSAGE = 500
"""Most characters of a refusal. A longer message keeps its beginning, with the file, and its end,
with the reason.
"""

LONGEST_VALUE = 200
"""Most characters of a value in a message."""

_CUT = " ... "


def printable(text: str) -> str:
    """A text in which each character that a terminal cannot print is written as its escape."""
    return "".join(
        letter
        if letter.isprintable()
        else letter.encode("unicode_escape", "surrogatepass").decode("ascii")
        for letter in text
    )


def one_line(text: str, longest: int = LONGEST_MESSAGE) -> str:
    """A message on one line, printable, and with at most ``longest`` characters."""
    # Of a very long text only the ends are looked at.
    ends = (
        text if len(text) <= 20 * longest else text[: 10 * longest] + _CUT + text[-10 * longest :]
    )
    line = printable(" ".join(ends.split()))
    if len(line) <= longest:
        return line
    head = (longest - len(_CUT)) // 2
    return line[:head] + _CUT + line[-(longest - len(_CUT) - head) :]


def described(value: object) -> str:
    """What a value looks like, for a message: at most 200 characters, whatever it is."""
    try:
        # Numbers of numpy look like others.
        text = str(value) if isinstance(value, Real) else repr(value)
    except ValueError:  # a whole number with thousands of digits
        text = f"a very large {type(value).__name__}"
    return one_line(text, LONGEST_VALUE)


def counted(number: int, noun: str) -> str:
    """A number with its noun: "1 lap", "4 laps"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def announce(text: str) -> None:
    """Say on stderr what takes long, so that nobody wonders what is being done."""
    if not os.environ.get(QUIET):
        print(f"limslam: {text}", file=sys.stderr, flush=True)  # noqa: T201


announce_once = functools.cache(announce)
"""The same, at most once for each text."""
