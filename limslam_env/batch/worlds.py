"""Many worlds in one set of arrays, as the kernels of the batch take them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import RobotSpec
from limslam_env.kernels.batch_state import Worlds
from limslam_env.kernels.random_numbers import Words
from limslam_env.kernels.tiles import TILE
from limslam_env.simulation.coverage import coverage_grid
from limslam_env.simulation.sensors import WallIndex, build_wall_index, walls_around
from limslam_env.simulation.starts import starting_places
from limslam_env.worlds.world import World

# Near walls, on the average, up to which a ray tries them all.
_MOST_NEAR = 60
# Edges of a world that can be counted in two bytes.
_MOST_EDGES = 65_536

_NOWHERE = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class StartCells:
    """Where robots start: the known poses, and for the other robots the cells of a region, row by row.

    Attributes
    ----------
    given
        Poses (g, 3) of the first robots, m and rad.
    runs
        (r, 2): the number of the first of some cells side by side, and how many cells come before it.
    count
        Number of all cells.
    space
        (4,): lower left corner x, y and side of the cells, m, and columns.
    """

    given: FloatArray
    runs: NDArray[np.int32]
    count: int
    space: FloatArray


@dataclass(frozen=True, eq=False)
class Site:
    """A world prepared for a batch: its sorted walls, the cells that count for coverage, and its starting places.

    Attributes
    ----------
    walls
        For rays and contact.
    reach
        Farthest that robots see, m.
    area
        (3,): lower left corner and cell side of the coverage grid, m.
    shape
        Rows and columns of the coverage grid.
    tiles
        Its coverable cells, as :func:`to_tiles` makes them.
    starts
        Where robots start.
    """

    walls: WallIndex
    reach: float
    area: FloatArray
    shape: tuple[int, int]
    tiles: Words
    starts: StartCells


def prepare(world: World, robot: RobotSpec, num_robots: int, start: FloatArray | None = None) -> Site:
    """Make a world ready, for robots that start as :func:`limslam_env.simulation.starts.starting_places` says.

    Raises
    ------
    WorldError
        If a start cannot be used or there is no room.
    """
    places = starting_places(world, robot, num_robots, start)
    grid = coverage_grid(world, robot, places.known)
    cells = places.cells[~places.is_pocket]
    firsts = np.concatenate(([0], 1 + np.flatnonzero(cells[1:] != cells[:-1] + 1)))[: len(cells)]
    runs = np.column_stack((cells[firsts], firsts)).astype(np.int32)
    starts = StartCells(places.given, runs, len(cells), places.space)
    tiles = to_tiles(grid.coverable)
    return Site(build_wall_index(world.edges), robot.reach, grid.area, grid.coverable.shape, tiles, starts)


def near_walls(walls: WallIndex, reach: float) -> tuple[IntArray, IntArray] | None:
    """The walls within ``reach`` (m) of each cell of their list; None where these are too many."""
    # Sensors that see far across a building: going from cell to cell is faster, and such lists would be long.
    low, high = walls.edges.reshape(-1, 2).min(axis=0), walls.edges.reshape(-1, 2).max(axis=0)
    share = min(1.0, (2.0 * reach) ** 2 / max(float(np.prod(high - low)), 1e-9))
    if share * len(walls.edges) > _MOST_NEAR or len(walls.edges) > _MOST_EDGES:
        return None
    return walls_around(walls, reach)


def to_tiles(cells: BoolArray) -> Words:
    """A grid (rows, columns) as words of 8 x 8 cells, (tile_rows, tile_columns)."""
    rows, columns = (-(-side // TILE) for side in cells.shape)
    padded = np.zeros((rows * TILE, columns * TILE), dtype=bool)
    padded[: cells.shape[0], : cells.shape[1]] = cells
    blocks = padded.reshape(rows, TILE, columns, TILE).swapaxes(1, 2).reshape(rows, columns, TILE * TILE)
    return np.packbits(blocks, axis=-1, bitorder="little").view("<u8")[..., 0].astype(np.uint64)


def from_tiles(tiles: Words, shape: tuple[int, int]) -> BoolArray:
    """The grid (rows, columns) that :func:`to_tiles` made tiles (tile_rows, tile_columns) of."""
    rows, columns = tiles.shape
    bits = np.unpackbits(tiles.astype("<u8").view(np.uint8).reshape(rows, columns, TILE), axis=-1, bitorder="little")
    blocks = bits.reshape(rows, columns, TILE, TILE).swapaxes(1, 2).reshape(rows * TILE, columns * TILE)
    return np.asarray(blocks[: shape[0], : shape[1]], dtype=bool)


class Sites:
    """The worlds of a batch, by the numbers of their slots."""

    def __init__(self) -> None:
        self._sites: list[tuple[Site, tuple[IntArray, IntArray] | None]] = []
        self._worlds: Worlds | None = None
        self._width = 0

    def __len__(self) -> int:
        return len(self._sites)

    def put(self, slot: int, site: Site) -> None:
        """Put a world at a slot: the next one, or one whose world is needed no more."""
        self._sites[slot : slot + 1] = [(site, near_walls(site.walls, site.reach))]
        self._worlds, self._width = None, max(self._width, site.tiles.size)

    @property
    def tiles(self) -> Words:
        """The coverable cells of each world, (w, t)."""
        return self.worlds.coverable

    @property
    def worlds(self) -> Worlds:
        """All worlds as the kernels take them, put together anew after changes."""
        if self._worlds is None:
            self._worlds = self._together()
        return self._worlds

    def to_cells(self, slot: int, tiles: Words) -> BoolArray:
        """Tiles (t,) of a world as a grid (rows, columns)."""
        site, _ = self._sites[slot]
        return from_tiles(tiles[: site.tiles.size].reshape(site.tiles.shape), site.shape)

    def _together(self) -> Worlds:
        sites, near = [site for site, _ in self._sites], [near or _NOWHERE for _, near in self._sites]
        walls, tiles = [site.walls for site in sites], np.zeros((len(sites), self._width), dtype=np.uint64)
        for row, site in zip(tiles, sites, strict=True):
            row[: site.tiles.size] = site.tiles.ravel()
        edges, first_edges = _joined([each.edges for each in walls])
        items, first_items = _joined([each.cell_edges for each in walls], first_edges)
        cells, first_cells = _joined([each.cell_starts for each in walls], first_items)
        near_items, first_near_items = _joined([numbers for _, numbers in near])
        near_cells, first_near = _joined([starts for starts, _ in near], first_near_items)
        first_near[[each is None for _, each in self._sites]] = -1
        grids, shapes = np.array([each.grid for each in walls]), np.array([site.tiles.shape for site in sites])
        return Worlds(
            np.column_stack((first_edges, first_cells, grids[:, 3:].astype(np.int64), shapes[:, ::-1], first_near)),
            np.ascontiguousarray(grids[:, :3]), np.array([site.area for site in sites]), edges,
            cells.astype(np.int32), items.astype(np.int32), near_cells.astype(np.int32), near_items.astype(np.uint16),
            tiles, np.maximum(np.bitwise_count(tiles).sum(axis=1, dtype=np.int64), 1),
        )  # fmt: skip


def _joined(parts: list[NDArray[Any]], shifts: IntArray | int = 0) -> tuple[NDArray[Any], IntArray]:
    """Arrays one after the other, each with its shift added, and where each of them begins."""
    sizes = np.array([len(part) for part in parts])
    joined = np.concatenate(parts)
    if not isinstance(shifts, int):
        joined = joined + np.repeat(shifts, sizes)
    return joined, np.cumsum(sizes) - sizes
