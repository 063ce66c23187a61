"""Infinite lines in the plane as ``(r, theta)``.

A line is the set of points with ``x cos(theta) + y sin(theta) = r``. Written with ``r >= 0``
and theta in (-pi, pi] the pair is unique, except for lines through the origin, where theta
and theta + pi name the same line. Functions that compare lines therefore never compare raw
parameters: they bring one line next to the other first (:func:`nearest_form`).
"""

import math
from typing import overload

import numpy as np

from limslam_env.geometry.arrays import FloatArray
from limslam_env.geometry.se2 import wrap_angle


@overload
def angle_between(turn: float) -> float: ...
@overload
def angle_between(turn: FloatArray) -> FloatArray: ...
def angle_between(turn: float | FloatArray) -> float | FloatArray:
    """The angle between two lines, rad, in [-pi / 2, pi / 2).

    ``turn`` is the difference of their directions, rad. Half a turn leaves a line as it is, and so
    counts as none.
    """
    return (turn + 0.5 * math.pi) % math.pi - 0.5 * math.pi


def normalise(line: FloatArray) -> FloatArray:
    """The same line(s) with ``r >= 0`` and theta in (-pi, pi]; the last axis holds (r, theta)."""
    line = np.asarray(line, dtype=float)
    if line.ndim == 1:
        return _normalise_one(*line.tolist())
    negative = line[..., 0] < 0.0
    theta = np.where(negative, line[..., 1] + math.pi, line[..., 1])
    return np.stack((np.abs(line[..., 0]), wrap_angle(theta)), axis=-1)


def nearest_form(line: FloatArray, reference: FloatArray) -> FloatArray:
    """The same line(s) in the form whose normal points the way of ``reference``'s.

    ``r`` may come out negative; the angle lies within pi / 2 of the reference's, unwrapped
    towards it, so that ``result - reference`` is the difference of the two lines.
    """
    line = np.asarray(line, dtype=float)
    reference = np.asarray(reference, dtype=float)
    if line.ndim == reference.ndim == 1:
        (r, theta), towards = line.tolist(), float(reference[1])
        turn = wrap_angle(theta - towards)
        if abs(turn) > 0.5 * math.pi:
            return np.array([-r, towards + wrap_angle(turn + math.pi)])
        return np.array([r, towards + turn])
    difference = wrap_angle(line[..., 1] - reference[..., 1])
    opposite = np.abs(difference) > 0.5 * math.pi
    r = np.where(opposite, -line[..., 0], line[..., 0])
    difference = np.where(opposite, wrap_angle(difference + math.pi), difference)
    return np.stack((r, reference[..., 1] + difference), axis=-1)


def through(start: FloatArray, end: FloatArray) -> FloatArray:
    """The line (r, theta) through two points.

    Raises
    ------
    ValueError
        If the points coincide.
    """
    direction = np.asarray(end, dtype=float) - np.asarray(start, dtype=float)
    if not np.any(direction):
        raise ValueError("a line needs two different points")
    theta = math.atan2(direction[0], -direction[1])
    return normalise(np.array([start[0] * math.cos(theta) + start[1] * math.sin(theta), theta]))


def to_frame(line: FloatArray, pose: FloatArray) -> FloatArray:
    """World line(s) as seen from ``pose``: (r, theta) in its frame, normalised."""
    line = np.asarray(line, dtype=float)
    if line.ndim == 1:
        (r, theta), (x, y, heading) = line.tolist(), np.asarray(pose, dtype=float).tolist()
        return _normalise_one(r - x * math.cos(theta) - y * math.sin(theta), theta - heading)
    r = line[..., 0] - pose[0] * np.cos(line[..., 1]) - pose[1] * np.sin(line[..., 1])
    return normalise(np.stack((r, line[..., 1] - pose[2]), axis=-1))


def from_frame(line: FloatArray, pose: FloatArray) -> FloatArray:
    """Line(s) given in the frame of ``pose``, in the world: the inverse of :func:`to_frame`."""
    line = np.asarray(line, dtype=float)
    theta = line[..., 1] + pose[2]
    r = line[..., 0] + pose[0] * np.cos(theta) + pose[1] * np.sin(theta)
    return normalise(np.stack((r, theta), axis=-1))


def to_frame_jacobians(line: FloatArray, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives of :func:`to_frame` for one line, by pose (2, 3) and by line (2, 2)."""
    (r, theta), (x, y, _) = line.tolist(), pose.tolist()
    cos = math.cos(theta)
    sin = math.sin(theta)
    sign = -1.0 if r - x * cos - y * sin < 0.0 else 1.0
    by_both = np.array(
        [
            [-sign * cos, -sign * sin, 0.0, sign, sign * (x * sin - y * cos)],
            [0.0, 0.0, -1.0, 0.0, 1.0],
        ]
    )
    return by_both[:, :3], by_both[:, 3:]


def from_frame_jacobians(line: FloatArray, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives of :func:`from_frame` for one line, by pose (2, 3) and by line (2, 2)."""
    theta = line[1] + pose[2]
    cos = math.cos(theta)
    sin = math.sin(theta)
    sign = -1.0 if line[0] + pose[0] * cos + pose[1] * sin < 0.0 else 1.0
    turned = sign * (pose[1] * cos - pose[0] * sin)
    by_pose = np.array([[sign * cos, sign * sin, turned], [0.0, 0.0, 1.0]])
    by_line = np.array([[sign, turned], [0.0, 1.0]])
    return by_pose, by_line


def normal(line: FloatArray) -> FloatArray:
    """Unit normal(s) (..., 2): the direction from the origin to the line."""
    return _pairs(np.cos(line[..., 1]), np.sin(line[..., 1]))


def direction(line: FloatArray) -> FloatArray:
    """Unit vector(s) (..., 2) along the line: the normal turned by +90 degrees."""
    return _pairs(-np.sin(line[..., 1]), np.cos(line[..., 1]))


def distance(line: FloatArray, points: FloatArray) -> FloatArray:
    """Signed distance (m) of points (n, 2) from one line, positive beyond it as seen from the
    origin.
    """
    return np.asarray(points @ normal(line) - line[0])


def along(line: FloatArray, points: FloatArray) -> FloatArray:
    """Where points (n, 2) fall along one line: metres from the foot of the origin's
    perpendicular.
    """
    return points @ direction(line)


def at(line: FloatArray, position: FloatArray) -> FloatArray:
    """Points (n, 2) on one line at the given positions (n,) along it: the inverse of
    :func:`along`.
    """
    return np.asarray(line[0] * normal(line) + np.multiply.outer(position, direction(line)))


def _pairs(first: FloatArray, second: FloatArray) -> FloatArray:
    # ``np.stack`` with axis=-1, in a third of its time.
    pairs = np.empty((*first.shape, 2))
    pairs[..., 0] = first
    pairs[..., 1] = second
    return pairs


def _normalise_one(r: float, theta: float) -> FloatArray:
    # Single lines are looked at in every update; plain numbers take a tenth of the time.
    return (
        np.array([-r, wrap_angle(theta + math.pi)]) if r < 0.0 else np.array([r, wrap_angle(theta)])
    )
