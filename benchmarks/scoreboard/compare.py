"""Two scoreboards compared in pairs of cells, and what counts as worse."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from limslam_agent.measurements.statistics import Estimate, geometric_ratio, two_errors
from limslam_env.geometry import FloatArray

Cell = Mapping[str, Any]
"""A cell: ``row``, ``world``, ``seed``, and its figures, or ``error``."""

NOISE = {
    "ate_m": 0.05,
    "ate_aligned_m": 0.05,
    "ate_smoothed_m": 0.18,
    "ate_smoothed_aligned_m": 0.12,
    "nees": 0.05,
    "nees_smoothed": 0.05,
}
"""Standard deviations of the logarithm of the ratio of one cell, when 0.1 mm of noise is added to
its ranges.

An interval is never narrower than these allow, so that a single cell has an interval, too.
"""
F1_NOISE = 0.08
"""The same of a difference of F1."""
CPU = ("drive_cpu_s", "smoothing_cpu_s")
_LEAST_SECONDS = 2.0
"""Further seconds, wrong and ok or of false alarms, that are never a reason: a robot stands so long
at a door.
"""
_TINY = 1e-4  # m; errors below are taken to be equal to it


@dataclass(frozen=True)
class Difference:
    """A row under the old and the new estimator: ratios of its figures in ``NOISE`` and ``CPU``
    over pairs of cells.

    The reasons say why the row is worse beyond its noise. There are none if it is not.
    """

    row: str
    pairs: int
    ratios: dict[str, Estimate]
    reasons: tuple[str, ...]


def compared(old: Iterable[Cell], new: Iterable[Cell]) -> list[Difference]:
    """Compare the rows that both scoreboards have, by the cells that both have; the row ``all`` has
    all of them.
    """
    before = {_key(cell): cell for cell in old}
    pairs = [(before[_key(cell)], cell) for cell in new if _key(cell) in before]
    rows: dict[str, list[tuple[Cell, Cell]]] = {}
    for pair in pairs:
        rows.setdefault(str(pair[1]["row"]), []).append(pair)
    return [difference(row, each) for row, each in (rows | {"all": pairs}).items()] if pairs else []


def difference(row: str, pairs: Sequence[tuple[Cell, Cell]]) -> Difference:
    """Compare cells in pairs, old and new."""
    failed = sum("error" in new and "error" not in old for old, new in pairs)
    pairs = [(old, new) for old, new in pairs if "error" not in old and "error" not in new]
    ratios = {}
    for name in (*NOISE, *CPU):
        # A covariance that is too large is not worse than a right one.
        least = 1.0 if name.startswith("nees") else _TINY
        values = [
            (max(old[name], least), max(new[name], least)) for old, new in _having(pairs, name)
        ]
        found = geometric_ratio(
            [a for a, _ in values], [b for _, b in values], NOISE.get(name, 0.0)
        )
        if found is not None:
            ratios[name] = found
    reasons = [
        f"{name} {ratio.text(2)}"
        for name, ratio in ratios.items()
        if name not in CPU and (ratio.low or 0.0) > 1.0
    ]
    reasons += [f"{failed} failed"] if failed else []
    return Difference(row, len(pairs), ratios, (*reasons, *_other_reasons(pairs)))


def _other_reasons(pairs: Sequence[tuple[Cell, Cell]]) -> list[str]:
    found = []
    drops = _changes(pairs, "f1_5cm")
    if len(drops) and drops.mean() + two_errors(drops, F1_NOISE) < 0.0:
        found.append(f"f1_5cm {drops.mean():+.3f}")
    for name in ("wrong_ok_s", "false_alarm_s"):
        more = _changes(pairs, name)
        if more.sum() > _LEAST_SECONDS and more.mean() > two_errors(more, 0.0):
            found.append(f"{name} {more.sum():+.0f} s")
    if (more := _changes(pairs, "wrong_ok_end")).sum() > 0.0:
        found.append(f"{more.sum():.0f} more wrong and ok at the end")
    # McNemar's test: of the cells that changed, more than chance allows became worse.
    placed = _changes(pairs, "placed")
    if -placed.sum() > 2.0 * math.sqrt(np.abs(placed).sum()):
        found.append(f"{-placed.sum():.0f} fewer placed")
    return found


def comparison_table(found: Sequence[Difference]) -> list[str]:
    """The lines of a table of ratios, new over old, in Markdown. The last line says which rows are
    worse.

    The row ``all`` is shown and not judged.
    """
    if not found:
        return ["no cell is in both scoreboards"]
    names = [*NOISE, *CPU]
    lines = [f"| row | n | {' | '.join(names)} | worse |", f"|{'---|' * (len(names) + 3)}"]
    for each in found:
        cells = [each.ratios[name].text(2) if name in each.ratios else "" for name in names]
        lines.append(
            f"| {each.row} | {each.pairs} | {' | '.join(cells)} | {'; '.join(each.reasons)} |"
        )
    worse = [f"{each.row} ({'; '.join(each.reasons)})" for each in found[:-1] if each.reasons]
    none = f"no row is worse ({len(found) - 1} rows compared)"
    return [*lines, "", f"worse beyond noise: {', '.join(worse)}" if worse else none]


def _key(cell: Cell) -> tuple[Any, ...]:
    return cell["row"], cell["world"], cell["seed"]


def _having(pairs: Sequence[tuple[Cell, Cell]], name: str) -> list[tuple[Cell, Cell]]:
    return [
        (old, new) for old, new in pairs if old.get(name) is not None and new.get(name) is not None
    ]


def _changes(pairs: Sequence[tuple[Cell, Cell]], name: str) -> FloatArray:
    return np.array([float(new[name]) - float(old[name]) for old, new in _having(pairs, name)])
