"""The leaderboard: entries in the order of their scores, with intervals and paired tests."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from limslam_agent.arena.results import Row, Stamp, read_results
from limslam_agent.measurements.statistics import Estimate, holm, mean, signed_rank
from limslam_env.geometry import FloatArray

SCORE = "plan_time_to_95_s"
"""The metric whose mean over the plans is the score of an entry."""

_DIGITS = 9  # scores that differ by rounding only are equal

_FIGURES: dict[str, Any] = {
    "ate_final_m": np.median,
    "wall_f1_5cm": np.median,
    "anees_final": np.median,
    "correct_coverage": np.mean,
    "touches": np.mean,
    "plan_time_to_80_s": np.mean,
}


@dataclass(frozen=True)
class Standing:
    """The place of an entry, from 1, which entries with equal scores share.

    The score is the mean of the ``values`` (n,) in the plans. ``figures`` are further means and
    medians by their names.
    """

    folder: Path
    stamp: Stamp
    rows: list[Row]
    place: int
    values: FloatArray
    score: Estimate
    figures: dict[str, float | None]

    @property
    def name(self) -> str:
        """Name of the entry."""
        return str(self.stamp.entry.get("name", ""))

    @property
    def solved(self) -> int:
        """Number of plans that were not lost."""
        return sum(not row.metrics["lost"] for row in self.rows)

    @property
    def claimed(self) -> int:
        """Number of plans that were lost by a wrong claim to be done."""
        return sum(
            bool(row.metrics["claims_done"]) and bool(row.metrics["lost"]) for row in self.rows
        )


@dataclass(frozen=True)
class Comparison:
    """Two entries: the mean score of the second minus that of the first.

    The p-value is that of a signed-rank test, corrected for the number of pairs; None if all values
    are equal.
    """

    first: str
    second: str
    difference: Estimate
    p_value: float | None


@dataclass(frozen=True)
class Board:
    """A leaderboard: the entries, best first, and all pairs of them.

    ``plans`` are the numbers of the plans that all entries have run, on which they are compared.
    """

    is_secret: bool
    plans: list[int]
    standings: list[Standing]
    comparisons: list[Comparison]


def board(folders: Sequence[Path]) -> Board:
    """The leaderboard of folders of results.

    Raises
    ------
    ValueError
        If a folder holds no results, or the folders have no plans in common.
    """
    entries = [(folder, *read_results(folder)) for folder in folders]
    (first, stamp, _), *others = entries
    for folder, other, _ in others:
        if other.plans != stamp.plans:
            raise ValueError(f"{folder}: has other plans than {first}, so they cannot be compared")
        if sum(other.digest == each.digest for _, each, _ in entries) > 1:
            raise ValueError(f"{folder}: its entry is there twice")
    plans = sorted(set.intersection(*(set(rows) for *_, rows in entries)))
    if not plans:
        raise ValueError("the folders have no plan in common")
    scored = [(folder, each, [rows[plan] for plan in plans]) for folder, each, rows in entries]
    values = {folder: _values(rows) for folder, _, rows in scored}
    totals = {folder: round(float(each.mean()), _DIGITS) for folder, each in values.items()}
    standings = [
        Standing(
            folder,
            each,
            rows,
            1 + sum(total < totals[folder] for total in totals.values()),
            values[folder],
            _mean(values[folder]),
            _figures(rows),
        )
        for folder, each, rows in sorted(scored, key=lambda entry: totals[entry[0]])
    ]
    return Board(stamp.is_secret, plans, standings, _comparisons(standings))


def _mean(values: FloatArray) -> Estimate:
    found = mean(values)
    assert found is not None  # noqa: S101 (there are plans)
    return found


def _numbers(rows: Sequence[Row], metric: str) -> list[float | None]:
    found = [row.metrics.get(metric) for row in rows]
    return [float(value) if isinstance(value, int | float) else None for value in found]


def _values(rows: Sequence[Row]) -> FloatArray:
    return np.array(_numbers(rows, SCORE), dtype=float)


def _figures(rows: Sequence[Row]) -> dict[str, float | None]:
    known: dict[str, Any] = {
        name: [each for each in _numbers(rows, name) if each is not None] for name in _FIGURES
    }
    found = {name: float(of(known[name])) if known[name] else None for name, of in _FIGURES.items()}
    return {**found, "cpu_s": float(np.mean([row.cost.get("cpu_s", 0.0) for row in rows]))}


def _comparisons(standings: Sequence[Standing]) -> list[Comparison]:
    """All pairs of entries, with p-values that are corrected for their number."""
    pairs = list(combinations(standings, 2))
    # Differences by rounding only are none, and equal ones have equal ranks.
    differences = [np.round(second.values - first.values, _DIGITS) for first, second in pairs]
    p_values = holm([signed_rank(each) for each in differences])
    return [
        Comparison(first.name, second.name, _mean(each), p_value)
        for (first, second), each, p_value in zip(pairs, differences, p_values, strict=True)
    ]
