"""Reads text in TOML that anybody may have written."""

import re
import tomllib
from typing import Any

MOST_DOTS = 32
"""Most dots of a key. Python's parser takes time and memory with the square of their number."""

_QUOTED = re.compile(r"\"(?:[^\"\\]|\\.)*\"|'[^']*'")
_SEPARATORS = re.compile(r"[,=\[\]{}#]")


def parse_toml(text: str) -> dict[str, Any]:
    """The table in a text.

    Raises
    ------
    ValueError
        If the text is not TOML, or a key has more than ``MOST_DOTS`` dots.
    """
    for number, line in enumerate(text.splitlines(), start=1):
        if line.count(".") > MOST_DOTS and not line.lstrip().startswith("#"):
            parts = _SEPARATORS.split(_QUOTED.sub("", line))
            if max(part.count(".") for part in parts) > MOST_DOTS:
                raise ValueError(f"line {number}: a key has more than {MOST_DOTS} dots")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("too many brackets are open at once") from error
