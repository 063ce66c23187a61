"""Angles and sorting for compiled functions."""

import math

import numpy as np

from limslam_agent.kernels.compilation import compiled
from limslam_env.geometry import FloatArray


@compiled
def wrapped(angle: float) -> float:
    """The angle in (-pi, pi], rad."""
    if -math.pi < angle <= math.pi:
        return angle
    result = math.pi - (math.pi - angle) % (2.0 * math.pi)
    return result if result > -math.pi else math.pi


@compiled
def sort_with(keys: FloatArray, follow: np.ndarray, size: int) -> None:
    """Sort keys in place by stable insertion, and permute ``follow`` alike."""
    for i in range(1, size):
        key, other = keys[i], follow[i]
        j = i
        while j > 0 and keys[j - 1] > key:
            keys[j], follow[j] = keys[j - 1], follow[j - 1]
            j -= 1
        keys[j], follow[j] = key, other
