"""The leaderboard: entries in the order of their scores, with intervals and paired tests."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata

from limslam_agent.arena.results import Row, Stamp, read_rows, read_stamp
from limslam_agent.arena.statistics import Comparison, Mean, compare, holm, mean
from limslam_agent.arena.tracks import EXPLORATION, MAPPING, MAX_TIME
from limslam_env.geometry import FloatArray

SCORES = {"exploration": "plan_time_to_95_s", "mapping": "wall_f1_5cm"}
"""The metric whose mean over the plans is the score of an entry in each track."""

_WORST = {EXPLORATION: MAX_TIME, MAPPING: 0.0}
_DIGITS = 9  # scores that differ by rounding only are equal

_MEDIANS = ("ate_final_m", "wall_f1_5cm", "anees_final")
_MEANS = ("correct_coverage", "touches")


@dataclass(frozen=True)
class Results:
    """A folder of results.

    Attributes
    ----------
    folder, stamp
        The folder, and whose results it has.
    rows
        The rows by the numbers of their plans.
    """

    folder: Path
    stamp: Stamp
    rows: dict[int, Row]

    def values(self, metric: str, plans: Sequence[int]) -> dict[int, float]:
        """A metric by the plans that have it."""
        found = {plan: self.rows[plan].metrics.get(metric) for plan in plans}
        return {plan: float(value) for plan, value in found.items() if isinstance(value, int | float)}

    @property
    def knows_truth(self) -> bool:
        """Whether the entry knows the truth, so that it is not ranked."""
        return self.stamp.entry.get("uses") == "truth"


@dataclass(frozen=True)
class Standing:
    """The place of an entry.

    Attributes
    ----------
    results
        Its results.
    place
        Its place from 1, which entries with equal scores share; None for an entry that knows the truth.
    score
        The mean of the track's score.
    mean_rank
        The mean of its ranks among the ranked entries, plan by plan. None without a place.
    solved, claimed, failed
        Numbers of plans that were not lost, that were lost by a wrong claim to be done, and that failed.
    figures
        Further means and medians by their names.
    """

    results: Results
    place: int | None
    score: Mean
    mean_rank: float | None
    solved: int
    claimed: int
    failed: int
    figures: dict[str, float | None]

    @property
    def name(self) -> str:
        """Name of the entry."""
        return str(self.results.stamp.entry.get("name", ""))


@dataclass(frozen=True)
class Board:
    """A leaderboard.

    Attributes
    ----------
    track, is_secret
        The track, and whether its plans come from a secret seed.
    plans
        Numbers of the plans that all entries have run, on which they are compared.
    standings
        The entries, best first. Entries that know the truth come last.
    comparisons
        Of all pairs of ranked entries: first, second, and the score of the second minus that of the first. The p-values
        are corrected for the number of pairs (:func:`~limslam_agent.arena.statistics.holm`).
    """

    track: str
    is_secret: bool
    plans: list[int]
    standings: list[Standing]
    comparisons: list[tuple[str, str, Comparison]]


def read_results(folder: Path) -> Results:
    """A folder of results.

    Raises
    ------
    ValueError
        If it holds none.
    """
    stamp, rows = read_stamp(folder), {row.plan: row for row in read_rows(folder)}
    if not rows:
        raise ValueError(f"{folder}: has no results yet")
    return Results(folder, stamp, rows)


def board(folders: Sequence[Path]) -> Board:
    """The leaderboard of folders of results.

    Raises
    ------
    ValueError
        If a folder holds no results, or the folders have no plans in common.
    """
    entries = [read_results(folder) for folder in folders]
    first = entries[0]
    for other in entries[1:]:
        if other.stamp.plans != first.stamp.plans:
            raise ValueError(f"{other.folder}: has other plans than {first.folder}, so they cannot be compared")
        if any(other.stamp.digest == each.stamp.digest for each in entries if each is not other):
            raise ValueError(f"{other.folder}: its entry is there twice")
    plans = sorted(set.intersection(*(set(each.rows) for each in entries)))
    if not plans:
        raise ValueError("the folders have no plan in common")
    track = first.stamp.track
    ranked = sorted((each for each in entries if not each.knows_truth), key=lambda each: _order(each, track, plans))
    ranks = _mean_ranks(ranked, track, plans)
    scores = [_order(each, track, plans) for each in ranked]
    standings = [
        _standing(each, track, plans, 1 + scores.index(score), rank)
        for each, score, rank in zip(ranked, scores, ranks, strict=True)
    ]
    standings += [_standing(each, track, plans, None, None) for each in entries if each.knows_truth]
    return Board(track, first.stamp.is_secret, plans, standings, _comparisons(standings, track, plans))


def score_values(results: Results, track: str, plans: Sequence[int]) -> FloatArray:
    """The score of each plan (n,). A row without a score has the worst one."""
    found = results.values(SCORES[track], plans)
    return np.array([found.get(plan, _WORST[track]) for plan in plans])


def _order(results: Results, track: str, plans: Sequence[int]) -> float:
    value = round(float(np.mean(score_values(results, track, plans))), _DIGITS)
    return -value if track == MAPPING else value


def _mean_ranks(ranked: Sequence[Results], track: str, plans: Sequence[int]) -> list[float]:
    """Mean rank of each entry over the plans. Equal entries share the mean of their ranks."""
    if not ranked:
        return []
    table = np.round([score_values(each, track, plans) for each in ranked], _DIGITS)
    ranks = rankdata(-table if track == MAPPING else table, axis=0)
    return [float(value) for value in ranks.mean(axis=1)]


def _standing(
    results: Results, track: str, plans: Sequence[int], place: int | None, mean_rank: float | None
) -> Standing:
    rows = [results.rows[plan] for plan in plans]
    return Standing(
        results, place, mean(score_values(results, track, plans)), mean_rank,
        solved=sum(not row.metrics.get("lost") for row in rows),
        claimed=sum(bool(row.metrics.get("claims_done")) and bool(row.metrics.get("lost")) for row in rows),
        failed=sum(row.error is not None for row in rows),
        figures={
            **{name: _of(np.median, results.values(name, plans)) for name in _MEDIANS},
            **{name: _of(np.mean, results.values(name, plans)) for name in (*_MEANS, "plan_time_to_80_s")},
            "cpu_s": float(np.mean([row.cost.get("cpu_s", 0.0) for row in rows])),
        },
    )  # fmt: skip


def _of(statistic: Any, values: dict[int, float]) -> float | None:
    return float(statistic(list(values.values()))) if values else None


def _comparisons(standings: Sequence[Standing], track: str, plans: Sequence[int]) -> list[tuple[str, str, Comparison]]:
    """All pairs of ranked entries, with p-values that are corrected for their number."""
    pairs = list(combinations([each for each in standings if each.place is not None], 2))
    found = [
        compare(*(dict(zip(plans, score_values(each.results, track, plans), strict=True)) for each in pair))
        for pair in pairs
    ]
    corrected = holm([each.p_value for each in found])
    return [
        (first.name, second.name, replace(each, p_value=p_value))
        for (first, second), each, p_value in zip(pairs, found, corrected, strict=True)
    ]
