"""Drives that depend on the seed and not on the estimator, as logs of wheel travel with the
truth.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.scoreboard.rows import Row
from benchmarks.suite.faults import DRIVE_FAULTS, Fault, drawn_slips, with_fault
from benchmarks.suite.runner import world_source
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.policies.controller import TURN_RATE, wheel_speeds
from limslam_agent.policies.simple_policies import LAP_SPEED
from limslam_agent.runs.policies import Tour
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.bounds import Roadmap
from limslam_env.envs.parallel_env import LimSlamParallelEnv
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.worlds.formats.loading import load_world
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig, floor_plan
from limslam_env.worlds.world import World

PILLARS = "pillars:"
"""Beginning of the names of floor plans with many pillars; the seed follows."""

_PILLARS = FloorPlanConfig(obstacles=6.0, obstacle_size=(0.2, 0.35), slanted=0.0)
_CANDIDATES = 8  # places of which the next goal is chosen
_NEW = 0.6  # share of goals that are far from all where the robot has been
LEAST_WAY = 1.0
"""The least distance to the next goal, m."""
_BEAM_BEGINS = 0.5  # share of the drive after which one beam is late
_BACK, _TURN = 0.5, 1.5  # s of driving back from an obstacle, and of the longest turn after that

Driver = Callable[[FloatArray, bool], FloatArray]
"""Wheel speeds (2,) by the true pose (3,) and whether the robot touches something."""


def world_of(name: str) -> World:
    """The world of a cell, by its name."""
    if not name.startswith(PILLARS):
        return load_world(world_source(name))
    generator = np.random.default_rng(int(name.removeprefix(PILLARS)))
    return replace(floor_plan(_PILLARS, generator, RobotSpec().radius), name=name)


def recorded_drive(row: Row, world: World, seed: int, jitter: float) -> RecordedLog:
    """The drive of a row, with the readings that its robot reports. It is the same for the same
    arguments.

    ``jitter`` is the standard deviation of further noise of the ranges, m, by which the noise of
    the scoreboard itself is measured.
    """
    robot, generator = RobotSpec(), np.random.default_rng([seed, 1])
    turns = np.zeros(len(robot.beams))
    if row.fault == "turned beam":
        turns[seed % len(robot.beams)] = math.radians(DRIVE_FAULTS[row.fault])
    true_robot = RangeSensor(0.0, turns=tuple(turns.tolist())).mounted(robot)
    noise = (
        row.true_noise
        if row.true_noise.sensor_noise
        else replace(row.true_noise, sensor_noise=row.noise)
    )
    env = LimSlamParallelEnv(
        world, robot=true_robot, noise=noise, num_robots=1, coverage_goal=None, max_cycles=None
    )
    observed, infos = env.reset(seed=seed)
    (name,) = observed
    drive = (
        _bumps(robot, generator)
        if row.bumps
        else _from_place_to_place(env, infos[name]["pose"], generator)
    )
    rows = [(observed[name], infos[name])]
    for _ in range(round(row.seconds / robot.control_period)):
        action = drive(infos[name]["pose"], infos[name]["collision"])
        observed, _, _, _, infos = env.step({name: action})
        rows.append((observed[name], infos[name]))
    ranges, wheels = (
        np.array([seen[key] for seen, _ in rows], dtype=float) for key in ("ranges", "wheels")
    )
    true = np.array([info["pose"] for _, info in rows])
    ranges = shaken(ranges, robot, jitter, seed)
    time = robot.control_period * np.arange(float(len(rows)))
    if row.fault:
        begin = time[round(_BEAM_BEGINS * len(rows))] if row.fault == "delayed" else 0.0
        slips = drawn_slips(len(rows), generator) if row.fault == "slips" else {}
        ranges, wheels = with_fault(
            Fault(row.fault, begin, seed, robot, slips), ranges, wheels, time
        )
    return RecordedLog(
        robot=robot,
        time=time,
        ranges=ranges.astype(np.float32),
        has_scan=np.ones(len(rows), dtype=np.bool_),
        start_pose=true[0],
        wheels=wheels,
        true_pose=true,
    )


def shaken(ranges: FloatArray, robot: RobotSpec, jitter: float, seed: int) -> FloatArray:
    """Ranges (t, n_beams), m, with noise of a standard deviation, m, on those that show a wall."""
    if not jitter:
        return ranges
    noisy = ranges + jitter * np.random.default_rng([seed, 2]).standard_normal(ranges.shape)
    return np.where((ranges > robot.too_near) & (ranges < robot.too_far), noisy, ranges)


def _from_place_to_place(
    env: LimSlamParallelEnv, start: FloatArray, generator: np.random.Generator
) -> Driver:
    """Drive to a place far from all where the robot has been, or to one that it may have seen
    before, and so on.
    """
    roads, been = Roadmap(env.world, env.robot.radius, start[:2]), [start[:2]]

    def plan(pose: FloatArray) -> FloatArray:
        while True:
            goal, _ = next_place(roads, been, generator)
            way = roads.way(pose[:2], goal) if np.hypot(*(goal - pose[:2])) > LEAST_WAY else None
            if way is not None:
                been.extend(way)
                return way

    tour = Tour(env.robot, plan, tours=1_000_000)

    def drive(pose: FloatArray, is_touching: bool) -> FloatArray:
        del is_touching
        tour.observe_truth(pose)
        return tour.act(None)

    return drive


def next_place(
    roads: Roadmap, been: list[FloatArray], generator: np.random.Generator, *, revisits: bool = True
) -> tuple[FloatArray, float]:
    """A place (2,), m, to drive to, and how far the farthest of some places is from all where the
    robot has been, m.

    Mostly it is that farthest one, and otherwise one that the robot may have seen before; without
    ``revisits`` never.
    """
    some = generator.choice(roads.places, _CANDIDATES)
    apart = np.hypot(*(some[:, None] - np.array(been)).transpose(2, 0, 1)).min(axis=1)
    goal = some[np.argmax(apart)] if not revisits or generator.random() < _NEW else some[0]
    return goal, float(apart.max())


def _bumps(robot: RobotSpec, generator: np.random.Generator) -> Driver:
    """Drive straight on, push what is in the way for a moment, drive back, and turn by chance."""
    period, plan = robot.control_period, list[FloatArray]()

    def drive(pose: FloatArray, is_touching: bool) -> FloatArray:
        del pose
        if is_touching and not plan:
            pushing = int(generator.integers(1, 8))
            turning = int(generator.integers(3, round(_TURN / period)))
            turn = float(generator.choice((-TURN_RATE, TURN_RATE)))
            plan.extend([wheel_speeds(LAP_SPEED, 0.0, robot)] * pushing)
            plan.extend([wheel_speeds(-LAP_SPEED, 0.0, robot)] * round(_BACK / period))
            plan.extend([wheel_speeds(0.0, turn, robot)] * turning)
        return plan.pop(0) if plan else wheel_speeds(LAP_SPEED, 0.0, robot)

    return drive
