"""The offline optimum: the best estimate of a path from a complete log, given the true data association.

All poses and all wall lines are estimated together by least squares (F. Dellaert and M. Kaess, "Factor Graphs for
Robot Perception", 2017). The estimate uses the true wall of each reading and nothing else of the truth: neither the
positions of the walls nor that two of them are collinear or perpendicular. The ratio of an estimator's error to the
error of this optimum shows how much the estimator loses. Needs gtsam, the extra ``limits``.
"""

import math
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limslam_env.bounds.optimum_model import fitted_lines, motions_between, usable_readings
from limslam_env.bounds.optimum_solver import Problem, Solution, chi_square, moved_to, solve, without_grazing
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.line import normalise
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec

LEAST_RANGE_STD = 0.005  # m

# Sideways motion of this size, m, adds up to less than a millimetre in a run and keeps the equations regular.
_ASIDE_STD = 1e-5
_LEAST_VARIANCE = 1e-12


@dataclass(frozen=True, eq=False)
class OfflineOptimum:
    """The poses and wall lines with the least sum of squared residuals.

    Attributes
    ----------
    poses
        (t, n, 3), m and rad.
    walls, lines
        Indices (m,) of the walls that were read, and their lines (m, 2) as (r, theta), m and rad.
    iterations
        Gauss-Newton steps taken in all.
    is_converged
        Whether the last of them moved no pose by more than a ten millionth of a metre or radian.
    chi_square, degrees_of_freedom
        Sum of the squared residuals in standard deviations, and its mean where the noise is as assumed.
    """

    poses: FloatArray
    walls: IntArray
    lines: FloatArray
    iterations: int
    is_converged: bool
    chi_square: float
    degrees_of_freedom: int


class UnreadWallsError(ValueError):
    """A log in which no beam has measured a wall."""


def require_gtsam() -> None:
    """Make sure that gtsam is installed.

    Raises
    ------
    ValueError
        If gtsam is not installed.
    """
    if find_spec("gtsam") is None:
        raise ValueError("the offline optimum needs gtsam, which is not installed: pip install 'limslam[limits]'")


def solve_optimum(
    robot: RobotSpec,
    guess: FloatArray,
    wheels: FloatArray,
    ranges: FloatArray,
    wall_seen: IntArray,
    *,
    range_std: float,
    wheel_variance: float,
    contact: BoolArray | None = None,
) -> OfflineOptimum:
    """Compute the offline optimum of a log.

    Four kinds of readings are left out: readings that hit nothing, readings that hit a robot, repeated readings of slow
    sensors, and readings at grazing angles (cosine of the angle of incidence below 0.2).

    Parameters
    ----------
    robot
        Body and beams of each of the n robots.
    guess
        Poses (t, n, 3), m and rad, from which the iteration begins, such as the true poses. The guess decides to which
        local minimum the iteration converges. The first row is the known start.
    wheels, ranges, wall_seen
        (t, n, 2), m, (t, n, n_beams), m, and (t, n, n_beams): the log, row 0 the moment of the reset, and the wall that
        each beam truly hit (-1 nothing, -2 a robot).
    range_std
        Assumed standard deviation of a range, m; 5 mm where it is less.
    wheel_variance
        Assumed variance of a wheel's reported travel, m^2 per metre.
    contact
        (t, n), in which rows a robot touches something: in these rows the wheels slip, and their
        travel only bounds the motion of the robot. None: no contact at all.

    Raises
    ------
    ValueError
        If gtsam is missing, arrays do not belong together or a number is not finite.
    UnreadWallsError
        If no beam has measured a wall.
    """
    require_gtsam()
    guess, wheels, ranges = (np.asarray(values, dtype=float) for values in (guess, wheels, ranges))
    _check(robot, guess, wheels, ranges, np.asarray(wall_seen), contact, range_std, wheel_variance)
    readings, walls = usable_readings(robot, ranges, np.asarray(wall_seen))
    if not len(readings):
        raise UnreadWallsError("no beam has measured a wall, so that the offline optimum does not exist")
    motions, stds = _measured_motions(wheels, wheel_variance, contact)
    std = max(range_std, LEAST_RANGE_STD)
    anchors, lines = fitted_lines(guess, readings, len(walls), std)
    problem = Problem(robot.axle, guess[0], motions, stds, readings, std, anchors, lines)
    begin = moved_to(problem, motions_between(guess, robot.axle), lines)
    first = solve(without_grazing(problem, begin), begin)
    # The first solution used the angles of the guess to find grazing readings.
    problem = without_grazing(problem, first.state)
    best = solve(problem, first.state)
    return _optimum(problem, best, first.iterations, walls)


def _optimum(problem: Problem, best: Solution, iterations: int, walls: IntArray) -> OfflineOptimum:
    state, seen = best.state, np.unique(problem.readings.line)
    lines, anchors = state.lines[seen], problem.anchors[seen]
    normals = np.stack((np.cos(lines[:, 1]), np.sin(lines[:, 1])), axis=-1)
    about_origin = np.column_stack((lines[:, 0] + np.sum(normals * anchors, axis=1), lines[:, 1]))
    return OfflineOptimum(
        poses=np.concatenate((state.poses[..., :2], wrap_angle(state.poses[..., 2:])), axis=-1),
        walls=walls[seen],
        lines=normalise(about_origin),
        iterations=iterations + best.iterations,
        is_converged=best.is_converged,
        chi_square=chi_square(problem, state),
        degrees_of_freedom=len(problem.readings) - 2 * len(seen),
    )


def _measured_motions(
    wheels: FloatArray, wheel_variance: float, contact: BoolArray | None
) -> tuple[FloatArray, FloatArray]:
    """Motions (t - 1, n, 3) that the wheels report, and their standard deviations, m."""
    motions = np.concatenate((wheels[1:], np.zeros_like(wheels[1:, :, :1])), axis=-1)
    stds = np.full_like(motions, _ASIDE_STD)
    stds[..., :2] = np.sqrt(wheel_variance * np.abs(wheels[1:]) + _LEAST_VARIANCE)
    if contact is not None:
        farthest = np.abs(wheels[1:]).max(axis=-1, keepdims=True)
        stds = np.where(np.asarray(contact)[1:, :, None], np.maximum(stds, farthest), stds)
    return motions, stds


def _check(
    robot: RobotSpec,
    guess: FloatArray,
    wheels: FloatArray,
    ranges: FloatArray,
    wall_seen: IntArray,
    contact: BoolArray | None,
    range_std: float,
    wheel_variance: float,
) -> None:
    if wheels.ndim != 3 or not all(wheels.shape) or wheels.shape[2] != 2:
        raise ValueError(f"wheels must be (steps, robots, 2), not {wheels.shape}")
    steps, robots, _ = wheels.shape
    read = (steps, robots, len(robot.beams))
    shapes: dict[str, tuple[NDArray[Any], tuple[int, ...]]] = {
        "guess": (guess, (steps, robots, 3)),
        "ranges": (ranges, read),
        "wall_seen": (wall_seen, read),
    }
    if contact is not None:
        shapes["contact"] = np.asarray(contact), (steps, robots)
    for name, (values, shape) in shapes.items():
        if values.shape != shape:
            raise ValueError(f"{name} must have the shape {shape} beside wheels of {wheels.shape}, not {values.shape}")
    for name, values in (("guess", guess), ("wheels", wheels), ("ranges", ranges)):
        if not np.isfinite(values).all():
            raise ValueError(f"{name} hold a number that is not finite")
    for name, number in (("range_std", range_std), ("wheel_variance", wheel_variance)):
        if not (math.isfinite(number) and number >= 0.0):
            raise ValueError(f"{name} must be a number of 0 or more, not {number:g}")
