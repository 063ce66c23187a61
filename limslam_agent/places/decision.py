"""Whether a match of two maps counts: it must be good, and no other place may fit nearly as well."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from limslam_agent.places.matching import Fit, are_apart, best_fits
from limslam_agent.places.place_map import PlaceMap
from limslam_env.geometry import FloatArray

LEAST_FORWARD, _LEAST_BACKWARD = 0.94, 0.85
"""Least share of confirmed points among the confirmed and contradicted points: of the local map, and of the other map.
"""

LARGEST_RUNNER_UP = 0.70
"""Largest score of another pose, as a share of the best score."""

MATCH_STD, MATCH_HEADING_STD = 0.05, math.radians(2.0)
"""Standard deviations of position and heading of a match, m and rad."""

FIRST, SPACING = 1.5, 0.5
"""Distance that a robot drives before its local map is matched for the first time, and between two matches, m."""

LONGEST = 6000
"""Largest number of steps of a search, and of those that are kept of a robot that is lost."""

CONFIRMED, FAR_CONFIRMED = 3.0, 30.0
"""A place is confirmed after so much driving without contradictions, m: in a map without a frontier, and in any map."""

_LEAST_WALLS, _LEAST_ACROSS = 4.0, 0.9  # m: length of confirmed walls, in all and across their main direction
_LEAST_KNOWN = 0.35  # share of the local map's points that are confirmed
# The score of another pose counts only for this share if at least this number of points contradict it and its shares of
# confirmed points are less than ``LEAST_FORWARD``.
_DISCOUNT, _DISCOUNTED = 0.78, 4


@dataclass(frozen=True, eq=False)
class Decision:
    """The best match of a local map with a known map, and whether it counts.

    Attributes
    ----------
    fit
        The best match; None if nothing could be compared.
    runner_up
        Score of the best match at another place, as a share of the best score.
    refusal
        Why the match does not count, in words. Empty if it counts.
    """

    fit: Fit | None
    runner_up: float
    refusal: str

    @property
    def is_accepted(self) -> bool:
        """Whether the match counts."""
        return not self.refusal

    @property
    def record(self) -> dict[str, Any]:
        """The decision as it stands in ``result.json``."""
        fit = self.fit
        figures = {} if fit is None else {
            "pose": fit.pose.tolist(), "score": fit.score, "forward": fit.forward, "backward": fit.backward,
            "runner_up": self.runner_up, "contradictions": fit.contradictions, "known": fit.known,
            "walls_m": fit.walls, "across_m": fit.across,
        }  # fmt: skip
        return {
            **figures,
            "accepted": self.is_accepted,
            "reason": self.refusal or "the local map fits in one place only",
        }


def find_place(known: PlaceMap, local: PlaceMap) -> Decision:
    """Match a local map with a known map, and decide whether the match counts."""
    fits = best_fits(known, local)
    if not fits:
        return Decision(None, 0.0, "one of the maps has no walls")
    best = fits[0]
    share = runner_up(fits)
    return Decision(best, share, _refusal(best, share))


def runner_up(fits: Sequence[Fit]) -> float:
    """The best score of the other poses, as a share of the score of the first one. Contradicted poses count less."""
    best = fits[0].score
    scores = [max(fit.score, 0.0) * (_DISCOUNT if _is_contradicted(fit) else 1.0) for fit in fits[1:]]
    return max(scores, default=0.0) / best if best > 0.0 else 1.0


def _is_contradicted(fit: Fit) -> bool:
    return fit.contradictions >= _DISCOUNTED and min(fit.forward, fit.backward) < LEAST_FORWARD


def agree(first: Decision, second: Decision, local: PlaceMap) -> bool:
    """Whether two decisions accept the same place of a local map."""
    if first.fit is None or second.fit is None or not (first.is_accepted and second.is_accepted):
        return False
    return not are_apart(first.fit.pose, second.fit.pose, local.middle)


def match_covariance(middle: FloatArray, pose: FloatArray, drift: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """Covariance (3, 3) of a pose (3,) that follows from a match, which places the middle (2,) of a map.

    An error of its turn moves poses that are far from there. The variances ``drift`` of position and heading, m^2 and
    rad^2, are those of the way from the pose to the middle.
    """
    place, lever = MATCH_STD**2 + drift[0], np.eye(3)
    lever[:2, 2] = middle[1] - pose[1], pose[0] - middle[0]
    return lever @ np.diag([place, place, MATCH_HEADING_STD**2 + drift[1]]) @ lever.T


def _refusal(best: Fit, runner_up: float) -> str:
    """Why a match does not count, in words; empty if it counts."""
    if best.walls < _LEAST_WALLS:
        return f"only {best.walls:.1f} m of walls fit"
    if best.across < _LEAST_ACROSS:
        return f"ambiguous: only {best.across:.1f} m of the walls run across the others"
    if best.forward < LEAST_FORWARD or best.backward < _LEAST_BACKWARD:
        return f"{best.contradictions} points of walls lie where the other map is free"
    if best.known < _LEAST_KNOWN:
        return f"only {best.known:.0%} of the local map's walls are known"
    if runner_up > LARGEST_RUNNER_UP:
        return f"ambiguous: another place has {runner_up:.0%} of the best score"
    return ""
