"""Stretches that a robot drove backwards, in logs whose odometry never says so.

Encoders with a single channel count distances without a sign, and so do some converted logs: on ``fr079`` odometry says
"ahead" for all of its 393 m, and the robot drove backwards in 14 places. Such a stretch of 3 m is an error of 6 m, which
no model of noise explains.

A robot can change its direction only where it stops. After a stop it sees the walls that it has seen before the stop
again: from where it has been before, if it drives backwards, and from ahead otherwise. Both are tried.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from limslam_agent.config.graph import GraphConfig, ReversingConfig
from limslam_agent.slam.graph.key_poses import LogData, integrate, to_world
from limslam_agent.slam.graph.local_maps import LocalMap, draw_grid, grid_size, thinned
from limslam_agent.slam.graph.matching import NO_MATCH, SearchGrid, Window, match, search_grid
from limslam_env.geometry import FloatArray, IntArray, se2

_FEWEST_POINTS = 10


def with_reversing(data: LogData, config: GraphConfig) -> LogData:
    """The log with the motions turned round that the ranges say were driven backwards.

    A log whose odometry reports driving backwards itself stays as it is.
    """
    drive = _Drive(data, config)
    if not drive.is_unsigned:
        return data
    leads = {number: drive.lead(number) for number in range(len(drive.stretches))}
    while leads and leads[best := max(leads, key=leads.__getitem__)] > 0.0:
        del leads[best]
        drive.turn_round(best)
        for number in drive.near(best):
            if number in leads:
                leads[number] = drive.lead(number)
    return replace(data, odometry=integrate(data.odometry[0], drive.moves)) if drive.turned else data


def reversed_distance(data: LogData, directed: LogData) -> tuple[float, int]:
    """Distance that is driven backwards in the second log and not in the first one, m, and the number of stretches."""
    before, after = (_moves(each)[:, 0] for each in (data, directed))
    backwards = (after < 0.0) & (before > 0.0)
    begins = backwards & ~np.append(False, backwards[:-1])
    return float(before[backwards].sum()), int(begins.sum())


def _moves(data: LogData) -> FloatArray:
    return se2.between(data.odometry[:-1], data.odometry[1:])


@dataclass(eq=False)
class _Drive:
    """The motions of a log, divided into stretches between stops.

    Attributes
    ----------
    data, config
        The log and the settings.
    moves
        Motions (n - 1, 3) from event to event, with the directions found so far.
    travel
        Length (n,) of the path up to each event, m.
    points
        Points (n, b, 2) in the robot's frame, m.
    stretches
        First event and last event (k, 2) of each stretch that is long enough to be judged.
    turned
        Numbers of the stretches that were driven backwards.
    """

    data: LogData
    config: GraphConfig
    moves: FloatArray = field(init=False)
    travel: FloatArray = field(init=False)
    points: FloatArray = field(init=False)
    stretches: IntArray = field(init=False)
    turned: list[int] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        data = self.data
        self.moves = _moves(data)
        self.travel = np.append(0.0, np.cumsum(np.hypot(self.moves[:, 0], self.moves[:, 1])))
        rays = np.column_stack((np.cos(data.angles), np.sin(data.angles)))
        self.points = data.origins + data.ranges[..., None] * rays
        self.stretches = _stretches(data.time, self.travel, self.settings)

    @property
    def settings(self) -> ReversingConfig:
        """The settings of the search for stretches that were driven backwards."""
        return self.config.reversing

    @property
    def is_unsigned(self) -> bool:
        """Whether odometry has never reported driving backwards."""
        ahead = self.moves[:, 0]
        return bool(-ahead[ahead < 0.0].sum() <= self.settings.unsigned * self.travel[-1])

    def turn_round(self, number: int) -> None:
        """Take a stretch as driven backwards."""
        begin, end = self.stretches[number]
        self.moves[begin:end, :2] *= -1.0
        self.turned.append(number)

    def near(self, number: int) -> IntArray:
        """The stretches whose comparison uses this stretch."""
        begins, ends = self.travel[self.stretches.T]
        reach = self.settings.before + self.settings.after
        return np.flatnonzero((begins <= ends[number] + reach) & (ends >= begins[number] - reach))

    def lead(self, number: int) -> float:
        """By how much a stretch fits better than is needed if it was driven backwards."""
        begin, end = self.stretches[number]
        known = self._known(begin)
        if known is None:
            return NO_MATCH
        ahead, backwards = (self._score(known, begin, end, sign) for sign in (1.0, -1.0))
        needed = self.settings.lead + self.settings.lead_per_metre * (self.travel[end] - self.travel[begin])
        return float(backwards - ahead - needed) if backwards >= self.settings.score else NO_MATCH

    def _known(self, event: int) -> SearchGrid | None:
        """What was seen in the last metres before an event, in the frame of its pose."""
        first = int(np.searchsorted(self.travel, self.travel[event] - self.settings.before))
        poses = integrate(np.zeros(3), self.moves[first:event])
        places, origins = self._seen(np.arange(first, event + 1), se2.between(poses[-1], poses))
        if len(places) < _FEWEST_POINTS:
            return None
        maps = self.config.maps
        grid = draw_grid(places, origins, grid_size(maps, self.data.max_range), maps)
        chunk = LocalMap(event, float(self.travel[event]), places, origins, places, grid, maps.cell)
        return search_grid(chunk, self.settings.window, self.config.matching)

    def _score(self, known: SearchGrid, begin: int, end: int, sign: float) -> float:
        """The score of the metres after ``begin``, with the stretch up to ``end`` driven ahead (1) or backwards."""
        settings = self.settings
        length = min(settings.after, self.travel[end] - self.travel[begin] + settings.beyond)
        last = int(np.searchsorted(self.travel, self.travel[begin] + length, side="right")) - 1
        moves = self.moves[begin:last].copy()
        moves[: end - begin, :2] *= sign
        places, _ = self._seen(np.arange(begin, last + 1), integrate(np.zeros(3), moves))
        window = Window(settings.window, settings.turn_window, self.config.loops.turn_step)
        points = thinned(places, self.config.maps.cell)
        return match(known, points, np.zeros(3), window, self.config.matching, NO_MATCH).score

    def _seen(self, events: IntArray, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points and origins of their beams, (p, 2) each, at events (k,) with poses (k, 3)."""
        row, beam = np.nonzero(self.data.hit[events])
        places = to_world(poses[row], self.points[events[row], beam])
        return places, to_world(poses[row], self.data.origins[beam])


def _stretches(time: FloatArray, travel: FloatArray, settings: ReversingConfig) -> IntArray:
    """First and last event (k, 2) of the stretches between stops."""
    lengths, periods = np.diff(travel), np.diff(np.maximum.accumulate(time))
    speeds = lengths / np.maximum(periods, 1e-3)
    driving = speeds[lengths > 0.0]
    moving = speeds >= settings.slow * np.median(driving) if len(driving) else np.zeros(len(speeds), dtype=np.bool_)
    changes = np.diff(np.concatenate(([False], moving, [False])).astype(np.int64))
    found = np.column_stack((np.flatnonzero(changes > 0), np.flatnonzero(changes < 0)))
    return np.asarray(found[travel[found[:, 1]] - travel[found[:, 0]] >= settings.least])
