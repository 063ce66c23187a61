"""What could be seen of a world, and what has been: the true coverage."""

import functools
from dataclasses import dataclass

import numpy as np

from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.kernels import mark_rays
from limslam_env.sensors import Rays, build_wall_index
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
def _coverage_grid(world: World, robot: RobotSpec, starts: tuple[tuple[float, ...], ...]) -> CoverageGrid:
    edges, reach = world.edges, robot.reach
    low = np.floor(np.minimum(edges[:, :2], edges[:, 2:]).min(axis=0) / CELL) * CELL
    high = np.maximum(edges[:, :2], edges[:, 2:]).max(axis=0)
    columns, rows = np.ceil((high - low) / CELL - 1e-9).astype(int)
    coverable = np.zeros((rows, columns), dtype=bool)
    index = build_wall_index(edges, reach)
    lengths, owners, no_discs = np.full(len(_VIEWS), reach), np.zeros(len(_VIEWS), dtype=np.int64), np.zeros((0, 2))
    for place in _reachable_places(world, robot.radius, np.array(starts)):
        origins = np.tile(place, (len(_VIEWS), 1))
        distances, _ = index.cast(origins, _VIEWS, lengths, owners, no_discs, 0.0)
        mark_rays(coverable, origins, _VIEWS, distances, low, CELL)
    return CoverageGrid(low, coverable)


def coverage_grid(world: World, robot: RobotSpec, starts: FloatArray) -> CoverageGrid:
    """What robots (all alike) that start at poses (n, 3) could cover; remembered for later calls."""
    return _coverage_grid(world, robot, tuple((float(x), float(y)) for x, y, _ in starts))


def mark_seen(
    seen: BoolArray, grid: CoverageGrid, poses: FloatArray, rays: Rays, distances: FloatArray, radius: float
) -> None:
    """Set the cells that true beams cross and that bodies of ``radius`` (m) at poses (n, 3) stand on."""
    mark_rays(seen, rays.origins, rays.directions, distances, grid.low, CELL)
    centres = np.repeat(poses[:, :2], len(_SPOKES), axis=0)
    spokes = np.tile(_SPOKES, (len(poses), 1))
    mark_rays(seen, centres, spokes, np.full(len(spokes), radius), grid.low, CELL)


def _reachable_places(world: World, radius: float, starts: FloatArray) -> FloatArray:
    space = world.free_space(radius)
    region = np.zeros_like(space.free)
    for start in starts:
        region |= space.region_of(start)
    every = max(round(_PLACE_SPACING / space.cell), 1)
    sparse = np.zeros_like(region)
    sparse[::every, ::every] = region[::every, ::every]
    return np.vstack((space.centres(sparse), starts))
