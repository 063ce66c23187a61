"""Somebody who walks through a building while a robot drives there, as the beams see them."""

import numpy as np

from limslam_env.bounds import Roadmap, Speeds, poses_along
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.worlds.world import World

_SPEED = 0.5  # m/s
_TURN = 3.0  # rad/s, on the spot
_CANDIDATES = 4  # places of which the next one is chosen
_LONGEST_STOP = 10.0  # s
_KEPT = 0.25  # m that a person stays away from the robot's body


def walk(
    world: World,
    robot: RobotSpec,
    radius: float,
    driven: FloatArray,
    generator: np.random.Generator,
) -> FloatArray:
    """Positions (t, 2), m, of a person of a ``radius``, m, who walks from place to place and stops
    there, while a robot drives along poses (t, 3).

    The next place is the one of some that is nearest to the robot. Near the robot the person waits,
    and steps back if it comes nearer.
    """
    roads = Roadmap(world, radius, driven[len(driven) // 2, :2])
    away = np.hypot(*(roads.places - driven[0, :2]).T)
    at = roads.places[generator.choice(np.flatnonzero(away >= min(1.0, away.max())))]
    steps = [at[None]]
    while (count := sum(map(len, steps))) < len(driven):
        some = generator.choice(roads.places, _CANDIDATES)
        goal = some[np.argmin(np.hypot(*(some - driven[count, :2]).T))]
        way = roads.way(at, goal) if np.hypot(*(goal - at)) else None
        if way is None:
            continue
        heading = np.arctan2(*(way[0] - at)[::-1])
        leg = poses_along(np.array([*at, heading]), way, robot, Speeds(_SPEED, _TURN))[1:, :2]
        stop = int(generator.uniform(0.0, _LONGEST_STOP) / robot.control_period)
        steps += [leg, np.tile(goal, (stop, 1))]
        at = goal
    return _kept_clear(np.concatenate(steps), driven, radius + robot.radius + _KEPT)


def _kept_clear(way: FloatArray, driven: FloatArray, distance: float) -> FloatArray:
    """Where a person is who walks along points (t, 2), one a step, and never comes nearer to the
    robot than a distance, m, on purpose: then they stay, or go back.
    """
    at = 0
    places = np.empty((len(driven), 2))
    for step, pose in enumerate(driven):
        choices = way[max(at - 1, 0) : at + 2][::-1]
        away = np.hypot(*(choices - pose[:2]).T)
        chosen = int(np.argmax(away >= distance)) if (away >= distance).any() else np.argmax(away)
        places[step] = choices[chosen]
        at = min(at + 1, len(way) - 1) - int(chosen)
    return places


def ranges_to(
    centres: FloatArray, radius: float, robot: RobotSpec, poses: FloatArray
) -> FloatArray:
    """Ranges (t, n_beams), m, of a robot at poses (t, 3) to a disc at centres (t, 2); infinite
    where a beam passes by.
    """
    angles = poses[:, 2:] + robot.beam_angles
    cosine = np.cos(poses[:, 2])
    sine = np.sin(poses[:, 2])
    turned = np.stack((np.stack((cosine, -sine), -1), np.stack((sine, cosine), -1)), axis=1)
    origins = poses[:, None, :2] + np.einsum("tij,bj->tbi", turned, robot.beam_origins)
    to_centre = centres[:, None] - origins
    along = to_centre[..., 0] * np.cos(angles) + to_centre[..., 1] * np.sin(angles)
    squared = radius**2 - (to_centre**2).sum(axis=-1) + along**2
    nearest = along - np.sqrt(np.maximum(squared, 0.0))
    is_met = (squared > 0.0) & (along > 0.0)
    return np.where(is_met, np.maximum(nearest, robot.min_ranges), np.inf)
