"""Beams with an opening angle: what they read of a slanted wall.

The beam of an infrared or ultrasonic sensor is a cone. A sensor that reports the nearest point inside the cone reads a
wall under its border ray, or at the foot of the perpendicular if the cone contains it, as in
:mod:`limslam_agent.slam.consistent.beam_model`. With half the opening angle c, and the angle phi between the middle ray
and the wall's normal, a wall at distance r along the middle ray reads r cos(phi) / cos(max(|phi| - c, 0)). The error
grows with the range and with the slant, up to centimetres, and it never averages out.
"""

import math

import numpy as np

from limslam_agent.slam.line_graph.chain_kernels import BY_LINE, BY_POSE, RANGE
from limslam_env.geometry import FloatArray


def widen(rows: FloatArray, angles: FloatArray, width: float) -> None:
    """Change the expected ranges and derivatives (k, 7) of ideal beams to those of beams with half an opening angle.

    ``angles`` (k,), rad, are those of the lines' normals minus those of the beams. Rows of readings without a line stay
    zero.
    """
    slants = (angles + 0.5 * np.pi) % np.pi - 0.5 * np.pi
    border = np.maximum(np.abs(slants) - width, 0.0)
    by_slant = np.where(border > 0.0, -np.sign(slants) * math.sin(width) / np.cos(border) ** 2, -np.sin(slants))
    by_angle = rows[:, RANGE] * by_slant
    rows[:, : BY_LINE + 2] *= (np.cos(slants) / np.cos(border))[:, None]
    rows[:, BY_POSE + 2] -= by_angle
    rows[:, BY_LINE + 1] += by_angle
