"""A step of many environments at once.

Rays, readings and encoders are those of the single environment.
"""

import math

import numpy as np
from numpy.typing import NDArray

from limslam_env.compilation import inlined, lean_entry, merged, prefetch
from limslam_env.geometry import FloatArray, IntArray, se2
from limslam_env.kernels.batch_state import Episodes, Measurements, Robots, Scratch, Worlds
from limslam_env.kernels.contact import LONGEST_MOVE, separate
from limslam_env.kernels.coverage import BODY_MARGIN, RAY_MARGIN
from limslam_env.kernels.observation import CONE
from limslam_env.kernels.random_numbers import GOLDEN, Words, mixed, normal, unit
from limslam_env.kernels.rays import ROBOT, cast_at_discs, first_wall, measure, meeting, turned
from limslam_env.kernels.readings import noisy_reading, reported_travel
from limslam_env.kernels.tiles import TILE, take_disc, take_ray, unseen_nearby, walk_disc, walk_ray
from limslam_env.kernels.wall_cells import Walls

SKIP, STEP, BEGIN = 0, 1, 2
"""What an environment does: nothing, a step, or the first observation of a new episode."""

NUM_NOISES = 14
"""Columns of the table of noise."""

_NONE, _ONE = np.uint64(0), np.uint64(1)

_AHEAD = 2  # environments between asking for memory and its use

arc_end = inlined(se2.arc_end)


@merged
def aim(beams: FloatArray, body_x: float, body_y: float, cos: float, sin: float, aims: FloatArray) -> None:
    """Set ``aims`` (4, lanes) to the origins x and y (m) of a robot's rays, and to the rays' directions."""
    # The rim may touch a wall, and a ray from the rim could start behind the wall: rays start inside the body.
    for number in range(len(beams)):
        dx, dy = turned(beams[number, 7], beams[number, 8], cos, sin)
        rim_x, rim_y = turned(beams[number, 0], beams[number, 1], cos, sin)
        aims[0, number] = body_x + rim_x - beams[number, 3] * dx
        aims[1, number] = body_y + rim_y - beams[number, 3] * dy
        aims[2, number], aims[3, number] = dx, dy


@merged
def cast_fan(
    cell: int,
    first_edge: int,
    beams: FloatArray,
    aims: FloatArray,
    edges: FloatArray,
    near_starts: IntArray,
    near_edges: NDArray[np.uint16],
    rays: FloatArray,
) -> None:
    """Set ``rays`` (2, lanes) to the lengths of a robot's rays, m, and to the walls that they hit, or -1."""
    for number in range(len(beams)):
        rays[0, number], rays[1, number] = beams[number, 5] + beams[number, 3], -1.0
    for item in range(near_starts[cell], near_starts[cell + 1]):
        edge = first_edge + int(near_edges[item])
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


@merged
def find_unseen(
    env: int,
    unseen: Words,
    tile_columns: int,
    tile_rows: int,
    x: float,
    y: float,
    radius: float,
    low_x: float,
    low_y: float,
    cell: float,
    aims: FloatArray,
    rays: FloatArray,
    found: Words,
) -> None:
    """Set ``found`` (n_beams + 1,): where there are unseen cells around the rays of a robot, and around its body last.

    Body: centre (x, y) and radius in cells. ``low_x`` and ``low_y`` (m) are the corner of the cells, ``cell`` (m) their
    side. A robot covers cells in this step, too: a ray may find none left where this function has found some.
    """
    beams = len(found) - 1
    found[beams] = unseen_nearby(unseen, env, tile_columns, tile_rows, x - radius, y - radius, x + radius, y + radius)
    for number in range(beams):
        from_x, from_y = (aims[0, number] - low_x) / cell, (aims[1, number] - low_y) / cell
        end = rays[0, number] / cell - RAY_MARGIN
        far_x, far_y = from_x + aims[2, number] * end, from_y + aims[3, number] * end
        found[number] = unseen_nearby(unseen, env, tile_columns, tile_rows, from_x, from_y, far_x, far_y)


@merged
def cover_ray(
    is_looked_for: bool,
    found: np.uint64,
    env: int,
    unseen: Words,
    tile_columns: int,
    tile_rows: int,
    x: float,
    y: float,
    dx: float,
    dy: float,
    end: float,
) -> int:
    """:func:`limslam_env.kernels.tiles.take_ray`, without a test of its own if unseen cells were looked for already."""
    if not is_looked_for:
        return take_ray(unseen, env, tile_columns, tile_rows, x, y, dx, dy, end)
    if found != _NONE:
        return walk_ray(unseen, env, tile_columns, tile_rows, x, y, dx, dy, end)
    return 0


@merged
def prefetch_unseen(env: int, worlds: Worlds, episodes: Episodes) -> None:
    """Ask for the unseen cells around the robots of an environment that is soon to be stepped."""
    world = episodes.world_of[env]
    columns = worlds.layout[world, 4]
    side = TILE * worlds.areas[world, 2]
    for robot in range(episodes.poses.shape[1]):
        row = int((episodes.poses[env, robot, 1] - worlds.areas[world, 1]) / side)
        column = int((episodes.poses[env, robot, 0] - worlds.areas[world, 0]) / side)
        for line in range(row - 2, row + 3):
            # A row of five tiles lies in one or two lines of the processor's cache.
            prefetch(episodes.unseen, env, line * columns + column - 2)
            prefetch(episodes.unseen, env, line * columns + column + 2)


@inlined
def world_walls(worlds: Worlds, world: int) -> Walls:
    """The walls of one world."""
    return Walls(
        worlds.edges, worlds.cell_starts, worlds.cell_edges,
        worlds.grids[world, 0], worlds.grids[world, 1], worlds.grids[world, 2],
        worlds.layout[world, 2], worlds.layout[world, 3], worlds.layout[world, 1],
    )  # fmt: skip


@merged
def turn_wheels(
    env: int, state: np.uint64, actions: FloatArray, most: float, noise: FloatArray, scratch: Scratch
) -> float:
    """Set how far the wheels turn and travel; returns the longest way of a robot, m.

    ``most`` (m) is a wheel's travel at an action of 1. Slips are those of ``simulation.odometry``.
    """
    longest = 0.0
    for robot in range(len(scratch.travel)):
        for wheel in range(2):
            turn = min(max(actions[env, robot, wheel], -1.0), 1.0) * most
            scratch.turned[robot, wheel] = scratch.travel[robot, wheel] = turn
            if noise[env, 11] > 0.0:
                uniform = unit(mixed(state + np.uint64((robot << 20) + 2 * wheel + 1) * GOLDEN))
                if uniform < -math.expm1(-noise[env, 11] * abs(turn)):
                    scratch.travel[robot, wheel] = turn * (1.0 - noise[env, 12])
        longest = max(longest, 0.5 * abs(scratch.travel[robot, 0] + scratch.travel[robot, 1]))
    return longest


@merged
def move(
    env: int, longest: float, radius: float, walls: Walls, episodes: Episodes, measured: Measurements, scratch: Scratch
) -> None:
    """Move the robots of one environment along their arcs, and separate them from what they touch."""
    poses, clearances, before, travel = episodes.poses, episodes.clearances, scratch.before, scratch.travel
    # A move of more than the radius could end beyond a wall; an arc in parts is the same arc.
    parts = 1 if longest <= LONGEST_MOVE * radius else math.ceil(longest / (LONGEST_MOVE * radius))
    for _ in range(parts):
        for robot in range(len(travel)):
            before[robot, 0], before[robot, 1] = poses[env, robot, 0], poses[env, robot, 1]
            poses[env, robot, 0], poses[env, robot, 1], poses[env, robot, 2] = arc_end(
                before[robot, 0], before[robot, 1], poses[env, robot, 2],
                travel[robot, 0] / parts, travel[robot, 1] / parts, episodes.noise[env, 13],
            )  # fmt: skip
        # Two robots may approach each other.
        clearances[env] -= (1.0 if len(travel) == 1 else 2.0) * longest / parts
        if clearances[env] <= 0.0:
            clearances[env] = separate(poses[env], before, scratch.deep, radius, measured.contact[env], walls)


@merged
def begin(env: int, world: int, worlds: Worlds, episodes: Episodes, scratch: Scratch) -> None:
    """Reset what an environment keeps from step to step, all but its pose and its noise."""
    episodes.clearances[env] = 0.0
    for tile in range(worlds.coverable.shape[1]):
        episodes.unseen[env, tile] = worlds.coverable[world, tile]
    for robot in range(len(scratch.turned)):
        for wheel in range(2):
            scratch.turned[robot, wheel] = episodes.unreported[env, robot, wheel] = 0.0


@merged
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


@merged
def read_beam(
    env: int,
    robot: int,
    number: int,
    distance: float,
    hit: int,
    own: np.uint64,
    beams: FloatArray,
    noise: FloatArray,
    measured: Measurements,
) -> None:
    """Set the reading of a beam whose ray has a length of ``distance``, m, and hits ``hit``.

    ``own`` is the state of the robot's random numbers; a number that no noise needs is not drawn.
    """
    place = np.uint64(2 * number + 4)
    random, uniform = 0.0, 1.0
    if noise[env, 0] > 0.0 or noise[env, 1] > 0.0:
        random = normal(mixed(own + place * GOLDEN))
    if noise[env, 2] > 0.0:
        uniform = unit(mixed(own + (place + _ONE) * GOLDEN))
    measured.ranges[env, robot, number] = noisy_reading(
        distance - beams[number, 3], hit, beams[number, 4], beams[number, 5],
        noise[env, 0], noise[env, 1], noise[env, 2], noise[env, 3], noise[env, 4], random, uniform,
    )  # fmt: skip


@merged
def read_encoders(
    env: int, robot: int, own: np.uint64, episodes: Episodes, turned_by: FloatArray, measured: Measurements
) -> None:
    """Set the wheel travel that a robot's encoders report for wheels that ``turned_by`` (m, 2), m."""
    noise, unreported = episodes.noise, episodes.unreported
    for wheel in range(2):
        random = 0.0
        if turned_by[robot, wheel] != 0.0 and noise[env, 8] > 0.0:
            random = normal(mixed(own + np.uint64(2 * wheel) * GOLDEN))
        measured.wheels[env, robot, wheel], unreported[env, robot, wheel] = reported_travel(
            turned_by[robot, wheel], unreported[env, robot, wheel],
            noise[env, 6 + wheel], noise[env, 8], noise[env, 9], noise[env, 10], random,
        )  # fmt: skip


@merged
def measure_one(
    env: int,
    robot: int,
    number: int,
    distance: float,
    hit: int,
    own: np.uint64,
    robots: Robots,
    walls: Walls,
    first_edge: int,
    episodes: Episodes,
    measured: Measurements,
    aims: FloatArray,
) -> None:
    """Set what a beam measures whose ray has a length of ``distance``, m, and hits ``hit``; a cone may hit more."""
    beams, noise, poses = robots.beams, episodes.noise, episodes.poses
    if noise[env, 5] > 0.0:
        offset, reach = beams[number, 3], beams[number, 5] + beams[number, 3]
        x, y = aims[0, number] + offset * aims[2, number], aims[1, number] + offset * aims[3, number]
        distance, hit = nearest_in_cone(
            robot, distance, hit, x, y, poses[env, robot, 2] + beams[number, 2],
            offset, reach, noise[env, 5], robots.radius, poses[env], walls,
        )  # fmt: skip
    measured.hits[env, robot, number] = hit - first_edge if hit >= 0 else hit
    read_beam(env, robot, number, distance, hit, own, beams, noise, measured)


@merged
def measure_beams(
    env: int,
    robot: int,
    world: int,
    own: np.uint64,
    robots: Robots,
    worlds: Worlds,
    walls: Walls,
    episodes: Episodes,
    measured: Measurements,
    scratch: Scratch,
) -> None:
    """Measure with all beams of one robot that are due, and count the cells that the robot is the first to see."""
    poses, unseen, step = episodes.poses, episodes.unseen, episodes.steps[env]
    beams, radius, aims, rays, found = robots.beams, robots.radius, scratch.aims, scratch.rays, scratch.found
    area_x, area_y, cell = worlds.areas[world, 0], worlds.areas[world, 1], worlds.areas[world, 2]
    tile_columns, tile_rows = worlds.layout[world, 4], worlds.layout[world, 5]
    first_edge, near_cell = worlds.layout[world, 0], worlds.layout[world, 6]
    body_x, body_y, heading = poses[env, robot, 0], poses[env, robot, 1], poses[env, robot, 2]
    cell_x, cell_y, cell_radius = (body_x - area_x) / cell, (body_y - area_y) / cell, (radius - BODY_MARGIN) / cell
    is_looked_for = robots.is_small and near_cell >= 0
    aim(beams, body_x, body_y, math.cos(heading), math.sin(heading), aims)
    if near_cell >= 0:
        column = min(max(math.floor((body_x - walls.low_x) / walls.side), 0), walls.columns - 1)
        row = min(max(math.floor((body_y - walls.low_y) / walls.side), 0), walls.rows - 1)
        cell_number = near_cell + row * walls.columns + column
        cast_fan(cell_number, first_edge, beams, aims, walls.edges, worlds.near_starts, worlds.near_edges, rays)
    if is_looked_for:
        find_unseen(
            env, unseen, tile_columns, tile_rows, cell_x, cell_y, cell_radius, area_x, area_y, cell, aims, rays, found
        )  # fmt: skip
        new = 0
        if found[len(beams)] != _NONE:
            new = walk_disc(unseen, env, tile_columns, tile_rows, cell_x, cell_y, cell_radius)
    else:
        new = take_disc(unseen, env, tile_columns, tile_rows, cell_x, cell_y, cell_radius)
    for number in range(len(beams)):
        if beams[number, 6] != 1.0 and step % int(beams[number, 6]) != 0:
            continue
        x, y, dx, dy = aims[0, number], aims[1, number], aims[2, number], aims[3, number]
        distance, hit = rays[0, number], int(rays[1, number])
        if near_cell < 0:
            distance, hit = first_wall(x, y, dx, dy, beams[number, 5] + beams[number, 3], walls)
        if poses.shape[1] > 1:
            disc = cast_at_discs(x, y, dx, dy, distance, robot, poses[env], radius)
            if disc < distance:
                distance, hit = disc, ROBOT
        new += cover_ray(
            is_looked_for, found[number], env, unseen, tile_columns, tile_rows,
            (x - area_x) / cell, (y - area_y) / cell, dx, dy, distance / cell - RAY_MARGIN,
        )  # fmt: skip
        measure_one(
            env, robot, number, distance, hit, own, robots, walls, first_edge, episodes, measured, aims
        )  # fmt: skip
    measured.new_cells[env, robot] = new


@lean_entry
def advance(
    first: int,
    last: int,
    scratch: Scratch,
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
    scratch
        Memory of its own for each thread (:func:`limslam_env.kernels.batch_state.scratch_for`).
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
    num_robots = episodes.poses.shape[1]
    for env in range(first, last):
        if env + _AHEAD < last:
            prefetch_unseen(env + _AHEAD, worlds, episodes)
        if tasks[env] == SKIP:
            continue
        world = episodes.world_of[env]
        walls = world_walls(worlds, world)
        episodes.steps[env] = episodes.steps[env] + 1 if tasks[env] == STEP else 0
        state = episodes.keys[env] + (np.uint64(episodes.steps[env]) << np.uint64(24)) * GOLDEN
        for robot in range(num_robots):
            measured.contact[env, robot] = False
        if tasks[env] == BEGIN:
            begin(env, world, worlds, episodes, scratch)
        else:
            longest = turn_wheels(env, state, actions, robots.wheel_travel, episodes.noise, scratch)
            move(env, longest, robots.radius, walls, episodes, measured, scratch)
        for robot in range(num_robots):
            own = state + np.uint64(robot << 20) * GOLDEN
            measure_beams(env, robot, world, own, robots, worlds, walls, episodes, measured, scratch)
            read_encoders(env, robot, own, episodes, scratch.turned, measured)
