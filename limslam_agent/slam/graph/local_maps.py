"""Local maps: chunks of a few metres of driving, drawn into small grids for matching with other chunks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limslam_agent.config.graph import LocalMapConfig
from limslam_agent.slam.graph.key_poses import KeyPoses, Trajectory, points_in_keys, to_world
from limslam_env.compilation import entry_of
from limslam_env.geometry import FloatArray, IntArray, se2

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)

HIT = 5
"""Value of an occupied cell. Scores are sums of cells divided by this value."""
FREE = -3
"""Value of a free cell, through which a beam has passed; the value 0 means unknown."""

Cells = NDArray[np.int8]


@dataclass(frozen=True, eq=False)
class LocalMap:
    """A chunk of driving, in the frame of the key pose in its middle.

    Attributes
    ----------
    middle
        Index of this key pose.
    travel
        Distance driven up to this key pose, m.
    places, origins
        All points (p, 2) and the origins of their beams (p, 2), m.
    points
        Points (k, 2), thinned to one point in each cell, m.
    grid
        Cells (n, n), first index along x. The origin of the frame is in the middle.
    cell
        Side of a cell, m.
    """

    middle: int
    travel: float
    places: FloatArray
    origins: FloatArray
    points: FloatArray
    grid: Cells
    cell: float

    @property
    def low(self) -> float:
        """The grid's lowest x and y, m."""
        return -0.5 * self.cell * len(self.grid)


def chunk_middles(keys: KeyPoses, config: LocalMapConfig, hop: float) -> IntArray:
    """Key poses (c,) in the middle of the chunks, ``hop`` m of driving apart."""
    travel = keys.key_travel
    wanted = np.arange(config.half, max(travel[-1], config.half + 1e-9), hop)
    return np.unique(np.minimum(np.searchsorted(travel, wanted), len(keys) - 1))


def cut_chunks(
    keys: KeyPoses, trajectory: Trajectory, config: LocalMapConfig, middles: IntArray, max_range: float
) -> list[LocalMap]:
    """Draw the chunks around the key poses ``middles`` (c,)."""
    points, origins = points_in_keys(keys, trajectory.bias)
    travel = keys.key_travel
    begins = np.searchsorted(travel, travel[middles] - config.half)
    ends = np.searchsorted(travel, travel[middles] + config.half) + 1
    spans = np.searchsorted(keys.point_key, np.column_stack((begins, ends)))
    size = grid_size(config, max_range)
    maps = []
    for middle, (begin, end) in zip(middles, spans, strict=True):
        relative = se2.between(trajectory.poses[middle], trajectory.poses[keys.point_key[begin:end]])
        places, starts = to_world(relative, points[begin:end]), to_world(relative, origins[begin:end])
        grid = draw_grid(places, starts, size, config)
        thin = thinned(places, config.cell)
        maps.append(LocalMap(int(middle), float(travel[middle]), places, starts, thin, grid, config.cell))
    return maps


def grid_size(config: LocalMapConfig, max_range: float) -> int:
    """Cells along each side of a chunk's grid."""
    return 2 * int(np.ceil((config.half + max_range) / config.cell))


def united(maps: Sequence[LocalMap], poses: FloatArray, size: int, config: LocalMapConfig) -> LocalMap:
    """One map of several chunks with poses (c, 3), in the frame of the first chunk."""
    relative = se2.between(poses[0], poses)
    places = np.vstack([se2.transform_points(pose, each.places) for pose, each in zip(relative, maps, strict=True)])
    origins = np.vstack([se2.transform_points(pose, each.origins) for pose, each in zip(relative, maps, strict=True)])
    grid = draw_grid(places, origins, size, config)
    first = maps[0]
    return LocalMap(first.middle, first.travel, places, origins, first.points, grid, config.cell)


def thinned(places: FloatArray, cell: float) -> FloatArray:
    """The first of the points (p, 2) in each cell."""
    _, first = np.unique(np.floor(places / cell).astype(np.int64), axis=0, return_index=True)
    return np.asarray(places[np.sort(first)])


def draw_grid(places: FloatArray, origins: FloatArray, size: int, config: LocalMapConfig) -> Cells:
    """A grid (size, size) around the origin, with free cells along the beams and occupied cells around the points."""
    low = -0.5 * config.cell * size
    return _draw(places, origins, size, low, config.cell, config.hit_radius)


@kernel
def _draw(places: FloatArray, origins: FloatArray, size: int, low: float, cell: float, radius: float) -> Cells:
    grid = np.zeros((size, size), np.int8)
    for k in range(len(places)):
        ax, ay = (origins[k, 0] - low) / cell, (origins[k, 1] - low) / cell
        bx, by = (places[k, 0] - low) / cell, (places[k, 1] - low) / cell
        length = max(abs(bx - ax), abs(by - ay))
        steps = int(length) + 1
        # The last cells before a point may belong to the wall.
        last = 1.0 - 2.5 / max(length, 1e-6)
        for step in range(steps):
            share = step / steps
            if share > last:
                break
            i, j = int(np.floor(ax + (bx - ax) * share)), int(np.floor(ay + (by - ay) * share))
            if 0 <= i < size and 0 <= j < size:
                grid[i, j] = -3
    reach = int(np.ceil(radius / cell))
    square = (radius / cell) ** 2 + 1e-9
    for k in range(len(places)):
        i, j = int(np.floor((places[k, 0] - low) / cell)), int(np.floor((places[k, 1] - low) / cell))
        for a in range(-reach, reach + 1):
            for b in range(-reach, reach + 1):
                if a * a + b * b <= square and 0 <= i + a < size and 0 <= j + b < size:
                    grid[i + a, j + b] = 5
    return grid
