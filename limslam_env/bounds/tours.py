"""Tours for a driver that knows the true map."""

from typing import NamedTuple

import numpy as np

from limslam_env.bounds.roadmap import Roadmap
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec
from limslam_env.worlds.world import World, WorldError


class Speeds(NamedTuple):
    """Speeds of a tour: m/s on straight lines, and rad/s of turns on the spot."""

    drive: float
    turn: float


def poses_along(start: FloatArray, way: FloatArray, robot: RobotSpec, speeds: Speeds) -> FloatArray:
    """Poses (n, 3) at each control step from ``start`` (3,) on along waypoints (k, 2), m.

    The robot turns on the spot towards each waypoint, drives there on a straight line, and continues in the next step.
    """
    points = np.vstack((start[None, :2], way))
    spans = np.diff(points, axis=0)
    lengths = np.hypot(*spans.T)
    moves = lengths > 1e-9
    points, spans, lengths = points[np.append(True, moves)], spans[moves], lengths[moves]
    turns = wrap_angle(np.diff(np.append(start[2], np.arctan2(spans[:, 1], spans[:, 0]))))
    headings = start[2] + np.append(0.0, np.cumsum(turns))
    # Numbers of control steps: of the turn, of the drive, and of the rest of the step in which the drive ends.
    turning = np.abs(turns) / (speeds.turn * robot.control_period)
    driving = lengths / (speeds.drive * robot.control_period)
    waiting = np.ceil(turning + driving - 1e-6) - turning - driving
    times = np.append(0.0, np.cumsum(np.column_stack((turning, driving, waiting))))
    steps = np.arange(round(times[-1]) + 1)
    x, y = (np.interp(steps, times, np.repeat(points[:, axis], 3)[1:-1]) for axis in (0, 1))
    return np.column_stack((x, y, np.interp(steps, times, np.repeat(headings, 3)[2:])))


def loop_tour(world: World, robot: RobotSpec, start: FloatArray, laps: int = 1) -> FloatArray:
    """Waypoints (k, 2), m, of ``laps`` rounds of the world's loop from a pose (3,).

    Raises
    ------
    WorldError
        If there is no room to drive at the start or along the loop.
    """
    place = np.asarray(start, dtype=float)[:2]
    first = (int(np.argmin(np.hypot(*(world.loop - place).T))) + 1) % len(world.loop)
    corners = np.tile(np.roll(world.loop, -first, axis=0), (laps, 1))
    roads = Roadmap(world, robot.radius, place)
    ways = [roads.way(here, there) for here, there in zip((place, *corners[:-1]), corners, strict=True)]
    if any(way is None for way in ways):
        raise WorldError(f"world {world.name!r}: a robot of {robot.radius:g} m radius cannot drive along its loop")
    return np.vstack([way for way in ways if way is not None])
