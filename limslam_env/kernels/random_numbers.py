"""Random numbers for many environments: each number is a function of its environment's key and of a
counter.

The generator has no state. A number that no noise needs can be skipped without changing any other
number.
"""

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from limslam_env.compilation import compiled, entry, inlined, lean_entry, merged
from limslam_env.geometry import FloatArray, IntArray

Words: TypeAlias = NDArray[np.uint64]

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
"""Increment between two states of the sequence."""

_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S11 = np.uint64(11)
_S27 = np.uint64(27)
_S30 = np.uint64(30)
_S31 = np.uint64(31)
_ONE = np.uint64(1)
_LAYER = np.uint64(127)
_UNIT = 2.0**-53

# The ziggurat: where its layers and its tail begin, and the area of each.
_NUM_LAYERS = 128
_TAIL = 3.442619855899
_VOLUME = 9.91256303526217e-3


def _layer_edges() -> FloatArray:
    edges = np.zeros(_NUM_LAYERS + 1)
    density = math.exp(-0.5 * _TAIL * _TAIL)
    edges[0] = _VOLUME / density
    edges[1] = _TAIL
    for layer in range(2, _NUM_LAYERS):
        density += _VOLUME / edges[layer - 1]
        edges[layer] = math.sqrt(-2.0 * math.log(density))
    return edges


_EDGES = _layer_edges()
_RATIOS = _EDGES[1:] / _EDGES[:-1]


@inlined
def mixed(state: np.uint64) -> np.uint64:
    """64 random bits from a number of a sequence: splitmix64 (Steele, Lea and Flood, 2014)."""
    state = (state ^ (state >> _S30)) * _MIX_1
    state = (state ^ (state >> _S27)) * _MIX_2
    return state ^ (state >> _S31)


@inlined
def unit(bits: np.uint64) -> float:
    """A number from U(0, 1) of random bits; 1 is left out."""
    number: float = float(bits >> _S11) * _UNIT
    return number


@merged
def normal(bits: np.uint64) -> float:
    """A number from N(0, 1) of random bits, exactly.

    The ziggurat of 128 layers, after Doornik, "An improved ziggurat method to generate normal
    random samples" (2005).
    """
    layer = bits & _LAYER
    share = 2.0 * unit(bits) - 1.0
    if abs(share) < _RATIOS[layer]:
        place: float = share * _EDGES[layer]
        return place
    return _rare_normal(bits)


@compiled
def _rare_normal(bits: np.uint64) -> float:
    """:func:`normal`, for one number in eighty; further bits that it needs are mixed from the
    first.
    """
    while True:
        layer = bits & _LAYER
        share = 2.0 * unit(bits) - 1.0
        place: float = share * _EDGES[layer]
        if abs(share) < _RATIOS[layer]:
            return place
        bits = mixed(bits + GOLDEN)
        if layer == 0:
            break
        outer = math.exp(-0.5 * (_EDGES[layer] * _EDGES[layer] - place * place))
        inner = math.exp(-0.5 * (_EDGES[layer + _ONE] * _EDGES[layer + _ONE] - place * place))
        if inner + unit(bits) * (outer - inner) < 1.0:
            return place
        bits = mixed(bits + GOLDEN)
    while True:
        beyond = -math.log(1.0 - unit(bits)) / _TAIL
        bits = mixed(bits + GOLDEN)
        height = -math.log(1.0 - unit(bits))
        bits = mixed(bits + GOLDEN)
        if 2.0 * height > beyond * beyond:
            return math.copysign(_TAIL + beyond, share)


@inlined
def derived(home: np.uint64, episode: int, purpose: int) -> np.uint64:
    """The key of random numbers for one purpose in an episode of an environment with a key."""
    return mixed(mixed(home + np.uint64(episode) * GOLDEN) + np.uint64(purpose) * GOLDEN)


@inlined
def chosen(key: np.uint64, count: int) -> np.int64:
    """Which of so many things a key chooses."""
    return np.int64((key >> _S11) % np.uint64(count))


@entry
def derive_keys(homes: Words, episodes: IntArray, purpose: int) -> Words:
    """Keys (n,) of random numbers for one purpose in episodes (n,) of environments with keys
    ``homes`` (n,).
    """
    keys = np.empty_like(homes)
    for row in range(len(homes)):
        keys[row] = derived(homes[row], episodes[row], purpose)
    return keys


@merged
def draw_row(
    key: np.uint64, lowest: FloatArray, spans: FloatArray, places: IntArray, numbers: FloatArray
) -> None:
    """Set ``numbers`` (k,) to numbers from U(``lowest``, ``lowest + spans``), all (k,).

    ``places`` (k,) are those of the random numbers in the sequence of the key; equal ones give the
    same random number.
    """
    for column in range(len(numbers)):
        share = unit(mixed(key + np.uint64(places[column] + 1) * GOLDEN))
        numbers[column] = lowest[column] + spans[column] * share


@lean_entry
def draw_rows(
    keys: Words, lowest: FloatArray, spans: FloatArray, places: IntArray, numbers: FloatArray
) -> None:
    """:func:`draw_row` for each row of ``numbers`` (n, k), by its key (n,)."""
    for number in range(len(keys)):
        draw_row(keys[number], lowest, spans, places, numbers[number])


class FreeCells(NamedTuple):
    """The cells in which robots may start.

    Attributes
    ----------
    runs
        (r, 2): the number of the first of some cells side by side, and how many cells come before
        it.
    number
        Number of the cells.
    space
        Lower left corner x, y and side of the cells, m, and number of columns of their grid (4,).
    """

    runs: IntArray
    number: int
    space: FloatArray


@merged
def draw_start(
    key: np.uint64,
    num_given: int,
    cells: FreeCells,
    apart: float,
    poses: FloatArray,
    tries: int,
) -> bool:
    """Put robots from the ``num_given``-th on at random free cells; returns whether there was
    enough space.

    Robots are ``apart`` (m) at least. Of ``poses`` (m, 3), m and rad, those that are given are set
    already. For all robots together so many places are tried.
    """
    runs = cells.runs
    count = cells.number
    space = cells.space
    columns = int(space[3])
    state = key
    placed = num_given
    for _ in range(tries):
        if placed == len(poses) or count == 0:
            break
        place = int(unit(mixed(state + GOLDEN)) * count)
        run = 0
        end = len(runs)
        while end - run > 1:
            middle = (run + end) // 2
            run, end = (middle, end) if runs[middle, 1] <= place else (run, middle)
        cell = int(runs[run, 0]) + place - int(runs[run, 1])
        heading = (2.0 * unit(mixed(state + GOLDEN + GOLDEN)) - 1.0) * math.pi
        state = state + GOLDEN + GOLDEN
        x = space[0] + (cell % columns + 0.5) * space[2]
        y = space[1] + (cell // columns + 0.5) * space[2]
        is_free = True
        for other in range(placed):
            is_free &= math.hypot(poses[other, 0] - x, poses[other, 1] - y) > apart
        if is_free:
            poses[placed, 0] = x
            poses[placed, 1] = y
            poses[placed, 2] = heading
            placed += 1
    return placed == len(poses)


@lean_entry
def draw_starts(
    keys: Words,
    num_given: int,
    cells: FreeCells,
    apart: float,
    poses: FloatArray,
    tries: int,
) -> bool:
    """:func:`draw_start` for environments with keys (n,) and poses (n, m, 3); returns whether all
    had enough space.
    """
    for env in range(len(keys)):
        if not draw_start(keys[env], num_given, cells, apart, poses[env], tries):
            return False
    return True
