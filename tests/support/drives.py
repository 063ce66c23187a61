"""Drives for tests of estimators: along walls of nothing but geometry, and round the square by the
truth.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from limslam_agent import AgentConfig, LineSlam
from limslam_agent.slam.core.diagnostics import AssociationRecord
from limslam_agent.slam.slam import Estimator
from limslam_env import LimSlamEnv, NoiseConfig, Observation, RobotSpec, load_world
from limslam_env.geometry import FloatArray, IntArray, se2, segment
from limslam_env.interface import beams_on_rim

ROBOT = RobotSpec()
FOUR_BEAMS = RobotSpec(beams=beams_on_rim((90.0, 45.0, -45.0, -90.0), 0.10))
SQUARE = load_world("square")
SPEED = 0.25
STEP = 0.025


def placed(walls: FloatArray, start: FloatArray) -> FloatArray:
    """Walls (n, 4) given about the start, in the world."""
    return se2.transform_points(start, walls.reshape(-1, 2)).reshape(-1, 4)


def local(points: FloatArray, start: FloatArray) -> FloatArray:
    """Points (n, 2) of the world as seen from the start."""
    return se2.transform_points(se2.inverse(start), points)


def ranges_at(pose: FloatArray, walls: FloatArray, robot: RobotSpec = ROBOT) -> FloatArray:
    """Exact readings (n_beams,): where each beam first crosses a wall."""
    origins = se2.transform_points(pose, robot.beam_origins)[:, None]
    headings = pose[2] + robot.beam_angles
    rays = np.column_stack((np.cos(headings), np.sin(headings)))[:, None]
    spans = walls[:, 2:] - walls[:, :2]
    to_wall = walls[:, :2] - origins
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = rays[..., 0] * spans[:, 1] - rays[..., 1] * spans[:, 0]
        reach = (to_wall[..., 0] * spans[:, 1] - to_wall[..., 1] * spans[:, 0]) / cross
        share = (to_wall[..., 0] * rays[..., 1] - to_wall[..., 1] * rays[..., 0]) / cross
    meets = (np.abs(cross) > 1e-12) & (reach > 0.0) & (share >= 0.0) & (share <= 1.0)
    nearest = np.where(meets, reach, np.inf).min(axis=1, initial=np.inf)
    return np.asarray(np.minimum(np.maximum(nearest, robot.min_ranges), robot.max_ranges))


def drive(
    walls: FloatArray,
    start: FloatArray,
    wheels: list[tuple[float, float]],
    robot: RobotSpec = ROBOT,
    noise: float = 0.0,
    seed: int = 0,
) -> tuple[list[Observation], FloatArray]:
    """Observations, and true poses (n, 3), along given wheel travels; the first is taken at the
    start.
    """
    generator = np.random.default_rng(seed)
    pose = start
    poses = []
    observations = []
    for travel in [(0.0, 0.0), *wheels]:
        pose = se2.compose(pose, se2.arc(*se2.wheels_to_arc(np.array(travel), robot.axle)))
        poses.append(pose)
        ranges = ranges_at(pose, walls, robot)
        seen = ranges < robot.too_far
        ranges[seen] += noise * generator.standard_normal(len(ranges))[seen]
        ranges = np.clip(ranges, robot.min_ranges, robot.max_ranges)
        observations.append(
            Observation(ranges=ranges.astype(np.float32), wheels=np.array(travel, dtype=np.float32))
        )
    return observations, np.array(poses)


def straight(metres: float) -> list[tuple[float, float]]:
    """Straight ahead, or back if negative."""
    return [(math.copysign(STEP, metres),) * 2] * round(abs(metres) / STEP)


def turn(degrees: float, robot: RobotSpec = ROBOT) -> list[tuple[float, float]]:
    """On the spot, counter-clockwise."""
    number = max(round(abs(degrees) / 5.0), 1)
    each = 0.5 * robot.axle * math.radians(degrees) / number
    return [(-each, each)] * number


def along(
    places: list[tuple[float, float]], heading: float = 0.0, robot: RobotSpec = ROBOT
) -> list[tuple[float, float]]:
    """From place to place, turning on the spot."""
    wheels: list[tuple[float, float]] = []
    for (x1, y1), (x2, y2) in pairwise(places):
        towards = math.atan2(y2 - y1, x2 - x1)
        change = math.degrees(se2.wrap_angle(towards - heading))
        wheels += [
            *(turn(change, robot) if abs(change) > 1e-6 else []),
            *straight(math.hypot(x2 - x1, y2 - y1)),
        ]
        heading = towards
    return wheels


def recorded(
    observations: list[Observation],
    config: AgentConfig,
    start: FloatArray,
    robot: RobotSpec = ROBOT,
) -> tuple[Estimator, list[AssociationRecord]]:
    """The mapping half during a drive, and what became of each observed line."""
    slam = LineSlam(robot, config, start)
    records = list[AssociationRecord]()
    slam.on_association = records.append
    for observation in observations:
        slam.step(observation)
    return slam, records


def slam_after(
    observations: list[Observation],
    config: AgentConfig,
    start: FloatArray,
    robot: RobotSpec = ROBOT,
) -> tuple[Estimator, list[AssociationRecord]]:
    """As :func:`recorded`, with the readings used that were still pending at the end of the
    drive.
    """
    slam, records = recorded(observations, config, start, robot)
    slam.finish()
    return slam, records


@dataclass(frozen=True, eq=False)
class LapLog:
    """Laps round the square corridor by one robot, a row a step: what it was told, and what was
    true.
    """

    observations: list[Observation]
    poses: FloatArray
    wall_seen: IntArray

    def __len__(self) -> int:
        return len(self.poses)


def laps_of_square(
    noise: float,
    seed: int = 0,
    laps: float = 1.0,
    robot: RobotSpec = FOUR_BEAMS,
    *,
    wheel_variance: float = 2e-5,
    start: tuple[float, float, float] = (1.0, 1.0, 0.0),
) -> LapLog:
    """Round the corridor at 0.25 m/s, driven by somebody who knows the true pose; ``laps`` in
    quarters.
    """
    env = LimSlamEnv(
        SQUARE,
        robot=robot,
        noise=NoiseConfig(sensor_noise=noise, wheel_variance=wheel_variance),
        coverage_goal=None,
    )
    sides = round(4 * laps)
    route = [SQUARE.loop[(1 + number) % 4].tolist() for number in range(sides)]
    seen, info = env.reset(seed=seed, options={"start": start})
    observations = [seen]
    poses = [info["pose"]]
    walls = [info["wall_seen"]]
    while route:
        seen, _, _, _, info = env.step(np.array(_towards(poses[-1], route[0], robot)))
        observations.append(seen)
        poses.append(info["pose"])
        walls.append(info["wall_seen"])
        if math.hypot(*(np.array(route[0]) - poses[-1][:2])) < 0.3:
            route.pop(0)
    env.close()
    return LapLog(observations, np.array(poses), np.array(walls))


def _towards(pose: FloatArray, goal: list[float], robot: RobotSpec) -> tuple[float, float]:
    """Wheel speeds that bring a true pose to a point."""
    error = se2.wrap_angle(math.atan2(goal[1] - pose[1], goal[0] - pose[0]) - float(pose[2]))
    most = 2.0 * (robot.max_wheel_speed - SPEED) / robot.axle
    difference = 0.5 * robot.axle * min(max(2.0 * error, -most), most)
    return (SPEED - difference) / robot.max_wheel_speed, (
        SPEED + difference
    ) / robot.max_wheel_speed


def room(low_x: float, low_y: float, high_x: float, high_y: float) -> FloatArray:
    """Four walls (4, 4)."""
    return segment.polygon_edges(
        np.array([[low_x, low_y], [high_x, low_y], [high_x, high_y], [low_x, high_y]])
    )
