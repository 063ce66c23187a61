"""Line extraction from points by the Hough transform: compiled counterpart of ``core.hough``."""

import math

import numpy as np

from limslam_agent.slam.batch.algebra import sort_with
from limslam_agent.slam.batch.compilation import compiled
from limslam_agent.slam.batch.line_fit import fit_line
from limslam_agent.slam.batch.state import Settings
from limslam_agent.slam.core.hough import MAX_CANDIDATES
from limslam_env.geometry import FloatArray, IntArray


@compiled
def num_angles(step: float) -> int:
    """Number of OpenCV's bins of theta in half a turn."""
    number = math.floor(math.pi / step) + 1
    return number - 1 if number > 1 and abs(math.pi - (number - 1) * step) < 0.5 * step else number


@compiled
def hough_votes(points: FloatArray, settings: Settings) -> FloatArray:
    """Lines (k, 2) as (r, theta), m and rad, with enough votes, best first.

    The arithmetic is that of OpenCV's ``HoughLinesPointSet``, which is partly in single precision.
    """
    single, step = np.float32, settings.r_step
    reach = 0.0
    for i in range(len(points)):
        reach = max(reach, math.sqrt(points[i, 0] * points[i, 0] + points[i, 1] * points[i, 1]))
    low = -reach - step
    inverse = single(1.0) / single(step)
    lowest = single(low) * inverse
    angles, bins = num_angles(settings.theta_step), int(np.rint((reach + step - low + 1.0) / step))
    counts, wide = np.zeros((angles + 2) * (bins + 2), dtype=np.int16), bins + 2
    found, size, angle = np.empty(len(points) * angles, dtype=np.int64), 0, single(0.0)
    for n in range(angles):
        cos = single(math.cos(float(angle)) * float(inverse))
        sin = single(math.sin(float(angle)) * float(inverse))
        for i in range(len(points)):
            place = (n + 1) * wide + 1 + int(
                np.rint(single(points[i, 0]) * cos + single(points[i, 1]) * sin - lowest)
            )  # fmt: skip
            counts[place] += 1
            # Each bin reaches the threshold once.
            if counts[place] == settings.min_votes:
                found[size] = place
                size += 1
        angle += single(settings.theta_step)
    return peaks(counts, wide, found[:size], single(low), settings)


@compiled
def peaks(
    counts: np.ndarray, wide: int, found: IntArray, low: np.float32, settings: Settings
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
        lines[i, 0] = float(low + np.float32(r) * np.float32(settings.r_step))
        lines[i, 1] = float(np.float32(0.0) + np.float32(n) * np.float32(settings.theta_step))
    return lines


@compiled
def near_line(points: FloatArray, free: np.ndarray, r: float, theta: float, most: float) -> IntArray:
    """Indices (n,) of the free points within ``most``, m, of a line."""
    chosen, size = np.empty(len(points), dtype=np.int64), 0
    cos, sin = math.cos(theta), math.sin(theta)
    for i in range(len(points)):
        if free[i] and abs(points[i, 0] * cos + points[i, 1] * sin - r) <= most:
            chosen[size] = i
            size += 1
    return chosen[:size]


@compiled
def refined(
    points: FloatArray, free: np.ndarray, r: float, theta: float, settings: Settings
) -> tuple[IntArray, FloatArray]:  # fmt: skip
    """Indices (n,) of a candidate line's points after two refinements, and their positions along it, m, sorted."""
    ends = np.empty((2, 2))
    for tolerance in (settings.r_step, settings.near_line):
        members = near_line(points, free, r, theta, tolerance)
        if len(members) < settings.min_votes:
            return members[:0], np.empty(0)
        r, theta = fit_line(points, members, ends)
    members = near_line(points, free, r, theta, settings.near_line)
    cos, sin, along = math.cos(theta), math.sin(theta), np.empty(len(members))
    for i in range(len(members)):
        along[i] = -sin * points[members[i], 0] + cos * points[members[i], 1]
    sort_with(along, members, len(members))
    return members, along


@compiled
def extract_lines(
    points: FloatArray, max_gap: float, settings: Settings, owner: IntArray, lines: FloatArray, ends: FloatArray
) -> int:
    """Extract the lines in points (n, 2), m, and return their number k.

    Fills the line of each point, -1 for none, in ``owner`` (n,), the lines as (r, theta) in ``lines`` (k, 2), and
    their end points in ``ends`` (k, 2, 2), m.
    """
    owner[:] = -1
    total, size = len(points), 0
    if total < settings.min_votes:
        return 0
    middle_x, middle_y = points[:, 0].sum() / total, points[:, 1].sum() / total
    free, left = np.ones(total, dtype=np.bool_), total
    about = points.copy()
    about[:, 0] -= middle_x
    about[:, 1] -= middle_y
    for candidate in hough_votes(about, settings):
        theta = candidate[1]
        r = candidate[0] + middle_x * math.cos(theta) + middle_y * math.sin(theta)
        members, along = refined(points, free, r, theta, settings)
        first, before = 0, size
        for i in range(1, len(members) + 1):
            if i < len(members) and along[i] - along[i - 1] <= max_gap:
                continue
            part, first = members[first:i], i
            if len(part) < settings.min_votes:
                continue
            r_part, theta_part = fit_line(points, part, ends[size])
            x, y = ends[size, 1, 0] - ends[size, 0, 0], ends[size, 1, 1] - ends[size, 0, 1]
            if math.sqrt(x * x + y * y) >= settings.segment_length:
                lines[size, 0], lines[size, 1] = r_part, theta_part
                for each in part:
                    owner[each], free[each] = size, False
                left -= len(part)
                size += 1
        if (settings.only_best and size > before) or left < settings.min_votes:
            break
    return size
