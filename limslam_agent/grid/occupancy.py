"""A low-resolution occupancy grid that grows with the area that the robot has seen."""

import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from limslam_agent.config.presets import GridConfig
from limslam_agent.dropouts import without_dropouts
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.numbers import check_poses
from limslam_env.geometry.se2 import compose, inverse
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
        self._config = config
        # Cells are counted from the world's origin. The known cells lie between the two corners.
        self._low = self._known_low = self._known_high = np.zeros(2, dtype=np.int64)
        self._values = np.zeros((0, 0), dtype=np.int16)
        self._rules = np.array([config.seen_through, config.hit, config.limit])
        # Each cell has the number of the update that has changed it last.
        self._stamps = np.zeros((0, 0), dtype=np.int32)
        self._stamp = 0

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
        grid._low = grid._known_low = np.rint(view.low / config.cell).astype(np.int64)
        grid._known_high = grid._low + np.array(view.values.shape[::-1])
        grid._values = np.array(view.values, dtype=np.int16)
        grid._stamps = np.zeros_like(grid._values, dtype=np.int32)
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
        return GridView(
            np.asarray(self._known_low * self._config.cell, dtype=np.float64),
            self._config.cell,
            values,
        )

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
        touched = np.empty((2, 2), dtype=np.int64)
        while True:
            self._stamp += 1
            is_done = update_grid(
                pose,
                np.asarray(ranges, dtype=float),
                usable,
                robot.beam_table,
                robot.radius,
                self._config.cell,
                self._values,
                self._low,
                self._rules,
                self._stamps,
                self._stamp,
                touched,
            )
            low, high = touched
            if is_done:
                break
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
        for row in range(len(poses)):
            for number, pose in enumerate(poses[row]):
                self.update(pose, robot, ranges[row, number], drawn[number][row])

    def bend(self, anchors: FloatArray, motions: FloatArray) -> None:
        """Move each cell with what lies around the nearest of some points (m, 2), by the rigid
        motions (m, 3) there.
        """
        view = self.view
        cell = self._config.cell
        before = np.column_stack((anchors, np.zeros(len(anchors))))
        known = (
            _moved_with_nearest(view.centres(np.argwhere(~view.unknown)), before, before + motions)
            / cell
        )
        # A cell at the border may leave the grid.
        reached = np.concatenate((known, [self._known_low, self._known_high]))
        low: IntArray = np.floor(reached.min(axis=0)).astype(np.int64)
        high: IntArray = np.ceil(reached.max(axis=0)).astype(np.int64)
        columns, rows = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        places = np.column_stack((columns.ravel(), rows.ravel()))
        values = view.values_at(
            _moved_with_nearest((places + 0.5) * cell, before + motions, before)
        )
        self._grow(low, high)
        column, row = (places - self._low).T
        self._values[row, column] = values
        self._know(low, high)

    def _know(self, low: IntArray, high: IntArray) -> None:
        """Take the cells from ``low`` to before ``high`` (2,) for known ones."""
        is_first = self._known_low.tolist() == self._known_high.tolist()
        self._known_low = low if is_first else np.minimum(self._known_low, low)
        self._known_high = high if is_first else np.maximum(self._known_high, high)

    def _grow(self, low: IntArray, high: IntArray) -> None:
        """Extend the grid to cells from ``low`` to before ``high`` (2,), with a margin, so that it
        seldom grows.
        """
        rows, columns = self._values.shape
        end = self._low + np.array([columns, rows])
        old_low, old_high = (self._low, end) if rows else (low, high)
        new_low = np.where(low < old_low, low - _SPARE_CELLS, old_low)
        new_high = np.where(high > old_high, high + _SPARE_CELLS, old_high)
        columns_new, rows_new = new_high - new_low
        if max(columns_new, rows_new) > _MAX_CELLS:
            raise ValueError(
                f"the map has grown past {_MAX_CELLS * self._config.cell:g} m: the robot's pose "
                "is lost"
            )
        grown = np.zeros((rows_new, columns_new), dtype=np.int16)
        column, row = old_low - new_low
        grown[row : row + rows, column : column + columns] = self._values
        self._low = new_low
        self._values = grown
        self._stamps = np.zeros_like(grown, dtype=np.int32)


def _moved_with_nearest(points: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """Points (n, 2), each of which moves with the nearest of some poses (m, 3) from before to
    after.
    """
    nearest = cKDTree(before[:, :2]).query(points)[1]
    there = compose(inverse(before[nearest]), np.column_stack((points, np.zeros(len(points)))))
    return np.asarray(compose(after[nearest], there)[:, :2])


def drawn_grid(
    config: GridConfig, robot: RobotSpec, poses: FloatArray, ranges: FloatArray, measured: BoolArray
) -> GridView:
    """The grid of all readings of a finished run from other poses than the run's:
    :meth:`OccupancyGrid.draw`.
    """
    grid = OccupancyGrid(config)
    grid.draw(robot, poses, ranges, measured)
    return grid.view
