"""A low-resolution occupancy grid that grows with the area that the robot has seen."""

import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limslam_agent.config.presets import GridConfig
from limslam_agent.dropouts import without_dropouts
from limslam_agent.kernels.tables import Cells
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.numbers import check_poses
from limslam_env.interface import RobotSpec

_SPARE_CELLS = 32
_MAX_CELLS = 20_000


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
        """Cells (n, 2) as (row, column) in which points (n, 2), m, lie. They may be outside the
        grid.
        """
        return np.floor((points - self.low) / self.cell).astype(np.int64)[:, ::-1]

    def centres(self, cells: IntArray | FloatArray) -> FloatArray:
        """Centres (n, 2), m, of cells (n, 2) given as (row, column)."""
        return self.low + (cells[:, ::-1] + 0.5) * self.cell

    def values_at(self, points: FloatArray) -> NDArray[np.int16]:
        """Values (n,) of the cells in which points (n, 2), m, lie. Points outside of the grid are
        unknown.
        """
        cells = self.cells(points)
        inside = np.all((cells >= 0) & (cells < self.values.shape), axis=1)
        values = np.zeros(len(points), dtype=np.int16)
        values[inside] = self.values[cells[inside, 0], cells[inside, 1]]
        return values


class OccupancyGrid:
    """The occupancy grid of one map.

    A cell's value increases when a beam crosses the cell, and decreases when a beam ends in it, as
    in the published method, so that single wrong readings have little effect. Each cell changes
    once a step, however many beams touch it.

    Parameters
    ----------
    config
        Side of a cell, and by how much values change.
    """

    def __init__(self, config: GridConfig) -> None:
        origin = np.zeros(2, dtype=np.int64)
        rules = np.array([config.seen_through, config.hit, config.limit])
        nothing = np.zeros((0, 0), dtype=np.int16)
        self._cells = Cells(nothing, nothing.astype(np.int32), origin, float(config.cell), rules)
        # The known cells lie between the two corners.
        self._known_low = self._known_high = origin
        self._stamp = 0  # number of the latest update

    @classmethod
    def of(cls, view: GridView, config: GridConfig) -> "OccupancyGrid":
        """A grid that begins with known cells.

        Raises
        ------
        ValueError
            If the cells have another size than those of the settings.
        """
        if abs(view.cell - config.cell) > 1e-6 * config.cell:
            raise ValueError(
                f"the map has cells of {view.cell:g} m, and the settings have cells of "
                f"{config.cell:g} m"
            )
        grid = cls(config)
        corner = np.rint(view.low / config.cell).astype(np.int64)
        grid._hold(np.array(view.values, dtype=np.int16), corner)
        grid._known_low = corner
        grid._known_high = corner + np.array(view.values.shape[::-1])
        return grid

    def copied(self) -> "OccupancyGrid":
        """A copy. Later updates of one of the two do not change the other."""
        return copy.deepcopy(self)

    @property
    def view(self) -> GridView:
        """The part of the grid in which cells are known."""
        corner, size = self._cells.corner, self._cells.size
        (left, bottom), (right, top) = self._known_low - corner, self._known_high - corner
        values = self._cells.values[bottom:top, left:right]
        values.setflags(write=False)
        return GridView(np.asarray(self._known_low * size, dtype=np.float64), size, values)

    def update(
        self, pose: FloatArray, robot: RobotSpec, ranges: FloatArray, usable: BoolArray
    ) -> None:
        """Update the grid by one step's readings (n_beams,), m, from an estimated pose (3,), m, m,
        rad.

        Those readings count that are ``usable`` (n_beams,), since they are new.

        Raises
        ------
        ValueError
            If the pose is too large, or the map has become so large that the pose must be wrong.
        """
        from limslam_agent.kernels.cells import update_grid

        check_poses("the robot's pose", pose)
        ranges = np.asarray(ranges, dtype=float)
        body = robot.beam_table, robot.radius
        low, high = touched = np.empty((2, 2), dtype=np.int64)
        self._stamp += 1
        while not update_grid(pose, ranges, usable, body, self._cells, self._stamp, touched):
            self._grow(low, high)
        self._know(low, high)

    def draw(
        self, robot: RobotSpec, poses: FloatArray, ranges: FloatArray, measured: BoolArray
    ) -> None:
        """Update the grid by all readings of a finished stretch. Those that may be drop-outs are
        not drawn.

        Given are poses (t, n, 3) of n robots, m and rad, readings (t, n, n_beams), m, and which of
        them are new.
        """
        drawn = [
            without_dropouts(robot, ranges[:, number], measured[:, number])
            for number in range(ranges.shape[1])
        ]
        for row, number in np.ndindex(poses.shape[:2]):
            self.update(poses[row, number], robot, ranges[row, number], drawn[number][row])

    def _know(self, low: IntArray, high: IntArray) -> None:
        """Take the cells from ``low`` to before ``high`` (2,) for known ones."""
        is_first = self._known_low.tolist() == self._known_high.tolist()
        self._known_low = low if is_first else np.minimum(self._known_low, low)
        self._known_high = high if is_first else np.maximum(self._known_high, high)

    def _grow(self, low: IntArray, high: IntArray) -> None:
        """Extend the grid to cells from ``low`` to before ``high`` (2,), with a margin, so that it
        seldom grows.
        """
        before = self._cells
        rows, columns = before.values.shape
        end = before.corner + np.array([columns, rows])
        old_low, old_high = (before.corner, end) if rows else (low, high)
        new_low = np.where(low < old_low, low - _SPARE_CELLS, old_low)
        new_high = np.where(high > old_high, high + _SPARE_CELLS, old_high)
        if (new_high - new_low).max() > _MAX_CELLS:
            raise ValueError(
                f"the map has grown past {_MAX_CELLS * before.size:g} m: the robot's pose is lost"
            )
        grown = np.zeros((new_high - new_low)[::-1], dtype=np.int16)
        column, row = old_low - new_low
        grown[row : row + rows, column : column + columns] = before.values
        self._hold(grown, new_low)

    def _hold(self, values: NDArray[np.int16], corner: IntArray) -> None:
        """Hold other cells (rows, columns), from a column and row (2,) on."""
        stamps = np.zeros(values.shape, dtype=np.int32)
        self._cells = self._cells._replace(values=values, stamps=stamps, corner=corner)


def drawn_grid(
    config: GridConfig, robot: RobotSpec, poses: FloatArray, ranges: FloatArray, measured: BoolArray
) -> GridView:
    """The grid of all readings of a finished run from other poses than the run's:
    :meth:`OccupancyGrid.draw`.
    """
    grid = OccupancyGrid(config)
    grid.draw(robot, poses, ranges, measured)
    return grid.view
