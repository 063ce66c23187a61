"""A step of many environments at once, compiled.

Rays, readings and encoders are those of :mod:`limslam_env.kernels.rays`. Worlds lie in one set of arrays, each with its
first places in them.
"""

import math

import numpy as np

from limslam_env.geometry import BoolArray, FloatArray, IntArray, ReadingArray, se2
from limslam_env.kernels.contact import LONGEST_MOVE, separate
from limslam_env.kernels.random_numbers import GOLDEN, Words, mixed, normal, unit
from limslam_env.kernels.rays import (
    BODY_MARGIN,
    CONE,
    RAY_MARGIN,
    ROBOT,
    cast_at_discs,
    compiled,
    first_wall,
    inlined,
    meeting,
    merged,
    noisy_reading,
    reported_travel,
    turned,
)
from limslam_env.kernels.tiles import take_disc, take_ray

# numba's cache of this file notices changes of this file alone. So this names what the other ones were like; a test
# says what to write here when one of them has changed.
SOURCES = "17faac04f2771b4b"

SKIP, STEP, BEGIN = 0, 1, 2
"""What becomes of an environment: nothing, a step, or a new episode's first observation."""

NUM_NOISES = 14
"""Columns of the table of noise."""

_ONE = np.uint64(1)

arc_end = inlined(se2.arc_end)


@inlined
def lanes_of(count: int) -> int:
    """Places for so many beams when four are worked on at once."""
    return (count + 3) // 4 * 4


@merged
def aim(beams: FloatArray, body_x: float, body_y: float, cos: float, sin: float, aims: FloatArray) -> None:
    """Set ``aims`` (4, lanes) to where the rays of a robot start, x and y (m), and to their directions."""
    # The rim may touch a wall, and a ray from there start behind it: rays start inside the body.
    for number in range(len(beams)):
        dx, dy = turned(beams[number, 7], beams[number, 8], cos, sin)
        rim_x, rim_y = turned(beams[number, 0], beams[number, 1], cos, sin)
        aims[0, number] = body_x + rim_x - beams[number, 3] * dx
        aims[1, number] = body_y + rim_y - beams[number, 3] * dy
        aims[2, number], aims[3, number] = dx, dy


@merged
def cast_fan(
    cell: int,
    beams: FloatArray,
    aims: FloatArray,
    edges: FloatArray,
    near_starts: IntArray,
    near_edges: IntArray,
    rays: FloatArray,
) -> None:
    """Set ``rays`` (2, lanes) to how far a robot's rays get, m, and to the wall that they hit, or -1."""
    for number in range(len(beams)):
        rays[0, number], rays[1, number] = beams[number, 5] + beams[number, 3], -1.0
    for item in range(near_starts[cell], near_starts[cell + 1]):
        edge = near_edges[item]
        ex, ey = edges[edge, 2] - edges[edge, 0], edges[edge, 3] - edges[edge, 1]
        from_x, from_y, which = edges[edge, 0], edges[edge, 1], float(edge)
        # No branches: the compiler takes several rays at once.
        for lane in range(rays.shape[1]):
            distance, is_met = meeting(
                from_x - aims[0, lane], from_y - aims[1, lane], ex, ey, aims[2, lane], aims[3, lane]
            )
            is_met &= distance < rays[0, lane]
            rays[0, lane] = distance if is_met else rays[0, lane]
            rays[1, lane] = which if is_met else rays[1, lane]


@compiled
def advance(  # noqa: C901, PLR0912, PLR0915 (one loop: what is handed to a function costs as much as a ray)
    first: int,
    last: int,
    tasks: IntArray,
    actions: FloatArray,
    farthest: float,
    radius: float,
    beams: FloatArray,
    world_of: IntArray,
    layout: IntArray,
    grids: FloatArray,
    areas: FloatArray,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    near_starts: IntArray,
    near_edges: IntArray,
    coverable: Words,
    noise: FloatArray,
    keys: Words,
    steps: IntArray,
    rooms: FloatArray,
    poses: FloatArray,
    untold: FloatArray,
    left: Words,
    hits: IntArray,
    ranges: ReadingArray,
    wheels: ReadingArray,
    contact: BoolArray,
    new_cells: IntArray,
) -> None:
    """Drive, and take all measurements of, environments ``first`` to ``last`` - 1.

    Parameters
    ----------
    tasks
        (n,): ``SKIP``, ``STEP`` or ``BEGIN`` of each.
    actions
        (n, m, 2), left and right wheel speed of each robot, -1 to 1; the rest is clipped.
    farthest, radius
        Wheel travel at full speed, and of the bodies, m.
    beams
        As :func:`limslam_env.kernels.rays.observe` takes them.
    world_of
        (n,), the world of each.
    layout
        (w, 7): a world's first edge and cell in the lists, the cells' columns and rows, its tiles' columns and
        rows, and its first cell in the lists of near walls, or -1.
    grids, areas
        (w, 3), lower left corner x, y and cell side of the cell lists and of the coverage grids, m.
    edges, cell_starts, cell_edges
        The walls of all worlds, one after the other.
    near_starts, near_edges
        The walls that are within the beams' reach of each cell, in worlds where these are few.
    coverable
        (w, t), the tiles of each world.
    noise
        (n, 14): that of :func:`limslam_env.kernels.rays.observe`, rate and share of slips, and the axle, m.
    keys, steps, rooms, poses, untold, left, hits, ranges
        What is kept from step to step: (n,) key of the episode's random numbers, number of steps, room to drive in
        (m); (n, m, 3) poses; (n, m, 2) travel that encoders have not told (m); (n, t) tiles left to see; and
        (n, m, n_beams) walls hit and readings, m.
    wheels, contact, new_cells
        Set: (n, m, 2), what encoders say, m; (n, m), who touched something; and (n, m), cells seen first.
    """
    # Numbers are taken out of the arrays one by one: a slice costs as much as a ray.
    num_robots, num_beams = poses.shape[1], len(beams)
    aims, rays = np.zeros((4, lanes_of(num_beams))), np.zeros((2, lanes_of(num_beams)))
    travel, carried, before = np.zeros((num_robots, 2)), np.zeros((num_robots, 2)), np.zeros((num_robots, 2))
    for env in range(first, last):
        task = tasks[env]
        if task == SKIP:
            continue
        world = world_of[env]
        first_edge, first_cell = layout[world, 0], layout[world, 1]
        columns, rows, tile_columns, tile_rows = (
            layout[world, 2], layout[world, 3], layout[world, 4], layout[world, 5],
        )  # fmt: skip
        near_cell = layout[world, 6]
        low_x, low_y, side = grids[world, 0], grids[world, 1], grids[world, 2]
        area_x, area_y, cell = areas[world, 0], areas[world, 1], areas[world, 2]
        steps[env] = steps[env] + 1 if task == STEP else 0
        step = steps[env]
        state = keys[env] + (np.uint64(step) << np.uint64(24)) * GOLDEN
        if task == BEGIN:
            rooms[env] = 0.0
            for tile in range(coverable.shape[1]):
                left[env, tile] = coverable[world, tile]
        way = 0.0
        for robot in range(num_robots):
            contact[env, robot] = False
            for wheel in range(2):
                if task == BEGIN:
                    travel[robot, wheel] = untold[env, robot, wheel] = 0.0
                    continue
                turn = min(max(actions[env, robot, wheel], -1.0), 1.0) * farthest
                travel[robot, wheel] = carried[robot, wheel] = turn
                if noise[env, 11] > 0.0:
                    uniform = unit(mixed(state + np.uint64((robot << 20) + 2 * wheel + 1) * GOLDEN))
                    if uniform < -math.expm1(-noise[env, 11] * abs(turn)):
                        carried[robot, wheel] = turn * (1.0 - noise[env, 12])
            way = max(way, 0.5 * abs(carried[robot, 0] + carried[robot, 1]))
        if task == STEP:
            # A move of more than the radius could end beyond a wall; an arc in pieces is the same arc.
            parts = 1 if way <= LONGEST_MOVE * radius else math.ceil(way / (LONGEST_MOVE * radius))
            for _ in range(parts):
                for robot in range(num_robots):
                    before[robot, 0], before[robot, 1] = poses[env, robot, 0], poses[env, robot, 1]
                    poses[env, robot, 0], poses[env, robot, 1], poses[env, robot, 2] = arc_end(
                        before[robot, 0], before[robot, 1], poses[env, robot, 2],
                        carried[robot, 0] / parts, carried[robot, 1] / parts, noise[env, 13],
                    )  # fmt: skip
                # Others may come one's way.
                rooms[env] -= (1.0 if num_robots == 1 else 2.0) * way / parts
                if rooms[env] <= 0.0:
                    rooms[env] = separate(
                        poses[env], before, radius, contact[env],
                        edges, cell_starts, cell_edges, low_x, low_y, side, columns, rows, first_cell,
                    )  # fmt: skip
        for robot in range(num_robots):
            own = state + np.uint64(robot << 20) * GOLDEN
            body_x, body_y, heading = poses[env, robot, 0], poses[env, robot, 1], poses[env, robot, 2]
            cos, sin = math.cos(heading), math.sin(heading)
            new = take_disc(
                left, env, tile_columns, tile_rows,
                (body_x - area_x) / cell, (body_y - area_y) / cell, (radius - BODY_MARGIN) / cell,
            )  # fmt: skip
            aim(beams, body_x, body_y, cos, sin, aims)
            if near_cell >= 0:
                column = min(max(math.floor((body_x - low_x) / side), 0), columns - 1)
                row = min(max(math.floor((body_y - low_y) / side), 0), rows - 1)
                cast_fan(near_cell + row * columns + column, beams, aims, edges, near_starts, near_edges, rays)
            for number in range(num_beams):
                if beams[number, 6] != 1.0 and step % int(beams[number, 6]) != 0:
                    continue
                offset, longest = beams[number, 3], beams[number, 5]
                x, y, dx, dy = aims[0, number], aims[1, number], aims[2, number], aims[3, number]
                distance, hit = rays[0, number], int(rays[1, number])
                if near_cell < 0:
                    distance, hit = first_wall(
                        x, y, dx, dy, longest + offset,
                        edges, cell_starts, cell_edges, low_x, low_y, side, columns, rows, first_cell,
                    )  # fmt: skip
                if num_robots > 1:
                    disc = cast_at_discs(x, y, dx, dy, distance, robot, poses[env], radius)
                    if disc < distance:
                        distance, hit = disc, ROBOT
                new += take_ray(
                    left, env, tile_columns, tile_rows,
                    (x - area_x) / cell, (y - area_y) / cell, dx, dy, distance / cell - RAY_MARGIN,
                )  # fmt: skip
                if noise[env, 5] > 0.0:
                    angle, reach = heading + beams[number, 2], longest + offset
                    rim_x, rim_y = x + offset * dx, y + offset * dy
                    for share in CONE:
                        dx, dy = math.cos(angle + share * noise[env, 5]), math.sin(angle + share * noise[env, 5])
                        x, y = rim_x - offset * dx, rim_y - offset * dy
                        aside, other = first_wall(
                            x, y, dx, dy, reach,
                            edges, cell_starts, cell_edges, low_x, low_y, side, columns, rows, first_cell,
                        )  # fmt: skip
                        if num_robots > 1:
                            disc = cast_at_discs(x, y, dx, dy, aside, robot, poses[env], radius)
                            if disc < aside:
                                aside, other = disc, ROBOT
                        if aside < distance:
                            distance, hit = aside, other
                place = np.uint64(2 * number + 4)
                random, uniform = 0.0, 1.0
                if noise[env, 0] > 0.0 or noise[env, 1] > 0.0:
                    random = normal(mixed(own + place * GOLDEN))
                if noise[env, 2] > 0.0:
                    uniform = unit(mixed(own + (place + _ONE) * GOLDEN))
                hits[env, robot, number] = hit - first_edge if hit >= 0 else hit
                ranges[env, robot, number] = noisy_reading(
                    distance - offset, hit, beams[number, 4], longest,
                    noise[env, 0], noise[env, 1], noise[env, 2], noise[env, 3], noise[env, 4], random, uniform,
                )  # fmt: skip
            new_cells[env, robot] = new
            for wheel in range(2):
                random = 0.0
                if travel[robot, wheel] != 0.0 and noise[env, 8] > 0.0:
                    random = normal(mixed(own + np.uint64(2 * wheel) * GOLDEN))
                wheels[env, robot, wheel], untold[env, robot, wheel] = reported_travel(
                    travel[robot, wheel], untold[env, robot, wheel],
                    noise[env, 6 + wheel], noise[env, 8], noise[env, 9], noise[env, 10], random,
                )  # fmt: skip
