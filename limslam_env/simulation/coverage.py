"""The true coverage: the cells that can be seen, and the cells that have been seen."""

import functools
from dataclasses import dataclass

import numpy as np

from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.kernels.coverage import CellGrid
from limslam_env.kernels.floor import Lookout, look_out
from limslam_env.simulation.sensors import build_wall_index
from limslam_env.worlds.free_space import eroded
from limslam_env.worlds.world import World

CELL = 0.10
"""Side of a cell of the coverage grid, m."""

# The directions (n, 2), unit vectors, in which what can be covered is looked for.
_TURNS = np.arange(240) * (2.0 * np.pi / 240)
_VIEWS = np.column_stack((np.cos(_TURNS), np.sin(_TURNS)))


@dataclass(frozen=True, eq=False)
class CoverageGrid:
    """The cells that a beam can see from some place that the robots can reach.

    Attributes
    ----------
    low, coverable
        Lower left corner of the grid (2,), m; and its cells (rows, columns), row 0 at the bottom.
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


@functools.lru_cache(maxsize=16)
def _coverage_grid(
    world: World, robot: RobotSpec, regions: frozenset[int], loose: tuple[tuple[float, float], ...]
) -> CoverageGrid:
    low, shape = grid_over(world.edges)
    space = world.free_space(robot.radius)
    walls = build_wall_index(world.edges)
    grid = CoverageGrid(low, np.zeros(shape, dtype=bool))
    reachable = np.zeros_like(space.free)
    for region in regions:
        reachable |= space.labels == region
    around = np.array(space.free.shape) * (space.cell / CELL) + 3.0
    lookout = Lookout(
        walls,
        _VIEWS,
        robot.reach,
        np.array([*space.origin, space.cell]),
        reachable,
        eroded(reachable),
        CellGrid(grid.coverable, grid.coverable, grid.area),
    )
    look_out(lookout, np.array(loose).reshape(-1, 2), np.zeros(around.astype(int), dtype=bool))
    return grid


def coverage_grid(world: World, robot: RobotSpec, starts: FloatArray) -> CoverageGrid:
    """What robots (all alike) that start at poses (n, 3) could cover; remembered for later
    calls.
    """
    space = world.free_space(robot.radius)
    labels = [space.label_of(start[:2]) for start in starts]
    # A robot may stand where the grid of free space is too coarse to hold it.
    loose = tuple(
        (float(x), float(y)) for (x, y, _), label in zip(starts, labels, strict=True) if label == 0
    )
    return _coverage_grid(world, robot, frozenset(labels) - {0}, loose)
