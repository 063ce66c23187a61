"""Pictures of a batch of environments, for the adapters that draw."""

import numpy as np
from numpy.typing import NDArray

from limslam_env.batch.batch import BatchSimulation, Results
from limslam_env.geometry import BoolArray
from limslam_env.interface import RobotSpec
from limslam_env.rendering.painter import Painter
from limslam_env.simulation.coverage import CoverageGrid
from limslam_env.simulation.simulation import Readings, Truth
from limslam_env.worlds.world import World


class BatchPictures:
    """Pictures of all environments of a batch, as the single environment draws them, but square.

    Parameters
    ----------
    simulation
        The batch.
    """

    def __init__(self, simulation: BatchSimulation) -> None:
        self._scenes = [_Scene(simulation, env) for env in range(simulation.num_envs)]
        self._painters = [Painter("rgb_array", square=True) for _ in self._scenes]

    def follow(self, results: Results) -> None:
        """Remember the state of all environments for later pictures."""
        times, coverages = results.time.tolist(), results.coverage.tolist()
        for env, (painter, scene) in enumerate(zip(self._painters, self._scenes, strict=True)):
            truth = Truth(results.poses[env], times[env], coverages[env], [], [], results.wall_seen[env])
            painter.follow(scene, Readings(results.ranges[env], results.wheels[env]), truth)

    def paint(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A picture (height, width, 3) of each environment; None before the first reset."""
        pictures = (painter.paint(scene) for painter, scene in zip(self._painters, self._scenes, strict=True))
        return tuple(picture for picture in pictures if picture is not None) or None


class _Scene:
    """One environment of a batch, as a painter takes it."""

    def __init__(self, simulation: BatchSimulation, env: int) -> None:
        self._simulation, self._env = simulation, env

    @property
    def world(self) -> World:
        return self._simulation.world(self._env)

    @property
    def robot(self) -> RobotSpec:
        return self._simulation.robot

    @property
    def coverage_grid(self) -> CoverageGrid:
        return self._simulation.coverage_grid(self._env)

    @property
    def seen(self) -> BoolArray:
        return self._simulation.seen(self._env)
