"""The results of a suite as tables.

No table depends on the name of a world. Groups are formed from the worlds, noises, robots, presets,
policies and ablations in the rows, and a table without a group is left out.
"""

import re
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from benchmarks.analysis.groups import (
    FRONTIER,
    PUBLISHED,
    Group,
    Setting,
    Value,
    groups,
    metric,
    setting_of,
    with_sums,
)
from benchmarks.suite.jobs import KIDNAPPED
from benchmarks.suite.store import Row
from limslam_agent.measurements.statistics import MISSING, Estimate, Pairs, median, number, paired

READING = (
    "Medians over runs with 95 % bootstrap intervals; the interval is left out where it has no "
    "width or there are "
    "fewer than 3 values; of fewer than 6 it is their range at most, which holds the median less "
    "often. "
    "n: runs that ended well (failed). A number in brackets behind a value: so many runs have one."
)
NOTICED_WITHIN = 10.0
PLACED_WITHIN = 30.0
"""Times after a fault within which it should be noticed, and a kidnapped robot be placed, s."""

TOLERATED_ATE = 0.5
"""Root mean square error of a smoothed path above which the status should not be ok, m."""

Column: TypeAlias = tuple[str, Callable[[Group], str]]
"""The heading of a column, and the text of its cell for a group."""

TIMES = "\N{MULTIPLICATION SIGN}"


@dataclass(frozen=True)
class Sheet:
    """A table, with its content in a line above it, and a note below it that says how to read it.

    The first ``words`` columns contain words, the others numbers.
    """

    title: str
    note: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: int = 1

    def without_empty(self) -> "Sheet":
        """The table without columns of numbers that contain no number."""
        columns = [
            column
            for number, column in enumerate(zip(self.header, *self.rows, strict=True))
            if number < self.words or {*column[1:]} != {MISSING}
        ]
        header, *rows = zip(*columns, strict=True)
        return replace(self, header=header, rows=tuple(rows))

    def markdown(self) -> str:
        """The table in Markdown."""
        marks = ["---" if number < self.words else "---:" for number in range(len(self.header))]
        header, *rows = (
            f"| {' | '.join(map(_escaped, row))} |" for row in (self.header, *self.rows)
        )
        lines = [f"### {_escaped(self.title)}", "", header, f"|{'|'.join(marks)}|", *rows]
        return "\n".join([*lines, "", _escaped(self.note)])


def table(rows: Sequence[Row]) -> str:
    """All tables of the given rows, as Markdown."""
    return "\n\n".join(sheet.markdown() for sheet in sheets(rows)) + "\n"


def sheets(rows: Sequence[Row]) -> list[Sheet]:
    """All tables of the given rows."""
    if not rows:
        raise ValueError("no results: there is not one row to make a table of")
    parts = groups(rows)
    explored = [part for part in parts if part.setting.kind == "exploration"]
    by_frontier = [part for part in explored if part.setting.policy == FRONTIER]
    others = {
        (part.setting.world, part.setting.noise) for part in explored if part not in by_frontier
    }
    smoothed = [part for part in by_frontier if len(part.values(metric("ate_smoothed_m")))]
    found = [
        _sheet("Exploration", READING, with_sums(by_frontier), _GRID),
        _sheet("Outcomes of explorations", _ENDS, with_sums(smoothed), _OUTCOMES),
        _pairs_sheet("Several robots against one", "one robot", by_frontier, _alone),
        _sheet(
            "Driven paths",
            READING,
            [part for part in parts if part.setting.kind == "drive"],
            _DRIVE,
        ),
        _pairs_sheet(
            "Other methods against the published one", "the published method", parts, _published
        ),
        _sheet(
            "Policies",
            READING,
            [part for part in explored if (part.setting.world, part.setting.noise) in others],
            _POLICIES,
        ),
        _sheet(
            "Faults",
            _FAULTY,
            with_sums([part for part in parts if part.setting.kind == "faulty"]),
            _FAULTS,
        ),
        _failures(rows),
    ]
    return [sheet for sheet in found if sheet is not None]


def _sheet(
    title: str, note: str, parts: Sequence[Group], columns: Sequence[Column]
) -> Sheet | None:
    """A table with a row for each group; None without groups. Words that all groups share are left
    out.
    """
    if not parts:
        return None
    facts = [part.setting.words for part in parts]
    words = [
        name
        for name in ("world", "laps", "noise", "robots", "policy", "method")
        if name in {"world", "noise"} or len({each[name] for each in facts}) > 1
    ]
    all_columns = [("n", _ended), *columns]
    rows = tuple(
        (*(about[name] for name in words), *(text(part) for _, text in all_columns))
        for about, part in zip(facts, parts, strict=True)
    )
    header = (*words, *(name for name, _ in all_columns))
    return Sheet(title, note, header, rows, len(words)).without_empty()


def _ended(part: Group) -> str:
    failed = len(part.rows) - part.ended
    return f"{part.ended} ({failed})" if failed else str(part.ended)


def _median(heading: str, of: str | Value, decimals: int = 2) -> Column:
    """A column of medians of a metric or of another value."""
    value = metric(of) if isinstance(of, str) else of
    return heading, lambda part: _text(median(part.values(value)), decimals, part.ended)


def _text(found: Estimate | None, decimals: int, runs: int) -> str:
    """An estimate, with its number of values if that is not the number of runs."""
    if found is None:
        return MISSING
    return found.text(decimals) + ("" if found.count == runs else f" ({found.count})")


def _of(heading: str, statistic: Callable[..., float], name: str, decimals: int) -> Column:
    """A column of another statistic of a metric."""

    def text(part: Group) -> str:
        values = part.values(metric(name))
        return number(float(statistic(values)), decimals) if len(values) else MISSING

    return heading, text


def _count(
    heading: str, name: str, holds: Callable[[float], bool] = lambda value: value > 0.0
) -> Column:
    """A column of how many of the runs have a metric for which this holds."""
    return (
        heading,
        lambda part: f"{sum(map(holds, part.values(metric(name)).tolist()))} of {part.ended}",
    )


def _ended_ok(part: Group, above: float = -np.inf) -> str:
    """How many of the runs have the status ok at their end, and an error of the smoothed path above
    a limit (m).
    """
    ok = [row for row in part.rows if row.metrics.get("status") == "ok"]
    return f"{sum((metric('ate_smoothed_m')(row) or 0.0) > above for row in ok)} of {part.ended}"


def _placed(part: Group) -> str:
    """How many of the robots that were carried away were placed in time."""
    _, in_time = _count("", "fault_placed_s", lambda value: value <= PLACED_WITHIN)
    return in_time(part) if part.setting.policy == KIDNAPPED else MISSING


def _over_odometry(row: Row) -> float | None:
    estimated = metric("ate_m")(row)
    odometry = metric("odometry_ate_m")(row)
    return estimated / odometry if estimated is not None and odometry else None


_SCORES = (
    _median("F1 aligned", "wall_f1_aligned"),
    _median("F1", "wall_f1"),
    _median("F1 5 cm", "wall_f1_5cm"),
    _median("spurious walls", "spurious_walls", 1),
    _median("doors open", "doors_open"),
)
_POSE = (
    _median("ATE m", "ate_m", 3),
    _median("ATE / limit", "ate_over_limit", 1),
    _median("ANEES", "anees", 1),
)
_GRID = (
    *_SCORES,
    *_POSE,
    _median("time s", "exploration_time_s", 0),
    _median("covered", "coverage_true", 3),
)
_DRIVE = (
    *_POSE,
    _median("odometry ATE m", "odometry_ate_m", 3),
    _median("ATE / odometry", _over_odometry),
    _median("limit ATE m", "limit_ate_m", 3),
    _median("heading deg", "heading_rmse_deg"),
    _median("odometry deg", "odometry_heading_rmse_deg"),
    _median("final error m", "final_error_m", 3),
    _median("NEES in 95 %", "nees_in_95"),
    *_SCORES,
)
_POLICIES = (
    *(_median(f"{share} % s", f"time_to_{share}_s", 0) for share in (50, 90, 95)),
    _median("time s", "exploration_time_s", 0),
    _median("path m", "path_m", 1),
    _median("covered", "coverage_true", 3),
    _median("claimed and correct", "coverage_correct", 3),
    _median("collisions", "collisions", 1),
)
_OUTCOMES = (
    _count("ended by itself", "exploration_time_s", lambda _: True),
    ("ok at the end", _ended_ok),
    _count("unsure at some time", "unsure_s"),
    _count("lost at some time", "lost_s"),
    _count("touched a wall", "collisions"),
    _median("odometry ATE m", "odometry_ate_m"),
    _median("ATE m", "ate_m", 3),
    _of("worst ATE m", np.max, "ate_m", 3),
    _median("smoothed ATE m", "ate_smoothed_m", 3),
    _of("worst smoothed ATE m", np.max, "ate_smoothed_m", 3),
    _of("mean ANEES", np.mean, "anees", 1),
    _of("mean smoothed ANEES", np.mean, "anees_smoothed", 1),
    _median("F1 aligned 5 cm", "wall_f1_aligned_5cm"),
    _of("worst F1 aligned 5 cm", np.min, "wall_f1_aligned_5cm", 2),
    _median("recall", "wall_recall", 3),
)
_FAULTS = (
    _count("not ok within 10 s", "fault_doubted_s", lambda value: value <= NOTICED_WITHIN),
    _count("lost within 10 s", "fault_lost_s", lambda value: value <= NOTICED_WITHIN),
    _median("not ok after s", "fault_doubted_s", 1),
    _of("ok though wrong, at most s", np.max, "fault_unnoticed_s", 1),
    ("placed within 30 s", _placed),
    _median("placed after s", "fault_placed_s", 1),
    _count("at a wrong place", "fault_wrong_place_s"),
    _count("of these ok", "fault_wrong_place_ok_s"),
    _count("not ok before", "fault_alarms_before_s"),
    _median("smoothed ATE m", "ate_smoothed_m", 3),
    ("ok at the end, smoothed ATE above 0.5 m", lambda part: _ended_ok(part, TOLERATED_ATE)),
)
_ENDS = (
    "Medians over runs with 95 % bootstrap intervals, the worst runs, means, and numbers of runs. "
    "The walls are those "
    "of the final map, which is the smoothed one where there is one."
)
_FAULTY = (
    "Numbers of runs, and medians with 95 % bootstrap intervals over those that were noticed or "
    "placed. A right pose "
    "is at most 0.5 m and 15 degrees off. At a wrong place: the robot was lost, and then not lost "
    "with a wrong pose."
)
# Heading, metric, whether a ratio is shown and not a difference, and decimals.
_MEASURES = (
    (f"time, {TIMES}", "exploration_time_s", True, 2),
    (f"ATE, {TIMES}", "ate_m", True, 2),
    ("F1 aligned, +", "wall_f1_aligned", False, 2),
    ("spurious walls, +", "spurious_walls", False, 1),
    ("doors open, +", "doors_open", False, 2),
    ("associations right, +", "association_right_share", False, 3),
)


def _alone(setting: Setting) -> Setting | None:
    return replace(setting, robots=1) if setting.robots > 1 else None


def _published(setting: Setting) -> Setting | None:
    is_published = setting.preset == PUBLISHED and setting.ablation is None
    return None if is_published else replace(setting, preset=PUBLISHED, ablation=None)


def _pairs_sheet(
    title: str, other: str, parts: Sequence[Group], base: Callable[[Setting], Setting | None]
) -> Sheet | None:
    """Settings compared with others, run by run; None if there are none. The last rows are sums."""
    known = {part.setting: part for part in parts}
    matched = [
        (known[one], part)
        for part in parts
        if (one := base(part.setting)) is not None and one in known
    ]
    lines: dict[Setting, list[tuple[Group, Group]]] = {pair[1].setting: [pair] for pair in matched}
    for pair in matched if len(matched) > 1 else []:
        lines.setdefault(pair[1].setting.pooled, []).append(pair)
    rows = [_pairs_row(setting, pairs) for setting, pairs in lines.items()]
    if not rows:
        return None
    header = ("method", "world", "noise", "robots", "policy", "pairs", "left out", "unpaired")
    note = (
        f"{TIMES}: over {other}; +: minus {other}. Medians over pairs of runs that share world, "
        "noise and seed, with "
        "95 % bootstrap intervals. Left out: pairs of which a run failed; unpaired: runs without "
        "a partner. A number "
        "in brackets behind a value: so many pairs have one."
    )
    return Sheet(
        title, note, (*header, *(name for name, *_ in _MEASURES)), tuple(rows), 5
    ).without_empty()


def _pairs_row(setting: Setting, pairs: Sequence[tuple[Group, Group]]) -> tuple[str, ...]:
    def values(of: Value) -> Pairs:
        first = dict[Hashable, float | None]()
        second = dict[Hashable, float | None]()
        for one, other in pairs:
            first |= one.by_job(of)
            second |= other.by_job(of)
        return paired(first, second)

    ended = values(lambda row: None if row.error else 0.0)
    count = len(ended.first)
    cells = [
        _text(found.ratio if is_ratio else found.difference, decimals, count)
        for found, is_ratio, decimals in (
            (values(metric(name)), ratio, each) for _, name, ratio, each in _MEASURES
        )
    ]
    told = setting.words
    if setting.laps:
        told["world"] += f", {setting.laps} laps"
    words = [told[name] for name in ("method", "world", "noise", "robots", "policy")]
    return (*words, str(count), str(ended.left_out), str(ended.unpaired or MISSING), *cells)


def _failures(rows: Sequence[Row]) -> Sheet | None:
    """All failed runs with the reasons; None if no run failed."""
    header = ("world", "noise", "robots", "method", "policy", "seed", "reason")
    failed = []
    for row in rows:
        if row.error is not None:
            words = setting_of(row).words | {"world": row.world}
            told = words | {"seed": str(row.seed), "reason": row.error}
            failed.append(tuple(told[name] for name in header))
    note = f"{len(failed)} of {len(rows)} runs failed. They are in every count, and in no median."
    return Sheet("Failures", note, header, tuple(failed), len(header)) if failed else None


def _escaped(text: str) -> str:
    """Text without marks of Markdown; line breaks become spaces."""
    return re.sub(r"([\\|<*`])", r"\\\1", " ".join(text.split()))
