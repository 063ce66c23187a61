"""Whether a match of two maps counts: it must be good, and no other place may fit nearly as well."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from limslam_agent.config.places import PlaceConfig
from limslam_agent.places.matching import Fit, are_apart, best_fits
from limslam_agent.places.place_map import PlaceMap
from limslam_env.geometry import FloatArray


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


def find_place(known: PlaceMap, local: PlaceMap, config: PlaceConfig) -> Decision:
    """Match a local map with a known map, and decide whether the match counts."""
    fits = best_fits(known, local, config)
    if not fits:
        return Decision(None, 0.0, "one of the maps has no walls")
    best = fits[0]
    share = runner_up(fits, config)
    return Decision(best, share, _refusal(best, share, config))


def runner_up(fits: Sequence[Fit], config: PlaceConfig) -> float:
    """The best score of the other poses, as a share of the score of the first one. Contradicted poses count less."""
    best = fits[0].score
    scores = [max(fit.score, 0.0) * (config.discount if _is_contradicted(fit, config) else 1.0) for fit in fits[1:]]
    return max(scores, default=0.0) / best if best > 0.0 else 1.0


def _is_contradicted(fit: Fit, config: PlaceConfig) -> bool:
    return fit.contradictions >= config.discounted and min(fit.forward, fit.backward) < config.forward


def agree(first: Decision, second: Decision, local: PlaceMap, config: PlaceConfig) -> bool:
    """Whether two decisions accept the same place of a local map."""
    if first.fit is None or second.fit is None or not (first.is_accepted and second.is_accepted):
        return False
    return not are_apart(first.fit.pose, second.fit.pose, local, config)


def match_covariance(
    middle: FloatArray, pose: FloatArray, config: PlaceConfig, drift: tuple[float, float] = (0.0, 0.0)
) -> FloatArray:
    """Covariance (3, 3) of a pose (3,) that follows from a match, which places the middle (2,) of a map.

    An error of its turn moves poses that are far from there. The variances ``drift`` of position and heading, m^2 and
    rad^2, are those of the way from the pose to the middle.
    """
    place, lever = config.std**2 + drift[0], np.eye(3)
    lever[:2, 2] = middle[1] - pose[1], pose[0] - middle[0]
    return lever @ np.diag([place, place, config.heading_std**2 + drift[1]]) @ lever.T


def _refusal(best: Fit, runner_up: float, config: PlaceConfig) -> str:
    """Why a match does not count, in words; empty if it counts."""
    if best.walls < config.least_walls:
        return f"only {best.walls:.1f} m of walls fit"
    if best.across < config.least_across:
        return f"ambiguous: only {best.across:.1f} m of the walls run across the others"
    if best.forward < config.forward or best.backward < config.backward:
        return f"{best.contradictions} points of walls lie where the other map is free"
    if best.known < config.known:
        return f"only {best.known:.0%} of the local map's walls are known"
    if runner_up > config.runner_up:
        return f"ambiguous: another place has {runner_up:.0%} of the best score"
    return ""
