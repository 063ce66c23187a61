"""The simulation of one or several robots in one world: physics, sensors, odometry and the ground
truth.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from limslam_env.config import NoiseConfig
from limslam_env.geometry import BoolArray, FloatArray, IntArray, ReadingArray
from limslam_env.interface import RobotSpec
from limslam_env.kernels.coverage import CellGrid
from limslam_env.kernels.observation import drive_and_observe, new_scene
from limslam_env.kernels.readings import TRUE_AXLE
from limslam_env.simulation.coverage import CELL, CoverageGrid, coverage_grid
from limslam_env.simulation.imu import Imu
from limslam_env.simulation.physics import Physics
from limslam_env.simulation.sensors import StepDraws, beam_table, build_wall_index, noise_table
from limslam_env.simulation.starts import drawn_starts, starting_places
from limslam_env.worlds.world import World

_CELL_AREA = CELL**2


class Readings(NamedTuple):
    """The measurements of all robots after a step, in new arrays.

    ``ranges`` (n, n_beams) and ``wheels`` (n, 2), left and right wheel travel, are float32, in m.
    ``yaw`` (n, 1) are headings by inertial measurement units, rad; None without such units.
    """

    ranges: ReadingArray
    wheels: ReadingArray
    yaw: ReadingArray | None = None


class Truth(NamedTuple):
    """The ground truth after a step. It is for evaluation, never for an agent.

    Attributes
    ----------
    poses, contact
        (n, 3), m and rad; and which robots touched something.
    time, coverage
        Since the reset, s; and the share of the coverable cells that have been seen by any robot, 0
        to 1.
    new_area
        Coverable area that each robot was the first to see in this step, m^2. Area that two robots
        see in the same step counts for the robot with the lower number.
    wall_seen
        (n, n_beams): index of the wall that each beam's latest measurement hit, -1 nothing, -2 a
        robot.
    """

    poses: FloatArray
    time: float
    coverage: float
    new_area: list[float]
    contact: list[bool]
    wall_seen: IntArray


class Simulation:
    """``num_robots`` robots of one kind in a world.

    The attribute ``coverage_grid``, the cells that count for coverage, is known after the first
    reset.

    Raises
    ------
    WorldError
        If a robot cannot start in the world or could leave it.
    """

    def __init__(self, world: World, robot: RobotSpec, num_robots: int = 1) -> None:
        world.check(robot.radius)
        self.world = world
        self.robot = robot
        self.num_robots = num_robots
        self.coverage_grid: CoverageGrid
        self._walls = build_wall_index(world.edges)
        self._physics = Physics(world.edges, robot.radius, num_robots)
        self._beams = beam_table(robot)
        self._farthest = robot.max_wheel_speed * robot.control_period

    @property
    def seen(self) -> BoolArray:
        """Which cells of the coverage grid have truly been seen (rows, columns); a copy."""
        return self._scene.seen.copy()

    @property
    def poses(self) -> FloatArray:
        """Pose of each robot (n, 3), m and rad; a copy."""
        return self._physics.poses

    def reset(
        self,
        seeds: np.random.SeedSequence,
        noise: NoiseConfig,
        start: FloatArray | None = None,
        *,
        imu: bool = False,
    ) -> tuple[Readings, Truth]:
        """Begin again at ``start``, pose (3,) of robot 0 or poses (num_robots, 3), or else at the
        world's starts.

        Start, ranges, wheels, settings and headings get a generator each from the seeds, so that
        runs with other noise share their starts and their draws. Ranges in ``noise`` are drawn from
        now. With ``imu``, the robots read their headings, too.

        Raises
        ------
        WorldError
            If a given start collides, lies outside, or there is no room for all robots.
        """
        # The fifth seed draws the world of a task.
        starts, ranges, wheels, settings, _, headings = (
            np.random.default_rng(part) for part in seeds.spawn(6)
        )
        robot = self.robot
        count = self.num_robots
        places = starting_places(self.world, robot, count, start)
        poses = drawn_starts(places, self.world, robot, count, starts)
        drawn = noise.drawn(settings)
        self._noise = noise_table(vars(drawn), robot)
        self._imu = Imu(headings, drawn, robot.control_period) if imu else None
        self._draws = StepDraws(ranges, wheels, count, len(robot.beams))
        self._physics.place(poses, float(self._noise[TRUE_AXLE]))
        self.coverage_grid = grid = coverage_grid(self.world, robot, poses)
        self._total = max(grid.total, 1)
        self._covered = self._steps = 0
        self._scene = new_scene(
            self._physics.current,
            self._physics.motion,
            robot.radius,
            self._beams,
            self._noise,
            self._walls,
            CellGrid(np.zeros_like(grid.coverable), grid.coverable, grid.area),
        )
        drive_and_observe(True, 0, self._draws.next(), *self._scene)  # noqa: FBT003 (kernels take no keywords)
        return self._results([False] * count)

    def carry(self, number: int, pose: FloatArray) -> None:
        """Carry a robot to another pose (3,), where it reads its beams in the next step. Its wheels
        do not turn.
        """
        self.world.check_poses(np.asarray(pose, dtype=float)[None], self.robot.radius)
        poses = self._physics.poses
        poses[number] = pose
        self._physics.place(poses, float(self._noise[TRUE_AXLE]))

    def step(self, actions: Sequence[tuple[float, float]]) -> tuple[Readings, Truth]:
        """Drive for one control period with each robot's left and right wheel speed, fractions of
        the maximum.
        """
        if len(actions) != self.num_robots:
            raise ValueError(
                f"there must be an action for each of {self.num_robots} robots, not {len(actions)}"
            )
        self._steps += 1
        draws = self._draws.next()
        travel = self._scene.travel
        for robot, (left, right) in enumerate(actions):
            travel[robot, 0], travel[robot, 1] = (
                _clipped(left) * self._farthest,
                _clipped(right) * self._farthest,
            )
        contact = [False] * self.num_robots
        if not drive_and_observe(False, self._steps, draws, *self._scene):  # noqa: FBT003
            contact = self._physics.step(self._scene.ground.tolist(), self.robot.control_period)
            drive_and_observe(True, self._steps, draws, *self._scene)  # noqa: FBT003
        return self._results(contact)

    def _results(self, contact: list[bool]) -> tuple[Readings, Truth]:
        new_cells = self._scene.new_cells.tolist()
        self._covered += sum(new_cells)
        time = self._steps * self.robot.control_period
        coverage = self._covered / self._total
        new_area = [cells * _CELL_AREA for cells in new_cells]
        truth = Truth(
            self._physics.poses, time, coverage, new_area, contact, self._scene.hits.copy()
        )
        yaw = None if self._imu is None else self._imu.read(truth.poses[:, 2])
        return Readings(self._scene.ranges.copy(), self._scene.wheels.copy(), yaw), truth


def _clipped(speed: float) -> float:
    return speed if -1.0 <= speed <= 1.0 else math.copysign(1.0, speed)
