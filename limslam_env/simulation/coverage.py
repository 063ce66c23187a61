"""The true coverage: the cells that can be seen, and the cells that have been seen."""

import functools
from dataclasses import dataclass

import numpy as np

from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import RobotSpec
from limslam_env.kernels.coverage import look_out, sweep
from limslam_env.simulation.sensors import beam_table, build_wall_index
from limslam_env.worlds.free_space import FreeSpace, eroded
from limslam_env.worlds.world import World

CELL = 0.10
"""Side of a cell of the coverage grid, m."""

_VIEWS = 240


@dataclass(frozen=True, eq=False)
class CoverageGrid:
    """The cells that a beam can see from some place that the robots can reach.

    Attributes
    ----------
    low
        Lower left corner of the grid (2,), m.
    coverable
        (rows, columns), row 0 at the bottom.
    """

    low: FloatArray
    coverable: BoolArray

    @property
    def area(self) -> FloatArray:
        """Corner and cell side (3,), m, as the kernels take them."""
        return np.array([*self.low, CELL])

    @functools.cached_property
    def total(self) -> int:
        """How many cells are coverable."""
        return int(np.count_nonzero(self.coverable))


def grid_over(edges: FloatArray) -> tuple[FloatArray, tuple[int, int]]:
    """Lower left corner (2,), m, and rows and columns of the coverage grid over edges (k, 4), m."""
    low = np.floor(np.minimum(edges[:, :2], edges[:, 2:]).min(axis=0) / CELL) * CELL
    high = np.maximum(edges[:, :2], edges[:, 2:]).max(axis=0)
    columns, rows = np.ceil((high - low) / CELL - 1e-9).astype(int)
    return low, (int(rows), int(columns))


@functools.cache
def views() -> FloatArray:
    """The directions (n, 2), unit vectors, in which what can be covered is looked for."""
    angles = np.arange(_VIEWS) * (2.0 * np.pi / _VIEWS)
    return np.column_stack((np.cos(angles), np.sin(angles)))


@functools.lru_cache(maxsize=16)
def _coverage_grid(
    world: World, robot: RobotSpec, regions: frozenset[int], loose: tuple[tuple[float, float], ...]
) -> CoverageGrid:
    edges, reach = world.edges, robot.reach
    low, shape = grid_over(edges)
    coverable = np.zeros(shape, dtype=bool)
    space = world.free_space(robot.radius)
    reachable = np.isin(space.labels, list(regions))
    # A robot sees the cell it stands in. Rows and columns are computed apart, as large worlds have millions of cells.
    standing_columns, standing_rows = (
        np.floor((space.origin[axis] + (np.arange(count) + 0.5) * space.cell - low[axis]) / CELL).astype(int)
        for axis, count in enumerate(reachable.shape[::-1])
    )
    at_rows, at_columns = np.nonzero(reachable)
    coverable[standing_rows[at_rows], standing_columns[at_columns]] = True
    index = build_wall_index(edges)
    lookouts = np.vstack((_lookouts(space, reachable), np.array(loose).reshape(-1, 2)))
    grid = CoverageGrid(low, coverable)
    space_area = np.array([*space.origin, space.cell])
    look_out(lookouts, views(), reach, *index.scene, coverable, grid.area, reachable, space_area)
    return grid


def coverage_grid(world: World, robot: RobotSpec, starts: FloatArray) -> CoverageGrid:
    """What robots (all alike) that start at poses (n, 3) could cover; remembered for later calls."""
    space = world.free_space(robot.radius)
    labels = [space.label_of(start[:2]) for start in starts]
    # A robot may stand where the grid of free space is too coarse to hold it.
    loose = tuple((float(x), float(y)) for (x, y, _), label in zip(starts, labels, strict=True) if label == 0)
    return _coverage_grid(world, robot, frozenset(labels) - {0}, loose)


def _lookouts(space: FreeSpace, reachable: BoolArray) -> FloatArray:
    """Places (n, 2), m, from which all that can be seen of what cannot be reached is seen.

    Every view of such a cell crosses the border of the reachable region, and the border lies nearer to the cell.
    """
    places = space.centres(reachable & ~eroded(reachable))
    # One place in each cell of the coverage grid is enough.
    _, first = np.unique(np.floor(places / CELL).astype(int), axis=0, return_index=True)
    return places[np.sort(first)]


class BeamSweep:
    """The coverage of a robot along a given path, counted as in a simulation.

    Parameters
    ----------
    world, robot
        Whose walls and whose beams.
    grid
        The cells that count.
    """

    def __init__(self, world: World, robot: RobotSpec, grid: CoverageGrid) -> None:
        self.grid = grid
        self._scene, self._beams = build_wall_index(world.edges).scene, beam_table(robot)
        self._radius = robot.radius

    def mark(self, poses: FloatArray, seen: BoolArray, step: int = 0) -> IntArray:
        """Set in ``seen`` (rows, columns) the cells covered at poses (n, 3), m and rad, the first of them at ``step``.

        Returns
        -------
        new_cells
            (n,), how many coverable cells each pose was the first to cover.
        """
        new_cells = np.zeros(len(poses), dtype=np.int64)
        sweep(
            np.ascontiguousarray(poses), step, self._radius, self._beams, *self._scene,
            seen, self.grid.coverable, self.grid.area, new_cells,
        )  # fmt: skip
        return new_cells
