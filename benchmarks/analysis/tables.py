"""The results of a suite as tables: ``table`` gives text, and ``sheets`` gives data for the report.

No table depends on the name of a world. Groups are formed from the worlds, noises, robots, presets, policies and
ablations in the rows, and a table without a group is left out.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.analysis.claims import Verdict, claims
from benchmarks.analysis.comparison_tables import ablation_sheet, limit_sheet, team_sheet
from benchmarks.analysis.groups import (
    FRONTIER,
    PUBLISHED,
    Group,
    Setting,
    centimetres,
    cost,
    groups,
    is_drive,
    is_exploration,
    is_faulty,
    is_log,
    merged,
    metric,
    ratio,
)
from benchmarks.analysis.outcome_tables import fault_sheet, outcome_sheet
from benchmarks.analysis.sheets import MISSING, Column, Sheet, counted, median_cells, render, written
from benchmarks.analysis.statistics import interquartile_means, medians
from benchmarks.suite.jobs import PLAN
from benchmarks.suite.store import Row

READING = (
    "Medians over runs with 95 % bootstrap intervals; the interval is left out where it has no width or there are "
    "fewer than 3 values; of fewer than 6 it is their range at most, which holds the median less often. "
    "n: runs that ended well (failed). A number in brackets behind a value: so many runs have one."
)

_SCORES = (
    Column("F1 aligned", metric("wall_f1_aligned")),
    Column("F1", metric("wall_f1")),
    Column("F1 5 cm", metric("wall_f1_5cm")),
    Column("spurious walls", metric("spurious_walls"), 1),
    Column("doors open", metric("doors_open")),
)
_POSE = (
    Column("ATE m", metric("ate_m"), 3),
    Column("ATE / limit", metric("ate_over_limit"), 1),
    Column("ANEES", metric("anees"), 1),
)
_GRID = (
    *_SCORES, *_POSE, Column("time s", metric("exploration_time_s"), 0), Column("covered", metric("coverage_true"), 3),
)  # fmt: skip
_DRIVE = (
    *_POSE,
    Column("odometry ATE m", metric("odometry_ate_m"), 3),
    Column("ATE / odometry", ratio("ate_m", "odometry_ate_m")),
    Column("limit ATE m", metric("limit_ate_m"), 3),
    Column("heading deg", metric("heading_rmse_deg")),
    Column("odometry deg", metric("odometry_heading_rmse_deg")),
    Column("final error m", metric("final_error_m"), 3),
    Column("NEES in 95 %", metric("nees_in_95")),
    *_SCORES,
)
_POLICIES = (
    Column("50 % s", metric("time_to_50_s"), 0),
    Column("90 % s", metric("time_to_90_s"), 0),
    Column("95 % s", metric("time_to_95_s"), 0),
    Column("time s", metric("exploration_time_s"), 0),
    Column("path m", metric("path_m"), 1),
    Column("covered", metric("coverage_true"), 3),
    Column("claimed and correct", metric("coverage_correct"), 3),
    Column("collisions", metric("collisions"), 1),
)
_LOGS = (
    Column("estimate m", metric("relation_error_m")),
    Column("odometry m", metric("odometry_relation_error_m")),
    Column("raw m", metric("raw_odometry_relation_error_m")),
    Column("estimate deg", metric("relation_error_deg"), 1),
    Column("odometry deg", metric("odometry_relation_error_deg"), 1),
    Column("loops: estimate m", metric("loop_relation_error_m")),
    Column("loops: odometry m", metric("odometry_loop_relation_error_m")),
    Column("loops: estimate deg", metric("loop_relation_error_deg"), 1),
    Column("loops: odometry deg", metric("odometry_loop_relation_error_deg"), 1),
    Column("relations", metric("relations"), 0),
)
_COSTS = (
    Column("mapping, ms a step", cost("slam_ms_median"), 3),
    Column("mapping, ms a step, 99 %", cost("slam_ms_p99"), 3),
    Column("exploring, ms a step", cost("explore_ms_median"), 3),
    Column("times real time", cost("speed_x_real_time"), 0),
    Column("run s", cost("job_s"), 1),
    Column("memory MB", cost("peak_rss_mb"), 0),
)
_ROOMS = "random plans"
_WORST = 5


def table(rows: Sequence[Row], *, latex: bool = False, folder: Path | None = None) -> str:
    """All tables of the given rows, as Markdown or LaTeX (packages booktabs, graphicx, longtable).

    Parameters
    ----------
    rows
        Rows of one folder of results.
    latex
        Write LaTeX instead of Markdown.
    folder
        Folder of the rows. Some claims are about the course of a run, which is stored in the series of the folder.

    Raises
    ------
    ValueError
        If there are no rows.
    """
    parts = [render(sheet, "latex" if latex else "markdown") for sheet in sheets(rows, folder)]
    return "\n\n".join((["% \\usepackage{booktabs,graphicx,longtable}"] if latex else []) + parts) + "\n"


def sheets(rows: Sequence[Row], folder: Path | None = None) -> list[Sheet]:
    """All tables of the given rows; parameters and errors as for :func:`table`."""
    found = number_sheets(rows)
    failures = failure_sheet(rows)
    verdicts = [claim_sheet(claims(rows, folder))] if any(row.preset == PUBLISHED for row in rows) else []
    return [*found, *([] if failures is None else [failures]), *verdicts]


def number_sheets(rows: Sequence[Row]) -> list[Sheet]:
    """The tables of numbers, without the tables of failures and claims.

    Raises
    ------
    ValueError
        If there are no rows.
    """
    if not rows:
        raise ValueError("no results: there is not one row to make a table of")
    parts = groups(rows)
    explored = [part for part in parts if is_exploration(part.setting)]
    by_frontier = [part for part in explored if part.setting.policy == FRONTIER]
    own = [part for part in by_frontier if part.setting.world != _ROOMS and not part.setting.world.startswith(PLAN)]
    found = [
        _scores("Exploration", own, _GRID),
        _overall(own),
        outcome_sheet(by_frontier),
        team_sheet(by_frontier),
        _scores("Driven paths", [part for part in parts if is_drive(part.setting)], _DRIVE),
        ablation_sheet(parts),
        _policies(explored),
        limit_sheet(explored),
        _scores("Random floor plans", [part for part in by_frontier if part.setting.world == _ROOMS], _GRID),
        _worst([row for part in by_frontier if part.setting.world == _ROOMS for row in part.rows]),
        _scores("Floor plans", [part for part in by_frontier if part.setting.world.startswith(PLAN)], _GRID),
        fault_sheet([part for part in parts if is_faulty(part.setting)]),
        _scores("Recorded logs", [part for part in parts if is_log(part.setting)], _LOGS),
    ]
    return [sheet for sheet in found if sheet is not None]


def failure_sheet(rows: Sequence[Row]) -> Sheet | None:
    """All failed runs with the reasons; None if no run failed."""
    failed = [
        (row.world, centimetres(row.noise), str(row.robots), _method(row), row.policy, str(row.seed), row.error)
        for row in rows
        if row.error is not None
    ]
    header = ("world", "noise", "robots", "method", "policy", "seed", "reason")
    note = f"{len(failed)} of {len(rows)} runs failed. They are in every count, and in no median."
    return Sheet("Failures", note, header, tuple(failed), len(header)) if failed else None


def cost_sheet(rows: Sequence[Row]) -> Sheet | None:
    """The cost of runs by number of robots and method; None if no row has a cost."""
    parts = merged(groups(rows), lambda each: replace(each, world="all", noise=0.0, policy="", laps=0))
    cells = median_cells(parts, _COSTS)
    named = zip(parts, cells, strict=True)
    lines = tuple((str(part.setting.robots), part.setting.method, counted(part), *numbers) for part, numbers in named)
    header = ("robots", "method", "n", *(column.heading for column in _COSTS))
    note = "Medians; they depend on the machine and on what else it did, and are part of no comparison."
    found = Sheet("Cost", note, header, lines, 2).without_empty()
    return found if len(found.header) > 3 else None


def claim_sheet(verdicts: Sequence[Verdict]) -> Sheet:
    """The claims of the paper with their verdicts."""
    rows = tuple((each.claim, each.source, each.outcome, each.evidence) for each in verdicts)
    note = (
        "Judged on the rows of the published method. Intervals are 95 %; undecided: the interval holds both answers, "
        "and more runs would tell. What counts as confirmed is our choice, since the paper gives no numbers."
    )
    return Sheet("Claims of the paper", note, ("claim", "where", "outcome", "measured"), rows, words=4)


def _method(row: Row) -> str:
    return row.preset if row.ablation is None else f"{row.preset}, {row.ablation}"


_FACTS: dict[str, Callable[[Setting], str]] = {
    "world": lambda setting: setting.world,
    "laps": lambda setting: str(setting.laps) if setting.laps else MISSING,
    "noise": lambda setting: centimetres(setting.noise),
    "robots": lambda setting: str(setting.robots),
    "policy": lambda setting: setting.policy,
    "method": lambda setting: setting.method,
}
_ALWAYS = {"world", "noise", "robots"}


def _described(parts: Sequence[Group]) -> dict[str, list[str]]:
    """The facts that distinguish groups: a column of words for each fact that differs between the groups."""
    columns = {name: [fact(part.setting) for part in parts] for name, fact in _FACTS.items()}
    return {name: cells for name, cells in columns.items() if name in _ALWAYS or len(set(cells)) > 1}


def _scores(title: str, parts: Sequence[Group], columns: Sequence[Column]) -> Sheet | None:
    """A table with one row for each group; None without groups."""
    if not parts:
        return None
    facts = _described(parts)
    cells = median_cells(parts, columns)
    rows = tuple(
        (*words, counted(part), *numbers)
        for words, part, numbers in zip(zip(*facts.values(), strict=True), parts, cells, strict=True)
    )
    header = (*facts, "n", *(column.heading for column in columns))
    return Sheet(title, READING, header, rows, len(facts)).without_empty()


def _policies(explored: Sequence[Group]) -> Sheet | None:
    """How fast different policies explore a world; None if there is only one policy."""
    policies = {part.setting.policy for part in explored}
    if len(policies) < 2:
        return None
    places = {_place(part.setting) for part in explored if part.setting.policy != FRONTIER}
    compared = [part for part in explored if _place(part.setting) in places]
    return _scores("Policies", compared, _POLICIES)


def _place(setting: Setting) -> tuple[str, float, int]:
    return setting.world, setting.noise, setting.robots


def _overall(own: Sequence[Group]) -> Sheet | None:
    """Each method over all worlds and noises; None if there is only one world and one noise."""
    pooled = merged(own, lambda each: Setting("all", 0.0, each.robots, each.preset, each.policy, each.ablation, 0))
    if len(pooled) == len(own):
        return None
    columns = (*_SCORES[:2], _SCORES[3], _POSE[0], _POSE[2], _GRID[-2])
    samples = [part.values(column.value) for part in pooled for column in columns]
    both = iter(zip(interquartile_means(samples), medians(samples), strict=True))
    rows = []
    for part in pooled:
        ended = len(part.rows) - part.failed
        found = [next(both) for _ in columns]
        for name, which in (("interquartile mean", 0), ("median", 1)):
            cells = (written(pair[which], column.decimals, ended) for pair, column in zip(found, columns, strict=True))
            rows.append((str(part.setting.robots), part.setting.method, name, counted(part), *cells))
    note = (
        "All worlds and noises of the table above put together, each run counted once: what a method is worth on the "
        "whole, not in a place. Intervals are of the runs at hand, not of other worlds."
    )
    header = ("robots", "method", "statistic", "n", *(column.heading for column in columns))
    return Sheet("All worlds and noises together", note, header, tuple(rows), 3).without_empty()


def _worst(rows: Sequence[Row]) -> Sheet | None:
    """The random plans with the worst maps; None if there are no random plans."""
    value = metric("wall_f1_aligned")
    found = sorted((score, number) for number, row in enumerate(rows) if (score := value(row)) is not None)
    if not found:
        return None
    columns = (_SCORES[0], *_POSE, _GRID[-1])
    cells = []
    for _, number in found[:_WORST]:
        row = rows[number]
        numbers = ((column.value(row), column.decimals) for column in columns)
        words = (MISSING if number is None else f"{number:.{decimals}f}" for number, decimals in numbers)
        why = str(row.metrics.get("stop_reason") or MISSING)
        cells.append((row.world, centimetres(row.noise), str(row.robots), str(row.seed), why, *words))
    header = ("plan", "noise", "robots", "seed", "ended because", *(column.heading for column in columns))
    return Sheet("The worst random floor plans", "Those with the lowest F1.", header, tuple(cells), 5).without_empty()
