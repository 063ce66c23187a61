"""Successive metres of a log compared with each other: what was seen next, placed on what was seen just before."""

from dataclasses import dataclass, field

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.key_poses import LogData, integrate, to_world
from limslam_agent.slam.graph.local_maps import LocalMap, draw_grid, grid_size, thinned
from limslam_agent.slam.graph.matching import NO_MATCH, SearchGrid, Window, match, search_grid
from limslam_env.geometry import FloatArray, IntArray, se2

_FEWEST_POINTS = 10


@dataclass(eq=False)
class LocalViews:
    """What was seen along a log.

    Attributes
    ----------
    data, config
        The log and the settings.
    window
        The window of a match.
    moves
        Motions (n - 1, 3) from event to event. They may be changed.
    travel
        Length (n,) of the path up to each event, m.
    """

    data: LogData
    config: GraphConfig
    window: Window
    moves: FloatArray = field(init=False)
    travel: FloatArray = field(init=False)
    _points: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        data = self.data
        self.moves = moves_of(data)
        self.travel = np.append(0.0, np.cumsum(np.hypot(self.moves[:, 0], self.moves[:, 1])))
        rays = np.column_stack((np.cos(data.angles), np.sin(data.angles)))
        self._points = data.origins + data.ranges[..., None] * rays

    def known(self, event: int, metres: float) -> SearchGrid | None:
        """What was seen in the last metres before an event, in the frame of its pose. None if that is too little."""
        first = int(np.searchsorted(self.travel, self.travel[event] - metres))
        poses = integrate(np.zeros(3), self.moves[first:event])
        places, origins = self._seen(np.arange(first, event + 1), se2.between(poses[-1], poses))
        if len(places) < _FEWEST_POINTS:
            return None
        maps = self.config.maps
        grid = draw_grid(places, origins, grid_size(maps, self.data.max_range), maps)
        chunk = LocalMap(event, float(self.travel[event]), places, origins, places, grid, maps.cell)
        return search_grid(chunk, self.window.shift, self.config.matching)

    def last_event(self, event: int, metres: float) -> int:
        """The last event of some metres after an event."""
        return int(np.searchsorted(self.travel, self.travel[event] + metres, side="right")) - 1

    def score(self, known: SearchGrid, event: int, moves: FloatArray) -> float:
        """How well that fits which was seen from an event on, along motions (k, 3)."""
        events = np.arange(event, event + len(moves) + 1)
        places, _ = self._seen(events, integrate(np.zeros(3), moves))
        points = thinned(places, self.config.maps.cell)
        return match(known, points, np.zeros(3), self.window, self.config.matching, NO_MATCH).score

    def _seen(self, events: IntArray, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points and origins of their beams, (p, 2) each, at events (k,) with poses (k, 3)."""
        row, beam = np.nonzero(self.data.hit[events])
        places = to_world(poses[row], self._points[events[row], beam])
        return places, to_world(poses[row], self.data.origins[beam])


def moves_of(data: LogData) -> FloatArray:
    """Motions (n - 1, 3) of odometry from event to event."""
    return se2.between(data.odometry[:-1], data.odometry[1:])
