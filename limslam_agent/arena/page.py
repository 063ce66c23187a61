"""The leaderboard as text, and as one HTML file that asks nothing from a network."""

import json
import os
from importlib.resources import files
from pathlib import Path
from typing import Any

from limslam_agent.arena.leaderboard import SCORES, Board, Standing, score_values
from limslam_agent.arena.results import RUNS, Row
from limslam_agent.arena.statistics import Mean
from limslam_agent.arena.tracks import MAX_TIME
from limslam_agent.inspect.page import escaped, filled, plotting_library
from limslam_agent.output.atomic_write import atomic_write

INSPECTOR = "inspect.html"
"""The page that ``limslam inspect`` writes into the folder of a run."""

_SHOWN = {
    "exploration": (
        "time_to_80_s", "plan_time_to_95_s", "correct_coverage", "ate_final_m", "wall_f1_5cm", "anees_final", "touches",
    ),
    "mapping": ("wall_f1_5cm", "wall_f1", "ate_final_m", "anees_final"),
}  # fmt: skip
"""Metrics of a plan that the page shows."""

_TEXT = {
    "exploration": ("place", "entry", "95 % after, s", "80 %, s", "solved", "false claims", "ATE, m", "F1 5 cm",
                    "NEES/3", "touches", "CPU, s"),
    "mapping": ("place", "entry", "F1 5 cm", "mapped", "ATE, m", "NEES/3", "CPU, s"),
}  # fmt: skip


def table_rows(found: Board) -> list[tuple[str, ...]]:
    """The leaderboard as rows of text, with headings."""
    of_track = _exploration_row if found.track == "exploration" else _mapping_row
    return [_TEXT[found.track], *(of_track(each, len(found.plans)) for each in found.standings)]


def _exploration_row(standing: Standing, plans: int) -> tuple[str, ...]:
    figures = standing.figures
    return (
        _place(standing), standing.name, _mean(standing.score, 1), _figure(figures["plan_time_to_80_s"], 1),
        f"{standing.solved}/{plans}", str(standing.claimed), _figure(figures["ate_final_m"], 3),
        _figure(figures["wall_f1_5cm"], 3), _figure(figures["anees_final"], 2), _figure(figures["touches"], 2),
        _figure(figures["cpu_s"], 1),
    )  # fmt: skip


def _mapping_row(standing: Standing, plans: int) -> tuple[str, ...]:
    figures = standing.figures
    return (
        _place(standing), standing.name, _mean(standing.score, 3), f"{standing.solved}/{plans}",
        _figure(figures["ate_final_m"], 3), _figure(figures["anees_final"], 2), _figure(figures["cpu_s"], 1),
    )  # fmt: skip


def _place(standing: Standing) -> str:
    return "-" if standing.place is None else str(standing.place)


def _mean(found: Mean, digits: int) -> str:
    if found.low is None or found.high is None:
        return f"{found.value:.{digits}f}"
    return f"{found.value:.{digits}f} [{found.low:.{digits}f}, {found.high:.{digits}f}]"


def _figure(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def write_board(path: Path, found: Board) -> int:
    """Write the page, which appears only when it is complete. Returns its size in bytes.

    Raises
    ------
    OSError
        If it cannot be written there.
    """
    content = page(found, path.absolute().parent).encode()
    with atomic_write(path) as beside:
        beside.write_bytes(content)
    return len(content)


def page(found: Board, place: Path) -> str:
    """The text of the page, whose links are relative to the folder ``place``."""
    library = plotting_library()
    told = json.dumps(_content(found, place), allow_nan=False).replace("<", "\\u003c")
    parts = {
        "TITLE": escaped(f"LimSLAM arena, {found.track}"), "STYLE": library.style + _part("board.css"),
        "LICENSE": library.license, "LIBRARY": library.script, "SCRIPT": _part("board.js"), "DATA": told,
    }  # fmt: skip
    return filled(_part("board.html"), parts)


def _part(name: str) -> str:
    return files("limslam_agent.arena").joinpath("page", name).read_text(encoding="utf-8")


def _content(found: Board, place: Path) -> dict[str, Any]:
    """What the program of the page shows."""
    return {
        "track": found.track, "score": SCORES[found.track], "secret": found.is_secret, "plans": found.plans,
        "longest": MAX_TIME, "shown": _SHOWN[found.track],
        "entries": [_entry(each, found, place) for each in found.standings],
        "comparisons": [
            {
                "first": first, "second": second, "difference": vars(result.difference), "p": result.p_value,
                "plans": result.plans,
            }
            for first, second, result in found.comparisons
        ],
    }  # fmt: skip


def _entry(standing: Standing, found: Board, place: Path) -> dict[str, Any]:
    results, manifest = standing.results, standing.results.stamp.entry
    return {
        **{name: manifest.get(name, "") for name in ("name", "authors", "kind", "uses", "about", "preset")},
        "place": standing.place, "score": vars(standing.score), "meanRank": standing.mean_rank,
        "solved": standing.solved, "claimed": standing.claimed, "failed": standing.failed, "figures": standing.figures,
        "commit": results.stamp.commit, "version": results.stamp.versions.get("limslam", ""),
        "digest": results.stamp.digest[:12], "values": score_values(results, found.track, found.plans).tolist(),
        "rows": [_row(results.rows[plan], results.folder, found, place) for plan in found.plans],
    }  # fmt: skip


def _row(row: Row, folder: Path, found: Board, place: Path) -> dict[str, Any]:
    run = folder / RUNS / f"{row.plan:03d}"
    inspector = run / INSPECTOR
    return {
        "plan": row.plan, "world": row.setting.get("world", ""), "noise": row.setting.get("noise"),
        "robots": row.setting.get("robots"), "fault": row.setting.get("fault", ""),
        "lost": row.metrics.get("lost") or "",
        **{name: row.metrics.get(name) for name in _SHOWN[found.track]},
        "link": Path(os.path.relpath(inspector.absolute(), place)).as_posix() if inspector.is_file() else "",
        "folder": str(run) if run.is_dir() else "",
    }  # fmt: skip
