"""Whether the smoothed path of a log can be trusted, by signals that need no truth.

Two things can be wrong. Nothing holds a stretch of the path: then the posterior covariance of the
graph says how far off it may be, whether a place was seen twice or not. Or wrong places were taken
for each other: then other visits contradict what was seen, everywhere or at one place.

In 96 made-up logs with 5 to 40 points a metre (4 to 11 beams), the error of a right path was 0.3 to
1.2 times its expected one, and other visits contradicted at most 8 % of the points that they had
seen.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from limslam_agent.slam.map_graph.agreement import visit_counts
from limslam_agent.slam.map_graph.posterior import position_covariance
from limslam_agent.slam.map_graph.stages import GraphResult
from limslam_agent.status.chance import (
    LIMIT,
    chance_mistaken,
    chance_path_off,
    either,
    in_words,
    planar_covariance,
    rate_evidence,
)
from limslam_agent.status.status import Status, judged
from limslam_env.geometry import FloatArray, IntArray

# Shares of the points that other visits contradict, of all that they have seen, in a right path
# and in a wrong one: readings beside edges and thin obstacles are contradicted in a right path, too
_RIGHT = 0.06
_WRONG = 0.135
_LEAST_TIES = 2  # loops that span a break of odometry: a single one may be wrong


@dataclass(frozen=True)
class PathSignals:
    """What speaks for or against a path."""

    driven: float  # length of the path, m
    points: int  # number of the readings of walls that were used
    # confirmed, contradicted: shares of the points that other visits of their place confirm and
    # contradict
    confirmed: float
    contradicted: float
    # Joint covariance (2 k, 2 k) of positions along the path after rigid alignment, m^2
    covariance: FloatArray
    # Begin and end of the longest stretch that no loop spans, s from the beginning of the log. None
    # if it has not been looked for.
    loose: tuple[float, float] | None = None
    # Times around which other visits contradict more than they confirm, s from the beginning of the
    # log
    doubtful_times: tuple[float, ...] = ()
    # Times of breaks of odometry that too few loops span, s from the beginning of the log
    untied: tuple[float, ...] = ()

    @property
    def points_per_metre(self) -> float:
        """Readings of walls in a metre of driving."""
        return self.points / max(self.driven, 1.0)

    @property
    def contradicted_share(self) -> float:
        """Share of the contradicted points among all points that other visits have seen."""
        return self.contradicted / max(self.confirmed + self.contradicted, 1e-9)

    @property
    def position_std(self) -> float:
        """Expected root mean square error of the positions after rigid alignment, m."""
        return math.sqrt(max(2.0 * float(np.diag(self.covariance).mean()), 0.0))

    @property
    def status(self) -> Status:
        """By the chance that the path is off, and whether its parts are tied together."""
        far = chance_path_off(self.covariance)
        # That places were taken for each other, by the points that other visits contradict
        seen = self.points * (self.confirmed + self.contradicted)
        evidence = rate_evidence(self.points * self.contradicted, seen, _RIGHT, _WRONG)
        mistaken = chance_mistaken(evidence)
        chance = either(far, mistaken)
        if self.untied or self.doubtful_times:
            chance = max(chance, 0.5)
        reasons = []
        if self.untied:
            reasons.append(
                f"odometry jumps or has a gap at {_seconds(self.untied)}, and too few places that "
                "were seen before and after it tie both parts together"
            )
        if mistaken >= LIMIT:
            reasons.append(
                f"visits of a place contradict each other at {self.contradicted_share:.0%} of the "
                "points"
            )
        if self.doubtful_times:
            reasons.append(
                "visits contradict what was seen more often than they confirm it after "
                f"{_seconds(self.doubtful_times)}"
            )
        if far >= LIMIT or not reasons:
            where = "" if self.loose is None else " from {:.0f} to {:.0f} s".format(*self.loose)
            words = in_words(far, planar_covariance(self.position_std), "the path")
            reasons.append(f"{words}, as no recognised place holds it{where}")
        return judged(chance, ", ".join(reasons))

    @property
    def figures(self) -> dict[str, Any]:
        """For ``result.json``."""
        status = self.status
        return {
            "smoothed_status": status.level,
            "smoothed_status_reason": status.reason,
            "smoothed_status_chance": status.chance,
            "smoothed_position_std_m": self.position_std,
            "smoothed_points_per_m": self.points_per_metre,
            "smoothed_contradicted_share": self.contradicted_share,
            "smoothed_doubtful_times": [round(time, 2) for time in self.doubtful_times],
        }


def path_signals(found: GraphResult, time: FloatArray, seam: int = 0) -> PathSignals:
    """What speaks for or against a path.

    Parameters
    ----------
    found
        The smoothed log, or two logs that were smoothed as one.
    time
        Times of all events (n,), s from the beginning of their log.
    seam
        The key pose at which a second log begins; zero if there is none.
    """
    keys = found.keys
    path = found.trajectory
    loops = found.relations[0]
    visits = visit_counts(keys, path)
    times = time[keys.first_event]
    loose = times[list(longest_loose(keys.key_travel, loops))].tolist()
    breaks = keys.breaks[keys.breaks != seam]
    return PathSignals(
        driven=keys.driven,
        points=len(keys.point_event),
        confirmed=visits.shares[0],
        contradicted=visits.shares[1],
        covariance=position_covariance(keys, path, found.relations),
        loose=None if seam else tuple(loose),
        doubtful_times=tuple(times[visits.doubtful(seam)].tolist()),
        untied=tuple(times[_untied(breaks, loops)].tolist()),
    )


def _seconds(times: Sequence[float]) -> str:
    """The first few times, s."""
    return ", ".join(f"{time:.0f}" for time in times[:3]) + " s"


def _untied(breaks: IntArray, ends: IntArray) -> IntArray:
    """The breaks (k,), key poses, that fewer than ``_LEAST_TIES`` loops with the ends (f, 2)
    span.
    """
    first, last = np.sort(ends, axis=1).T
    ties = (first < breaks[:, None]) & (breaks[:, None] <= last)
    return np.asarray(breaks[ties.sum(axis=1) < _LEAST_TIES])


def longest_loose(travel: FloatArray, ends: IntArray) -> tuple[int, int]:
    """First and last index of the longest stretch of a path that no loop spans.

    Parameters
    ----------
    travel
        Length of the path up to each of its poses (n,), m.
    ends
        Indices (f, 2) of the poses that the loops join.
    """
    begin = 0
    best = (0, 0)
    for low, high in [*sorted(map(sorted, ends.tolist())), (len(travel) - 1, len(travel) - 1)]:
        if travel[low] - travel[begin] > travel[best[1]] - travel[best[0]]:
            best = begin, low
        begin = max(begin, high)
    return best
