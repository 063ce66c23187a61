"""The arrays that the step of a batch works on, for n environments with m robots each in w worlds."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from limslam_env.geometry import BoolArray, FloatArray, IntArray, ReadingArray
from limslam_env.kernels.random_numbers import Words

LANES = 4
"""Number of rays that the compiler processes at once."""


class Robots(NamedTuple):
    """What all robots are.

    Attributes
    ----------
    wheel_travel
        Travel of a wheel in one step at an action of 1, m.
    radius
        Radius of the body, m.
    beams
        (n_beams, 9), as :func:`limslam_env.kernels.observation.observe` takes them.
    is_small
        Whether :func:`limslam_env.kernels.tiles.unseen_nearby` can look at the body and at each beam at once.
    """

    wheel_travel: float
    radius: float
    beams: FloatArray
    is_small: bool


class Worlds(NamedTuple):
    """All worlds of a batch; the walls of one world follow those of another.

    Attributes
    ----------
    layout
        (w, 7): a world's first edge and first cell in the lists, the columns and rows of its cells, the columns and
        rows of its tiles, and its first cell in the lists of near walls, or -1 if it has none.
    grids, areas
        (w, 3): lower left corner x, y and cell side of the grid of walls and of the coverage grid, m.
    edges, cell_starts, cell_edges
        Walls sorted into cells (:class:`limslam_env.kernels.wall_cells.Walls`).
    near_starts, near_edges
        The walls within the beams' reach of each cell, in worlds where these walls are few; counted from the world's
        first edge, in two bytes each, since they are most of a world's memory.
    coverable
        (w, t): the coverable cells of each world as tiles (:mod:`limslam_env.kernels.tiles`).
    """

    layout: IntArray
    grids: FloatArray
    areas: FloatArray
    edges: FloatArray
    cell_starts: IntArray
    cell_edges: IntArray
    near_starts: IntArray
    near_edges: NDArray[np.uint16]
    coverable: Words


class Episodes(NamedTuple):
    """The running episodes: what is kept from step to step.

    Attributes
    ----------
    world_of
        (n,), the world of each environment.
    noise
        (n, 14): the noise as :func:`limslam_env.kernels.observation.observe` takes it, then rate and share of slips,
        and the distance between the wheels, m.
    keys
        (n,), keys of the episodes' random numbers.
    steps
        (n,), number of steps so far.
    clearances
        (n,), distance that the robots can travel, all told, before one of them may touch something, m.
    poses
        (n, m, 3), m and rad.
    unreported
        (n, m, 2), wheel travel that the encoders have not reported so far, m.
    unseen
        (n, t), tiles with the coverable cells that have not been seen.
    """

    world_of: IntArray
    noise: FloatArray
    keys: Words
    steps: IntArray
    clearances: FloatArray
    poses: FloatArray
    unreported: FloatArray
    unseen: Words


class Measurements(NamedTuple):
    """What a step measures.

    Attributes
    ----------
    hits, ranges
        (n, m, n_beams): the wall that each beam hit, and its reading, m. Beams that do not measure keep theirs.
    wheels
        (n, m, 2): wheel travel that the encoders report, m.
    contact
        (n, m): which robots touched something.
    new_cells
        (n, m): number of coverable cells that each robot was the first to see.
    """

    hits: IntArray
    ranges: ReadingArray
    wheels: ReadingArray
    contact: BoolArray
    new_cells: IntArray


class Scratch(NamedTuple):
    """Memory for one environment at a time.

    Attributes
    ----------
    aims
        (4, lanes): where the rays of a robot start, x and y (m), and their directions.
    rays
        (2, lanes): lengths of the rays, m, and the walls that they hit, or -1.
    turned, travel
        (m, 2): how far each wheel turned, and how far it moved on the floor, m. Slips make the difference.
    before
        (m, 2): positions before the latest move, m.
    deep
        (m,): which robots overlap something too far.
    found
        (n_beams + 1,): whether there are unseen cells around each beam and around the body.
    """

    aims: FloatArray
    rays: FloatArray
    turned: FloatArray
    travel: FloatArray
    before: FloatArray
    deep: BoolArray
    found: Words


def scratch_for(num_robots: int, num_beams: int) -> Scratch:
    """Scratch memory for environments of a number of robots with a number of beams."""
    lanes = (num_beams + LANES - 1) // LANES * LANES
    turned, travel, before = (np.zeros((num_robots, 2)) for _ in range(3))
    deep, found = np.zeros(num_robots, dtype=bool), np.zeros(num_beams + 1, dtype=np.uint64)
    return Scratch(np.zeros((4, lanes)), np.zeros((2, lanes)), turned, travel, before, deep, found)
