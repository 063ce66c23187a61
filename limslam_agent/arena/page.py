"""The leaderboard as text, and as one HTML file that asks nothing from a network."""

import json
import os
from pathlib import Path
from typing import Any

from limslam_agent.arena.leaderboard import Board, Standing
from limslam_agent.arena.results import RUNS, Row
from limslam_agent.arena.tracks import MAX_TIME
from limslam_agent.inspect.page import filled, part, parts_of_pages
from limslam_agent.measurements.statistics import number
from limslam_agent.output.atomic_write import atomic_write

_HERE = "limslam_agent.arena"

INSPECTOR = "inspect.html"
"""The page that ``limslam inspect`` writes into the folder of a run."""

# The metrics of a plan that the page shows: name, heading and decimals.
_SHOWN = (
    ("time_to_80_s", "80 % after, s", 1),
    ("plan_time_to_95_s", "95 % after, s", 1),
    ("correct_coverage", "Correct coverage", 3),
    ("ate_final_m", "ATE, m", 3),
    ("wall_f1_5cm", "F1 at 5 cm", 3),
    ("anees_final", "NEES/3", 3),
    ("touches", "Touches", 0),
)

# The columns of the text: heading, and name and decimals of a figure, or what is counted.
_COLUMNS = {
    "95 % after, s": ("score", 1),
    "80 %, s": ("plan_time_to_80_s", 1),
    "solved": ("solved", 0),
    "false claims": ("claimed", 0),
    "ATE, m": ("ate_final_m", 3),
    "F1 5 cm": ("wall_f1_5cm", 3),
    "NEES/3": ("anees_final", 2),
    "touches": ("touches", 2),
    "CPU, s": ("cpu_s", 1),
}


def table_rows(found: Board) -> list[tuple[str, ...]]:
    """The leaderboard as rows of text, with headings."""
    rows = [
        (str(each.place), each.name, *(_cell(each, *column) for column in _COLUMNS.values()))
        for each in found.standings
    ]
    return [("place", "entry", *_COLUMNS), *rows]


def _cell(standing: Standing, name: str, decimals: int) -> str:
    if name == "solved":
        return f"{standing.solved}/{len(standing.rows)}"
    if name == "claimed":
        return str(standing.claimed)
    return (
        standing.score.text(decimals)
        if name == "score"
        else number(standing.figures[name], decimals)
    )


def write_board(path: Path, found: Board) -> int:
    """Write the page, which appears only when it is complete. Returns its size in bytes."""
    told = json.dumps(_content(found, path.absolute().parent), allow_nan=False).replace(
        "<", "\\u003c"
    )
    own = {"TITLE": "LimSLAM arena", "SCRIPT": part(_HERE, "board.js"), "DATA": told}
    parts = parts_of_pages(part(_HERE, "board.css")) | own
    content = filled(part(_HERE, "board.html"), parts).encode()
    with atomic_write(path) as beside:
        beside.write_bytes(content)
    return len(content)


def _content(found: Board, place: Path) -> dict[str, Any]:
    """What the program of the page shows. Its links are relative to the folder ``place``."""
    return {
        "secret": found.is_secret,
        "plans": found.plans,
        "longest": MAX_TIME,
        "shown": _SHOWN,
        "entries": [_entry(each, place) for each in found.standings],
        "comparisons": [
            {
                "first": each.first,
                "second": each.second,
                "difference": vars(each.difference),
                "p": each.p_value,
                "plans": each.difference.count,
            }
            for each in found.comparisons
        ],
    }


def _entry(standing: Standing, place: Path) -> dict[str, Any]:
    stamp = standing.stamp
    manifest = standing.stamp.entry
    return {
        **{
            name: manifest.get(name, "")
            for name in ("name", "authors", "kind", "uses", "about", "preset")
        },
        "place": standing.place,
        "score": vars(standing.score),
        "solved": standing.solved,
        "claimed": standing.claimed,
        "failed": sum(row.error is not None for row in standing.rows),
        "figures": standing.figures,
        "commit": stamp.commit,
        "version": stamp.versions.get("limslam", ""),
        "digest": stamp.digest[:12],
        "values": standing.values.tolist(),
        "rows": [_row(row, standing.folder, place) for row in standing.rows],
    }


def _row(row: Row, folder: Path, place: Path) -> dict[str, Any]:
    run = folder / RUNS / f"{row.plan:03d}"
    inspector = run / INSPECTOR
    return {
        "plan": row.plan,
        "world": row.setting.get("world", ""),
        "noise": row.setting.get("noise"),
        "robots": row.setting.get("robots"),
        "fault": row.setting.get("fault", ""),
        "lost": row.metrics.get("lost") or "",
        **{name: row.metrics.get(name) for name, _, _ in _SHOWN},
        "link": Path(os.path.relpath(inspector.absolute(), place)).as_posix()
        if inspector.is_file()
        else "",
        "folder": str(run) if run.is_dir() else "",
    }
