"""Whether the smoothed path of a log can be trusted, by signals that need no truth.

A right path does not pass through the walls that its own readings draw, and different visits of a place agree about
what is there. On variations of the logs ``csail`` and ``fr079``, other visits contradicted 2 to 10 % of the points that
they had seen if the path was at most 0.3 m off, 12 % of a path that was 0.5 m off, and 17 to 35 % if it was more than
1.6 m off. The latter crossed up to 3.5 walls in 100 m, and right paths at most 1.8.

Where two places look alike, most points of a wrong map are confirmed, too. But points are then contradicted at one
place only: in two made-up rings of corridors at 16 and 29 % of the points along some 20 m of driving, 15 times as often
as in three quarters of the log. In 21 right paths, among them cluttered ones of real logs, the factor was at most 5.
Wrong loops also bend the path away from what odometry and the walls along the way say. On simulated logs the chi-square
of a hop of 2.5 m was at most 10 in right paths (7 on ``fr079``), and 21 to 45 where wrong loops had bent the path.

Clutter, people and glass contradict scattered points. A wrong path contradicts whole pieces of walls, which one visit
has read and another one has looked through. On right paths of made-up and real logs 0 to 2.5 % of the pieces are
contradicted, and 0.4 % of all. In a made-up ring whose corridor lay 2.7 m off along itself they are 10 %, and in five
wrong maps of another ring 5 to 7 %, where less than 12 % of the points were contradicted.

A path that cannot be trusted still shows what is wrong with the log: up to which range the visits agree, and how large
the errors of odometry are. The log can then be smoothed again with both.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.agreement import MapScore
from limslam_agent.slam.graph.key_poses import KeyPoses, LogData, Trajectory, calibrated_steps, motion_variances
from limslam_agent.slam.graph.local_maps import chunk_middles, cut_chunks
from limslam_agent.status.contradictions import log_likelihood_ratio
from limslam_agent.status.status import Status
from limslam_env.geometry import BoolArray, FloatArray, se2

INSIDE_BY = 0.2
"""A path crosses a wall if it passes through it at least this far inside of its ends, m."""

MOST_CROSSINGS = 3.0
"""A path that crosses more walls than this in 100 m, and at least two, is doubtful."""

MOST_CONTRADICTED = 0.12
"""A path is doubtful if other visits contradict a larger share of the points that they confirm or contradict."""

PIECES_OF_RIGHT, PIECES_OF_WRONG, MOST_ODDS = 0.01, 0.06, 100.0
"""Shares of the pieces of walls that other visits contradict on right and on wrong paths, and the largest odds for a
wrong path by both. Chunks overlap and several visits read one wall, so pieces are not independent: the odds are a
threshold, and no probability."""

FEWEST_PIECES = 6
"""Fewer contradicted pieces of walls may be one thing that was moved: a cupboard of 1.6 m is up to four in a short
log."""

MOST_BENT = 16.0
"""A path is doubtful where its loops bend it away from the local smoothing by a larger chi-square."""

FAR_WITHOUT_LOOPS = 50.0
"""Distance, m, after which the error of a path without loops matters. It also holds for the parts of a path along which
hardly a wall was seen, and which no loop spans."""

_BIN, _LEAST_REACH, _LEAST_POINTS = 0.25, 1.0, 50
"""Ranges are judged in bins of this width, m, from this range on, m, and with at least so many judged points."""

_WINDOW = 14.0
"""Driving over which the errors of odometry are compared with what is assumed, m: they last for seconds."""

_LEAST_RATIO, _MOST_RATIO = 0.04, 9.0
"""Variances of odometry are changed by factors within these limits."""


@dataclass(frozen=True)
class PathSignals:
    """What speaks for or against a path.

    Attributes
    ----------
    driven
        Length of the path, m.
    crossing_times
        Times at which the path passes through walls, s from the beginning of the log.
    confirmed, contradicted
        Shares of the points that other visits of their place confirm and contradict.
    loops
        Number of loops that hold the path.
    bend_times
        Times at which the loops bend the path more than the local smoothing allows, s from the beginning of the log.
    doubtful_times
        Times around which other visits contradict much more than in the rest of the log, s from its beginning.
    reach
        Range from which on readings were left out because visits contradict each other there, m. None if all were used.
    pieces
        Numbers of all pieces of walls that other visits have seen, and of those that they contradict as a whole.
    blind
        Length of the parts of the path that only odometry holds, m: no loop spans them, and too few points were seen
        there to recognise them.
    """

    driven: float
    crossing_times: tuple[float, ...]
    confirmed: float
    contradicted: float
    loops: int
    bend_times: tuple[float, ...] = ()
    doubtful_times: tuple[float, ...] = ()
    reach: float | None = None
    pieces: tuple[int, int] = (0, 0)
    blind: float = 0.0

    @property
    def crossings(self) -> int:
        """Number of places where the path passes through walls."""
        return len(self.crossing_times)

    @property
    def crossings_per_100_m(self) -> float:
        """Places in 100 m of driving where the path passes through walls."""
        return 100.0 * self.crossings / max(self.driven, 1.0)

    @property
    def contradicted_share(self) -> float:
        """Share of the contradicted points among all points that other visits have seen."""
        return self.contradicted / max(self.confirmed + self.contradicted, 1e-9)

    @property
    def contradicts_itself(self) -> bool:
        """Whether visits contradict each other at so many points that the path is doubtful."""
        return self.contradicted_share > MOST_CONTRADICTED

    @property
    def contradicts_walls(self) -> bool:
        """Whether so many whole pieces of walls are contradicted that the path is doubtful."""
        seen, against = self.pieces
        log_odds = log_likelihood_ratio(against, seen, PIECES_OF_WRONG, PIECES_OF_RIGHT)
        return against >= FEWEST_PIECES and log_odds > math.log(MOST_ODDS)

    @property
    def status(self) -> Status:
        """``ok``, or ``unsure`` with the reasons."""
        reasons = []
        if self.crossings > 1 and self.crossings_per_100_m > MOST_CROSSINGS:
            reasons.append(f"the path passes through walls at {self.crossings} places")
        if self.contradicts_itself:
            reasons.append(f"visits of a place contradict each other at {self.contradicted_share:.0%} of the points")
        if self.contradicts_walls:
            seen, against = self.pieces
            reasons.append(f"of {seen} pieces of walls, {against} are where other visits saw free space")
        if self.doubtful_times:
            times = _listed(self.doubtful_times)
            reasons.append(f"visits contradict each other much more than elsewhere after {times} s")
        if self.bend_times:
            times = _listed(self.bend_times)
            reasons.append(f"the path is bent more than odometry and walls allow after {times} s")
        if not self.loops and self.driven > FAR_WITHOUT_LOOPS:
            reasons.append(f"no place was recognised again in {self.driven:.0f} m")
        elif self.blind > FAR_WITHOUT_LOOPS:
            reasons.append(f"hardly a wall was seen in {self.blind:.0f} m that no recognised place holds")
        return Status("unsure", ", ".join(reasons)) if reasons else Status()

    def is_worse_than(self, other: "PathSignals") -> bool:
        """Whether another path of the same log crosses clearly fewer walls, and its visits agree better."""
        agreement, others = self.confirmed - self.contradicted, other.confirmed - other.contradicted
        return self.crossings > max(1, 2 * other.crossings) and others > agreement

    @property
    def figures(self) -> dict[str, Any]:
        """For ``result.json``."""
        return {
            "smoothed_status": self.status.level,
            "smoothed_status_reason": self.status.reason,
            "smoothed_wall_crossings": self.crossings,
            "smoothed_wall_crossing_times": [round(time, 2) for time in self.crossing_times],
            "smoothed_contradicted_share": self.contradicted_share,
            "smoothed_contradicted_walls": self.pieces[1] / self.pieces[0] if self.pieces[0] else None,
            "smoothed_reach_m": self.reach,
            "smoothed_bend_times": [round(time, 2) for time in self.bend_times],
            "smoothed_doubtful_times": [round(time, 2) for time in self.doubtful_times],
        }


def _listed(times: tuple[float, ...]) -> str:
    """The first times of a reason, s."""
    return ", ".join(f"{time:.0f}" for time in times[:3])


def reach_of_agreement(keys: KeyPoses, trajectory: Trajectory, config: GraphConfig, max_range: float) -> float:
    """The range up to which visits agree, m: beyond it, other visits contradict too many points at every range.

    A beam may see the floor where the robot tilts, or get echoes that are too weak. Such readings are wrong beyond some
    range, whatever the path. A wrong path is contradicted at all ranges, and then ``max_range`` is returned.
    """
    middles = chunk_middles(keys, config.maps, config.maps.half)
    maps = cut_chunks(keys, trajectory, config.maps, middles, max_range)
    # The score compares few points of each cell; here each point needs its range.
    counts = [len(each.places) for each in maps]
    score = replace(
        MapScore.of(maps),
        points=np.concatenate([each.places for each in maps]),
        starts=np.cumsum([0, *counts]),
    )
    ranges = np.concatenate([np.hypot(*(each.places - each.origins).T) for each in maps])
    return _reach(ranges, *score.verdicts(trajectory.poses[middles]), max_range)


def _reach(ranges: FloatArray, confirmed: BoolArray, contradicted: BoolArray, max_range: float) -> float:
    """The first bin's begin from which on all bins with enough points are contradicted too much; or ``max_range``."""
    most = int(np.ceil(max_range / _BIN))
    bins = np.minimum((ranges / _BIN).astype(np.int64), most - 1)  # a range may be rounded up to the longest one
    against = np.bincount(bins[contradicted], minlength=most)
    judged = against + np.bincount(bins[confirmed], minlength=most)
    bad = (judged < _LEAST_POINTS) | (against > MOST_CONTRADICTED * judged)
    first = len(bad) - int(np.argmin(bad[::-1])) if not bad.all() else 0
    is_beyond = against[first:].sum() > MOST_CONTRADICTED * judged[first:].sum()
    return first * _BIN if is_beyond and _LEAST_REACH <= first * _BIN < max_range else max_range


def odometry_variances(data: LogData, keys: KeyPoses, trajectory: Trajectory) -> FloatArray:
    """Variances (n, 3) of the motions of a log, as large as its smoothed path shows.

    The differences between the smoothed path and the corrected odometry over some metres are compared with the
    variances that are assumed for them. Gyroscopes turn ten times as exactly as wheels.
    """
    moves = se2.between(trajectory.poses[:-1], trajectory.poses[1:]) - calibrated_steps(keys, trajectory.bias)
    moves[:, 2] = se2.wrap_angle(moves[:, 2])
    ends = np.searchsorted(keys.key_travel, keys.key_travel + _WINDOW)
    begins = np.flatnonzero(ends < len(keys))
    ratios = np.ones(3)
    if len(begins):
        errors, assumed = (np.vstack((np.zeros(3), np.cumsum(each, axis=0))) for each in (moves, keys.step_variances))
        found = ((errors[ends[begins]] - errors[begins]) ** 2).mean(axis=0)
        ratios = np.clip(found / (assumed[ends[begins]] - assumed[begins]).mean(axis=0), _LEAST_RATIO, _MOST_RATIO)
    steps = se2.between(data.odometry[:-1], data.odometry[1:])
    lengths, turns = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    return np.vstack((np.zeros(3), motion_variances(lengths, turns) * ratios))


def crossings(path: FloatArray, segments: FloatArray) -> BoolArray:
    """Which steps (n - 1,) of a path (n, 2), m, pass through at least one of the walls (k, 4), m."""
    begins, ends = path[:-1], path[1:]
    crosses = np.zeros(len(begins), dtype=np.bool_)
    for segment in segments:
        begin, along = segment[:2], segment[2:] - segment[:2]
        length = float(np.hypot(*along))
        if length <= 2.0 * INSIDE_BY:
            continue
        along = along / length
        normal = np.array([-along[1], along[0]])
        before, after = (begins - begin) @ normal, (ends - begin) @ normal
        passes = before * after < 0.0
        share = np.where(passes, before / np.where(passes, before - after, 1.0), 0.0)
        place = (begins + share[:, None] * (ends - begins) - begin) @ along
        crosses |= passes & (place > INSIDE_BY) & (place < length - INSIDE_BY)
    return crosses
