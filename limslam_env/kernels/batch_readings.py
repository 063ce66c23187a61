"""The readings of the robots in a batch: range sensors, wheel encoders, and what a step hands out."""

import numpy as np

from limslam_env.compilation import merged
from limslam_env.geometry import FloatArray
from limslam_env.kernels import tables
from limslam_env.kernels.batch_state import Episodes, Results, Robots, Scratch, Task, Worlds
from limslam_env.kernels.random_numbers import GOLDEN, mixed, normal, unit
from limslam_env.kernels.rays import is_due
from limslam_env.kernels.readings import noisy_reading, reported_travel

SKIP, STEP, BEGIN = 0, 1, 2
"""What an environment does: nothing, a step, or the first observation of a new episode."""

_ONE = np.uint64(1)


@merged
def read_beams(
    env: int, robot: int, own: np.uint64, first_edge: int, robots: Robots, episodes: Episodes, scratch: Scratch
) -> None:
    """Set the readings of a robot's beams that measure in this step, and the walls that they hit.

    ``own`` is the state of the robot's random numbers; numbers that no noise needs are not drawn.
    """
    noise, beams, rays = episodes.noise, robots.beams, scratch.rays
    is_noisy = noise[env, tables.RANGE_STD] > 0.0 or noise[env, tables.STD_GROWTH] > 0.0
    is_dropping = noise[env, tables.DROPOUT] > 0.0
    for number in range(len(beams)):
        if not is_due(beams, number, episodes.steps[env]):
            continue
        hit, place, random, uniform = int(rays[1, number]), np.uint64(2 * number + 4), 0.0, 1.0
        if is_noisy:
            random = normal(mixed(own + place * GOLDEN))
        if is_dropping:
            uniform = unit(mixed(own + (place + _ONE) * GOLDEN))
        episodes.hits[env, robot, number] = hit - first_edge if hit >= 0 else hit
        episodes.ranges[env, robot, number] = noisy_reading(
            rays[0, number] - beams[number, tables.OFFSET], hit,
            beams[number, tables.SHORTEST_RANGE], beams[number, tables.LONGEST_RANGE],
            noise[env, tables.RANGE_STD], noise[env, tables.STD_GROWTH], noise[env, tables.DROPOUT],
            noise[env, tables.RANGE_RESOLUTION], noise[env, tables.FOLD_BACK], random, uniform,
        )  # fmt: skip


@merged
def read_encoders(env: int, robot: int, own: np.uint64, episodes: Episodes, turned_by: FloatArray) -> None:
    """Set the wheel travel that a robot's encoders report for wheels that ``turned_by`` (m, 2), m."""
    noise, unreported = episodes.noise, episodes.unreported
    for wheel in range(2):
        random = 0.0
        if turned_by[robot, wheel] != 0.0 and noise[env, tables.WHEEL_VARIANCE] > 0.0:
            random = normal(mixed(own + np.uint64(2 * wheel) * GOLDEN))
        episodes.wheels[env, robot, wheel], unreported[env, robot, wheel] = reported_travel(
            turned_by[robot, wheel], unreported[env, robot, wheel],
            noise[env, tables.LEFT_WHEEL + wheel], noise[env, tables.WHEEL_VARIANCE],
            noise[env, tables.ENCODER_RESOLUTION], noise[env, tables.LARGEST_TRAVEL], random,
        )  # fmt: skip


@merged
def hand_out(
    env: int,
    does: int,
    robots: Robots,
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
    world, step = episodes.world_of[env], episodes.steps[env]
    area = worlds.areas[world, 2] * worlds.areas[world, 2]
    for robot in range(len(scratch.new_cells)):
        new, contact = scratch.new_cells[robot], episodes.contact[env, robot]
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
    results.time[env], results.coverage[env] = step * robots.control_period, coverage
    results.terminated[env] = does == STEP and coverage >= task.goal
    results.truncated[env] = does == STEP and step >= task.max_steps
