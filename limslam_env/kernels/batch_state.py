"""The arrays that the step of a batch works on, for n environments with m robots each in w
worlds.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from limslam_env.geometry import BoolArray, FloatArray, IntArray, ReadingArray
from limslam_env.kernels.random_numbers import Words
from limslam_env.kernels.readings import FROM_X, FROM_Y, LONGEST_RANGE, OFFSET, TOWARDS_X, TOWARDS_Y

LANES = 4
"""Number of rays that the compiler processes at once."""


class Robots(NamedTuple):
    """What all robots are.

    Attributes
    ----------
    wheel_travel, radius
        Travel of a wheel in one step at an action of 1, and radius of the body, m.
    beams, fan
        (n_beams, 12), see :mod:`limslam_env.kernels.readings`; and (8, lanes), as :func:`fan_of`
        makes it of them.
    is_small
        Whether :func:`limslam_env.kernels.batch_rays.find_unseen` can look at the body and at the
        beams.
    """

    wheel_travel: float
    radius: float
    beams: FloatArray
    fan: FloatArray
    is_small: bool


class Worlds(NamedTuple):
    """All worlds of a batch; the walls of one world follow those of another.

    Attributes
    ----------
    layout
        (w, 7): a world's first edge and first cell in the lists, the columns and rows of its cells,
        the columns and rows of its tiles, and its first cell in the lists of near walls, or -1 if
        it has none.
    grids, areas
        (w, 3): lower left corner x, y and cell side of the grid of walls and of the coverage grid,
        m.
    edges, cell_starts, cell_edges
        Walls sorted into cells (:class:`limslam_env.kernels.rays.Walls`).
    near_starts, near_edges
        The walls within the beams' reach of each cell, in worlds where these walls are few; counted
        from the world's first edge, in two bytes each, since they are most of a world's memory.
    coverable, totals
        (w, t): the coverable cells of each world as tiles (:mod:`limslam_env.kernels.coverage`);
        (w,): how many.
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
    totals: IntArray


class Episodes(NamedTuple):
    """The running episodes: what is kept from step to step.

    Attributes
    ----------
    world_of, keys, steps
        (n,): the world of each environment, the key of its episode's random numbers, and the number
        of steps so far.
    noise
        (n, 14), see :mod:`limslam_env.kernels.readings`.
    clearances
        (n,), distance that the robots can travel, all told, before one of them may touch something,
        m.
    poses, contact
        (n, m, 3), m and rad; and which robots touched something (n, m).
    wheels, unreported
        (n, m, 2): wheel travel that the encoders report, and what they have not reported so far, m.
    unseen, covered
        Tiles with the coverable cells that have not been seen (n, t), and how many have been seen
        (n,).
    hits, ranges
        (n, m, n_beams): the wall that each beam hit, and its reading, m. Beams that do not measure
        keep theirs.
    """

    world_of: IntArray
    noise: FloatArray
    keys: Words
    steps: IntArray
    clearances: FloatArray
    poses: FloatArray
    unreported: FloatArray
    unseen: Words
    covered: IntArray
    hits: IntArray
    ranges: ReadingArray
    wheels: ReadingArray
    contact: BoolArray


class Task(NamedTuple):
    """What a step is worth, and when an episode ends.

    Attributes
    ----------
    new_area, step, collision
        The weights of :class:`limslam_env.config.RewardConfig`.
    goal, max_steps
        Coverage at which an episode terminates, more than 1 if it never does; steps after which it
        is truncated.
    control_period
        Duration of a step, s.
    """

    new_area: float
    step: float
    collision: float
    goal: float
    max_steps: int
    control_period: float


class Results(NamedTuple):
    """What a step hands out, in new arrays: readings, rewards, ends, and the fields of
    ``simulation.Truth``.

    Attributes
    ----------
    ranges, wheels
        (n, m, n_beams) and (n, m, 2), float32, m.
    poses, contact, wall_seen
        (n, m, 3), m and rad; (n, m); (n, m, n_beams).
    time, coverage
        (n,): s, and 0 to 1.
    rewards, terminated, truncated
        (n, m), (n,) and (n,); 0 and False without a step.
    """

    ranges: ReadingArray
    wheels: ReadingArray
    poses: FloatArray
    time: FloatArray
    coverage: FloatArray
    contact: BoolArray
    wall_seen: IntArray
    rewards: FloatArray
    terminated: BoolArray
    truncated: BoolArray


class Settings(NamedTuple):
    """What the noise of episodes is drawn from.

    Attributes
    ----------
    lowest, spans, places
        (14,): the least value of each column of :mod:`limslam_env.kernels.readings`, how much
        larger it may be, and which of an environment's random numbers it depends on.
    """

    lowest: FloatArray
    spans: FloatArray
    places: IntArray


class Starts(NamedTuple):
    """Where robots start in w worlds.

    Attributes
    ----------
    given, num_given
        (w, m, 3): known poses, m and rad; and how many of them there are (w,).
    runs, firsts, counts, spaces
        The free cells as :func:`limslam_env.kernels.random_numbers.draw_start` takes them: the runs
        (r, 2) of one world after those of another and a world's first run (w + 1,), the number of
        cells (w,), and their grids (w, 4).
    apart
        Least distance of two robots, m.
    """

    given: FloatArray
    num_given: IntArray
    runs: IntArray
    counts: IntArray
    spaces: FloatArray
    firsts: IntArray
    apart: float


class Scratch(NamedTuple):
    """Memory for one environment at a time.

    Attributes
    ----------
    aims
        (4, lanes): where the rays of a robot start, x and y (m), and their directions.
    rays
        (4, lanes): lengths of the rays, m, and the walls that they hit, or -1; two more rows to
        work with.
    turned, travel, before
        (m, 2): how far each wheel turned, and how far it moved on the floor, m, which is less where
        it slipped; and positions before the latest move, m.
    deep, new_cells
        (m,): which robots overlap something too far, and how many coverable cells each was the
        first to see.
    """

    aims: FloatArray
    rays: FloatArray
    turned: FloatArray
    travel: FloatArray
    before: FloatArray
    deep: BoolArray
    new_cells: IntArray


def scratch_for(num_robots: int, num_beams: int) -> Scratch:
    """Scratch memory for environments of a number of robots with a number of beams."""
    lanes = lanes_for(num_beams)
    turned, travel, before = (np.zeros((num_robots, 2)) for _ in range(3))
    deep = np.zeros(num_robots, dtype=bool)
    new_cells = np.zeros(num_robots, dtype=np.int64)
    return Scratch(
        np.zeros((4, lanes)), np.zeros((4, lanes)), turned, travel, before, deep, new_cells
    )


def lanes_for(num_beams: int) -> int:
    """Number of lanes for a number of beams and the body."""
    return (num_beams + LANES) // LANES * LANES


def fan_of(beams: FloatArray, radius: float) -> FloatArray:
    """The beams (n_beams, 12) lane by lane, and in the other lanes a ray in the diagonal of a
    body's box.

    Rows (8, lanes): origin x and y (m) in the robot's frame, how far before it the ray starts, and
    its length, m; the direction in the robot's frame, what is added to its x and y in the world's
    frame, and to those of the origin, m. The diagonal has a negative length, from the upper right
    to the lower left: walls do not shorten it.
    """
    fan = np.zeros((8, lanes_for(len(beams))))
    count = len(beams)
    fan[0, :count] = beams[:, FROM_X]
    fan[1, :count] = beams[:, FROM_Y]
    fan[2, :count] = beams[:, OFFSET]
    fan[3, :count] = beams[:, LONGEST_RANGE] + beams[:, OFFSET]
    fan[4, :count] = beams[:, TOWARDS_X]
    fan[5, :count] = beams[:, TOWARDS_Y]
    fan[3, count:] = -2.0 * radius
    fan[6, count:] = 1.0
    fan[7, count:] = radius
    return fan
