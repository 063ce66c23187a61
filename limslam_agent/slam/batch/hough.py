"""Line extraction from points by the Hough transform: compiled counterpart of ``core.hough``."""

import math

import numpy as np

from limslam_agent.kernels.algebra import sort_with
from limslam_agent.kernels.lines import refine_lines
from limslam_agent.slam.batch.compilation import compiled
from limslam_agent.slam.core.hough import MAX_CANDIDATES
from limslam_env.geometry import FloatArray, IntArray


@compiled
def num_angles(step: float) -> int:
    """Number of OpenCV's bins of theta in half a turn."""
    number = math.floor(math.pi / step) + 1
    return number - 1 if number > 1 and abs(math.pi - (number - 1) * step) < 0.5 * step else number


@compiled
def hough_votes(points: FloatArray, min_votes: int, r_step: float, theta_step: float) -> FloatArray:
    """Lines (k, 2) as (r, theta), m and rad, with enough votes, best first.

    The arithmetic is that of OpenCV's ``HoughLinesPointSet``, which is partly in single precision.
    """
    single, step = np.float32, r_step
    reach = 0.0
    for i in range(len(points)):
        reach = max(reach, math.sqrt(points[i, 0] * points[i, 0] + points[i, 1] * points[i, 1]))
    low = -reach - step
    inverse = single(1.0) / single(step)
    lowest = single(low) * inverse
    angles, bins = num_angles(theta_step), int(np.rint((reach + step - low + 1.0) / step))
    counts, wide = np.zeros((angles + 2) * (bins + 2), dtype=np.int16), bins + 2
    found, size, angle = np.empty(len(points) * angles, dtype=np.int64), 0, single(0.0)
    xs, ys, places = points[:, 0].astype(single), points[:, 1].astype(single), np.empty(len(points), dtype=np.int32)
    for n in range(angles):
        cos = single(math.cos(float(angle)) * float(inverse))
        sin = single(math.sin(float(angle)) * float(inverse))
        # A loop of its own, in which the compiler takes several points at once.
        for i in range(len(points)):
            places[i] = np.int32(np.rint(xs[i] * cos + ys[i] * sin - lowest))
        for i in range(len(points)):
            place = (n + 1) * wide + 1 + places[i]
            counts[place] += 1
            # Each bin reaches the threshold once.
            if counts[place] == min_votes:
                found[size] = place
                size += 1
        angle += single(theta_step)
    return peaks(counts, wide, found[:size], single(low), r_step, theta_step)


@compiled
def peaks(
    counts: np.ndarray, wide: int, found: IntArray, low: np.float32, r_step: float, theta_step: float
) -> FloatArray:  # fmt: skip
    """Lines (k, 2) of those bins that have more votes than their neighbours."""
    keys, places, size = np.empty(len(found)), np.empty(len(found), dtype=np.int64), 0
    for place in found:
        votes_here = counts[place]
        if (
            votes_here > counts[place - 1]
            and votes_here >= counts[place + 1]
            and votes_here > counts[place - wide]
            and votes_here >= counts[place + wide]
        ):
            # Most votes first; of equal votes, the first bin.
            keys[size], places[size] = place - float(votes_here) * 2.0**32, place
            size += 1
    sort_with(keys, places, size)
    size = min(size, MAX_CANDIDATES)
    lines = np.empty((size, 2))
    for i in range(size):
        n = places[i] // wide - 1
        r = places[i] - (n + 1) * wide - 1
        lines[i, 0] = float(low + np.float32(r) * np.float32(r_step))
        lines[i, 1] = float(np.float32(0.0) + np.float32(n) * np.float32(theta_step))
    return lines


@compiled
def extract_lines(
    points: FloatArray, max_gap: float, min_votes: int, r_step: float, theta_step: float, near_line: float,
    least: float, only_best: bool,
) -> tuple[IntArray, FloatArray, FloatArray]:  # fmt: skip
    """The lines in points (n, 2), m: compiled counterpart of ``core.hough.line_parts``."""
    total, about, owner = len(points), points.copy(), np.full(len(points), -1)
    most = total // max(min_votes, 1) + 1
    lines, ends = np.empty((most, 2)), np.empty((most, 2, 2))
    if total < min_votes:
        return owner, lines[:0], ends[:0]
    about[:, 0] -= points[:, 0].sum() / total
    about[:, 1] -= points[:, 1].sum() / total
    number = refine_lines(
        points, hough_votes(about, min_votes, r_step, theta_step), (r_step, near_line), min_votes, max_gap, least,
        only_best, owner, lines, ends,
    )  # fmt: skip
    return owner, lines[:number], ends[:number]
