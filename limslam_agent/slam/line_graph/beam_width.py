"""Beams with an opening angle: what they read of a slanted wall.

The beam of an infrared or ultrasonic sensor is a cone. A sensor that reports the nearest point inside the cone reads a
wall under its border ray: with half the opening angle c, and the angle phi between the middle ray and the wall's
normal, a wall at distance r along the middle ray reads r cos(phi) / cos(|phi| - c), which is r (1 - c tan |phi|) to
first order. The error grows with the range and with the slant, up to centimetres, and it never averages out.
"""

import math

import numpy as np

from limslam_agent.slam.line_graph.chain_kernels import BY_LINE, BY_POSE, RANGE
from limslam_agent.slam.line_graph.compilation import compiled
from limslam_env.geometry import FloatArray


@compiled
def read_share(cosine: float, width: float) -> float:
    """The share of its distance that a wall reads, given the cosine between the beam and the wall's normal."""
    return 1.0 - width * math.sqrt(max(1.0 - cosine * cosine, 0.0)) / abs(cosine)


def widen(rows: FloatArray, angles: FloatArray, width: float) -> None:
    """Change the expected ranges and derivatives (k, 7) of ideal beams to those of beams with half an opening angle.

    ``angles`` (k,), rad, are those of the lines' normals minus those of the beams. Rows of readings without a line stay
    zero.
    """
    tangent = np.tan(angles)
    shares = 1.0 - width * np.abs(tangent)
    by_angle = rows[:, RANGE] * width * np.sign(tangent) * (1.0 + tangent**2)
    rows[:, : BY_LINE + 2] *= shares[:, None]
    rows[:, BY_POSE + 2] += by_angle
    rows[:, BY_LINE + 1] -= by_angle
