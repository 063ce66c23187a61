"""A robot that is carried to another place in the middle of a run."""

import numpy as np

from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.worlds.world import World, WorldError

LEAST_MOVE = 2.0
"""Least distance to which a robot is carried, m."""


def another_place(world: World, robot: RobotSpec, pose: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A random free pose (3,) that the robot could drive to, at least 2 m away from its pose (3,).

    Raises
    ------
    WorldError
        If there is no such place.
    """
    grid = world.free_space(robot.radius)
    places = grid.centres(grid.region_of(pose[:2]))
    far = places[np.hypot(*(places - pose[:2]).T) > LEAST_MOVE]
    if not len(far):
        raise WorldError(f"world {world.name!r} has no free place that is {LEAST_MOVE:g} m away from the robot")
    return np.array([*far[rng.integers(len(far))], rng.uniform(-np.pi, np.pi)])
