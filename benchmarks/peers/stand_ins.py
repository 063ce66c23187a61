"""Stand-ins for the maps of the peers: rooms and corridors in their format, for computers that do not have the maps.

They are not the peers' maps. Size of the picture, side of a tile, width of corridors and grey levels are the same; the
layout is this project's: rooms at random places that do not touch, each joined to an earlier one by a bent corridor,
and a few corridors more. Figures on stand-ins say nothing about figures on the real maps.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.peers.maps import START_GREY

NAME = "stand_in_"
"""Beginning of the files' names."""

TILE = 16
COLUMNS, ROWS = 40, 30
"""Side of a tile, pixels, and numbers of tiles: a picture of 640 x 480 pixels."""

_WALL_GREY, _FREE_GREY = 127, 194
_TRIES, _MOST_ROOMS, _LOOPS = 60, 12, 3
_SHORTEST, _LONGEST = 3, 8  # sides of a room, tiles

Room = tuple[int, int, int, int]
"""First row, row after the last, first column, column after the last."""


def write_stand_ins(folder: Path, count: int, columns: int = COLUMNS, rows: int = ROWS) -> None:
    """Write stand-ins into a folder that holds nothing else. The seed of each is its number.

    Raises
    ------
    ValueError
        If the folder holds something else.
    """
    names = [f"{NAME}{seed:03}.png" for seed in range(count)]
    if folder.exists() and (not folder.is_dir() or {path.name for path in folder.iterdir()} - set(names)):
        raise ValueError(f"{folder}: stand-ins are not written beside other files")
    folder.mkdir(parents=True, exist_ok=True)
    for seed, name in enumerate(names):
        grey = stand_in(seed, columns, rows)
        Image.fromarray(np.repeat(grey[..., None], 3, axis=2)).save(folder / name)


def stand_in(seed: int, columns: int = COLUMNS, rows: int = ROWS) -> NDArray[np.uint8]:
    """Grey levels (16 rows, 16 columns) of a stand-in."""
    generator = np.random.default_rng(seed)
    rooms = _rooms(generator, columns, rows)
    tiles = np.full((rows, columns), _WALL_GREY, dtype=np.uint8)
    for top, bottom, left, right in rooms:
        tiles[top:bottom, left:right] = _FREE_GREY
    for number in range(1, len(rooms)):
        _join(tiles, rooms[number], rooms[int(generator.integers(number))], generator)
    for _ in range(_LOOPS if len(rooms) > 2 else 0):
        one, other = generator.choice(len(rooms), 2, replace=False)
        _join(tiles, rooms[one], rooms[other], generator)
    row, column = _middle(rooms[0])
    tiles[row, column] = START_GREY
    return tiles.repeat(TILE, axis=0).repeat(TILE, axis=1)


def _rooms(generator: np.random.Generator, columns: int, rows: int) -> list[Room]:
    """Rooms with at least a tile of wall between them and around them."""
    found: list[Room] = []
    taken = np.zeros((rows, columns), dtype=bool)
    for _ in range(_TRIES):
        height, width = generator.integers(_SHORTEST, _LONGEST + 1, 2)
        top = int(generator.integers(1, rows - height)) if rows > height + 1 else 0
        left = int(generator.integers(1, columns - width)) if columns > width + 1 else 0
        bottom, right = top + int(height), left + int(width)
        if top and left and len(found) < _MOST_ROOMS and not taken[top - 1 : bottom + 1, left - 1 : right + 1].any():
            taken[top:bottom, left:right] = True
            found.append((top, bottom, left, right))
    return found


def _join(tiles: NDArray[np.uint8], one: Room, other: Room, generator: np.random.Generator) -> None:
    """Draw a corridor of one tile with one bend between two rooms."""
    (row, column), (end_row, end_column) = _middle(one), _middle(other)
    bend = (row, end_column) if generator.integers(2) else (end_row, column)
    for a, b in (((row, column), bend), (bend, (end_row, end_column))):
        rows, columns = sorted((a[0], b[0])), sorted((a[1], b[1]))
        tiles[rows[0] : rows[1] + 1, columns[0] : columns[1] + 1] = _FREE_GREY


def _middle(room: Room) -> tuple[int, int]:
    top, bottom, left, right = room
    return (top + bottom) // 2, (left + right) // 2
