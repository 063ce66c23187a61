"""The measurement models of `offline_optimum`: residuals of wheels and beams, and their Jacobians.

A **motion** is (left, right, aside): the travel of both wheels and a shift to the left, m. The increment that it
causes is the exact arc of the wheels (the chord of :func:`limslam_env.geometry.se2.arc`) and the shift square to the
chord. Without the shift two wheels make increments with a covariance of rank 2, which has no inverse to weigh
residuals with. With it the increment between two poses determines the motion, and vice versa.

A **line** is (d, alpha) about an anchor point a of its own: the points x with n . (x - a) = d, where n is
(cos alpha, sin alpha). The anchor lies among the line's first readings, so that d is small, of either sign, and nearly
independent of alpha; (r, theta) about the world's origin breaks for lines through it, and couples r with theta
far away from it. It is a change of coordinates alone: the optimum is the same.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec

GRAZING = 0.2  # cosine between beam and normal; below it a reading mostly depends on the error of the angle
_TRIED_ANGLES = 360


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of k beams, each with the line that it fell on, sorted by step.

    Attributes
    ----------
    step, robot, line
        (k,), row of the log, number of the robot, and of the line.
    distance
        (k,), what was read, m.
    origin, angle
        (k, 2), m, and (k,), rad: the beam in the robot's frame.
    """

    step: IntArray
    robot: IntArray
    line: IntArray
    distance: FloatArray
    origin: FloatArray
    angle: FloatArray

    def __len__(self) -> int:
        return len(self.step)

    def where(self, rows: BoolArray) -> "Readings":
        """Some of them, by a mask (k,)."""
        return Readings(*(values[rows] for values in vars(self).values()))


class Expected(NamedTuple):
    """What k beams should read.

    Attributes
    ----------
    distance
        (k,), m.
    by_pose, by_line
        Its derivatives (k, 3) and (k, 2).
    cosine
        (k,), of the angle between beam and normal: near 0 the beam grazes its line.
    """

    distance: FloatArray
    by_pose: FloatArray
    by_line: FloatArray
    cosine: FloatArray


def increments(motions: FloatArray, axle: float) -> FloatArray:
    """Increments (..., 3), m, m, rad, that motions (..., 3) make in the frame of the pose before."""
    left, right, aside = np.moveaxis(motions, -1, 0)
    half = 0.5 * (right - left) / axle
    chord = 0.5 * (left + right) * np.sinc(half / np.pi)
    cos, sin = np.cos(half), np.sin(half)
    return np.stack((chord * cos - aside * sin, chord * sin + aside * cos, 2.0 * half), axis=-1)


def increment_jacobians(motions: FloatArray, axle: float) -> FloatArray:
    """Derivatives (..., 3, 3) of :func:`increments` by the motions."""
    left, right, aside = np.moveaxis(motions, -1, 0)
    half, distance = 0.5 * (right - left) / axle, 0.5 * (left + right)
    cos, sin, sinc = np.cos(half), np.sin(half), np.sinc(half / np.pi)
    chord = distance * sinc
    # Derivatives by half the turn, by the distance and by the shift aside. A turn makes the chord shorter, and it turns
    # chord and shift.
    along, across = distance * _sinc_derivative(half) - aside, chord
    by_half = np.stack((along * cos - across * sin, along * sin + across * cos, np.full_like(half, 2.0)), axis=-1)
    by_distance = np.stack((sinc * cos, sinc * sin, np.zeros_like(half)), axis=-1)
    by_aside = np.stack((-sin, cos, np.zeros_like(half)), axis=-1)
    turning = by_half * (0.5 / axle)
    return np.stack((0.5 * by_distance - turning, 0.5 * by_distance + turning, by_aside), axis=-1)


def walk(starts: FloatArray, motions: FloatArray, axle: float) -> FloatArray:
    """Poses (t, n, 3) of n robots from their starts (n, 3) by motions (t - 1, n, 3); headings are not wrapped."""
    steps = increments(motions, axle)
    headings = np.concatenate((starts[None, :, 2], starts[:, 2] + np.cumsum(steps[..., 2], axis=0)))
    moves = turned(steps[..., :2], headings[:-1])
    places = np.concatenate((starts[None, :, :2], starts[:, :2] + np.cumsum(moves, axis=0)))
    return np.concatenate((places, headings[..., None]), axis=-1)


def motions_between(poses: FloatArray, axle: float) -> FloatArray:
    """Motions (t - 1, n, 3) from each pose of (t, n, 3) to the next, less than half a turn away."""
    heading, turn = poses[:-1, :, 2], wrap_angle(np.diff(poses[..., 2], axis=0))
    half = 0.5 * turn
    moves = turned(np.diff(poses[..., :2], axis=0), -(heading + half))
    distance = moves[..., 0] / np.sinc(half / np.pi)
    return np.stack((distance - half * axle, distance + half * axle, moves[..., 1]), axis=-1)


def motion_jacobians(poses: FloatArray, motions: FloatArray, axle: float) -> tuple[FloatArray, FloatArray]:
    """Derivatives (t - 1, n, 3, 3) of the motions between poses (t, n, 3), by the pose before and the one after."""
    steps, heading = increments(motions, axle), poses[:-1, :, 2]
    by_motion = increment_jacobians(motions, axle)
    by_motion[..., :2, :] = np.moveaxis(turned(np.moveaxis(by_motion[..., :2, :], -2, -1), heading[..., None]), -1, -2)
    by_after = np.asarray(np.linalg.inv(by_motion), dtype=float)
    carried = np.zeros_like(by_motion)
    carried[..., [0, 1, 2], [0, 1, 2]] = 1.0
    carried[..., :2, 2] = turned(steps[..., :2], heading + 0.5 * np.pi)
    return -by_after @ carried, by_after


def expected_readings(poses: FloatArray, lines: FloatArray, anchors: FloatArray, readings: Readings) -> Expected:
    """What readings should be, by poses (k, 3), lines (k, 2) and their anchors (k, 2), m: one of each a reading.

    From the beam's place p on the body in the direction phi to the line: n . (a - p) + d over cos(alpha - phi).
    """
    arm = turned(readings.origin, poses[:, 2])
    gap = anchors - poses[:, :2] - arm
    phi = poses[:, 2] + readings.angle
    normal = np.stack((np.cos(lines[:, 1]), np.sin(lines[:, 1])), axis=-1)
    tangent = np.stack((-normal[:, 1], normal[:, 0]), axis=-1)
    cosine, sine = np.cos(lines[:, 1] - phi), np.sin(lines[:, 1] - phi)
    distance = (np.sum(normal * gap, axis=1) + lines[:, 0]) / cosine
    swept = np.stack((-arm[:, 1], arm[:, 0]), axis=-1)
    by_heading = -np.sum(normal * swept, axis=1) - distance * sine
    by_alpha = np.sum(tangent * gap, axis=1) + distance * sine
    return Expected(
        distance,
        np.column_stack((-normal, by_heading)) / cosine[:, None],
        np.column_stack((np.ones_like(cosine), by_alpha)) / cosine[:, None],
        cosine,
    )


def fitted_lines(poses: FloatArray, readings: Readings, count: int, range_std: float) -> tuple[FloatArray, FloatArray]:
    """Anchors and lines (count, 2) to begin from, as readings put them that were taken at poses (t, n, 3).

    Of a few hundred angles the one that explains most of a line's readings; what explains none is no worse than five
    standard deviations. Total least squares of the points would take the noise along the beams for the line
    where these are crowded together.
    """
    at = poses[readings.step, readings.robot]
    origins = at[:, :2] + turned(readings.origin, at[:, 2])
    phi = at[:, 2] + readings.angle
    points = origins + readings.distance[:, None] * np.stack((np.cos(phi), np.sin(phi)), axis=-1)
    anchors, lines = np.empty((count, 2)), np.empty((count, 2))
    for line in range(count):
        own = readings.line == line
        anchors[line] = points[own].mean(axis=0)
        lines[line] = _fitted(points[own] - anchors[line], phi[own], range_std)
    return anchors, lines


def _fitted(points: FloatArray, phi: FloatArray, range_std: float) -> tuple[float, float]:
    """The line (d, alpha) through points (k, 2), m, that beams in directions (k,) have read."""
    best, angles = (np.inf, 0.0, 0.0), np.arange(_TRIED_ANGLES) * np.pi / _TRIED_ANGLES
    for angle in angles.tolist():
        # An error along the beam moves a point across the line by this error times the cosine of their angle.
        away = points[:, 0] * np.cos(angle) + points[:, 1] * np.sin(angle)
        std = np.maximum(np.abs(np.cos(angle - phi)), GRAZING) * range_std
        offset = float(np.average(away, weights=std**-2.0))
        cost = float(np.minimum(((away - offset) / std) ** 2, 25.0).sum())
        best = min(best, (cost, offset, angle))
    return best[1], best[2]


def usable_readings(robot: RobotSpec, ranges: FloatArray, wall_seen: IntArray) -> tuple[Readings, IntArray]:
    """The readings that measured a wall, and which wall each line of them is (m,).

    Left out are beams that saw nothing or were too near to measure, that hit another robot, and old readings that
    a slow sensor repeats. ``ranges`` and ``wall_seen`` are (t, n, n_beams).
    """
    fresh = np.array([robot.measures(step) for step in range(len(ranges))])
    is_measured = (wall_seen >= 0) & (ranges > robot.too_near) & (ranges < robot.too_far) & fresh[:, None]
    step, number, beam = np.nonzero(is_measured)
    walls, line = np.unique(wall_seen[is_measured], return_inverse=True)
    distance = ranges[is_measured].astype(float)
    return Readings(step, number, line, distance, robot.beam_origins[beam], robot.beam_angles[beam]), walls


def turned(vectors: FloatArray, angles: FloatArray) -> FloatArray:
    """Vectors (..., 2) turned by angles (...), rad."""
    cos, sin = np.cos(angles), np.sin(angles)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack((cos * x - sin * y, sin * x + cos * y), axis=-1)


def _sinc_derivative(angle: FloatArray) -> FloatArray:
    # The quotient loses digits near 0, where the series does not.
    is_small = np.abs(angle) < 1e-4
    safe = np.where(is_small, 1.0, angle)
    return np.where(is_small, -angle / 3.0, (np.cos(safe) - np.sin(safe) / safe) / safe)
