"""A step of many environments at once.

Rays, readings and encoders are those of the single environment.
"""

import math
from typing import NamedTuple

import numpy as np

from limslam_env.compilation import entry, inlined, merged
from limslam_env.geometry import FloatArray, IntArray, ReadingArray, se2
from limslam_env.kernels.batch_state import Episodes, Measurements, Robots, Scratch, Worlds
from limslam_env.kernels.contact import LONGEST_MOVE, separate
from limslam_env.kernels.coverage import BODY_MARGIN, RAY_MARGIN
from limslam_env.kernels.observation import CONE
from limslam_env.kernels.random_numbers import GOLDEN, mixed, normal, unit
from limslam_env.kernels.rays import ROBOT, cast_at_discs, first_wall, measure, meeting, turned
from limslam_env.kernels.readings import noisy_reading, reported_travel
from limslam_env.kernels.tiles import take_disc, take_ray
from limslam_env.kernels.wall_cells import Walls

SKIP, STEP, BEGIN = 0, 1, 2
"""What an environment does: nothing, a step, or the first observation of a new episode."""

NUM_NOISES = 14
"""Columns of the table of noise."""

_ONE = np.uint64(1)

arc_end = inlined(se2.arc_end)


@inlined
def lanes_of(count: int) -> int:
    """Places for a number of beams when four beams are processed at once."""
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


class Place(NamedTuple):
    """Numbers of one environment's world.

    Numbers cost nothing to hand on, while each array that is taken out of a tuple is counted as a reference.

    Attributes
    ----------
    low_x, low_y, side, columns, rows, first_cell
        The grid of its walls' cells (:class:`limslam_env.kernels.wall_cells.Walls`).
    area_x, area_y, cell, tile_columns, tile_rows
        Its coverage grid: lower left corner and cell side, m, and its size in tiles.
    first_edge, near_cell
        Its first wall, and its first cell in the lists of near walls, or -1.
    """

    low_x: float
    low_y: float
    side: float
    columns: int
    rows: int
    first_cell: int
    area_x: float
    area_y: float
    cell: float
    tile_columns: int
    tile_rows: int
    first_edge: int
    near_cell: int


@inlined
def place_of(layout: IntArray, grids: FloatArray, areas: FloatArray, world: int) -> Place:
    """The numbers of a world."""
    return Place(
        grids[world, 0], grids[world, 1], grids[world, 2], layout[world, 2], layout[world, 3], layout[world, 1],
        areas[world, 0], areas[world, 1], areas[world, 2], layout[world, 4], layout[world, 5],
        layout[world, 0], layout[world, 6],
    )  # fmt: skip


@inlined
def walls_at(place: Place, edges: FloatArray, cell_starts: IntArray, cell_edges: IntArray) -> Walls:
    """The walls of a place."""
    return Walls(
        edges, cell_starts, cell_edges, place.low_x, place.low_y, place.side, place.columns, place.rows,
        place.first_cell,
    )  # fmt: skip


@inlined
def turn_wheels(
    env: int,
    state: np.uint64,
    actions: FloatArray,
    most: float,
    noise: FloatArray,
    turns: FloatArray,
    travel: FloatArray,
) -> float:
    """Set how far the wheels turn and how far they travel, both (m, 2), m; returns the longest way of a robot, m.

    ``most`` (m) is a wheel's travel at an action of 1. Slips are those of ``simulation.odometry``.
    """
    longest = 0.0
    for robot in range(len(travel)):
        for wheel in range(2):
            turn = min(max(actions[env, robot, wheel], -1.0), 1.0) * most
            turns[robot, wheel] = travel[robot, wheel] = turn
            if noise[env, 11] > 0.0:
                uniform = unit(mixed(state + np.uint64((robot << 20) + 2 * wheel + 1) * GOLDEN))
                if uniform < -math.expm1(-noise[env, 11] * abs(turn)):
                    travel[robot, wheel] = turn * (1.0 - noise[env, 12])
        longest = max(longest, 0.5 * abs(travel[robot, 0] + travel[robot, 1]))
    return longest


@inlined
def move_part(
    env: int, parts: int, axle: float, travel: FloatArray, poses: FloatArray, before: FloatArray
) -> None:
    """Move the robots of one environment along one of ``parts`` equal parts of their arcs."""
    for robot in range(len(travel)):
        before[robot, 0], before[robot, 1] = poses[env, robot, 0], poses[env, robot, 1]
        poses[env, robot, 0], poses[env, robot, 1], poses[env, robot, 2] = arc_end(
            before[robot, 0], before[robot, 1], poses[env, robot, 2],
            travel[robot, 0] / parts, travel[robot, 1] / parts, axle,
        )  # fmt: skip


@inlined
def cast_near_walls(
    place: Place,
    body_x: float,
    body_y: float,
    beams: FloatArray,
    aims: FloatArray,
    edges: FloatArray,
    near_starts: IntArray,
    near_edges: IntArray,
    rays: FloatArray,
) -> None:
    """Set ``rays`` (2, lanes) as :func:`cast_fan` does, for a body at (x, y), m."""
    column = min(max(math.floor((body_x - place.low_x) / place.side), 0), place.columns - 1)
    row = min(max(math.floor((body_y - place.low_y) / place.side), 0), place.rows - 1)
    cast_fan(place.near_cell + row * place.columns + column, beams, aims, edges, near_starts, near_edges, rays)


@inlined
def nearest_in_cone(
    robot: int,
    distance: float,
    hit: int,
    x: float,
    y: float,
    angle: float,
    offset: float,
    reach: float,
    cone: float,
    radius: float,
    poses: FloatArray,
    walls: Walls,
) -> tuple[float, int]:
    """The nearest of what the rays of a cone meet: ``distance`` (m) and ``hit`` of its middle, or nearer ones.

    The cone opens by ``cone`` (rad) to both sides of ``angle`` (rad) at the point (x, y), m, on the rim of the body;
    its rays start ``offset`` (m) before that point and have the length ``reach`` (m).
    """
    for share in CONE:
        dx, dy = math.cos(angle + share * cone), math.sin(angle + share * cone)
        aside, other = measure(robot, poses, radius, x - offset * dx, y - offset * dy, dx, dy, reach, walls)
        if aside < distance:
            distance, hit = aside, other
    return distance, hit


@inlined
def read_beam(
    env: int, number: int, distance: float, hit: int, own: np.uint64, beams: FloatArray, noise: FloatArray
) -> float:
    """The reading (m) of a beam whose ray has a length of ``distance`` (m) and hits ``hit``.

    ``own`` is the state of the robot's random numbers; a number that no noise needs is not drawn.
    """
    place = np.uint64(2 * number + 4)
    random, uniform = 0.0, 1.0
    if noise[env, 0] > 0.0 or noise[env, 1] > 0.0:
        random = normal(mixed(own + place * GOLDEN))
    if noise[env, 2] > 0.0:
        uniform = unit(mixed(own + (place + _ONE) * GOLDEN))
    return noisy_reading(
        distance - beams[number, 3], hit, beams[number, 4], beams[number, 5],
        noise[env, 0], noise[env, 1], noise[env, 2], noise[env, 3], noise[env, 4], random, uniform,
    )  # fmt: skip


@inlined
def read_encoders(
    env: int,
    robot: int,
    own: np.uint64,
    noise: FloatArray,
    turns: FloatArray,
    unreported: FloatArray,
    wheels: ReadingArray,
) -> None:
    """Set the wheel travel that a robot's encoders report for wheels that turn by ``turns`` (m, 2), m."""
    for wheel in range(2):
        random = 0.0
        if turns[robot, wheel] != 0.0 and noise[env, 8] > 0.0:
            random = normal(mixed(own + np.uint64(2 * wheel) * GOLDEN))
        wheels[env, robot, wheel], unreported[env, robot, wheel] = reported_travel(
            turns[robot, wheel], unreported[env, robot, wheel],
            noise[env, 6 + wheel], noise[env, 8], noise[env, 9], noise[env, 10], random,
        )  # fmt: skip


@entry
def advance(  # noqa: C901, PLR0912, PLR0915 (one loop: an array that is handed to a function costs as much as a ray)
    first: int,
    last: int,
    tasks: IntArray,
    actions: FloatArray,
    robots: Robots,
    worlds: Worlds,
    episodes: Episodes,
    measured: Measurements,
) -> None:
    """Drive, and take all measurements of, environments ``first`` to ``last`` - 1.

    Parameters
    ----------
    first, last
        Which environments.
    tasks
        (n,): ``SKIP``, ``STEP`` or ``BEGIN`` of each.
    actions
        (n, m, 2), left and right wheel speed of each robot, -1 to 1; values beyond are clipped.
    robots, worlds
        What the robots are and where.
    episodes
        What is kept from step to step; changed in place.
    measured
        What is measured; changed in place.
    """
    # Arrays are taken out of the tuples once, and numbers out of the arrays one by one: each array that is taken out
    # of another or of a tuple in the loop costs as much as a ray.
    most, radius, beams = robots
    layout, grids, areas, edges, cell_starts, cell_edges, near_starts, near_edges, coverable = worlds
    world_of, noise, keys, steps, clearances, poses, unreported, unseen = episodes
    hits, ranges, wheels, contact, new_cells = measured
    num_robots, num_beams, num_lanes = poses.shape[1], len(beams), lanes_of(len(beams))
    aims, rays = np.zeros((4, num_lanes)), np.zeros((2, num_lanes))
    turns, travel, before = np.zeros((num_robots, 2)), np.zeros((num_robots, 2)), np.zeros((num_robots, 2))
    for env in range(first, last):
        if tasks[env] == SKIP:
            continue
        place = place_of(layout, grids, areas, world_of[env])
        steps[env] = steps[env] + 1 if tasks[env] == STEP else 0
        state = keys[env] + (np.uint64(steps[env]) << np.uint64(24)) * GOLDEN
        for robot in range(num_robots):
            contact[env, robot] = False
        if tasks[env] == BEGIN:
            clearances[env] = 0.0
            for tile in range(coverable.shape[1]):
                unseen[env, tile] = coverable[world_of[env], tile]
            for robot in range(num_robots):
                for wheel in range(2):
                    turns[robot, wheel] = unreported[env, robot, wheel] = 0.0
        else:
            longest = turn_wheels(env, state, actions, most, noise, turns, travel)
            # A move of more than the radius could end beyond a wall; an arc in parts is the same arc.
            parts = 1 if longest <= LONGEST_MOVE * radius else math.ceil(longest / (LONGEST_MOVE * radius))
            for _ in range(parts):
                move_part(env, parts, noise[env, 13], travel, poses, before)
                # Two robots may approach each other.
                clearances[env] -= (1.0 if num_robots == 1 else 2.0) * longest / parts
                if clearances[env] <= 0.0:
                    walls = walls_at(place, edges, cell_starts, cell_edges)
                    clearances[env] = separate(poses[env], before, radius, contact[env], walls)
        for robot in range(num_robots):
            own = state + np.uint64(robot << 20) * GOLDEN
            body_x, body_y, heading = poses[env, robot, 0], poses[env, robot, 1], poses[env, robot, 2]
            new = take_disc(
                unseen, env, place.tile_columns, place.tile_rows,
                (body_x - place.area_x) / place.cell, (body_y - place.area_y) / place.cell,
                (radius - BODY_MARGIN) / place.cell,
            )  # fmt: skip
            aim(beams, body_x, body_y, math.cos(heading), math.sin(heading), aims)
            if place.near_cell >= 0:
                cast_near_walls(place, body_x, body_y, beams, aims, edges, near_starts, near_edges, rays)
            for number in range(num_beams):
                if beams[number, 6] != 1.0 and steps[env] % int(beams[number, 6]) != 0:
                    continue
                offset, reach = beams[number, 3], beams[number, 5] + beams[number, 3]
                x, y, dx, dy = aims[0, number], aims[1, number], aims[2, number], aims[3, number]
                distance, hit = rays[0, number], int(rays[1, number])
                if place.near_cell < 0:
                    walls = walls_at(place, edges, cell_starts, cell_edges)
                    distance, hit = first_wall(x, y, dx, dy, reach, walls)
                if num_robots > 1:
                    disc = cast_at_discs(x, y, dx, dy, distance, robot, poses[env], radius)
                    if disc < distance:
                        distance, hit = disc, ROBOT
                new += take_ray(
                    unseen, env, place.tile_columns, place.tile_rows, (x - place.area_x) / place.cell,
                    (y - place.area_y) / place.cell, dx, dy, distance / place.cell - RAY_MARGIN,
                )  # fmt: skip
                if noise[env, 5] > 0.0:
                    walls = walls_at(place, edges, cell_starts, cell_edges)
                    distance, hit = nearest_in_cone(
                        robot, distance, hit, x + offset * dx, y + offset * dy, heading + beams[number, 2],
                        offset, reach, noise[env, 5], radius, poses[env], walls,
                    )  # fmt: skip
                hits[env, robot, number] = hit - place.first_edge if hit >= 0 else hit
                ranges[env, robot, number] = read_beam(env, number, distance, hit, own, beams, noise)
            new_cells[env, robot] = new
            read_encoders(env, robot, own, noise, turns, unreported, wheels)
