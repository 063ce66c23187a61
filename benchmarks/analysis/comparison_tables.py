"""Tables that compare settings, paired by world, noise and seed."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from benchmarks.analysis.groups import ORACLE, PUBLISHED, Group, Setting, Value, centimetres, metric
from benchmarks.analysis.sheets import MISSING, Sheet, written
from benchmarks.analysis.statistics import Comparison, Pairs, comparisons, paired
from limslam_env.messages import counted

_READING = (
    "Medians over pairs of runs that share world, noise and seed, with 95 % bootstrap intervals. Left out: pairs of "
    "which a run failed; unpaired: runs without a partner. A number in brackets behind a value: so many pairs have one."
)
_MOST = 60
"""Largest number of rows. A longer table shows only the rows over all worlds and noises."""


@dataclass(frozen=True)
class Measure:
    """A measure for comparing runs.

    Attributes
    ----------
    heading
        Heading of its column.
    value
        Function that gives the measure of a run.
    kind
        Whether the table shows the ratio second / first or the difference second - first.
    decimals
        Number of decimal places.
    """

    heading: str
    value: Value
    kind: Literal["ratio", "difference"] = "difference"
    decimals: int = 2


@dataclass(frozen=True)
class _Line:
    """One row of a table: pairs of groups whose runs are compared, pooled if there are several pairs."""

    words: tuple[str, ...]
    pairs: tuple[tuple[Group, Group], ...]
    marked: bool = False


_MAP = (
    Measure("F1 aligned, +", metric("wall_f1_aligned")),
    Measure("spurious walls, +", metric("spurious_walls"), decimals=1),
    Measure("doors open, +", metric("doors_open")),
)
_RIGHT = Measure("associations right, +", metric("association_right_share"), decimals=3)
_ATE = Measure("ATE, \N{MULTIPLICATION SIGN}", metric("ate_m"), "ratio")
_TIME = Measure("time, \N{MULTIPLICATION SIGN}", metric("exploration_time_s"), "ratio")


def ablation_sheet(parts: Sequence[Group]) -> Sheet | None:
    """Every other method compared with the published method; None if there is no other method."""

    def published(setting: Setting) -> Setting | None:
        return None if setting.is_published else replace(setting, preset=PUBLISHED, ablation=None)

    note = "\N{MULTIPLICATION SIGN}: over the published method; +: minus the published method. "
    return _sheet("Other methods against the published one", note, parts, published, (_ATE, *_MAP, _RIGHT))


def team_sheet(parts: Sequence[Group]) -> Sheet | None:
    """Several robots compared with one robot; None if there are no runs with several robots."""

    def alone(setting: Setting) -> Setting | None:
        return replace(setting, robots=1) if setting.robots > 1 else None

    note = "\N{MULTIPLICATION SIGN}: over one robot; +: minus one robot. "
    return _sheet("Several robots against one", note, parts, alone, (_TIME, _ATE, *_MAP, _RIGHT))


def limit_sheet(parts: Sequence[Group]) -> Sheet | None:
    """Policies compared with the oracle policy, which knows the map; None if the oracle was not run."""

    def oracle(setting: Setting) -> Setting | None:
        return None if setting.policy == ORACLE else replace(setting, policy=ORACLE)

    measures = (
        *(
            Measure(f"{level} % covered, \N{MULTIPLICATION SIGN}", metric(f"time_to_{level}_s"), "ratio")
            for level in (50, 90, 95)
        ),
        Measure("path, \N{MULTIPLICATION SIGN}", metric("path_m"), "ratio"),
    )
    note = "\N{MULTIPLICATION SIGN}: over a robot that knows the map and drives a nearest-neighbour tour of it. "
    return _sheet("Policies against the exploration limit", note, parts, oracle, measures)


def _sheet(
    title: str,
    note: str,
    parts: Sequence[Group],
    base: Callable[[Setting], Setting | None],
    measures: Sequence[Measure],
) -> Sheet | None:
    known = {part.setting: part for part in parts}
    matched = [(known[reference], part) for part in parts if (reference := base(part.setting)) in known and reference]
    if not matched:
        return None
    lines = _lines(matched)
    found = iter(comparisons([_paired(line, measure) for line in lines for measure in measures]))
    rows = [(*line.words, *_cells([next(found) for _ in measures], line, measures)) for line in lines]
    header = ("method", "world", "noise", "robots", "policy", "pairs", "left out", "unpaired")
    return Sheet(
        title, note + _READING, (*header, *(measure.heading for measure in measures)), tuple(rows), 5,
        frozenset(number for number, line in enumerate(lines) if line.marked),
    ).without_empty()  # fmt: skip


def _lines(matched: Sequence[tuple[Group, Group]]) -> list[_Line]:
    """A row for each pair of groups, and a row for each method over all worlds and noises."""
    together: dict[tuple[str, int, str], list[tuple[Group, Group]]] = {}
    for first, second in matched:
        setting = second.setting
        together.setdefault((setting.method, setting.robots, setting.policy), []).append((first, second))
    lines = []
    for (method, robots, policy), pairs in together.items():
        if len(matched) <= _MOST or len(pairs) == 1:
            for first, second in pairs:
                setting = second.setting
                words = (method, _world(setting), centimetres(setting.noise), str(robots), policy)
                lines.append(_Line(words, ((first, second),)))
        if len(pairs) > 1:
            lines.append(_Line((method, "all", "all", str(robots), policy), tuple(pairs), marked=True))
    return lines


def _world(setting: Setting) -> str:
    return f"{setting.world}, {counted(setting.laps, 'lap')}" if setting.laps else setting.world


def _paired(line: _Line, measure: Measure) -> Pairs:
    first, second = dict[Hashable, float | None](), dict[Hashable, float | None]()
    for one, other in line.pairs:
        first |= one.by_job(measure.value)
        second |= other.by_job(measure.value)
    return paired(first, second)


def _cells(found: Sequence[Comparison], line: _Line, measures: Sequence[Measure]) -> tuple[str, ...]:
    """The counts of paired runs, followed by the measures."""
    ended = _paired(line, Measure("", lambda row: None if row.error else 0.0))
    pairs = len(ended.first)
    return (
        str(pairs),
        str(ended.left_out),
        str(ended.unpaired) if ended.unpaired else MISSING,
        *(
            written(each.ratio if measure.kind == "ratio" else each.difference, measure.decimals, pairs)
            for each, measure in zip(found, measures, strict=True)
        ),
    )
