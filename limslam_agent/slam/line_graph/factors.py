"""The factors of the line smoother: expected measurements and their derivatives.

A **motion** is (left, right, aside): the travel of both wheels and a shift to the left, m. The
wheels drive an exact arc, as in :func:`limslam_env.geometry.se2.arc`; the shift is perpendicular to
the chord of that arc. With the shift, a pair of poses and a motion determine each other. A **line**
is (d, alpha) about an anchor a: the points x with (cos alpha, sin alpha) . (x - a) = d.
"""

import math
from typing import NamedTuple

import numpy as np

from limslam_agent.kernels.tables import LEAST_DIVISOR
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import angle_between

_SMALL_TURN = 1e-4  # rad: smaller turns are not divided by


def drive(start: FloatArray, motions: FloatArray, axle: float) -> FloatArray:
    """Poses (t, 3) from a start (3,) by motions (t - 1, 3); headings are not wrapped."""
    half = 0.5 * (motions[:, 1] - motions[:, 0]) / axle
    chord = 0.5 * (motions[:, 0] + motions[:, 1]) / _arc_over_chord(half)
    headings = start[2] + np.append(0.0, np.cumsum(2.0 * half))
    middle = headings[:-1] + half
    cos = np.cos(middle)
    sin = np.sin(middle)
    aside = motions[:, 2]
    x = start[0] + np.append(0.0, np.cumsum(chord * cos - aside * sin))
    y = start[1] + np.append(0.0, np.cumsum(chord * sin + aside * cos))
    return np.column_stack((x, y, headings))


def motions_between(poses: FloatArray, axle: float) -> FloatArray:
    """Motions (t - 1, 3) from each pose of (t, 3) to the next; headings must not jump."""
    half, ahead, aside, _ = _chords(poses)
    distance = ahead * _arc_over_chord(half)
    return np.column_stack((distance - half * axle, distance + half * axle, aside))


def motion_jacobians(poses: FloatArray, axle: float) -> FloatArray:
    """Derivatives (t - 1, 3, 6) of :func:`motions_between` by the pose before a motion and by the
    pose after it.
    """
    half, ahead, aside, middle = _chords(poses)
    cos = np.cos(middle)
    sin = np.sin(middle)
    longer = _arc_over_chord(half)
    turned = 0.5 * longer * aside
    stretched = 0.5 * ahead * _arc_over_chord_derivative(half)
    found = np.empty((len(half), 3, 6))
    for row, lever in enumerate((-0.5 * axle, 0.5 * axle)):
        found[:, row, 3] = longer * cos
        found[:, row, 4] = longer * sin
        found[:, row, 5] = turned + stretched + lever
        found[:, row, 2] = turned - stretched - lever
    found[:, 2, 3] = -sin
    found[:, 2, 4] = cos
    found[:, 2, 5] = found[:, 2, 2] = -0.5 * ahead
    found[:, :, :2] = -found[:, :, 3:5]
    return found


def _chords(poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Half the turns between successive poses, rad, the displacements ahead and to the left, m, and
    mean headings.
    """
    half = 0.5 * np.diff(poses[:, 2])
    middle = poses[:-1, 2] + half
    cos = np.cos(middle)
    sin = np.sin(middle)
    x = np.diff(poses[:, 0])
    y = np.diff(poses[:, 1])
    return half, cos * x + sin * y, cos * y - sin * x, middle


def _arc_over_chord(half: FloatArray) -> FloatArray:
    """Ratio of the length of an arc to that of its chord; ``half`` is half the turn, rad."""
    return np.asarray(1.0 / np.sinc(half / math.pi))


def _arc_over_chord_derivative(half: FloatArray) -> FloatArray:
    is_small = np.abs(half) < _SMALL_TURN
    sin = np.sin(half)
    return np.where(
        is_small, half / 3.0, (sin - half * np.cos(half)) / np.where(is_small, 1.0, sin * sin)
    )


class Expected(NamedTuple):
    """What some readings should be.

    Attributes
    ----------
    ranges
        Expected ranges (k,), m; negative behind the beam.
    by_pose, by_line
        Derivatives of the ranges by the poses (k, 3) and by the lines (k, 2).
    cosines
        Cosines (k,) of the angles between the beams and the normals of the lines.
    """

    ranges: FloatArray
    by_pose: FloatArray
    by_line: FloatArray
    cosines: FloatArray


def expected_readings(
    poses: FloatArray, beams: FloatArray, lines: FloatArray, anchors: FloatArray, width: float
) -> Expected:
    """What beams (x, y, angle) on the body (k, 3) should read of lines (k, 2) with anchors (k, 2)
    at poses (k, 3).

    ``width`` is half the opening angle of the beams, rad.
    """
    cos = np.cos(poses[:, 2])
    sin = np.sin(poses[:, 2])
    heading = poses[:, 2] + beams[:, 2]
    arm_x = cos * beams[:, 0] - sin * beams[:, 1]
    arm_y = sin * beams[:, 0] + cos * beams[:, 1]
    ux = np.cos(heading)
    uy = np.sin(heading)
    nx = np.cos(lines[:, 1])
    ny = np.sin(lines[:, 1])
    cosine = nx * ux + ny * uy
    # A beam exactly parallel to the line does not meet it. A very large finite distance is used
    # instead.
    divisor = np.where(np.abs(cosine) > LEAST_DIVISOR, cosine, LEAST_DIVISOR)
    x = poses[:, 0] + arm_x - anchors[:, 0]
    y = poses[:, 1] + arm_y - anchors[:, 1]
    ranges = (lines[:, 0] - nx * x - ny * y) / divisor
    swept = arm_x * ny - arm_y * nx + ranges * (ux * ny - uy * nx)
    by_pose = -np.column_stack((nx, ny, swept)) / divisor[:, None]
    turned = (x + ranges * ux) * ny - (y + ranges * uy) * nx
    by_line = np.column_stack((np.ones_like(turned), turned)) / divisor[:, None]
    found = Expected(ranges, by_pose, by_line, cosine)
    return widened(found, lines[:, 1] - heading, width) if width else found


def widened(ideal: Expected, angles: FloatArray, width: float) -> Expected:
    """What beams with half an opening angle should read, from what ideal beams should read.

    The beam of an infrared or ultrasonic sensor is a cone. A sensor that reports the nearest point
    inside the cone reads a wall under its border ray, or at the foot of the perpendicular if the
    cone contains it, as in
    :mod:`limslam_agent.kernels.measurement`. With half the opening angle c, and the angle phi
    between the middle ray and the wall's normal, a wall at distance r along the middle ray reads r
    cos(phi) / cos(max(|phi| - c, 0)). The error grows with the range and with the slant, up to
    centimetres, and it never averages out.

    Parameters
    ----------
    ideal
        What ideal beams should read.
    angles
        Angles (k,) of the lines' normals minus those of the beams, rad.
    width
        Half the opening angle c, rad.
    """
    slants = angle_between(angles)
    border = np.maximum(np.abs(slants) - width, 0.0)
    by_slant = np.where(
        border > 0.0, -np.sign(slants) * math.sin(width) / np.cos(border) ** 2, -np.sin(slants)
    )
    by_angle = ideal.ranges * by_slant
    share = np.cos(slants) / np.cos(border)
    by_pose = ideal.by_pose * share[:, None]
    by_line = ideal.by_line * share[:, None]
    by_pose[:, 2] -= by_angle
    by_line[:, 1] += by_angle
    return Expected(ideal.ranges * share, by_pose, by_line, ideal.cosines)


def rays(poses: FloatArray, beams: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Origins (k, 2), m, and unit vectors (k, 2) of beams (x, y, angle) on the body (k, 3) at poses
    (k, 3).
    """
    cos = np.cos(poses[:, 2])
    sin = np.sin(poses[:, 2])
    heading = poses[:, 2] + beams[:, 2]
    x = cos * beams[:, 0] - sin * beams[:, 1]
    y = sin * beams[:, 0] + cos * beams[:, 1]
    return poses[:, :2] + np.column_stack((x, y)), np.column_stack(
        (np.cos(heading), np.sin(heading))
    )
