"""What could be seen of a world, and what has been: the true coverage."""

import functools
from dataclasses import dataclass

import numpy as np

from limslam_env.free_space import FreeSpace
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.kernels import mark_rays
from limslam_env.sensors import build_wall_index
from limslam_env.world import World

CELL = 0.10
"""Side of a cell of the coverage grid, m."""

_PLACE_SPACING = 0.10


def _fan(count: int) -> FloatArray:
    angles = np.arange(count) * (2.0 * np.pi / count)
    return np.column_stack((np.cos(angles), np.sin(angles)))


_VIEWS = _fan(240)
_SPOKES = _fan(16)


@dataclass(frozen=True, eq=False)
class CoverageGrid:
    """The cells that some beam could ever see from a place that a robot can reach.

    Attributes
    ----------
    low
        Lower left corner of the grid (2,), m.
    coverable
        (rows, columns), row 0 at the bottom.
    """

    low: FloatArray
    coverable: BoolArray

    def count(self, seen: BoolArray) -> int:
        """How many coverable cells a mask holds."""
        return int(np.count_nonzero(seen & self.coverable))

    @functools.cached_property
    def total(self) -> int:
        """How many cells are coverable."""
        return int(np.count_nonzero(self.coverable))


@functools.lru_cache(maxsize=64)
def _free_space(world: World, radius: float) -> FreeSpace:
    return world.free_space(radius)


@functools.lru_cache(maxsize=64)
def _coverage_grid(
    world: World, robot: RobotSpec, regions: frozenset[int], loose: tuple[tuple[float, float], ...]
) -> CoverageGrid:
    edges, reach = world.edges, robot.reach
    low = np.floor(np.minimum(edges[:, :2], edges[:, 2:]).min(axis=0) / CELL) * CELL
    high = np.maximum(edges[:, :2], edges[:, 2:]).max(axis=0)
    columns, rows = np.ceil((high - low) / CELL - 1e-9).astype(int)
    coverable = np.zeros((rows, columns), dtype=bool)
    index = build_wall_index(edges, reach)
    lengths, owners, no_discs = np.full(len(_VIEWS), reach), np.zeros(len(_VIEWS), dtype=np.int64), np.zeros((0, 2))
    for place in np.vstack((_places(_free_space(world, robot.radius), regions), np.array(loose).reshape(-1, 2))):
        origins = np.tile(place, (len(_VIEWS), 1))
        distances, _ = index.cast(origins, _VIEWS, lengths, owners, no_discs, 0.0)
        mark_rays(coverable, origins, _VIEWS, distances, low, CELL)
    return CoverageGrid(low, coverable)


def coverage_grid(world: World, robot: RobotSpec, starts: FloatArray) -> CoverageGrid:
    """What robots (all alike) that start at poses (n, 3) could cover; remembered for later calls."""
    space = _free_space(world, robot.radius)
    labels = [space.label_of(start[:2]) for start in starts]
    # A robot may stand where the grid of free space is too coarse to hold it.
    loose = tuple((float(x), float(y)) for (x, y, _), label in zip(starts, labels, strict=True) if label == 0)
    return _coverage_grid(world, robot, frozenset(labels) - {0}, loose)


def mark_seen(
    seen: BoolArray,
    grid: CoverageGrid,
    poses: FloatArray,
    origins: FloatArray,
    directions: FloatArray,
    distances: FloatArray,
    radius: float,
) -> None:
    """Set the cells that true beams cross and that bodies of ``radius`` (m) at poses (n, 3) stand on.

    The beams start at ``origins`` (k, 2), m, along unit vectors (k, 2), and end after ``distances`` (k,), m.
    """
    mark_rays(seen, origins, directions, distances, grid.low, CELL)
    centres = np.repeat(poses[:, :2], len(_SPOKES), axis=0)
    spokes = np.tile(_SPOKES, (len(poses), 1))
    mark_rays(seen, centres, spokes, np.full(len(spokes), radius), grid.low, CELL)


def _places(space: FreeSpace, regions: frozenset[int]) -> FloatArray:
    """Places (n, 2), m, all over some regions of a world."""
    every = max(round(_PLACE_SPACING / space.cell), 1)
    sparse = np.zeros_like(space.free)
    reachable = np.isin(space.labels, list(regions))
    sparse[::every, ::every] = reachable[::every, ::every]
    # The lattice can miss a room that is hardly larger than the robot.
    return space.centres(sparse if sparse.any() else reachable)
