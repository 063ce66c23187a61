"""The rays of the robots in a batch: what they meet, and which unseen cells they cross.

The rays of a robot are processed side by side: each has a *lane*, a column of some arrays. Loops
over lanes have no branches, so that the compiler takes several lanes at once.
"""

import math

import numpy as np
from numpy.typing import NDArray

from limslam_env.compilation import floored, inlined, merged
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.kernels.batch_state import Episodes, Robots, Scratch, Worlds
from limslam_env.kernels.coverage import RAY_MARGIN, TileGrid, unseen_nearby, walk_disc, walk_ray
from limslam_env.kernels.rays import (
    Cone,
    Discs,
    Ray,
    Walls,
    cast_at_discs,
    first_wall,
    meeting,
    nearest_in_cone,
)
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
def find_unseen(grid: TileGrid, aims: FloatArray, rays: FloatArray) -> np.uint64:
    """Where there are unseen cells around the rays of a robot: a bit for each lane.

    A robot covers cells in this step, too: a ray may find none left where this function has found
    some.
    """
    per_metre = 1.0 / grid.cell
    found = _NONE
    for lane in range(rays.shape[1]):
        from_x = (aims[0, lane] - grid.low_x) * per_metre
        from_y = (aims[1, lane] - grid.low_y) * per_metre
        end = rays[0, lane] * per_metre - RAY_MARGIN
        far_x = from_x + aims[2, lane] * end
        far_y = from_y + aims[3, lane] * end
        nearby = unseen_nearby(
            grid,
            min(from_x, far_x) - _LOOK_MARGIN,
            min(from_y, far_y) - _LOOK_MARGIN,
            max(from_x, far_x) + _LOOK_MARGIN,
            max(from_y, far_y) + _LOOK_MARGIN,
        )
        found |= (_ONE if nearby != _NONE else _NONE) << np.uint64(lane)
    return found


@inlined
def ray_of(scratch: Scratch, number: int) -> Ray:
    """The ray of a beam, as long as it is known to be free so far."""
    aims = scratch.aims
    return Ray(
        aims[0, number],
        aims[1, number],
        aims[2, number],
        aims[3, number],
        scratch.rays[0, number],
    )


@merged
def cast_on(
    step: int, reaches_far: bool, robots: Robots, walls: Walls, discs: Discs, scratch: Scratch
) -> None:
    """Cast what :func:`cast_fan` did not: rays among walls that are not listed as near, and rays
    that meet robots.
    """
    rays = scratch.rays
    for number in range(len(robots.beams)):
        if not is_due(robots.beams, number, step):
            continue
        if reaches_far:
            ray = ray_of(scratch, number)
            rays[0, number], rays[1, number] = first_wall(ray, walls)
        if len(discs.poses) > 1:
            disc = cast_at_discs(ray_of(scratch, number), discs)
            if disc < rays[0, number]:
                rays[0, number] = disc
                rays[1, number] = ROBOT


@merged
def cover(
    grid: TileGrid,
    step: int,
    discs: Discs,
    is_looked_for: bool,
    found: np.uint64,
    robots: Robots,
    scratch: Scratch,
) -> int:
    """Take what a robot, the owner of the rays, sees out of the unseen cells; returns how many
    cells there were.

    ``found`` has a bit for each beam, and one for the body: whether there may be unseen cells.
    ``is_looked_for`` is whether :func:`find_unseen` has set them.
    """
    new = 0
    # There may be more beams than bits if nothing was looked for.
    if not is_looked_for or (found >> np.uint64(len(robots.beams))) & _ONE:
        x = discs.poses[discs.owner, 0]
        y = discs.poses[discs.owner, 1]
        new += walk_disc(grid, x, y, robots.radius)
    for number in range(len(robots.beams)):
        if is_looked_for and not (found >> np.uint64(number)) & _ONE:
            continue
        if not is_due(robots.beams, number, step):
            continue
        new += walk_ray(grid, ray_of(scratch, number))
    return new


@merged
def trace(
    env: int,
    robot: int,
    robots: Robots,
    worlds: Worlds,
    walls: Walls,
    episodes: Episodes,
    scratch: Scratch,
) -> int:
    """Set the rays of a robot, and count the cells that it is the first to see.

    Only the rays of beams that measure in this step are complete.
    """
    aims = scratch.aims
    rays = scratch.rays
    world = episodes.world_of[env]
    layout = worlds.layout
    areas = worlds.areas
    discs = Discs(robot, episodes.poses[env], robots.radius)
    x = discs.poses[robot, 0]
    y = discs.poses[robot, 1]
    near_cell = layout[world, 6]
    aim(robots.fan, x, y, discs.poses[robot, 2], aims, rays)
    if near_cell >= 0:
        column = min(max(floored((x - walls.low_x) / walls.side), 0), walls.columns - 1)
        row = min(max(floored((y - walls.low_y) / walls.side), 0), walls.rows - 1)
        listed = near_cell + row * walls.columns + column
        cast_fan(
            listed, layout[world, 0], aims, walls.edges, worlds.near_starts, worlds.near_edges, rays
        )
    grid = TileGrid(
        episodes.unseen,
        env,
        layout[world, 4],
        layout[world, 5],
        areas[world, 0],
        areas[world, 1],
        areas[world, 2],
    )
    is_looked_for = robots.is_small and near_cell >= 0
    found = _ALL
    if is_looked_for:
        found = find_unseen(grid, aims, rays)
    step = episodes.steps[env]
    if near_cell < 0 or len(discs.poses) > 1:
        cast_on(step, near_cell < 0, robots, walls, discs, scratch)
    return cover(grid, step, discs, is_looked_for, found, robots, scratch)


@merged
def widen(
    step: int, half_angle: float, robots: Robots, walls: Walls, discs: Discs, scratch: Scratch
) -> None:
    """Let each beam of a robot end at the nearest of what the rays of its cone meet
    (:func:`nearest_in_cone`).
    """
    beams = robots.beams
    aims = scratch.aims
    rays = scratch.rays
    heading = discs.poses[discs.owner, 2]
    for number in range(len(beams)):
        if not is_due(beams, number, step):
            continue
        offset = beams[number, OFFSET]
        cone = Cone(
            aims[0, number] + offset * aims[2, number],
            aims[1, number] + offset * aims[3, number],
            heading + beams[number, ANGLE],
            half_angle,
            offset,
            beams[number, LONGEST_RANGE] + offset,
        )
        rays[0, number], rays[1, number] = nearest_in_cone(
            cone, rays[0, number], int(rays[1, number]), discs, walls
        )
