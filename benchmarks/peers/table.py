"""The table of a comparison: our explorers, the published figures, and for each what is like for like."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.peers.stand_ins import NAME
from benchmarks.suite.store import Row

LIDAR, POINT = "lidar", "point"
"""What rows of runs with 720 rays have as their preset, and the policy of the point without a body."""

PUBLISHED = Path(__file__).with_name("published.toml")

_HEAD = ("explorer", "sensor, pose", "maps", "done", "path, pixels", "time, s", "share seen", "ATE, m", "like for like")
_FIGURES = ("path_px", "exploration_time_s", "explored", "ate_smoothed_m")
_DIGITS = (0, 0, 3, 3)

_NOTES = {
    "a": (
        "Like for like: maps, start pixel, 720 rays of 80 pixels without noise, true pose, a scan only at the end of a "
        "straight move, the end (at most 250 free pixels unseen), and the path as a sum of straight moves. Not: the "
        "point moves by 16.6 pixels at most to the middle of any cell of 2 x 2 pixels, where the peers move along a "
        "graph of 30 x 30 nodes, by up to 47 pixels and for at most 128 moves."
    ),
    "b": (
        "Like for like: maps, rays, true pose and the end, as in a. Not: a body, wheels and a heading, so the path is "
        "made of arcs, turns cost time, and the start is the nearest pixel where the body fits; scans are 16.6 pixels "
        "apart, and one more is taken where the robot stands. The time is that of our robot's top speed. The weights "
        "of the learned explorer come from six beams of 1.5 m, not from 720 rays."
    ),
    "c": (
        "Like for like: the maps alone. Six beams of 1.5 m with noise, a pose that is not known, and walls as straight "
        "lines; the run ends when the explorer says so, and the share is of what six beams could see. None of the "
        "peers can do this, so there is no figure to compare with."
    ),
    "d": "Not like for like with any row: other maps, another vehicle, and shares instead of lengths.",
}


@dataclass(frozen=True)
class Published:
    """A published figure, in the words of its source.

    Attributes
    ----------
    name
        Who.
    path, time
        Path length and time.
    source, ground
        Where it is published, and what it was measured on.
    """

    name: str
    path: str
    time: str
    source: str
    ground: str


def read_published(path: Path = PUBLISHED) -> list[Published]:
    """The published figures of a file.

    Raises
    ------
    ValueError
        If the file is not such a file.
    """
    try:
        return [Published(**table) for table in tomllib.loads(path.read_text(encoding="utf-8"))["figure"]]
    except (KeyError, TypeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"{path}: not a file of published figures: {error}") from error


def peers_table(rows: Sequence[Row]) -> str:
    """The table in Markdown, with the notes that it refers to."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.preset, row.policy), []).append(row)
    published = read_published()
    lines = [_line(_HEAD), _line(["---"] * len(_HEAD))]
    lines += [_line(_cells(*key, group)) for key, group in sorted(groups.items(), key=_order)]
    lines += [
        _line((each.name, "published", "", "", each.path, each.time, "", "", f"d{number}"))
        for number, each in enumerate(published, 1)
    ]
    lines += [
        "",
        "Means and standard deviations over all runs that did not fail, also over those that were not done.",
        "",
    ]
    if any(row.world.startswith(NAME) for row in rows):
        lines += ["**These maps are stand-ins, not the maps of the peers.**", ""]
    lines += [f"- {mark}: {note}" for mark, note in _NOTES.items()]
    lines += [f"- d{number}: {each.source}; {each.ground}." for number, each in enumerate(published, 1)]
    return "\n".join(lines) + "\n"


def _order(item: tuple[tuple[str, str], list[Row]]) -> tuple[bool, bool, str]:
    (preset, policy), _ = item
    return preset != LIDAR, policy != POINT, policy


def _cells(preset: str, policy: str, rows: Sequence[Row]) -> list[str]:
    """The cells of an explorer."""
    good = [row for row in rows if row.error is None]
    is_lidar = preset == LIDAR
    done = sum(int(row.metrics["is_done"] or 0) for row in good)
    figures = [_figure(good, name, digits) for name, digits in zip(_FIGURES, _DIGITS, strict=True)]
    figures[-1] = "true pose" if is_lidar else figures[-1]
    name = "nearest frontier, a point" if policy == POINT else policy
    sensor = "720 rays, true pose" if is_lidar else "six beams, unknown pose"
    failed = "" if len(good) == len(rows) else f" ({len(rows) - len(good)} failed)"
    mark = "a" if policy == POINT else "b" if is_lidar else "c"
    return [name, sensor, f"{len(good)}{failed}", str(done), *figures, mark]


def _figure(rows: Sequence[Row], name: str, digits: int) -> str:
    """Mean and standard deviation of a metric, over the rows that have it."""
    values = np.array([row.metrics[name] for row in rows if row.metrics.get(name) is not None], dtype=float)
    return f"{values.mean():.{digits}f} ± {values.std():.{digits}f}" if len(values) else ""


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
