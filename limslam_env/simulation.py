"""N robots in one world, step by step: physics, sensors, odometry, and the truth beside them."""

from dataclasses import dataclass

import numpy as np

from limslam_env.config import NoiseConfig
from limslam_env.coverage import CELL, CoverageGrid, coverage_grid, mark_seen
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import Observation, RobotSpec
from limslam_env.odometry import reported_travel
from limslam_env.physics import Physics
from limslam_env.sensors import beam_rays, build_wall_index, noisy_ranges
from limslam_env.world import World, WorldError


@dataclass(frozen=True)
class Truth:
    """What is really so after a step. For scoring, never for an agent.

    Attributes
    ----------
    poses
        (n, 3), m and rad.
    time
        Since the reset, s.
    coverage
        Share of the coverable cells that have been seen, 0 to 1.
    new_area
        Coverable area seen for the first time in this step, m^2.
    contact
        (n,), which robots touched something.
    wall_seen
        (n, n_beams): index of the wall that each beam's latest measurement hit, -1 nothing, -2 a robot.
    """

    poses: FloatArray
    time: float
    coverage: float
    new_area: float
    contact: BoolArray
    wall_seen: IntArray


class Simulation:
    """Robots of one kind in a world.

    Parameters
    ----------
    world
        Where they are.
    robot
        What each of them is.
    num_robots
        How many there are.

    Raises
    ------
    WorldError
        If a robot cannot start in the world or could leave it.
    """

    def __init__(self, world: World, robot: RobotSpec, num_robots: int = 1) -> None:
        world.check(robot.radius)
        self.world, self.robot, self.num_robots = world, robot, num_robots
        self._index = build_wall_index(world.edges, robot.reach)

    @property
    def coverage_grid(self) -> CoverageGrid:
        """The cells that count for coverage, and where they lie."""
        return self._grid

    def reset(
        self, seeds: np.random.SeedSequence, noise: NoiseConfig, start: FloatArray | None = None
    ) -> tuple[list[Observation], Truth]:
        """Begin again.

        Parameters
        ----------
        seeds
            Start, ranges, wheels and settings get a generator each from it, so that runs with
            other noise share their starts and their draws.
        noise
            Ranges in it are drawn from now.
        start
            Pose (3,) of robot 0, or poses (num_robots, 3); the world's starts otherwise.

        Raises
        ------
        WorldError
            If a given start collides, lies outside, or there is no room for all robots.
        """
        starts, ranges, wheels, settings = (np.random.default_rng(part) for part in seeds.spawn(4))
        poses = self._starts(starts, start)
        self.noise = noise.drawn(settings)
        self._range_generator, self._wheel_generator = ranges, wheels
        self._physics = Physics(self.world.edges, self.robot.radius, self.robot.axle, poses)
        self._grid = coverage_grid(self.world, self.robot, poses)
        self._seen = np.zeros_like(self._grid.coverable)
        self._covered = 0
        self._steps = 0
        self._remainders = np.zeros((self.num_robots, 2))
        shape = (self.num_robots, len(self.robot.beams))
        self._ranges, self._hits = np.zeros(shape), np.zeros(shape, dtype=np.int64)
        return self._observe(np.zeros((self.num_robots, 2)), np.zeros(self.num_robots, dtype=bool))

    def step(self, actions: FloatArray) -> tuple[list[Observation], Truth]:
        """Drive for one control period with wheel speeds ``actions`` (n, 2), fractions of the maximum."""
        self._steps += 1
        travel = np.clip(actions, -1.0, 1.0) * (self.robot.max_wheel_speed * self.robot.control_period)
        contact = self._physics.step(travel, self.robot.control_period)
        return self._observe(travel, contact)

    def _observe(self, travel: FloatArray, contact: BoolArray) -> tuple[list[Observation], Truth]:
        poses = self._physics.poses
        self._measure(poses)
        observations: list[Observation] = []
        for robot in range(self.num_robots):
            wheels, self._remainders[robot] = reported_travel(
                travel[robot], self._remainders[robot], self.noise, self.robot.max_wheel_travel, self._wheel_generator
            )
            ranges = self._ranges[robot].astype(np.float32)
            observations.append({"ranges": ranges, "wheels": wheels.astype(np.float32)})
        covered = self._grid.count(self._seen)
        new_area = (covered - self._covered) * CELL**2
        self._covered = covered
        time = self._steps * self.robot.control_period
        share = covered / max(self._grid.total, 1)
        return observations, Truth(poses, time, share, new_area, contact, self._hits.copy())

    def _measure(self, poses: FloatArray) -> None:
        rays = beam_rays(poses, self.robot)
        lengths = rays.offsets + np.tile(self.robot.max_ranges, self.num_robots)
        distances, hits = self._index.cast(
            rays.origins, rays.directions, lengths, rays.owners, poses[:, :2].copy(), self.robot.radius
        )
        measures = self.robot.measures(self._steps)
        seen = np.tile(measures, self.num_robots)
        mark_seen(
            self._seen, self._grid, poses, rays.origins[seen], rays.directions[seen], distances[seen], self.robot.radius
        )
        shape = (self.num_robots, -1)
        ideal, hits = (distances - rays.offsets).reshape(shape), hits.reshape(shape)
        for robot in range(self.num_robots):
            reading = noisy_ranges(ideal[robot], hits[robot], self.robot, self.noise, self._range_generator)
            self._ranges[robot] = np.where(measures, reading, self._ranges[robot])
            self._hits[robot] = np.where(measures, hits[robot], self._hits[robot])

    def _starts(self, generator: np.random.Generator, start: FloatArray | None) -> FloatArray:
        given = np.zeros((0, 3)) if start is None else np.atleast_2d(np.asarray(start, dtype=float))
        if len(given) > self.num_robots:
            raise WorldError(f"{len(given)} starts for {self.num_robots} robots")
        poses: list[FloatArray] = []
        for pose in given:
            self.world.check_pose(pose, self.robot.radius)
            if not self._is_apart(pose, poses):
                raise WorldError(f"world {self.world.name!r}: two robots are to start in one place")
            poses.append(pose)
        for pose in self.world.starts:
            if len(poses) < self.num_robots and self._is_apart(pose, poses):
                poses.append(pose)
        if len(poses) < self.num_robots:
            self._draw_starts(generator, poses)
        return np.array(poses)

    def _draw_starts(self, generator: np.random.Generator, poses: list[FloatArray]) -> None:
        space = self.world.free_space(self.robot.radius)
        region = space.region_of(poses[0][:2]) if poses else space.largest_closed_region()
        for place in generator.permutation(space.centres(region)):
            pose = np.array([*place, generator.uniform(-np.pi, np.pi)])
            if self._is_apart(pose, poses):
                poses.append(pose)
            if len(poses) == self.num_robots:
                return
        raise WorldError(f"world {self.world.name!r}: no room for {self.num_robots} robots")

    def _is_apart(self, pose: FloatArray, poses: list[FloatArray]) -> bool:
        return all(np.hypot(*(pose[:2] - other[:2])) > 2.5 * self.robot.radius for other in poses)
