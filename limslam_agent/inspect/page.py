"""The page: one HTML file that holds the recording, the program that plays it, and all that the
program needs.
"""

import html
import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from limslam_agent.inspect.columns import packed
from limslam_agent.output.atomic_write import atomic_write
from limslam_agent.video.narration import LESSONS

SCRIPTS = ("data.js", "scene.js", "panels.js", "plots.js", "orders.js", "app.js")
"""The program, in the order in which its parts are loaded."""

_HERE = "limslam_agent.inspect"

EXPLANATIONS = {
    "waits": (
        "Wait: this line is not used yet.",
        "A wrong association would spoil the map, so doubtful points wait.",
    ),
    "status": (
        "The status has changed.",
        "Readings that contradict the map, or an uncertain heading, change it.",
    ),
    "place": (
        "The robot's place is in question.",
        "A lost robot maps in a local frame until its place is clear.",
    ),
    "restart": (
        "Start again: the odometry has constant errors.",
        "The filter estimates wheels and axle, and processes all observations again.",
    ),
    "handover": (
        "The online graph goes on.",
        "The filter is lost or doubtful. The replay's path is the graph's from here on, not shown.",
    ),
    "kidnap": (
        "The robot is carried to another place.",
        "Nothing tells the agent: it has to notice by itself.",
    ),
}
"""Headline and explanation of the events that no film explains."""

MERGED = (
    "Close the loop: two walls of the map are the same wall.",
    "Both become one wall, which corrects map and pose.",
)
"""What a loop is for an estimator that merges walls."""


@cache
def part(package: str, name: str, folder: str = "page") -> str:
    """The text of a part of a page, from a folder of a package."""
    return files(package).joinpath(folder, name).read_text(encoding="utf-8")


def parts_of_pages(style: str) -> dict[str, str]:
    """The parts of all pages: the vendored plotting library, whose style sheet comes before a
    page's own.
    """
    return {
        "STYLE": part(_HERE, "uPlot.min.css", "vendor") + style,
        "LICENSE": part(_HERE, "LICENSE.uPlot", "vendor").replace(
            "--", "- -"
        ),  # the text of an HTML comment
        "LIBRARY": part(_HERE, "uPlot.iife.min.js", "vendor"),
    }


def page(title: str, recording: str = "") -> str:
    """The text of the HTML file, from what was run, in one line, and the recording as text. Without
    one, the page asks the server it comes from for it, again and again.
    """
    own = {
        "TITLE": html.escape(title, quote=False),
        "SCRIPT": "\n".join(part(_HERE, name) for name in SCRIPTS),
        "DATA": recording,
    }
    return filled(part(_HERE, "page.html"), parts_of_pages(part(_HERE, "style.css")) | own)


def content_of(title: str, meta: Mapping[str, Any]) -> dict[str, Any]:
    """The table of a recording with the title and the texts for students."""
    lessons = {
        kind: (caption.headline, caption.explanation) for kind, caption in LESSONS.items()
    } | EXPLANATIONS
    lessons |= {"loop": MERGED} if meta["merges"] else {}
    return {**meta, "title": title, "lessons": lessons}


def filled(template: str, parts: Mapping[str, str]) -> str:
    """A template with a part in place of each ``@@NAME@@``. The parts themselves stay as they
    are.
    """
    return re.sub("@@([A-Z]+)@@", lambda found: parts[found[1]], template)


def write_page(
    path: Path, title: str, arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]
) -> int:
    """Write the HTML file, which appears only when it is complete. Returns its size in bytes.
    Raises an OSError if it cannot be written there.
    """
    content = page(title, packed(arrays, content_of(title, meta))).encode()
    with atomic_write(path) as beside:
        beside.write_bytes(content)
    return len(content)
