"""Drives that depend on the seed and not on the estimator, as logs of wheel travel with the
truth.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.scoreboard.rows import Row
from benchmarks.suite.faults import Fault, drawn_slips, with_fault
from benchmarks.suite.person import ranges_to, walk
from limslam_agent.logs.lost_reports import gaps_in
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.policies.controller import TURN_RATE, wheel_speeds
from limslam_agent.policies.simple_policies import LAP_SPEED
from limslam_agent.runs.policies import Tour
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.bounds import Roadmap
from limslam_env.envs.parallel_env import LimSlamParallelEnv
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.worlds.world import World

_CANDIDATES = 8  # places of which the next goal is chosen
_NEW = 0.6  # share of goals that are far from all where the robot has been
LEAST_WAY = 1.0
"""The least distance to the next goal, m."""
_BEAM_BEGINS = 0.5  # share of the drive after which one beam is late
# s of driving back from an obstacle, and of the longest turn after that
_BACK = 0.5
_TURN = 1.5

Driver = Callable[[FloatArray, bool], FloatArray]
"""Wheel speeds (2,) by the true pose (3,) and whether the robot touches something."""


def recorded_drive(row: Row, world: World, seed: int) -> RecordedLog:
    """The drive of a row, with the readings that its robot reports. It is the same for the same
    arguments.
    """
    robot = row.robot
    generator = np.random.default_rng([seed, 1])
    fault = None if row.fault is None else Fault(row.fault, 0.0, seed, robot, size=row.fault_size)
    turns = np.zeros(len(robot.beams))
    if fault is not None and fault.kind == "turned beam":
        turns[fault.beam] = math.radians(fault.size)
    true_robot = RangeSensor(0.0, turns=tuple(turns.tolist())).mounted(robot)
    ranges, wheels, true = _driven(row, world, true_robot, seed, generator)
    ranges = shaken(ranges, robot, row.jitter, seed)
    time = robot.control_period * np.arange(float(len(true)))
    if fault is not None:
        if fault.kind == "delayed":
            fault.begin = time[round(_BEAM_BEGINS * len(true))]
        if fault.kind == "slips":
            fault.script = drawn_slips(len(true), generator, fault.size)
        if fault.kind == "person":
            centres = walk(world, robot, fault.size, true, generator)
            to_person = ranges_to(centres, fault.size, true_robot, true)
            fault.script = to_person + row.noise * generator.standard_normal(ranges.shape)
        ranges, wheels, arrives = with_fault(fault, ranges, wheels, time)
        time = time[arrives]
        true = true[arrives]
    # As a reader of logs finds them.
    gaps = gaps_in(wheels, time, robot.control_period)
    return RecordedLog(
        robot=robot,
        time=time,
        ranges=ranges.astype(np.float32),
        has_scan=np.ones(len(time), dtype=np.bool_),
        start_pose=true[0],
        wheels=wheels,
        true_pose=true,
        gaps=tuple(gaps.tolist()),
    )


def _driven(
    row: Row, world: World, robot: RobotSpec, seed: int, generator: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Ranges (t, n_beams) and wheel travel (t, 2), m, and true poses (t, 3) of a row's drive."""
    noise = row.true_noise
    if not noise.sensor_noise:
        noise = replace(noise, sensor_noise=row.noise)
    env = LimSlamParallelEnv(
        world, robot=robot, noise=noise, num_robots=1, coverage_goal=None, max_cycles=None
    )
    observed, infos = env.reset(seed=seed)
    (name,) = observed
    start = infos[name]["pose"]
    drive = _bumps(robot, generator) if row.bumps else _from_place_to_place(env, start, generator)
    rows = [(observed[name], infos[name])]
    driving, standing = (round(each / robot.control_period) for each in (row.seconds, row.stands))
    for step in range(driving + standing):
        is_standing = driving // 2 <= step < driving // 2 + standing
        _, info = rows[-1]
        action = np.zeros(2) if is_standing else drive(info["pose"], info["collision"])
        observed, _, _, _, infos = env.step({name: action})
        rows.append((observed[name], infos[name]))
    ranges, wheels = (
        np.array([seen[key] for seen, _ in rows], dtype=float) for key in ("ranges", "wheels")
    )
    return ranges, wheels, np.array([info["pose"] for _, info in rows])


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
    roads = Roadmap(env.world, env.robot.radius, start[:2])
    been = [start[:2]]

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
    period = robot.control_period
    plan = list[FloatArray]()

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
