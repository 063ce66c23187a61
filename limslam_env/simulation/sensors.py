"""Range sensors: the index of walls for ray casting, and the table of beams for the kernels."""

from dataclasses import dataclass

import numpy as np

from limslam_env.geometry import FloatArray, IntArray
from limslam_env.interface import RobotSpec
from limslam_env.kernels.rays import cast_rays
from limslam_env.kernels.wall_cells import list_walls

CELL = 0.5

# Walls are listed in a cell if they come as near as this to it, m.
_BORDER = 1e-6


@dataclass(frozen=True, eq=False)
class WallIndex:
    """Walls sorted by position, so that a ray is only compared with walls near it.

    The fields are the *scene* of :mod:`limslam_env.kernels.wall_cells`.

    Attributes
    ----------
    edges
        (k, 4), m.
    cell_starts, cell_edges
        The walls that cross each cell.
    grid
        (5,): lower left corner x, y and cell side (m), number of columns and of rows.
    """

    edges: FloatArray
    cell_starts: IntArray
    cell_edges: IntArray
    grid: FloatArray

    @property
    def scene(self) -> tuple[FloatArray, IntArray, IntArray, FloatArray]:
        """The four arrays, in the order in which kernels take them."""
        return self.edges, self.cell_starts, self.cell_edges, self.grid

    def cast(self, origins: FloatArray, directions: FloatArray, lengths: FloatArray) -> tuple[FloatArray, IntArray]:
        """Distances (n,), m, and walls hit (n,) of rays from (n, 2) along unit vectors (n, 2), (n,) m long.

        A ray that hits nothing has its own length, and -1.
        """
        distances, hits = np.empty(len(origins)), np.empty(len(origins), dtype=np.int64)
        cast_rays(origins, directions, lengths, *self.scene, distances, hits)
        return distances, hits


def build_wall_index(edges: FloatArray) -> WallIndex:
    """Sort walls (k, 4), m, for rays that start among them."""
    low = np.minimum(edges[:, :2], edges[:, 2:]).min(axis=0) - CELL
    high = np.maximum(edges[:, :2], edges[:, 2:]).max(axis=0) + CELL
    columns, rows = np.ceil((high - low) / CELL).astype(int)
    grid = np.array([low[0], low[1], CELL, columns, rows])
    edges = np.array(edges)
    return WallIndex(edges, *_listed(edges, grid, _BORDER), grid)


def walls_around(index: WallIndex, reach: float) -> tuple[IntArray, IntArray]:
    """The walls (``starts`` and numbers, as the cell list has them) that are within ``reach`` (m) of each cell."""
    return _listed(index.edges, index.grid, reach)


def _listed(edges: FloatArray, grid: FloatArray, border: float) -> tuple[IntArray, IntArray]:
    count = int(grid[3] * grid[4])
    starts, empty = np.zeros(count + 1, dtype=np.int64), np.zeros(0, dtype=np.int64)
    list_walls(edges, grid, border, np.zeros(count, dtype=np.int64), starts, empty)
    numbers = np.empty(starts[-1], dtype=np.int64)
    list_walls(edges, grid, border, np.zeros(count, dtype=np.int64), starts, numbers)
    return starts, numbers


def beam_table(robot: RobotSpec) -> FloatArray:
    """The beams (n_beams, 11) with the columns of :mod:`limslam_env.kernels.tables`."""
    offsets = np.maximum(np.einsum("bd,bd->b", robot.beam_origins, robot.beam_directions), 0.0)
    periods = [beam.period for beam in robot.beams]
    return np.column_stack((robot.beam_table, offsets, robot.min_ranges, periods))
