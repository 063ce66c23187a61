"""Differential-drive motion from wheel travel: compiled counterpart of ``core.motion``."""

import math
from typing import Any

import numpy as np

from limslam_agent.slam.batch.compilation import algebra
from limslam_agent.slam.core.ekf import POSE
from limslam_agent.slam.core.motion import LEAST_VARIANCE
from limslam_env.geometry import FloatArray


@algebra
def motion_from_wheels(wheels: FloatArray, settings: Any) -> tuple[FloatArray, FloatArray]:
    """The arc of left and right wheel travel (2,), m, as a pose increment (3,), and its covariance (3, 3)."""
    distance, turn = 0.5 * (wheels[0] + wheels[1]), (wheels[1] - wheels[0]) / settings.axle
    half = 0.5 * turn
    cos, sin = math.cos(half), math.sin(half)
    sinc = math.sin(half) / half if abs(half) > 1e-6 else 1.0 - half * half / 6.0
    slope = (cos - sin / half) / half if abs(half) > 1e-4 else -half / 3.0
    chord, chord_by_turn = distance * sinc, 0.5 * distance * slope
    by_arc = np.array([
        [sinc * cos, chord_by_turn * cos - 0.5 * chord * sin],
        [sinc * sin, chord_by_turn * sin + 0.5 * chord * cos],
        [0.0, 1.0],
    ])  # fmt: skip
    by_wheels = np.empty((POSE, 2))
    covariance = np.zeros((POSE, POSE))
    for i in range(POSE):
        by_wheels[i, 0] = 0.5 * by_arc[i, 0] - by_arc[i, 1] / settings.axle
        by_wheels[i, 1] = 0.5 * by_arc[i, 0] + by_arc[i, 1] / settings.axle
    for k in range(2):
        variance = settings.wheel_variance * abs(wheels[k]) + LEAST_VARIANCE
        for i in range(POSE):
            for j in range(POSE):
                covariance[i, j] += by_wheels[i, k] * variance * by_wheels[j, k]
    return np.array([chord * cos, chord * sin, turn]), covariance
