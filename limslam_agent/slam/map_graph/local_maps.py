"""Local maps: chunks of a few metres of driving, drawn into small grids for matching with other
chunks.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limslam_agent.config.graph import LocalMapConfig
from limslam_agent.slam.map_graph.key_poses import KeyPoses, Trajectory, points_in_keys, to_world
from limslam_env.compilation import entry_of
from limslam_env.geometry import FloatArray, IntArray, se2

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)

HIT = 5
"""Value of an occupied cell. A free cell has the value -3, and an unknown one 0. Scores are sums
divided by ``HIT``.
"""

Cells = NDArray[np.int8]


@dataclass(frozen=True, eq=False)
class LocalMap:
    """A chunk of driving, in the frame of the key pose in its middle."""

    travel: float  # distance driven up to this key pose, m
    points: FloatArray  # points (k, 2), thinned to one point in each cell, m
    grid: Cells  # cells (n, n), first index along x. The origin of the frame is in the middle.
    cell: float  # side of a cell, m


def chunk_middles(keys: KeyPoses, hop: float) -> IntArray:
    """Key poses (c,) in the middle of the chunks, ``hop`` m of driving apart."""
    travel = keys.key_travel
    half = keys.config.maps.half
    wanted = np.arange(half, max(travel[-1], half + 1e-9), hop)
    return np.unique(np.minimum(np.searchsorted(travel, wanted), len(keys) - 1))


def cut_chunks(keys: KeyPoses, trajectory: Trajectory, middles: IntArray) -> list[LocalMap]:
    """Draw the chunks around the key poses ``middles`` (c,)."""
    config = keys.config.maps
    points, origins = points_in_keys(keys, trajectory.bias)
    travel = keys.key_travel
    point_key = keys.point_key
    begins = np.searchsorted(travel, travel[middles] - config.half)
    ends = np.searchsorted(travel, travel[middles] + config.half) + 1
    spans = np.searchsorted(point_key, np.column_stack((begins, ends)))
    maps = []
    for middle, (begin, end) in zip(middles, spans, strict=True):
        own = slice(begin, end)
        relative = se2.between(trajectory.poses[middle], trajectory.poses[point_key[own]])
        places = to_world(relative, points[own])
        grid = draw_grid(places, to_world(relative, origins[own]), keys.data.max_range, config)
        points_of_map = thinned(places, config.cell)
        maps.append(LocalMap(float(travel[middle]), points_of_map, grid, config.cell))
    return maps


def thinned(places: FloatArray, cell: float) -> FloatArray:
    """The first of the points (p, 2) in each cell."""
    _, first = np.unique(np.floor(places / cell).astype(np.int64), axis=0, return_index=True)
    return np.asarray(places[np.sort(first)])


def draw_grid(
    places: FloatArray, origins: FloatArray, max_range: float, config: LocalMapConfig
) -> Cells:
    """A grid (n, n) around the origin, with free cells along the beams and occupied cells around
    the points.
    """
    size = 2 * int(np.ceil((config.half + max_range) / config.cell))
    return _draw(places, origins, size, -0.5 * config.cell * size, config.cell, config.hit_radius)


def joined_grid(maps: Sequence[LocalMap], poses: FloatArray) -> Cells:
    """A grid (n, n) of several local maps at poses (k, 3): what most of them have seen."""
    grids = np.array([each.grid for each in maps])
    sums = _sums(grids, se2.inverse(poses), maps[0].cell)
    return np.asarray(HIT * (sums > 0) - 3 * (sums < 0), dtype=np.int8)


@kernel
def _sums(grids: Cells, poses: FloatArray, cell: float) -> NDArray[np.int16]:
    """Sums (n, n) of the cells of grids (k, n, n), in each of which the sums have a pose (k, 3)."""
    size = grids.shape[1]
    half = 0.5 * size
    sums = np.zeros((size, size), np.int16)
    for k in range(len(grids)):
        cos = np.cos(poses[k, 2])
        sin = np.sin(poses[k, 2])
        for i in range(size):
            for j in range(size):
                x = i + 0.5 - half
                y = j + 0.5 - half
                a = int(np.floor(cos * x - sin * y + poses[k, 0] / cell + half))
                b = int(np.floor(sin * x + cos * y + poses[k, 1] / cell + half))
                if 0 <= a < size and 0 <= b < size:
                    sums[i, j] += grids[k, a, b]
    return sums


@kernel
def _draw(
    places: FloatArray, origins: FloatArray, size: int, low: float, cell: float, radius: float
) -> Cells:
    grid = np.zeros((size, size), np.int8)
    for k in range(len(places)):
        ax = (origins[k, 0] - low) / cell
        ay = (origins[k, 1] - low) / cell
        bx = (places[k, 0] - low) / cell
        by = (places[k, 1] - low) / cell
        length = max(abs(bx - ax), abs(by - ay))
        steps = int(length) + 1
        # The last cells before a point may belong to the wall.
        last = 1.0 - 2.5 / max(length, 1e-6)
        for step in range(steps):
            share = step / steps
            if share > last:
                break
            i = int(np.floor(ax + (bx - ax) * share))
            j = int(np.floor(ay + (by - ay) * share))
            if 0 <= i < size and 0 <= j < size:
                grid[i, j] = -3
    reach = int(np.ceil(radius / cell))
    square = (radius / cell) ** 2 + 1e-9
    for k in range(len(places)):
        i = int(np.floor((places[k, 0] - low) / cell))
        j = int(np.floor((places[k, 1] - low) / cell))
        for a in range(-reach, reach + 1):
            for b in range(-reach, reach + 1):
                if a * a + b * b <= square and 0 <= i + a < size and 0 <= j + b < size:
                    grid[i + a, j + b] = 5
    return grid
