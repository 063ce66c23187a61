"""The sensor of the peers: 720 rays without noise from the true place, drawn into a map of pixels.

Ray count, range and the walk from pixel to pixel are those of ``sensor.py`` in ARiADNE, and the definition of the end
is that of ``check_done`` in ``env.py``.
"""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.maps import PeerMap
from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray, IntArray

RAYS, RANGE = 720, 80
"""Number of rays of a scan, and their length, pixels."""

UNSEEN_AT_END = 250
"""Number of free pixels that may be unseen when an exploration counts as done."""

NODE_SPACING = 480 / 29
"""Least distance between two nodes of the peers' graph, pixels: 30 x 30 nodes on a picture of 640 x 480 pixels."""

BLOCK = 2
"""Side of a cell of the map that explorers get, pixels."""

_DEPTH = 9  # pixels of a wall that a ray draws


class LidarMap:
    """What 720 rays have shown of a map.

    Parameters
    ----------
    found
        The map.
    scale
        Side of a pixel, m.
    """

    def __init__(self, found: PeerMap, scale: float) -> None:
        self._found, self._scale = found, scale
        self._known: NDArray[np.int8] = np.zeros(found.free.shape, dtype=np.int8)
        self._free_pixels = int(np.count_nonzero(found.free))
        self._view: GridView | None = None
        self.scans = 0

    def scan(self, place: FloatArray) -> None:
        """Draw the rays from a place (2,), m."""
        pixels, is_drawn, is_wall = _seen(self._found, self._found.pixel(place, self._scale))
        rows, columns = pixels[is_drawn].T
        self._known[rows, columns] = np.where(is_wall[is_drawn], -1, 1)
        self.scans, self._view = self.scans + 1, None

    @property
    def view(self) -> GridView:
        """The map with cells of two by two pixels: occupied if one of them is, else unknown if one is, else free."""
        if self._view is None:
            rows, columns = self._found.free.shape
            blocks = self._known.reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK)
            values = np.ascontiguousarray(blocks.min(axis=(1, 3))[::-1], dtype=np.int16)
            self._view = GridView(np.zeros(2), BLOCK * self._scale, values)
        return self._view

    @property
    def unseen(self) -> int:
        """Number of free pixels that no ray has seen, also where no robot can go."""
        return self._free_pixels - int(np.count_nonzero(self._known > 0))

    @property
    def explored(self) -> float:
        """Share of the free pixels that have been seen."""
        return 1.0 - self.unseen / self._free_pixels

    @property
    def is_done(self) -> bool:
        """Whether the exploration is done by the peers' definition."""
        return self.unseen <= UNSEEN_AT_END


def _seen(found: PeerMap, start: tuple[int, int]) -> tuple[IntArray, BoolArray, BoolArray]:
    """The pixels on all rays (RAYS, steps, 2), which of them are drawn, and which are walls (RAYS, steps).

    A ray draws free pixels up to a wall, and then the wall up to its far side or a depth of nine pixels.
    """
    offsets, counts = ray_pixels()
    rows, columns = found.free.shape
    pixels = offsets + np.array(start)
    is_inside = ((pixels >= 0) & (pixels < (rows, columns))).all(axis=2)
    row, column = np.clip(pixels[..., 0], 0, rows - 1), np.clip(pixels[..., 1], 0, columns - 1)
    is_wall = ~found.free[row, column]
    depth = np.cumsum(is_wall, axis=1)
    is_behind = np.logical_or.accumulate(~is_wall & (depth > 0), axis=1)
    is_on_ray = is_inside & (np.arange(offsets.shape[1]) < counts[:, None])
    return pixels, is_on_ray & ~is_behind & (depth <= _DEPTH), is_wall


@cache
def ray_pixels() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Offsets (RAYS, steps, 2), rows and columns, of the pixels on each ray, and the number of them (RAYS,).

    The pixels of a ray touch at their sides, and the last pixel is left out. The walk is Bresenham's with one step
    along one axis at a time.
    """
    angles = np.arange(RAYS) * (2.0 * math.pi / RAYS)
    ends = np.rint(RANGE * np.column_stack((np.sin(angles), np.cos(angles)))).astype(np.int64)
    steps, sizes = np.where(ends > 0, 1, -1), np.abs(ends)
    counts, error = sizes.sum(axis=1), sizes[:, 1] - sizes[:, 0]
    offsets, at = np.zeros((RAYS, int(counts.max()), 2), dtype=np.int64), np.zeros_like(ends)
    for step in range(offsets.shape[1]):
        offsets[:, step] = at
        is_along = error > 0
        at[:, 1] += np.where(is_along, steps[:, 1], 0)
        at[:, 0] += np.where(is_along, 0, steps[:, 0])
        error += np.where(is_along, -2 * sizes[:, 0], 2 * sizes[:, 1])
    return offsets, counts
