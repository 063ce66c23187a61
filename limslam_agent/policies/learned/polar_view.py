"""The observation of the learned policy: the believed grid in polar cells around the robot.

The directions are cells of a circle, so that a network can treat all of them alike. The rings grow
with their distance, so that the view shows both a door beside the robot and an unknown region five
metres away.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.interface import RobotSpec

CHANNELS = 3
"""Values of a polar cell: share of unknown cells, share of occupied cells, and approach to a
frontier.
"""

AHEAD = 3
"""Values of a direction: how much driving there would show, after three distances
(`look_ahead`).
"""

# A step between two cells costs the sum of their two costs. The cost is higher beside a wall.
FREE_COST = 1
TIGHT_COST = 3

# Least number of unknown cells in the 5 x 5 cells around a frontier cell. Fewer are a gap between
# beams.
LEAST_UNKNOWN = 6

# A frontier cell with fewer unknown cells in the 9 x 9 cells around it belongs to a small remnant.
# Such a remnant counts as farther away: for each missing cell, by so many halves of a cell.
LARGE_UNKNOWN = 34
SMALL_COST = 4

FAR = 10.0


@dataclass(frozen=True)
class ViewConfig:
    """Shape of the view. The values are this project's choices.

    Attributes
    ----------
    directions
        Number of polar cells in a circle. The first begins straight ahead, and they go
        counter-clockwise.
    rings
        Number of polar cells from the inside to the outside.
    nearest, growth
        Distance of the middle of the first ring, m, and factor from one ring's distance to the
        next.
    """

    directions: int = 24
    rings: int = 10
    nearest: float = 0.15
    growth: float = 1.45

    @cached_property
    def samples(self) -> FloatArray:
        """Sample points in the robot's frame (rings * directions * 6, 2), m: six in each polar
        cell.
        """
        width = 2.0 * math.pi / self.directions
        radius = self.radii[:, None, None] * self.growth ** np.array(
            [-0.25, 0.25, -0.25, 0.25, -0.25, 0.25]
        )
        angle = width * (
            np.arange(self.directions)[None, :, None] + np.array([-1, -1, 0, 0, 1, 1]) / 3.0
        )
        radius, angle = np.broadcast_arrays(radius, angle)
        return np.column_stack(((radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()))

    @cached_property
    def radii(self) -> FloatArray:
        """Distance of each ring's middle (rings,), m."""
        return np.asarray(self.nearest * self.growth ** np.arange(self.rings))

    def angle(self, direction: int) -> float:
        """Angle of a direction from straight ahead, counter-clockwise, rad."""
        return 2.0 * math.pi * direction / self.directions

    def size(self, n_beams: int) -> int:
        """Number of values in an observation of a robot with ``n_beams`` beams."""
        return self.rows * self.directions + n_beams + 2

    @property
    def rows(self) -> int:
        """Number of values of each direction: those of its polar cells, and what driving there
        would show.
        """
        return CHANNELS * self.rings + AHEAD


def observe(
    grid: GridView, pose: FloatArray, ranges: FloatArray, robot: RobotSpec, config: ViewConfig
) -> NDArray[np.float32]:
    """The observation of the network (size,): the view (channels, rings, directions), what driving
    in each direction would show (AHEAD, directions), the readings, and two more numbers.

    The two numbers are the distance to the nearest frontier (1 for 10 m or more), and whether a
    frontier is reachable.

    Parameters
    ----------
    grid, pose
        Believed grid and pose (3,): x (m), y (m), heading (rad).
    ranges, robot
        Readings (n_beams,), m, and the robot that took them.
    config
        Shape of the view.
    """
    rows, columns = grid.values.shape
    away = frontier_distance(grid)
    row, column = grid.cells(transform_points(pose, config.samples)).T
    is_inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    values = np.zeros(len(row), dtype=np.int64)
    nearness = np.full(len(row), -np.inf)
    values[is_inside] = np.sign(grid.values[row[is_inside], column[is_inside]])
    nearness[is_inside] = -away[row[is_inside], column[is_inside]]
    shape = (config.rings, config.directions, 6)
    here = _distance_here(grid, away, pose)
    gain = np.full(shape[:2], -1.0)
    if np.isfinite(here):
        best = nearness.reshape(shape).max(axis=2)
        gain = np.clip((here + best) / config.radii[:, None], -1.0, 1.0)
    view = np.stack(
        ((values == 0).reshape(shape).mean(axis=2), (values < 0).reshape(shape).mean(axis=2), gain)
    )
    way = [min(here / FAR, 1.0), 1.0] if np.isfinite(here) else [1.0, 0.0]
    readings = np.nan_to_num(ranges, nan=1.0) / robot.max_ranges
    told = (view.ravel(), _shown_ahead(grid, pose, robot, config), np.clip(readings, 0.0, 1.0), way)
    return np.concatenate(told).astype(np.float32)


def expected_ranges(grid: GridView, pose: FloatArray, robot: RobotSpec) -> FloatArray:
    """What a robot's beams (n_beams,) would read at a pose (3,) by the believed grid, m: the
    distances of the first occupied cells, or the longest readings.
    """
    places = np.arange(0.0, robot.max_ranges.max(), 0.5 * grid.cell)
    points = robot.beam_origins[:, None] + places[:, None] * robot.beam_directions[:, None]
    values = grid.values_at(transform_points(pose, points.reshape(-1, 2)))
    is_wall = (values < 0).reshape(len(robot.beams), -1)
    found = np.where(is_wall.any(axis=1), places[is_wall.argmax(axis=1)], np.inf)
    return np.asarray(np.clip(found, robot.min_ranges, robot.max_ranges))


def _shown_ahead(
    grid: GridView, pose: FloatArray, robot: RobotSpec, config: ViewConfig
) -> NDArray[np.float32]:
    from limslam_agent.policies.learned.look_ahead import Ground, look_ahead

    ahead = np.zeros(AHEAD * config.directions, dtype=np.float32)
    corner = np.rint(grid.low / grid.cell).astype(np.int64)
    # One kind of array, or the kernel would be compiled for each kind.
    ground = Ground(np.array(np.sign(grid.values), dtype=np.int8), corner, grid.cell)
    look_ahead(ground, pose, robot.beam_table, robot.radius, config.directions, ahead)
    return ahead


def frontier_distance(grid: GridView) -> FloatArray:
    """Distance from each cell (rows, columns) to the nearest frontier over free cells, m. Infinite
    where there is no path.

    A path goes from a cell to its four neighbours, and costs three times as much beside walls. Only
    frontiers with enough unknown cells behind them count, and a frontier of a small remnant counts
    as up to 5.6 m farther away than it is.
    """
    rows, columns = grid.values.shape
    free = grid.free
    beside_wall = ndimage.binary_dilation(grid.occupied, np.ones((3, 3), dtype=int))
    is_source = (
        frontier_cells(grid, min_size=1)
        & ~beside_wall
        & (_unknown_around(grid, 2) >= LEAST_UNKNOWN)
    )
    sources = np.flatnonzero(is_source)
    if not len(sources):
        return np.full((rows, columns), np.inf)
    cost = np.where(beside_wall, TIGHT_COST, FREE_COST)
    index = np.arange(rows * columns).reshape(rows, columns)
    starts = []
    ends = []
    prices = []
    for here, there in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        is_open = free[here] & free[there]
        starts.append(index[here][is_open])
        ends.append(index[there][is_open])
        prices.append((cost[here] + cost[there])[is_open])
    # One more node, before all frontiers, is joined to each of them by its cost. Costs above 0 are
    # edges for certain.
    before = rows * columns
    starts.append(np.full(len(sources), before))
    ends.append(sources)
    prices.append(
        1 + SMALL_COST * np.maximum(LARGE_UNKNOWN - _unknown_around(grid, 4).flat[sources], 0)
    )
    graph = sparse.csr_array(
        (np.concatenate(prices).astype(float), (np.concatenate(starts), np.concatenate(ends))),
        shape=(before + 1,) * 2,
    )
    steps = csgraph.dijkstra(graph, directed=False, indices=before)[:before] - 1.0
    return np.asarray(steps.reshape(rows, columns) * (0.5 * grid.cell))


def _unknown_around(grid: GridView, reach: int) -> IntArray:
    """Number of unknown cells (rows, columns) in the square of ``reach`` cells to all sides of each
    cell. Cells beyond the edge of the grid are unknown, too.
    """
    side = np.ones(2 * reach + 1, dtype=int)
    across = ndimage.convolve1d(grid.unknown.astype(int), side, axis=0, mode="constant", cval=1)
    return np.asarray(ndimage.convolve1d(across, side, axis=1, mode="constant", cval=len(side)))


def _distance_here(grid: GridView, away: FloatArray, pose: FloatArray) -> float:
    """Distance from the robot's cell, or the least one of the cells around it, as the map may place
    the robot inside a wall.
    """
    (row, column), (rows, columns) = grid.cells(pose[None, :2])[0], away.shape
    if 0 <= row < rows and 0 <= column < columns and np.isfinite(away[row, column]):
        return float(away[row, column])
    near = away[max(row - 1, 0) : max(row + 2, 0), max(column - 1, 0) : max(column + 2, 0)]
    return float(near.min()) if near.size else math.inf
