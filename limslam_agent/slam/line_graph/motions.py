"""The motions of the line smoother and their derivatives.

A **motion** is (ahead, aside, turn): the length of an exact arc, m, as in
:func:`limslam_env.geometry.se2.arc`, a shift to the left, perpendicular to the chord of that arc,
m, and the turn, rad. With the shift, a pair of poses and a motion determine each other. Wheels
drive without one.
"""

import math

import numpy as np

from limslam_env.geometry import FloatArray

_SMALL_TURN = 1e-4  # rad: smaller turns are not divided by


def drive(starts: FloatArray, motions: FloatArray) -> FloatArray:
    """Poses (n, t, 3) from starts (n, 3) by motions (n, t - 1, 3); headings are not wrapped."""
    half = 0.5 * motions[..., 2]
    chord = motions[..., 0] / _arc_over_chord(half)
    aside = motions[..., 1]
    headings = _summed(starts[:, 2], motions[..., 2])
    middle = headings[:, :-1] + half
    cos = np.cos(middle)
    sin = np.sin(middle)
    x = _summed(starts[:, 0], chord * cos - aside * sin)
    y = _summed(starts[:, 1], chord * sin + aside * cos)
    return np.stack((x, y, headings), axis=-1)


def motions_between(poses: FloatArray) -> FloatArray:
    """Motions (..., t - 1, 3) from each pose of (..., t, 3) to the next; headings must not jump."""
    half, ahead, aside, _ = _chords(poses)
    return np.stack((ahead * _arc_over_chord(half), aside, 2.0 * half), axis=-1)


def motion_jacobians(poses: FloatArray) -> FloatArray:
    """Derivatives (..., t - 1, 3, 6) of :func:`motions_between` by the pose before a motion and by
    the pose after it.
    """
    half, ahead, aside, middle = _chords(poses)
    longer = _arc_over_chord(half)
    turned = 0.5 * longer * aside
    stretched = 0.5 * ahead * _arc_over_chord_derivative(half)
    jacobians = np.zeros((*half.shape, 3, 6))
    jacobians[..., 0, 2] = turned - stretched
    jacobians[..., 0, 3] = longer * np.cos(middle)
    jacobians[..., 0, 4] = longer * np.sin(middle)
    jacobians[..., 0, 5] = turned + stretched
    jacobians[..., 1, 2] = jacobians[..., 1, 5] = -0.5 * ahead
    jacobians[..., 1, 3] = -np.sin(middle)
    jacobians[..., 1, 4] = np.cos(middle)
    jacobians[..., 2, 2] = -1.0
    jacobians[..., 2, 5] = 1.0
    jacobians[..., :2] = -jacobians[..., 3:5]
    return jacobians


def _summed(start: FloatArray, steps: FloatArray) -> FloatArray:
    """Numbers (n, t) that begin at a start (n,) and change by steps (n, t - 1)."""
    return start[:, None] + np.pad(np.cumsum(steps, axis=1), ((0, 0), (1, 0)))


def _chords(poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Half the turns between successive poses, rad, the displacements ahead and to the left, m, and
    mean headings.
    """
    x, y, turn = np.moveaxis(np.diff(poses, axis=-2), -1, 0)
    half = 0.5 * turn
    middle = poses[..., :-1, 2] + half
    cos = np.cos(middle)
    sin = np.sin(middle)
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
