"""How two lines differ, and their pieces: in direction, across and along, and for beams."""

import numpy as np

from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.line import angle_between, direction, nearest_form, normal
from limslam_env.geometry.se2 import wrap_angle

_BEHIND = 0.05
"""A beam may begin this far behind a line, m, because noise moves the line."""


def difference(line: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """By what a line differs from another one (2,), m and rad, and the derivative (2, 2) by it.

    A line is (r, theta) as well as (-r, theta + pi): the form is taken that is nearest.
    """
    is_opposite = abs(wrap_angle(float(line[1] - reference[1]))) > 0.5 * np.pi
    return nearest_form(line, reference) - reference, np.diag([-1.0 if is_opposite else 1.0, 1.0])


def apart(
    line: FloatArray, ends: FloatArray, lines: FloatArray, segments: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """How far a line that ends at points (2, 2), m, is from lines (N, 2) with segments (N, 4), m.

    Angles (N,), rad, distances (N,), m, of its middle from the lines, and gaps (N,) along these, m,
    which are negative for an overlap.
    """
    angles = np.abs(angle_between(lines[:, 1] - line[1]))
    offsets = np.abs(normal(lines) @ ends.mean(axis=0) - lines[:, 0])
    directions = direction(lines)
    own = np.sort(directions @ ends.T, axis=1)
    others = np.sort(np.einsum("ned,nd->ne", segments.reshape(-1, 2, 2), directions), axis=1)
    gaps = np.maximum(own[:, 0] - others[:, 1], others[:, 0] - own[:, 1])
    return angles, offsets, gaps


def can_see(
    origins: FloatArray, points: FloatArray, segments: FloatArray, reach: float, slack: float
) -> BoolArray:
    """Segments (N, 4), m, that most beams from origins towards points (n, 2) meet, if they are
    lengthened by ``slack`` at their ends, ahead and within ``reach``, m.

    A segment behind another one counts, because a map may hold the same wall twice.
    """
    beams = points - origins
    beams /= np.maximum(np.linalg.norm(beams, axis=1, keepdims=True), 1e-12)
    start = segments[:, :2]
    span = segments[:, 2:] - start
    length = np.maximum(np.linalg.norm(span, axis=1), 1e-12)
    tangent = span / length[:, None]
    offset = start[None] - origins[:, None]
    cross = beams[:, :1] * tangent[:, 1] - beams[:, 1:] * tangent[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = (offset[..., 0] * tangent[:, 1] - offset[..., 1] * tangent[:, 0]) / cross
        position = (offset[..., 0] * beams[:, 1:] - offset[..., 1] * beams[:, :1]) / cross
    meets = (ahead > -_BEHIND) & (position > -slack) & (position < length + slack)
    return np.asarray((meets & (ahead < reach)).mean(axis=0) >= 0.5)
