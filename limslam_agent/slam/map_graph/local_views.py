"""Successive metres of a log compared with each other: what was seen next, placed on what was seen
just before.
"""

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.map_graph.key_poses import LogData, integrate, to_world
from limslam_agent.slam.map_graph.local_maps import draw_grid, thinned
from limslam_agent.slam.map_graph.matching import (
    LEAST_POINTS,
    NO_MATCH,
    SearchGrid,
    Window,
    match,
    search_grid,
)
from limslam_env.geometry import FloatArray, IntArray, se2

BEFORE = 3.5
AFTER = 2.0
"""Metres of driving that are compared: those before an event with those after it."""


class LocalViews:
    """What was seen along a log, whose metres are matched in a window.

    Attributes
    ----------
    moves
        Motions (n - 1, 3) from event to event. They may be changed.
    driven
        Length (n,) of the path up to each event, m.
    travel
        The same, with ``APART`` for each break of odometry.
    """

    def __init__(self, data: LogData, config: GraphConfig, window: Window) -> None:
        self._data = data
        self._maps = config.maps
        self._window = window
        self.moves = moves_of(data)
        lengths = np.hypot(self.moves[:, 0], self.moves[:, 1])
        self.driven = np.append(0.0, np.cumsum(lengths))
        self.travel = np.append(0.0, np.cumsum(lengths + data.apart[1:]))
        rays = np.column_stack((np.cos(data.angles), np.sin(data.angles)))
        self._points = data.origins + data.ranges[..., None] * rays

    def known(self, event: int) -> SearchGrid | None:
        """What was seen in the last metres before an event, in the frame of its pose. None if that
        is too little.
        """
        first = int(np.searchsorted(self.travel, self.travel[event] - BEFORE))
        poses = integrate(np.zeros(3), self.moves[first:event])
        places, origins = self._seen(np.arange(first, event + 1), se2.between(poses[-1], poses))
        if len(places) < LEAST_POINTS:
            return None
        grid = draw_grid(places, origins, self._data.max_range, self._maps)
        return search_grid(grid, self._maps.cell, self._window.shift)

    def next_moves(self, event: int, most: float = AFTER) -> FloatArray:
        """A copy of the motions (k, 3) of the first metres after an event, of at most ``most``
        m.
        """
        end = np.searchsorted(self.travel, self.travel[event] + min(AFTER, most), side="right")
        return self.moves[event : end - 1].copy()

    def fit(self, known: SearchGrid, event: int, moves: FloatArray) -> tuple[float, float]:
        """How well that fits which was seen from an event on, along motions (k, 3).

        The score of the best match, and the share of the points that it places where only free
        space was seen before.
        """
        events = np.arange(event, event + len(moves) + 1)
        places, _ = self._seen(events, integrate(np.zeros(3), moves))
        points = thinned(places, self._maps.cell)
        found = match(known, points, np.zeros(3), self._window, NO_MATCH)
        cells = _cells_at(known, se2.transform_points(found.pose, points))
        return found.score, float(np.mean(cells < 0)) if len(cells) else 0.0

    def _seen(self, events: IntArray, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points and origins of their beams, (p, 2) each, at events (k,) with poses (k, 3)."""
        row, beam = np.nonzero(self._data.hit[events])
        places = to_world(poses[row], self._points[events[row], beam])
        return places, to_world(poses[row], self._data.origins[beam])


def moves_of(data: LogData) -> FloatArray:
    """Motions (n - 1, 3) of odometry from event to event."""
    return se2.between(data.odometry[:-1], data.odometry[1:])


def _cells_at(grid: SearchGrid, places: FloatArray) -> IntArray:
    """The cells (k,) of a grid at places (k, 2), m. Outside of the grid nothing is known, as at its
    border.
    """
    last = np.array(grid.padded.shape) - 1
    rows, columns = np.clip(np.floor((places - grid.low) / grid.cell).astype(np.int64), 0, last).T
    return np.asarray(grid.padded[rows, columns], dtype=np.int64)
