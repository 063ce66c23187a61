"""A low-resolution occupancy grid that grows with the area that the robot has seen."""

import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limslam_agent.config.presets import GridConfig
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.interface import RobotSpec

_SPARE_CELLS = 32
_MAX_CELLS = 20_000
_ANGLES = np.arange(8) * (np.pi / 4)

BODY = np.vstack((np.zeros((1, 2)), 0.7 * np.column_stack((np.cos(_ANGLES), np.sin(_ANGLES)))))
"""Points (9, 2) of the robot's body that are certainly free, in shares of its radius."""


@dataclass(frozen=True, eq=False)
class GridView:
    """The grid at one moment, read-only.

    Attributes
    ----------
    low
        Lower left corner (2,), m.
    cell
        Side of a cell, m.
    values
        (rows, columns), row 0 at the bottom: positive is free, negative is occupied, 0 is unknown.
    """

    low: FloatArray
    cell: float
    values: NDArray[np.int16]

    @property
    def free(self) -> BoolArray:
        """Cells that more beams crossed than ended in, weighted (rows, columns)."""
        return np.asarray(self.values > 0)

    @property
    def occupied(self) -> BoolArray:
        """Cells in which more beams ended than crossed them, weighted (rows, columns)."""
        return np.asarray(self.values < 0)

    @property
    def unknown(self) -> BoolArray:
        """Cells that no beam has touched (rows, columns)."""
        return np.asarray(self.values == 0)

    def cells(self, points: FloatArray) -> IntArray:
        """Cells (n, 2) as (row, column) in which points (n, 2), m, lie. They may be outside the grid."""
        return np.floor((points - self.low) / self.cell).astype(np.int64)[:, ::-1]

    def centres(self, cells: IntArray) -> FloatArray:
        """Centres (n, 2), m, of cells (n, 2) given as (row, column)."""
        return self.low + (cells[:, ::-1] + 0.5) * self.cell


class OccupancyGrid:
    """The occupancy grid of one map.

    A cell's value increases when a beam crosses the cell, and decreases when a beam ends in it, as in the published
    method, so that single wrong readings have little effect. Each cell changes once a step, however many beams touch
    it. ``slam.batch.grid`` is the compiled counterpart.

    Parameters
    ----------
    config
        Side of a cell, and by how much values change.
    """

    def __init__(self, config: GridConfig) -> None:
        self._config = config
        # Cells are counted from the world's origin. The known cells lie between the two corners.
        self._low = self._known_low = self._known_high = np.zeros(2, dtype=np.int64)
        self._values = np.zeros((0, 0), dtype=np.int16)

    @classmethod
    def of(cls, view: GridView, config: GridConfig) -> "OccupancyGrid":
        """A grid that begins with known cells.

        Raises
        ------
        ValueError
            If the cells have another size than those of the settings.
        """
        if abs(view.cell - config.cell) > 1e-6 * config.cell:
            raise ValueError(f"the map has cells of {view.cell:g} m, and the settings have cells of {config.cell:g} m")
        grid = cls(config)
        grid._low = grid._known_low = np.rint(view.low / config.cell).astype(np.int64)
        grid._known_high = grid._low + np.array(view.values.shape[::-1])
        grid._values = np.array(view.values, dtype=np.int16)
        return grid

    def copied(self) -> "OccupancyGrid":
        """A copy. Later updates of one of the two do not change the other."""
        return copy.deepcopy(self)

    @property
    def view(self) -> GridView:
        """The part of the grid in which cells are known."""
        (left, bottom), (right, top) = self._known_low - self._low, self._known_high - self._low
        values = self._values[bottom:top, left:right]
        values.setflags(write=False)
        return GridView(np.asarray(self._known_low * self._config.cell, dtype=np.float64), self._config.cell, values)

    def update(self, pose: FloatArray, robot: RobotSpec, ranges: FloatArray, usable: BoolArray) -> None:
        """Update the grid by one step's readings.

        Parameters
        ----------
        pose
            Estimated pose (3,), m, m, rad.
        robot
            Body and beams.
        ranges, usable
            Readings (n_beams,), m, and which of them are new.

        Raises
        ------
        ValueError
            If the map has become so large that the pose must be wrong.
        """
        # A reading at the minimum says that something is near, or that the sensor is dirty, but not where.
        beams = np.nonzero(usable & (ranges > robot.too_near))[0]
        origins, directions = robot.beam_origins[beams], robot.beam_directions[beams]
        hit = ranges[beams] < robot.too_far[beams]
        length = ranges[beams]
        ends = transform_points(pose, origins + length[:, None] * directions)
        passed = transform_points(pose, self._samples(origins, directions, length))
        body = pose[:2] + robot.radius * BODY
        self._reach(np.concatenate((passed, body, ends)))
        crossed = self._indices(np.concatenate((passed, body)))
        ended = self._indices(ends[hit])
        # All new values are computed before any value changes, so that a cell changes once, however often it is listed.
        seen_through, hits = self._added(crossed, self._config.seen_through), self._added(ended, -self._config.hit)
        flat = self._values.reshape(-1)
        flat[crossed] = seen_through
        flat[ended] = hits

    def _samples(self, origins: FloatArray, directions: FloatArray, lengths: FloatArray) -> FloatArray:
        step = 0.5 * self._config.cell
        counts = np.floor(lengths / step).astype(np.int64)
        owner = np.repeat(np.arange(len(lengths)), counts)
        position = (np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)) * step
        return origins[owner] + position[:, None] * directions[owner]

    def _indices(self, points: FloatArray) -> IntArray:
        cells = np.floor(points / self._config.cell).astype(np.int64) - self._low
        return np.asarray(cells[:, 1] * self._values.shape[1] + cells[:, 0])

    def _added(self, indices: IntArray, amount: int) -> IntArray:
        """The values of some cells after an amount has been added."""
        limit = self._config.limit
        value = np.minimum(np.maximum(self._values.reshape(-1)[indices] + amount, -limit), limit)
        # The value 0 is reserved for unknown cells.
        value[value == 0] = 1 if amount > 0 else -1
        return value

    def _reach(self, points: FloatArray) -> None:
        """Extend the grid to cover points (n, 2), m, with a margin so that it seldom has to grow."""
        low = np.floor(points.min(axis=0) / self._config.cell).astype(np.int64)
        high = np.floor(points.max(axis=0) / self._config.cell).astype(np.int64) + 1
        rows, columns = self._values.shape
        end = self._low + np.array([columns, rows])
        known = (np.minimum(self._known_low, low), np.maximum(self._known_high, high)) if rows else (low, high)
        if not rows or (low < self._low).any() or (high > end).any():
            self._grow(low, high)
        self._known_low, self._known_high = known

    def _grow(self, low: IntArray, high: IntArray) -> None:
        rows, columns = self._values.shape
        end = self._low + np.array([columns, rows])
        old_low, old_high = (self._low, end) if rows else (low, high)
        new_low = np.where(low < old_low, low - _SPARE_CELLS, old_low)
        new_high = np.where(high > old_high, high + _SPARE_CELLS, old_high)
        columns_new, rows_new = new_high - new_low
        if max(columns_new, rows_new) > _MAX_CELLS:
            raise ValueError(f"the map has grown past {_MAX_CELLS * self._config.cell:g} m: the robot's pose is lost")
        grown = np.zeros((rows_new, columns_new), dtype=np.int16)
        column, row = old_low - new_low
        grown[row : row + rows, column : column + columns] = self._values
        self._low, self._values = new_low, grown


def drawn_grid(
    config: GridConfig, robot: RobotSpec, poses: FloatArray, ranges: FloatArray, measured: BoolArray
) -> GridView:
    """The occupancy grid of all readings of a finished run from other poses than those of the run itself.

    Parameters
    ----------
    poses
        Poses (t, n, 3) of n robots, m and rad.
    ranges, measured
        Readings (t, n, n_beams), m, and a mask of the readings that are new and of walls.
    """
    grid = OccupancyGrid(config)
    for row in range(len(poses)):
        for number, pose in enumerate(poses[row]):
            grid.update(pose, robot, ranges[row, number], measured[row, number])
    return grid.view
