"""A step of many environments at once. Rays, readings and encoders are those of the single
environment.
"""

import numpy as np

from limslam_env.compilation import floored, inlined, lean_entry, merged, next_of, prefetch
from limslam_env.geometry import FloatArray, IntArray, se2
from limslam_env.kernels import readings as tables
from limslam_env.kernels.batch_rays import trace, widen
from limslam_env.kernels.batch_state import Episodes, Results, Robots, Scratch, Task, Worlds
from limslam_env.kernels.contact import LONGEST_MOVE, separate
from limslam_env.kernels.coverage import TILE
from limslam_env.kernels.random_numbers import GOLDEN, mixed, normal, unit
from limslam_env.kernels.rays import Discs, Walls
from limslam_env.kernels.readings import is_due, noisy_reading, reported_travel, way_over_ground

SKIP = 0
STEP = 1
BEGIN = 2
"""What an environment does: nothing, a step, or the first observation of a new episode."""

_ONE = np.uint64(1)
_AHEAD = 2  # environments between asking for memory and its use

arc_end = inlined(se2.arc_end)


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
        worlds.edges,
        worlds.cell_starts,
        worlds.cell_edges,
        worlds.grids[world, 0],
        worlds.grids[world, 1],
        worlds.grids[world, 2],
        worlds.layout[world, 2],
        worlds.layout[world, 3],
        worlds.layout[world, 1],
    )


@merged
def turn_wheels(
    env: int,
    state: np.uint64,
    actions: FloatArray,
    most: float,
    noise: FloatArray,
    scratch: Scratch,
) -> float:
    """Set how far the wheels turn and travel; returns the longest way of a robot, m.

    ``most`` (m) is a wheel's travel at an action of 1.
    """
    longest = 0.0
    for robot in range(len(scratch.travel)):
        for wheel in range(2):
            turn = min(max(actions[env, robot, wheel], -1.0), 1.0) * most
            scratch.turned[robot, wheel] = scratch.travel[robot, wheel] = turn
            if noise[env, tables.SLIP_RATE] > 0.0:
                uniform = unit(mixed(state + np.uint64((robot << 20) + 2 * wheel + 1) * GOLDEN))
                scratch.travel[robot, wheel] = way_over_ground(
                    turn, noise[env, tables.SLIP_RATE], noise[env, tables.SLIP_SHARE], uniform
                )
        longest = max(longest, 0.5 * abs(scratch.travel[robot, 0] + scratch.travel[robot, 1]))
    return longest


@merged
def move(
    env: int, longest: float, radius: float, walls: Walls, episodes: Episodes, scratch: Scratch
) -> None:
    """Move the robots of one environment along their arcs, and separate them from what they
    touch.
    """
    poses = episodes.poses
    clearances = episodes.clearances
    before = scratch.before
    travel = scratch.travel
    # A move of more than the radius could end beyond a wall; an arc in parts is the same arc.
    parts = 1 if longest <= LONGEST_MOVE * radius else -floored(-longest / (LONGEST_MOVE * radius))
    for _ in range(parts):
        for robot in range(len(travel)):
            before[robot, 0] = poses[env, robot, 0]
            before[robot, 1] = poses[env, robot, 1]
            poses[env, robot, 0], poses[env, robot, 1], poses[env, robot, 2] = arc_end(
                before[robot, 0],
                before[robot, 1],
                poses[env, robot, 2],
                travel[robot, 0] / parts,
                travel[robot, 1] / parts,
                episodes.noise[env, tables.TRUE_AXLE],
            )
        # Two robots may approach each other.
        clearances[env] -= (1.0 if len(travel) == 1 else 2.0) * longest / parts
        if clearances[env] <= 0.0:
            clearances[env] = separate(
                poses[env], before, scratch.deep, radius, episodes.contact[env], walls
            )


@merged
def read_beams(
    env: int,
    robot: int,
    own: np.uint64,
    first_edge: int,
    robots: Robots,
    episodes: Episodes,
    scratch: Scratch,
) -> None:
    """Set the readings of a robot's beams that measure in this step, and the walls that they hit.

    ``own`` is the state of the robot's random numbers; numbers that no noise needs are not drawn.
    """
    noise = episodes.noise[env]
    beams = robots.beams
    rays = scratch.rays
    is_noisy = noise[tables.RANGE_STD] > 0.0 or noise[tables.STD_GROWTH] > 0.0
    is_dropping = noise[tables.DROPOUT] > 0.0
    for number in range(len(beams)):
        if not is_due(beams, number, episodes.steps[env]):
            continue
        hit = int(rays[1, number])
        place = np.uint64(2 * number + 4)
        random = 0.0
        uniform = 1.0
        if is_noisy:
            random = normal(mixed(own + place * GOLDEN))
        if is_dropping:
            uniform = unit(mixed(own + (place + _ONE) * GOLDEN))
        episodes.hits[env, robot, number] = hit - first_edge if hit >= 0 else hit
        ideal = rays[0, number] - beams[number, tables.OFFSET]
        episodes.ranges[env, robot, number] = noisy_reading(
            ideal, hit, beams, number, noise, random, uniform
        )


@merged
def read_encoders(
    env: int, robot: int, own: np.uint64, episodes: Episodes, turned_by: FloatArray
) -> None:
    """Set the wheel travel that a robot's encoders report for wheels that ``turned_by`` (m, 2),
    m.
    """
    noise = episodes.noise
    unreported = episodes.unreported
    for wheel in range(2):
        random = 0.0
        if turned_by[robot, wheel] != 0.0 and noise[env, tables.WHEEL_VARIANCE] > 0.0:
            random = normal(mixed(own + np.uint64(2 * wheel) * GOLDEN))
        episodes.wheels[env, robot, wheel], unreported[env, robot, wheel] = reported_travel(
            turned_by[robot, wheel],
            unreported[env, robot, wheel],
            noise[env, tables.LEFT_WHEEL + wheel],
            noise[env, tables.WHEEL_VARIANCE],
            noise[env, tables.ENCODER_RESOLUTION],
            noise[env, tables.LARGEST_TRAVEL],
            random,
        )


@merged
def hand_out(
    env: int,
    does: int,
    worlds: Worlds,
    episodes: Episodes,
    scratch: Scratch,
    task: Task,
    results: Results,
) -> None:
    """Set the results of an environment in which each robot saw ``scratch.new_cells`` (m,) first.

    ``does`` is what the environment does, and ``task`` what is asked of the robots.
    Rewards and ends are those of :mod:`limslam_env.config`.
    """
    world = episodes.world_of[env]
    step = episodes.steps[env]
    area = worlds.areas[world, 2] * worlds.areas[world, 2]
    for robot in range(len(scratch.new_cells)):
        new = scratch.new_cells[robot]
        contact = episodes.contact[env, robot]
        episodes.covered[env] += new
        worth = task.new_area * (new * area) + task.step + task.collision * contact
        results.rewards[env, robot] = worth if does == STEP else 0.0
        results.contact[env, robot] = contact
        for place in range(3):
            results.poses[env, robot, place] = episodes.poses[env, robot, place]
        for wheel in range(2):
            results.wheels[env, robot, wheel] = episodes.wheels[env, robot, wheel]
        for beam in range(results.ranges.shape[2]):
            results.ranges[env, robot, beam] = episodes.ranges[env, robot, beam]
            results.wall_seen[env, robot, beam] = episodes.hits[env, robot, beam]
    coverage = episodes.covered[env] / worlds.totals[world]
    results.time[env] = step * task.control_period
    results.coverage[env] = coverage
    results.terminated[env] = does == STEP and coverage >= task.goal
    results.truncated[env] = does == STEP and step >= task.max_steps


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
def advance_one(
    env: int,
    task: int,
    actions: FloatArray,
    robots: Robots,
    worlds: Worlds,
    episodes: Episodes,
    scratch: Scratch,
) -> None:
    """Drive one environment, or begin its episode, and take all its measurements."""
    world = episodes.world_of[env]
    walls = world_walls(worlds, world)
    episodes.steps[env] = episodes.steps[env] + 1 if task == STEP else 0
    step = episodes.steps[env]
    state = episodes.keys[env] + (np.uint64(step) << np.uint64(24)) * GOLDEN
    for robot in range(len(scratch.new_cells)):
        episodes.contact[env, robot] = False
    if task == BEGIN:
        begin(env, world, worlds, episodes, scratch)
    else:
        longest = turn_wheels(env, state, actions, robots.wheel_travel, episodes.noise, scratch)
        move(env, longest, robots.radius, walls, episodes, scratch)
    for robot in range(len(scratch.new_cells)):
        own = state + np.uint64(robot << 20) * GOLDEN
        scratch.new_cells[robot] = trace(env, robot, robots, worlds, walls, episodes, scratch)
        cone = episodes.noise[env, tables.CONE]
        if cone > 0.0:
            discs = Discs(robot, episodes.poses[env], robots.radius)
            widen(step, cone, robots, walls, discs, scratch)
        read_beams(env, robot, own, worlds.layout[world, 0], robots, episodes, scratch)
        read_encoders(env, robot, own, episodes, scratch.turned)


@lean_entry
def advance(
    begun: IntArray,
    portion: int,
    scratch: Scratch,
    tasks: IntArray,
    actions: FloatArray,
    robots: Robots,
    worlds: Worlds,
    episodes: Episodes,
    task: Task,
    results: Results,
) -> None:
    """Drive all environments, and take all measurements of them; changes ``episodes`` and sets all
    ``results``.

    Several threads may do this at the same time. Each takes the next portion when it has done one,
    so that a thread whose core is busy does not hold up the others.

    Parameters
    ----------
    begun, portion
        How many portions have been begun (1,), 0 at first and shared by the threads; and
        environments in a portion.
    scratch
        Memory of its own for each thread (:func:`limslam_env.kernels.batch_state.scratch_for`).
    tasks
        (n,): ``SKIP``, ``STEP`` or ``BEGIN`` of each.
    actions
        (n, m, 2), left and right wheel speed of each robot, -1 to 1; values beyond are clipped.
    """
    first = next_of(begun) * portion
    while first < len(tasks):
        last = min(first + portion, len(tasks))
        for env in range(first, last):
            if env + _AHEAD < last:
                prefetch_unseen(env + _AHEAD, worlds, episodes)
            if tasks[env] == SKIP:
                for robot in range(len(scratch.new_cells)):
                    scratch.new_cells[robot] = 0
            else:
                advance_one(env, tasks[env], actions, robots, worlds, episodes, scratch)
            hand_out(env, tasks[env], worlds, episodes, scratch, task, results)
        first = next_of(begun) * portion
