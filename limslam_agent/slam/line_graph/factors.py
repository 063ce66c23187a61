"""The motions of the line smoother and their derivatives.

A **motion** is (left, right, aside): the travel of both wheels and a shift to the left, m. The
wheels drive an exact arc, as in :func:`limslam_env.geometry.se2.arc`; the shift is perpendicular to
the chord of that arc. With the shift, a pair of poses and a motion determine each other.
"""

import math

import numpy as np

from limslam_env.geometry import FloatArray

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
