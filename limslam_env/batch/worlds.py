"""Many worlds in one set of arrays, as the kernels of the batch take them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import RobotSpec
from limslam_env.kernels.batch_state import Worlds
from limslam_env.kernels.coverage import TILE
from limslam_env.kernels.random_numbers import FreeCells, Words
from limslam_env.kernels.rays import Walls
from limslam_env.simulation.coverage import coverage_grid
from limslam_env.simulation.sensors import build_wall_index, walls_around
from limslam_env.simulation.starts import starting_places
from limslam_env.worlds.world import World

# Near walls, on the average, up to which a ray tries them all.
_MOST_NEAR = 60
# Edges of a world that can be counted in two bytes.
_MOST_EDGES = 65_536

_NOWHERE = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class StartCells:
    """Where robots start: the known poses, and for the other robots the cells of a region, row by
    row.

    Attributes
    ----------
    given
        Poses (g, 3) of the first robots, m and rad.
    cells
        Where the others may start.
    """

    given: FloatArray
    cells: FreeCells


@dataclass(frozen=True, eq=False)
class Site:
    """A world prepared for a batch: its sorted walls, the cells that count for coverage, and its
    starting places.

    Attributes
    ----------
    walls, reach, starts
        For rays and contact; farthest that robots see, m; and where they start.
    area, shape, tiles
        Lower left corner and cell side (3,), m, of the coverage grid, its rows and columns, and its
        coverable cells as
        :func:`to_tiles` makes them.
    """

    walls: Walls
    reach: float
    area: FloatArray
    shape: tuple[int, int]
    tiles: Words
    starts: StartCells

    @property
    def near(self) -> tuple[IntArray, IntArray] | None:
        """The walls within the beams' reach of each cell of their list; None where these are too
        many.
        """
        # Sensors that see far across a building: going from cell to cell is faster, and such lists
        # would be long.
        corners = self.walls.edges.reshape(-1, 2)
        count = len(self.walls.edges)
        share = min(
            1.0, (2.0 * self.reach) ** 2 / max(float(np.prod(np.ptp(corners, axis=0))), 1e-9)
        )
        too_many = share * count > _MOST_NEAR or count > _MOST_EDGES
        return None if too_many else walls_around(self.walls, self.reach)


def prepare(
    world: World, robot: RobotSpec, num_robots: int, start: FloatArray | None = None
) -> Site:
    """Make a world ready, for robots that start as
    :func:`limslam_env.simulation.starts.starting_places` says.
    """
    places = starting_places(world, robot, num_robots, start)
    grid = coverage_grid(world, robot, places.known)
    cells = places.cells[~places.is_pocket]
    firsts = np.concatenate(([0], 1 + np.flatnonzero(cells[1:] != cells[:-1] + 1)))[: len(cells)]
    runs = np.column_stack((cells[firsts], firsts)).astype(np.int32)
    starts = StartCells(places.given, FreeCells(runs, len(cells), places.space))
    tiles = to_tiles(grid.coverable)
    return Site(
        build_wall_index(world.edges), robot.reach, grid.area, grid.coverable.shape, tiles, starts
    )


def to_tiles(cells: BoolArray) -> Words:
    """A grid (rows, columns) as words of 8 x 8 cells, (tile_rows, tile_columns)."""
    rows, columns = (-(-side // TILE) for side in cells.shape)
    padded = np.zeros((rows * TILE, columns * TILE), dtype=bool)
    padded[: cells.shape[0], : cells.shape[1]] = cells
    blocks = (
        padded.reshape(rows, TILE, columns, TILE).swapaxes(1, 2).reshape(rows, columns, TILE * TILE)
    )
    return np.packbits(blocks, axis=-1, bitorder="little").view("<u8")[..., 0].astype(np.uint64)


def from_tiles(tiles: Words, shape: tuple[int, int]) -> BoolArray:
    """The grid (rows, columns) that :func:`to_tiles` made tiles (tile_rows, tile_columns) of."""
    rows, columns = tiles.shape
    bits = np.unpackbits(
        tiles.astype("<u8").view(np.uint8).reshape(rows, columns, TILE), axis=-1, bitorder="little"
    )
    blocks = (
        bits.reshape(rows, columns, TILE, TILE).swapaxes(1, 2).reshape(rows * TILE, columns * TILE)
    )
    return np.asarray(blocks[: shape[0], : shape[1]], dtype=bool)


class _RowStore:
    """The rows of many worlds, one after the other, with space to replace a world."""

    def __init__(self, dtype: type[np.generic], *width: int) -> None:
        self.rows: NDArray[Any] = np.zeros((0, *width), dtype=dtype)
        self._taken = 0
        self._firsts: list[int] = []
        self._sizes: list[int] = []

    def put(self, slot: int, rows: NDArray[Any]) -> int:
        """Put rows (k, ...) at a slot, the next one or one in use; where they begin."""
        if slot == len(self._firsts):
            self._firsts.append(0)
            self._sizes.append(-1)
        if len(rows) > self._sizes[slot]:
            # A later world in this slot may need a little more.
            size = len(rows) if self._sizes[slot] < 0 else len(rows) * 5 // 4
            self._firsts[slot] = self._taken
            self._sizes[slot] = size
            self._taken += size
            if self._taken > len(self.rows):
                self._grow(max(self._taken, len(self.rows) * 3 // 2))
        first = self._firsts[slot]
        self.rows[first : first + len(rows)] = rows
        return first

    def _grow(self, count: int) -> None:
        shape = count, *self.rows.shape[1:]
        try:
            # In place: thousands of worlds are a hundred megabytes.
            self.rows.resize(shape)
        except ValueError:  # others hold the array
            grown = np.zeros(shape, self.rows.dtype)
            grown[: len(self.rows)] = self.rows
            self.rows = grown


class Sites:
    """The worlds of a batch, by the numbers of their slots.

    Attributes
    ----------
    layout, grids, areas, tiles, totals
        As :class:`limslam_env.kernels.batch_state.Worlds` holds them; ``tiles`` are its
        ``coverable``.
    shapes
        Rows and columns of each coverage grid.
    """

    def __init__(self) -> None:
        self._edges = _RowStore(np.float64, 4)
        self._cells = _RowStore(np.int32)
        self._items = _RowStore(np.int32)
        self._near_cells = _RowStore(np.int32)
        self._near_items = _RowStore(np.uint16)
        self.layout: IntArray = np.zeros((0, 7), dtype=np.int64)
        self.grids: FloatArray = np.zeros((0, 3))
        self.areas: FloatArray = np.zeros((0, 3))
        self.totals: IntArray = np.zeros(0, dtype=np.int64)
        self.tiles: Words = np.zeros((0, 0), dtype=np.uint64)
        self.shapes: list[tuple[int, int]] = []

    def __len__(self) -> int:
        return len(self.shapes)

    @property
    def worlds(self) -> Worlds:
        """The arrays as the kernels take them."""
        walls = (
            self._edges.rows,
            self._cells.rows,
            self._items.rows,
            self._near_cells.rows,
            self._near_items.rows,
        )
        return Worlds(self.layout, self.grids, self.areas, *walls, self.tiles, self.totals)

    def put(self, slot: int, site: Site) -> None:
        """Put a world at a slot: the next one, or one whose world is needed no more."""
        if slot == len(self):
            self._grow()
        walls = site.walls
        tiles = site.tiles
        near = site.near
        first_edge = self._edges.put(slot, walls.edges)
        first_item = self._items.put(slot, walls.cell_edges + first_edge)
        first_cell = self._cells.put(slot, walls.cell_starts + first_item)
        starts, numbers = near or _NOWHERE
        first_item = self._near_items.put(slot, numbers)
        first_near = -1 if near is None else self._near_cells.put(slot, starts + first_item)
        self.layout[slot] = (
            first_edge,
            first_cell,
            walls.columns,
            walls.rows,
            *tiles.shape[::-1],
            first_near,
        )
        self.grids[slot] = (walls.low_x, walls.low_y, walls.side)
        self.areas[slot] = site.area
        self.totals[slot] = max(int(np.bitwise_count(tiles).sum()), 1)
        self.shapes[slot] = site.shape
        if tiles.size > self.tiles.shape[1]:
            self.tiles = np.pad(self.tiles, ((0, 0), (0, tiles.size - self.tiles.shape[1])))
        self.tiles[slot] = 0
        self.tiles[slot, : tiles.size] = tiles.ravel()

    def to_cells(self, slot: int, tiles: Words) -> BoolArray:
        """Tiles (t,) of a world as a grid (rows, columns)."""
        columns, rows = self.layout[slot, 4:6]
        return from_tiles(tiles[: rows * columns].reshape(rows, columns), self.shapes[slot])

    def _grow(self) -> None:
        # The arrays grow by a half, so that thousands of worlds do not copy them at each one.
        self.shapes.append((0, 0))
        if len(self.shapes) > len(self.layout):
            more = max(1, len(self.layout) // 2)
            for name in ("layout", "grids", "areas", "totals", "tiles"):
                array = getattr(self, name)
                setattr(
                    self,
                    name,
                    np.concatenate((array, np.zeros((more, *array.shape[1:]), array.dtype))),
                )
