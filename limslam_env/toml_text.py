"""Reads TOML that anybody may have made."""

import re
import tomllib
from typing import Any

MOST_PARTS = 10
"""Most parts of a key, as in ``agent.grid.cell``, which has three."""

# Texts and comments. One that does not end reaches to the end of its line or of the file, so that
# no byte is looked at twice.
_QUOTED = re.compile(
    r'"""(?:[^\\]|\\.)*?(?:"""|\\?\Z)'
    r"|'''.*?(?:'''|\Z)"
    r'|"(?:[^"\\\n]|\\[^\n])*+"?'
    r"|'[^'\n]*+'?"
    r"|#[^\n]*+",
    re.DOTALL,
)
_LONG_KEY = re.compile(rf"(?:(?<![\w-])[\w-]++[ \t]*+\.[ \t]*+){{{MOST_PARTS}}}")


def read_toml_text(text: str) -> dict[str, Any]:
    """The tables of a TOML text.

    The parser takes time and memory that grow with the square of the number of parts of a key.

    Raises
    ------
    ValueError
        If the text is not TOML, a key has more than ``MOST_PARTS`` parts, or tables are nested too
        deeply.
    """
    found = _LONG_KEY.search(_QUOTED.sub("_", text))
    if found is not None:
        raise ValueError(f"a key has more than {MOST_PARTS} parts: {found[0][:40]}")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("its tables and lists are nested too deeply") from error
