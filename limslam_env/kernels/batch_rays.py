"""The rays of the robots in a batch: what they meet, and which unseen cells they cross.

The rays of a robot are processed side by side: each has a *lane*, a column of some arrays. Loops
over lanes have no branches, so that the compiler takes several lanes at once.
"""

import math

import numpy as np
from numpy.typing import NDArray

from limslam_env.compilation import floored, merged
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.kernels.batch_state import Robots, Scratch, Worlds
from limslam_env.kernels.coverage import BODY_MARGIN, RAY_MARGIN, unseen_nearby, walk_disc, walk_ray
from limslam_env.kernels.random_numbers import Words
from limslam_env.kernels.rays import Walls, cast_at_discs, first_wall, meeting, nearest_in_cone
from limslam_env.kernels.readings import ANGLE, LONGEST_RANGE, NOTHING, OFFSET, ROBOT, is_due

MOST_LANES = 64
"""Largest number of lanes for which :func:`find_unseen` has bits."""

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_ALL = ~np.uint64(0)

# Cells, for rounding: a look for unseen cells may take in more cells than a ray crosses, but no
# less. It has to be far less than a ray's margin, or the cells behind walls would be looked at.
_LOOK_MARGIN = 1e-9

# Much more than the slack at the ends of walls, and than what rounding changes.
_DOUBT = 1e-8


@merged
def aim(
    fan: FloatArray,
    body_x: float,
    body_y: float,
    heading: float,
    aims: FloatArray,
    rays: FloatArray,
) -> None:
    """Set ``aims`` (4, lanes) to the origins x and y (m) of a robot's rays, and to the rays'
    directions.

    Also sets ``rays`` to rays that meet nothing. ``fan`` is that of
    :class:`limslam_env.kernels.batch_state.Robots`.
    """
    cos = math.cos(heading)
    sin = math.sin(heading)
    # Each loop has few rows: the compiler must check that they do not overlap, and gives up where
    # there are many.
    for lane in range(fan.shape[1]):
        rays[0, lane] = fan[3, lane]
        rays[1, lane] = NOTHING
    for lane in range(fan.shape[1]):
        aims[2, lane] = cos * fan[4, lane] - sin * fan[5, lane] + fan[6, lane]
    for lane in range(fan.shape[1]):
        aims[3, lane] = sin * fan[4, lane] + cos * fan[5, lane] + fan[6, lane]
    # The rim may touch a wall, and a ray from the rim could start behind the wall: rays start
    # inside the body.
    for lane in range(fan.shape[1]):
        aims[0, lane] = (
            body_x
            + fan[7, lane]
            + (cos * fan[0, lane] - sin * fan[1, lane])
            - fan[2, lane] * aims[2, lane]
        )
    for lane in range(fan.shape[1]):
        aims[1, lane] = (
            body_y
            + fan[7, lane]
            + (sin * fan[0, lane] + cos * fan[1, lane])
            - fan[2, lane] * aims[3, lane]
        )


@merged
def cast_fan(
    cell: int,
    first_edge: int,
    aims: FloatArray,
    edges: FloatArray,
    near_starts: IntArray,
    near_edges: NDArray[np.uint16],
    rays: FloatArray,
) -> None:
    """Shorten ``rays`` (4, lanes) to the lengths of a robot's rays, m, and set the walls that they
    hit.

    Lengths and walls are in the first two rows; the others are scratch memory.
    """
    half = 0
    for item in range(near_starts[cell], near_starts[cell + 1]):
        edge = first_edge + int(near_edges[item])
        x = edges[edge, 0]
        y = edges[edge, 1]
        ex = edges[edge, 2] - x
        ey = edges[edge, 3] - y
        which = float(edge)
        # What was nearest so far is read from one half of the rows and written to the other half:
        # the compiler would store some lanes only, and the next wall would have to wait for such a
        # store.
        start = 2 * half
        end = 2 - 2 * half
        doubt = 0
        half = 1 - half
        for lane in range(rays.shape[1]):
            # As ``meeting``, but a division takes longer than all the rest, and most need no second
            # one.
            ax = x - aims[0, lane]
            ay = y - aims[1, lane]
            dx = aims[2, lane]
            dy = aims[3, lane]
            cross = dx * ey - dy * ex
            across = ax * dy - ay * dx
            share = across if cross > 0.0 else -across
            whole = abs(cross)
            distance = (ax * ey - ay * ex) / cross
            nearest = rays[start, lane]
            is_met = (share >= 0.0) & (share <= whole)
            doubt |= (share >= -_DOUBT * whole) & (share <= whole + _DOUBT * whole) & (not is_met)
            is_met &= (distance >= 0.0) & (distance < nearest)
            rays[end + 1, lane] = which if is_met else rays[start + 1, lane]
            rays[end, lane] = distance if is_met else nearest
        if doubt:
            cast_at_end(edge, end, aims, edges, rays)
    if half == 1:
        for lane in range(rays.shape[1]):
            rays[0, lane], rays[1, lane] = rays[2, lane], rays[3, lane]


@merged
def cast_at_end(edge: int, row: int, aims: FloatArray, edges: FloatArray, rays: FloatArray) -> None:
    """:func:`cast_fan` for a wall that a ray passes very close to the end of."""
    x = edges[edge, 0]
    y = edges[edge, 1]
    ex = edges[edge, 2] - x
    ey = edges[edge, 3] - y
    for lane in range(rays.shape[1]):
        distance, is_met = meeting(
            x - aims[0, lane], y - aims[1, lane], ex, ey, aims[2, lane], aims[3, lane]
        )
        if is_met and distance < rays[row, lane]:
            rays[row, lane], rays[row + 1, lane] = distance, float(edge)


@merged
def find_unseen(
    env: int,
    unseen: Words,
    tile_columns: int,
    tile_rows: int,
    low_x: float,
    low_y: float,
    cell: float,
    aims: FloatArray,
    rays: FloatArray,
) -> np.uint64:
    """Where there are unseen cells around the rays of a robot: a bit for each lane.

    ``low_x`` and ``low_y`` (m) are the corner of the cells, ``cell`` (m) their side. A robot covers
    cells in this step, too: a ray may find none left where this function has found some.
    """
    per_metre = 1.0 / cell
    found = _NONE
    for lane in range(rays.shape[1]):
        from_x = (aims[0, lane] - low_x) * per_metre
        from_y = (aims[1, lane] - low_y) * per_metre
        end = rays[0, lane] * per_metre - RAY_MARGIN
        far_x = from_x + aims[2, lane] * end
        far_y = from_y + aims[3, lane] * end
        nearby = unseen_nearby(
            unseen,
            env,
            tile_columns,
            tile_rows,
            min(from_x, far_x) - _LOOK_MARGIN,
            min(from_y, far_y) - _LOOK_MARGIN,
            max(from_x, far_x) + _LOOK_MARGIN,
            max(from_y, far_y) + _LOOK_MARGIN,
        )
        found |= (_ONE if nearby != _NONE else _NONE) << np.uint64(lane)
    return found


@merged
def cast_on(
    robot: int,
    step: int,
    reaches_far: bool,
    robots: Robots,
    walls: Walls,
    poses: FloatArray,
    aims: FloatArray,
    rays: FloatArray,
) -> None:
    """Cast what :func:`cast_fan` did not: rays among walls that are not listed as near, and rays
    that meet robots.
    """
    for number in range(len(robots.beams)):
        if not is_due(robots.beams, number, step):
            continue
        x = aims[0, number]
        y = aims[1, number]
        dx = aims[2, number]
        dy = aims[3, number]
        if reaches_far:
            rays[0, number], rays[1, number] = first_wall(x, y, dx, dy, rays[0, number], walls)
        if len(poses) > 1:
            disc = cast_at_discs(x, y, dx, dy, rays[0, number], robot, poses, robots.radius)
            if disc < rays[0, number]:
                rays[0, number] = disc
                rays[1, number] = ROBOT


@merged
def cover(
    env: int,
    world: int,
    step: int,
    x: float,
    y: float,
    is_looked_for: bool,
    found: np.uint64,
    robots: Robots,
    worlds: Worlds,
    unseen: Words,
    scratch: Scratch,
) -> int:
    """Take what a robot at (x, y), m, and its rays see out of the unseen cells; returns how many
    cells there were.

    ``found`` has a bit for each beam, and one for the body: whether there may be unseen cells.
    ``is_looked_for`` is whether :func:`find_unseen` has set them.
    """
    beams = robots.beams
    aims = scratch.aims
    rays = scratch.rays
    low_x = worlds.areas[world, 0]
    low_y = worlds.areas[world, 1]
    cell = worlds.areas[world, 2]
    columns = worlds.layout[world, 4]
    rows = worlds.layout[world, 5]
    new = 0
    x = (x - low_x) / cell
    y = (y - low_y) / cell
    radius = (robots.radius - BODY_MARGIN) / cell
    # There may be more beams than bits if nothing was looked for.
    if not is_looked_for or (found >> np.uint64(len(beams))) & _ONE:
        new += walk_disc(unseen, env, columns, rows, x, y, radius)
    for number in range(len(beams)):
        if is_looked_for and not (found >> np.uint64(number)) & _ONE:
            continue
        if not is_due(beams, number, step):
            continue
        x = (aims[0, number] - low_x) / cell
        y = (aims[1, number] - low_y) / cell
        end = rays[0, number] / cell
        dx = aims[2, number]
        dy = aims[3, number]
        new += walk_ray(unseen, env, columns, rows, x, y, dx, dy, end - RAY_MARGIN)
    return new


@merged
def trace(
    env: int,
    robot: int,
    world: int,
    step: int,
    robots: Robots,
    worlds: Worlds,
    walls: Walls,
    poses: FloatArray,
    unseen: Words,
    scratch: Scratch,
) -> int:
    """Set the rays of a robot, and count the cells that it is the first to see.

    ``poses`` (m, 3) are those of its environment. Only the rays of beams that measure in this step
    are complete.
    """
    aims = scratch.aims
    rays = scratch.rays
    layout = worlds.layout
    x = poses[robot, 0]
    y = poses[robot, 1]
    near_cell = layout[world, 6]
    cell = worlds.areas[world, 2]
    aim(robots.fan, x, y, poses[robot, 2], aims, rays)
    if near_cell >= 0:
        column = min(max(floored((x - walls.low_x) / walls.side), 0), walls.columns - 1)
        row = min(max(floored((y - walls.low_y) / walls.side), 0), walls.rows - 1)
        listed = near_cell + row * walls.columns + column
        cast_fan(
            listed, layout[world, 0], aims, walls.edges, worlds.near_starts, worlds.near_edges, rays
        )
    is_looked_for = robots.is_small and near_cell >= 0
    found = _ALL
    if is_looked_for:
        found = find_unseen(
            env,
            unseen,
            layout[world, 4],
            layout[world, 5],
            worlds.areas[world, 0],
            worlds.areas[world, 1],
            cell,
            aims,
            rays,
        )
    if near_cell < 0 or len(poses) > 1:
        cast_on(robot, step, near_cell < 0, robots, walls, poses, aims, rays)
    return cover(env, world, step, x, y, is_looked_for, found, robots, worlds, unseen, scratch)


@merged
def widen(
    robot: int,
    step: int,
    cone: float,
    robots: Robots,
    walls: Walls,
    poses: FloatArray,
    scratch: Scratch,
) -> None:
    """Let each beam of a robot end at the nearest of what the rays of its cone meet
    (:func:`nearest_in_cone`).
    """
    beams = robots.beams
    aims = scratch.aims
    rays = scratch.rays
    for number in range(len(beams)):
        if not is_due(beams, number, step):
            continue
        offset = beams[number, OFFSET]
        reach = beams[number, LONGEST_RANGE] + beams[number, OFFSET]
        x = aims[0, number] + offset * aims[2, number]
        y = aims[1, number] + offset * aims[3, number]
        rays[0, number], rays[1, number] = nearest_in_cone(
            robot,
            rays[0, number],
            int(rays[1, number]),
            x,
            y,
            poses[robot, 2] + beams[number, ANGLE],
            offset,
            reach,
            cone,
            robots.radius,
            poses,
            walls,
        )
