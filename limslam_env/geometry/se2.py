"""Rigid motions of the plane, SE(2).

A pose is an array ``(x, y, theta)`` in metres and radians and stands for the transform
``T_world_robot``: it takes a point from the robot's frame into the world's. The algebra and
its Jacobians follow Smith, Self and Cheeseman, "Estimating uncertain spatial relationships
in robotics" (1990), where ``compose`` is written as a circled plus.
"""

import math
from typing import overload

import numpy as np

from limslam_env.geometry.arrays import FloatArray

_TAU = 2.0 * math.pi


@overload
def wrap_angle(angle: float) -> float: ...
@overload
def wrap_angle(angle: FloatArray) -> FloatArray: ...
def wrap_angle(angle: float | FloatArray) -> float | FloatArray:
    """Bring an angle, or an array of them, into (-pi, pi] (radians). Angles in this interval do not
    change.
    """
    wrapped = math.pi - (math.pi - angle) % _TAU
    # Just above pi the remainder rounds up to the full circle.
    if isinstance(wrapped, float):
        if -math.pi < angle <= math.pi:
            return float(angle)
        return wrapped if wrapped > -math.pi else math.pi
    wrapped = np.where(wrapped > -math.pi, wrapped, math.pi)
    return np.where((angle > -math.pi) & (angle <= math.pi), angle, wrapped)


def compose(first: FloatArray, second: FloatArray) -> FloatArray:
    """``T_a_c`` from ``T_a_b`` and ``T_b_c``; the last axis holds (x, y, theta).

    Leading axes broadcast. The heading of the result is wrapped.
    """
    first = np.asarray(first, dtype=float)
    second = np.asarray(second, dtype=float)
    if first.ndim == second.ndim == 1:
        # Single poses are composed at every step; plain numbers take a tenth of the time.
        (x0, y0, heading), (ahead, left, turn) = first.tolist(), second.tolist()
        c = math.cos(heading)
        s = math.sin(heading)
        return np.array(
            [x0 + c * ahead - s * left, y0 + s * ahead + c * left, wrap_angle(heading + turn)]
        )
    cos = np.cos(first[..., 2])
    sin = np.sin(first[..., 2])
    x = first[..., 0] + cos * second[..., 0] - sin * second[..., 1]
    y = first[..., 1] + sin * second[..., 0] + cos * second[..., 1]
    return np.stack((x, y, wrap_angle(first[..., 2] + second[..., 2])), axis=-1)


def inverse(pose: FloatArray) -> FloatArray:
    """``T_b_a`` from ``T_a_b``; the last axis holds (x, y, theta)."""
    pose = np.asarray(pose, dtype=float)
    cos = np.cos(pose[..., 2])
    sin = np.sin(pose[..., 2])
    x = -cos * pose[..., 0] - sin * pose[..., 1]
    y = sin * pose[..., 0] - cos * pose[..., 1]
    return np.stack((x, y, wrap_angle(-pose[..., 2])), axis=-1)


def between(start: FloatArray, end: FloatArray) -> FloatArray:
    """The pose of ``end`` as seen from ``start``: ``compose(inverse(start), end)``."""
    return compose(inverse(start), end)


def compose_jacobians(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives of ``compose(first, second)`` by ``first`` and by ``second``, each (3, 3)."""
    heading = float(first[2])
    x = float(second[0])
    y = float(second[1])
    cos = math.cos(heading)
    sin = math.sin(heading)
    by_first = np.array(
        [[1.0, 0.0, -sin * x - cos * y], [0.0, 1.0, cos * x - sin * y], [0.0, 0.0, 1.0]]
    )
    by_second = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return by_first, by_second


def moved_covariance(
    pose: FloatArray, covariance: FloatArray, motion: FloatArray, own: FloatArray
) -> FloatArray:
    """Covariance (3, 3) of a pose (3,) after a motion (3,) with the covariance ``own`` (3, 3)."""
    by_pose, by_motion = compose_jacobians(pose, motion)
    return np.asarray(by_pose @ covariance @ by_pose.T + by_motion @ own @ by_motion.T)


def transform_points(pose: FloatArray, points: FloatArray) -> FloatArray:
    """Take points (n, 2) from the frame of ``pose`` into the frame that ``pose`` is given in."""
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    rotation = np.array([[cos, sin], [-sin, cos]])
    return np.asarray(points @ rotation + pose[:2])


def turned(covariances: FloatArray, heading: float) -> FloatArray:
    """Covariances (..., 3, 3) of poses, as they are in a frame from which their own frame is turned
    by a heading.
    """
    cos = math.cos(heading)
    sin = math.sin(heading)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(turn @ covariances @ turn.T)


def arc(distance: float, turn: float) -> FloatArray:
    """The pose reached from the origin along a circular arc.

    Parameters
    ----------
    distance
        Length of the arc in metres, negative when driving backwards.
    turn
        Change of heading in radians.

    Notes
    -----
    The exact solution of the unicycle with constant speeds (Thrun, Burgard and Fox,
    "Probabilistic Robotics", eq. 5.9), as a chord of length ``distance sinc(turn / 2)`` in
    the direction ``turn / 2``, which has no singularity at ``turn = 0``.
    """
    half = 0.5 * turn
    chord = distance * _sinc(half)
    return np.array([chord * math.cos(half), chord * math.sin(half), turn])


def arc_end(
    x: float, y: float, heading: float, left: float, right: float, axle: float
) -> tuple[float, float, float]:
    """The pose at the end of the arc that wheel travel makes of a pose; the heading wrapped.

    Lengths in metres, ``left`` and ``right`` among them, angles in radians. See :func:`arc`; in
    plain numbers, since this is done at every step, by compiled code too.
    """
    half = 0.5 * (right - left) / axle
    chord = 0.5 * (left + right) * (math.sin(half) / half if abs(half) > 1e-6 else 1.0)
    middle = heading + half
    end = middle + half
    if not -math.pi < end <= math.pi:
        end = math.pi - (math.pi - end) % _TAU
        # Just above pi the remainder rounds up to the full circle.
        if end <= -math.pi:
            end = math.pi
    return x + chord * math.cos(middle), y + chord * math.sin(middle), end


def arc_derivatives(distance: float, turn: float) -> tuple[tuple[float, float], ...]:
    """Derivatives of x, y and heading of :func:`arc`, each by ``(distance, turn)``, in plain
    numbers.
    """
    half = 0.5 * turn
    cos = math.cos(half)
    sin = math.sin(half)
    sinc = _sinc(half)
    chord_by_turn = 0.5 * distance * _sinc_derivative(half)
    chord = distance * sinc
    return (
        (sinc * cos, chord_by_turn * cos - 0.5 * chord * sin),
        (sinc * sin, chord_by_turn * sin + 0.5 * chord * cos),
        (0.0, 1.0),
    )


def arc_jacobian(distance: float, turn: float) -> FloatArray:
    """Derivative (3, 2) of :func:`arc` by ``(distance, turn)``."""
    return np.array(arc_derivatives(distance, turn))


def wheels_to_arc(wheels: FloatArray, axle: float) -> tuple[float, float]:
    """Distance (m) and turn (rad) of a differential drive from its left and right wheel travel
    (m).
    """
    left = float(wheels[0])
    right = float(wheels[1])
    return 0.5 * (left + right), (right - left) / axle


def driven(wheels: FloatArray, axle: float, start: FloatArray) -> FloatArray:
    """Poses (n, 3) after each row of wheel travel (n, 2), m, that begins at a pose (3,): dead
    reckoning.
    """
    poses, (x, y, heading) = np.empty((len(wheels), 3)), start.tolist()
    for number, (left, right) in enumerate(wheels.tolist()):
        x, y, heading = arc_end(x, y, heading, left, right, axle)
        poses[number] = x, y, heading
    return poses


def _sinc(angle: float) -> float:
    return math.sin(angle) / angle if abs(angle) > 1e-6 else 1.0 - angle * angle / 6.0


def _sinc_derivative(angle: float) -> float:
    if abs(angle) > 1e-4:
        return (math.cos(angle) - math.sin(angle) / angle) / angle
    return -angle / 3.0
