"""The page on which a world is drawn: one HTML file that asks nothing from a network."""

import base64
import html
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from limslam_agent.inspect.page import filled, part
from limslam_agent.output.atomic_write import atomic_write
from limslam_agent.safe_files import read_limited

_HERE = "limslam_agent.draw"

SCRIPTS = ("rules.js", "draw.js")
"""The program, in the order in which its parts are loaded."""

MAX_PICTURE_BYTES = 20_000_000

_KINDS = {
    ".png": "png",
    ".jpg": "jpeg",
    ".jpeg": "jpeg",
    ".gif": "gif",
    ".bmp": "bmp",
    ".webp": "webp",
}


def picture_address(path: Path) -> str:
    """A picture as an address that holds all of it; a ValueError where no browser shows its
    kind.
    """
    kind = _KINDS.get(path.suffix.lower())
    if kind is None:
        raise ValueError(f"{path}: a picture to draw over ends in {', '.join(_KINDS)}")
    content = base64.b64encode(read_limited(path, MAX_PICTURE_BYTES)).decode()
    return f"data:image/{kind};base64,{content}"


def write_drawing_page(
    path: Path, world: Mapping[str, Any], radius: float, picture: str = ""
) -> int:
    """Write the page, with the table of a world as its file has it, the radius of the robot (m)
    that the page checks for, and the address of a picture. Returns its size in bytes.
    """
    told = json.dumps({"world": world, "radius": radius, "picture": picture}, allow_nan=False)
    parts = {
        "TITLE": html.escape(world["name"], quote=False),
        "STYLE": part("limslam_agent.inspect", "style.css") + part(_HERE, "draw.css"),
        "SCRIPT": "\n".join(part(_HERE, name) for name in SCRIPTS),
        "DATA": told.replace("<", "\\u003c"),
    }
    content = filled(part(_HERE, "draw.html"), parts).encode()
    with atomic_write(path) as beside:
        beside.write_bytes(content)
    return len(content)
