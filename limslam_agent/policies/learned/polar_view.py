"""What a learned explorer looks at: the believed grid in polar cells round the robot, fine near by and coarse afar.

Directions are cells of a circle, so that a network can treat all of them alike; rings grow with their distance, so
that a door at arm's length and a dark corner five metres off both have their cell.
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
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import transform_points

CHANNELS = 3
"""Of a polar cell: share unknown, share occupied, and how much nearer to a frontier it is."""

# A step between two cells costs the sum of their tolls; beside a wall the toll is higher.
FREE_TOLL, TIGHT_TOLL = 1, 3

# Cells of the 5 x 5 round a frontier cell that are unknown at least: less is a gap between beams.
LEAST_UNKNOWN = 6

_FAR = 10.0


@dataclass(frozen=True)
class ViewConfig:
    """Shape of the view. All ours.

    Attributes
    ----------
    directions
        Polar cells in a circle; the first begins straight ahead, counter-clockwise.
    rings
        Polar cells from the inside out.
    nearest, growth
        Distance of the middle of the first ring, m, and by how much each next one is farther off.
    """

    directions: int = 24
    rings: int = 10
    nearest: float = 0.15
    growth: float = 1.45

    @cached_property
    def samples(self) -> FloatArray:
        """Places in the robot's frame (rings * directions * 6, 2), m, six for each polar cell."""
        width = 2.0 * math.pi / self.directions
        radius = self.radii[:, None, None] * self.growth ** np.array([-0.25, 0.25, -0.25, 0.25, -0.25, 0.25])
        angle = width * (np.arange(self.directions)[None, :, None] + np.array([-1, -1, 0, 0, 1, 1]) / 3.0)
        radius, angle = np.broadcast_arrays(radius, angle)
        return np.column_stack(((radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()))

    @cached_property
    def radii(self) -> FloatArray:
        """Distances of the rings' middles (rings,), m."""
        return np.asarray(self.nearest * self.growth ** np.arange(self.rings))

    def angle(self, direction: int) -> float:
        """Where a direction points, rad from ahead, counter-clockwise."""
        return 2.0 * math.pi * direction / self.directions

    def size(self, n_beams: int) -> int:
        """How many numbers an observation has for a robot of so many beams."""
        return CHANNELS * self.rings * self.directions + n_beams + 2


def observe(
    grid: GridView, pose: FloatArray, ranges: FloatArray, max_ranges: FloatArray, config: ViewConfig
) -> NDArray[np.float32]:
    """All that the network is told: (size,), the view (channels, rings, directions), then the readings and two numbers.

    The two are the way to the nearest frontier (1 for 10 m or more), and whether there is one that can be got to.

    Parameters
    ----------
    grid, pose
        What is believed; pose (3,), m, m, rad.
    ranges, max_ranges
        Readings and longest readings (n_beams,), m.
    config
        Shape of the view.
    """
    rows, columns = grid.values.shape
    away = frontier_distance(grid)
    row, column = grid.cells(transform_points(pose, config.samples)).T
    is_inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    values, nearness = np.zeros(len(row), dtype=np.int64), np.full(len(row), -np.inf)
    values[is_inside] = np.sign(grid.values[row[is_inside], column[is_inside]])
    nearness[is_inside] = -away[row[is_inside], column[is_inside]]
    shape = (config.rings, config.directions, 6)
    here = _distance_here(grid, away, pose)
    gain = np.full(shape[:2], -1.0)
    if np.isfinite(here):
        best = nearness.reshape(shape).max(axis=2)
        gain = np.clip((here + best) / config.radii[:, None], -1.0, 1.0)
    view = np.stack(((values == 0).reshape(shape).mean(axis=2), (values < 0).reshape(shape).mean(axis=2), gain))
    way = [min(here / _FAR, 1.0), 1.0] if np.isfinite(here) else [1.0, 0.0]
    readings = np.nan_to_num(ranges, nan=1.0) / max_ranges
    return np.concatenate((view.ravel(), np.clip(readings, 0.0, 1.0), way)).astype(np.float32)


def frontier_distance(grid: GridView) -> FloatArray:
    """How far it is from each cell (rows, columns) to the nearest frontier over free ground, m; infinite for no way.

    Four neighbours a cell, three times the way beside walls. Only frontiers with something behind them count.
    """
    rows, columns = grid.values.shape
    free, beside_wall = grid.free, ndimage.binary_dilation(grid.occupied, np.ones((3, 3), dtype=int))
    # What lies past the grid's edge is unknown too.
    around = ndimage.convolve(grid.unknown.astype(int), np.ones((5, 5), dtype=int), mode="constant", cval=1)
    sources = np.flatnonzero(frontier_cells(grid, min_size=1) & ~beside_wall & (around >= LEAST_UNKNOWN))
    if not len(sources):
        return np.full((rows, columns), np.inf)
    toll = np.where(beside_wall, TIGHT_TOLL, FREE_TOLL)
    index = np.arange(rows * columns).reshape(rows, columns)
    starts, ends, prices = [], [], []
    for here, there in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        is_open = free[here] & free[there]
        starts.append(index[here][is_open])
        ends.append(index[there][is_open])
        prices.append((toll[here] + toll[there])[is_open])
    size = rows * columns
    graph = sparse.csr_array(
        (np.concatenate(prices).astype(float), (np.concatenate(starts), np.concatenate(ends))), shape=(size, size)
    )
    steps = csgraph.dijkstra(graph, directed=False, indices=sources, min_only=True)
    return np.asarray(steps.reshape(rows, columns) * (0.5 * grid.cell))


def _distance_here(grid: GridView, away: FloatArray, pose: FloatArray) -> float:
    """From the robot's cell, or the best of those round it: the map may take the robot to be inside a wall."""
    (row, column), (rows, columns) = grid.cells(pose[None, :2])[0], away.shape
    if 0 <= row < rows and 0 <= column < columns and np.isfinite(away[row, column]):
        return float(away[row, column])
    near = away[max(row - 1, 0) : max(row + 2, 0), max(column - 1, 0) : max(column + 2, 0)]
    return float(near.min()) if near.size else math.inf
