"""Where a second log lies in the map of the first one.

The second log is divided into stretches, and the readings of each are searched in the whole map, by
the likelihood by which a robot that was carried away is found. A stretch of a corridor fits in many
places. But all stretches of a right place move the log by the same motion, so that their evidence
adds up, and chance fits disagree.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from limslam_agent.kernels.tables import RAY_TO_X, RAY_X
from limslam_agent.places.localisation import LARGEST_RUNNER_UP, LEAD, KnownPlaces
from limslam_agent.record import Scan
from limslam_agent.replay.record import Replay
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.map_graph.loops import agree
from limslam_agent.status.known_map import PlaceFit
from limslam_agent.status.rays import rays_of
from limslam_env.geometry import BoolArray, FloatArray, se2

# m of driving: of a stretch, and between the beginnings of two stretches
_LENGTH = 12.0
_EVERY = 8.0
_KEPT = 20  # places of a stretch, all with an evidence that is no chance
_MOST_CONTRADICTED = (
    0.25  # share of the readings that contradict the map: furniture moves, and odometry bends walls
)

NO_MATCH = "no two stretches of one log fit in the other log at places that agree"


@dataclass(frozen=True, eq=False)
class Place:
    """The best place of a log in a map, and whether it counts.

    Attributes
    ----------
    fit
        Pose of the log's frame, and what its stretches say of it together. None if there is no
        place.
    runner_up
        The largest evidence of another place.
    refusal
        Why the place does not count; empty if it does.
    """

    fit: PlaceFit | None
    runner_up: float
    refusal: str

    @property
    def record(self) -> dict[str, Any]:
        """For ``result.json``."""
        fit = self.fit
        if fit is None:
            return {}
        figures = {
            "evidence": fit.evidence,
            "contradictions": fit.contradictions,
            "tested": fit.tested,
        }
        return {"pose": fit.pose.tolist(), **figures, "runner_up": self.runner_up}


class _Fit(NamedTuple):
    """A place of a stretch, whose middle is (2,)."""

    stretch: int
    middle: FloatArray
    fit: PlaceFit


def sensor_of(replay: Replay) -> RangeSensor:
    """How the ranges of a log were measured, as its filter has found out."""
    found = getattr(replay.smoothed and replay.smoothed.basis, "sensor", None)
    return found or RangeSensor(replay.config.range_std)


def place_in(known: KnownPlaces, replay: Replay, poses: FloatArray) -> Place:
    """Search a map for the place of a log with poses (n, 3) in a frame of its own."""
    fits = _fits(known, replay, poses)
    if not fits:
        return Place(None, 0.0, NO_MATCH)
    agree = _agreements(fits)
    evidence = np.array([each.fit.evidence for each in fits])
    stretches = np.array([each.stretch for each in fits])
    of_stretch = [np.flatnonzero(stretches == each) for each in np.unique(stretches)]
    support = np.sum([(agree[:, rows] * evidence[rows]).max(axis=1) for rows in of_stretch], axis=0)
    best = int(np.argmax(support))
    weights = agree[best] * evidence
    members = [rows[weights[rows].argmax()] for rows in of_stretch if weights[rows].any()]
    most = fits[max(members, key=lambda row: evidence[row])]
    fit = PlaceFit(
        most.fit.pose,
        float(support[best]),
        sum(fits[row].fit.contradictions for row in members),
        sum(fits[row].fit.tested for row in members),
    )
    others = ~agree[members].any(axis=0)
    runner_up = float(support[others].max(initial=0.0))
    return Place(fit, runner_up, _refusal(fit, runner_up, len(members)))


def _fits(known: KnownPlaces, replay: Replay, poses: FloatArray) -> list[_Fit]:
    """The likely places of all stretches of a log."""
    log = replay.log
    sensor = sensor_of(replay)
    ranges = np.where(log.has_scan[:, None], log.ranges.astype(np.float64), np.nan)
    steps = [Scan(*each) for each in zip(poses, ranges, strict=True)]
    travel = np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0, prepend=poses[:1, :2]).T))
    found = []
    for stretch, begin in enumerate(np.arange(0.0, max(travel[-1] - _EVERY, _EVERY), _EVERY)):
        first, last = np.searchsorted(travel, (begin, begin + _LENGTH))
        rays = rays_of(steps[first : max(last, first + 1)], log.robot, sensor)
        if len(rays) and len(known.segments):
            places = known.weigh(known.refined(known.likely(rays), rays), rays)
            best = sorted(places, key=lambda place: -place.evidence)[:_KEPT]
            middle = rays[:, RAY_X:RAY_TO_X].mean(axis=0)
            found += [_Fit(stretch, middle, each) for each in best if each.evidence > LEAD]
    return found


def _agreements(fits: list[_Fit]) -> BoolArray:
    """Which fits (k, k) are of the same place. Those of the same stretch agree only with
    themselves.

    The place of one predicts that of the other as two loops do.
    """
    poses = np.array([each.fit.pose for each in fits])
    middles = np.array([each.middle for each in fits])
    placed = np.column_stack((middles, np.zeros(len(fits))))
    predicted = se2.compose(poses[:, None], placed[None])
    between = np.hypot(*np.moveaxis(middles[:, None] - middles[None], -1, 0))
    agreed = agree(predicted, se2.compose(poses, placed)[None], between)
    stretches = np.array([each.stretch for each in fits])
    return np.asarray(
        (agreed & agreed.T & (stretches[:, None] != stretches[None]))
        | np.eye(len(fits), dtype=np.bool_)
    )


def _refusal(fit: PlaceFit, runner_up: float, stretches: int) -> str:
    """Why a place does not count, in words; empty if it counts."""
    if stretches < 2:
        return NO_MATCH
    if fit.contradictions > _MOST_CONTRADICTED * fit.tested:
        return f"{fit.contradictions} of {fit.tested} readings contradict the map there"
    if runner_up > min(fit.evidence - LEAD, LARGEST_RUNNER_UP * fit.evidence):
        return f"ambiguous: another place has {runner_up / fit.evidence:.0%} of the evidence"
    return ""
