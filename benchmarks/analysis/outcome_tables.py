"""Tables of how runs ended: the worst runs, the failures, and what became of robots with a fault."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.analysis.groups import Group, Setting, centimetres, merged, metric
from benchmarks.analysis.sheets import MISSING, Column, Sheet, counted, median_cells
from benchmarks.suite.jobs import KIDNAPPED
from benchmarks.suite.store import Row

NOTICED_WITHIN, PLACED_WITHIN = 10.0, 30.0
"""Times after a fault within which it should be noticed, and a kidnapped robot be placed, s."""

TOLERATED_ATE = 0.5
"""Root mean square error of a smoothed path above which the status should not be ok, m."""

Cell = Callable[[Group], str]
Written = tuple[str, Cell]
"""A column that is no median: its heading, and the text of its cell for a group."""

_ALL = "all"


def outcome_sheet(explored: Sequence[Group]) -> Sheet | None:
    """How explorations ended, with the worst runs and the smoothed paths; None if no run was smoothed."""
    if not any(len(part.values(metric("ate_smoothed_m"))) for part in explored):
        return None
    columns: list[Column | Written] = [
        ("ended by itself", _share("exploration_time_s", lambda _: True)),
        ("ok at the end", _ended_ok(lambda _: True)),
        ("unsure at some time", _share("unsure_s", lambda value: value > 0.0)),
        ("lost at some time", _share("lost_s", lambda value: value > 0.0)),
        ("touched a wall", _share("collisions", lambda value: value > 0.0)),
        Column("time s", metric("exploration_time_s"), 0),
        Column("odometry ATE m", metric("odometry_ate_m")),
        Column("ATE m", metric("ate_m"), 3),
        ("worst ATE m", _of(np.max, "ate_m", 3)),
        Column("smoothed ATE m", metric("ate_smoothed_m"), 3),
        ("worst smoothed ATE m", _of(np.max, "ate_smoothed_m", 3)),
        ("mean ANEES", _of(np.mean, "anees", 1)),
        ("mean smoothed ANEES", _of(np.mean, "anees_smoothed", 1)),
        Column("F1 aligned 5 cm, while driving", metric("wall_f1_aligned_5cm_online")),
        Column("F1 aligned 5 cm", metric("wall_f1_aligned_5cm")),
        ("worst F1 aligned 5 cm", _of(np.min, "wall_f1_aligned_5cm", 2)),
        Column("recall", metric("wall_recall"), 3),
        Column("spurious walls", metric("spurious_walls"), 1),
    ]
    note = (
        "Medians over runs with 95 % bootstrap intervals, the worst runs, means, and numbers of runs. The walls are "
        "those of the final map, which is the smoothed one where there is one."
    )
    return _sheet("Outcomes of explorations", note, explored, columns)


def fault_sheet(faulty: Sequence[Group]) -> Sheet | None:
    """What became of robots with a fault; None if there are none."""
    if not faulty:
        return None
    columns: list[Column | Written] = [
        ("not ok within 10 s", _share("fault_doubted_s", _is_soon)),
        ("lost within 10 s", _share("fault_lost_s", _is_soon)),
        Column("not ok after s", metric("fault_doubted_s"), 1),
        ("ok though wrong, at most s", _of(np.max, "fault_unnoticed_s", 1)),
        ("placed within 30 s", _placed),
        Column("placed after s", metric("fault_placed_s"), 1),
        ("at a wrong place", _share("fault_wrong_place_s", lambda value: value > 0.0)),
        ("of these ok", _share("fault_wrong_place_ok_s", lambda value: value > 0.0)),
        ("not ok before", _share("fault_alarms_before_s", lambda value: value > 0.0)),
        Column("smoothed ATE m", metric("ate_smoothed_m"), 3),
        ("ok at the end, smoothed ATE above 0.5 m", _ok_though_wrong),
    ]
    note = (
        "Numbers of runs, and medians with 95 % bootstrap intervals over those that were noticed or placed. A right "
        "pose is at most 0.5 m and 15 degrees off. At a wrong place: the robot was lost, and then not lost with a "
        "wrong pose."
    )
    return _sheet("Faults", note, faulty, columns)


def _sheet(title: str, note: str, parts: Sequence[Group], columns: Sequence[Column | Written]) -> Sheet:
    """A row for each group, and one for all worlds and noises of each method and policy."""
    pooled = merged(parts, lambda each: replace(each, world=_ALL, noise=0.0))
    lines = [(part, False) for part in parts]
    lines += [(part, True) for part in pooled if len(pooled) < len(parts)]
    medians = [column for column in columns if isinstance(column, Column)]
    found = median_cells([part for part, _ in lines], medians)
    rows = []
    for (part, is_sum), numbers in zip(lines, found, strict=True):
        rest = iter(numbers)
        cells = (next(rest) if isinstance(column, Column) else column[1](part) for column in columns)
        rows.append((*_words(part.setting, is_sum=is_sum), counted(part), *cells))
    headings = (column.heading if isinstance(column, Column) else column[0] for column in columns)
    header = ("world", "noise", "robots", "method", "policy", "n", *headings)
    marked = frozenset(number for number, (_, is_sum) in enumerate(lines) if is_sum)
    return Sheet(title, note, header, tuple(rows), 5, marked).without_empty()


def _words(setting: Setting, *, is_sum: bool) -> tuple[str, ...]:
    noise = _ALL if is_sum else centimetres(setting.noise)
    return setting.world, noise, str(setting.robots), setting.method, setting.policy


def _share(name: str, holds: Callable[[float], bool]) -> Cell:
    """So many of the runs that ended well have a metric for which this holds."""
    value = metric(name)

    def cell(part: Group) -> str:
        return f"{sum(holds(each) for each in part.values(value))} of {len(part.rows) - part.failed}"

    return cell


def _is_soon(time: float) -> bool:
    return time <= NOTICED_WITHIN


def _placed(part: Group) -> str:
    """So many of the robots that were carried away were placed in time."""
    in_time = _share("fault_placed_s", lambda value: value <= PLACED_WITHIN)
    return in_time(part) if part.setting.policy == KIDNAPPED else MISSING


def _ended_ok(holds: Callable[[Row], bool]) -> Cell:
    """So many of the runs that ended well have the status ok at their end, and this holds."""

    def cell(part: Group) -> str:
        found = [row for row in part.rows if row.metrics.get("status") == "ok" and holds(row)]
        return f"{len(found)} of {len(part.rows) - part.failed}"

    return cell


def _ok_though_wrong(part: Group) -> str:
    """So many of the runs have the status ok at their end with a wrong smoothed path."""
    ate = metric("ate_smoothed_m")
    return _ended_ok(lambda row: (ate(row) or 0.0) > TOLERATED_ATE)(part) if len(part.values(ate)) else MISSING


def _of(statistic: Callable[..., float], name: str, decimals: int) -> Cell:
    """A statistic of a metric over the runs."""

    def cell(part: Group) -> str:
        values = part.values(metric(name))
        return f"{statistic(values):.{decimals}f}" if len(values) else MISSING

    return cell
