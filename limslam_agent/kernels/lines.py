"""Lines in points: the Hough transform finds them, and total least squares refines them.

The Hough transform is that of R. Duda and P. Hart, "Use of the Hough transformation to detect lines
and curves in pictures", 1972, with the arithmetic of OpenCV's ``HoughLinesPointSet``, which is
partly in single precision.
"""

import math

import numpy as np

from limslam_agent.kernels.algebra import sort_with, wrapped
from limslam_agent.kernels.compilation import compiled, entry
from limslam_env.geometry import FloatArray, IntArray

MAX_CANDIDATES = 200
"""Largest number of lines that the Hough transform returns."""

MOST_BINS = 20_000_000
"""Most bins of the Hough transform: those of points 1 km apart, with the usual bins."""


@compiled
def num_angles(step: float) -> int:
    """Number of OpenCV's bins of theta in half a turn."""
    number = math.floor(math.pi / step) + 1
    return number - 1 if number > 1 and abs(math.pi - (number - 1) * step) < 0.5 * step else number


@compiled
def hough_votes(points: FloatArray, min_votes: int, r_step: float, theta_step: float) -> FloatArray:
    """Lines (k, 2) as (r, theta), m and rad, that enough points (n, 2), m, vote for, best first.

    Bins have a size of ``r_step``, m, by ``theta_step``, rad; r may be negative, and theta is in
    [0, pi). Points that would need more than ``MOST_BINS`` are too far apart for a line.
    """
    single = np.float32
    step = r_step
    reach = 0.0
    for i in range(len(points)):
        reach = max(reach, math.sqrt(points[i, 0] * points[i, 0] + points[i, 1] * points[i, 1]))
    angles = num_angles(theta_step)
    low = -reach - step
    # A comparison with NaN is false.
    if not (angles + 2) * ((reach + step - low + 1.0) / step + 2.0) < MOST_BINS:
        return np.empty((0, 2))
    inverse = single(1.0) / single(step)
    lowest = single(low) * inverse
    wide = int(np.rint((reach + step - low + 1.0) / step)) + 2
    counts = np.zeros((angles + 2) * wide, dtype=np.int32)
    most = len(points) * angles // max(min_votes, 1)
    found = np.empty(most, dtype=np.int64)
    size = 0
    angle = single(0.0)
    xs = points[:, 0].astype(single)
    ys = points[:, 1].astype(single)
    places = np.empty(len(points), dtype=np.int32)
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
    counts: np.ndarray,
    wide: int,
    found: IntArray,
    low: np.float32,
    r_step: float,
    theta_step: float,
) -> FloatArray:
    """Lines (k, 2) of those bins that have more votes than their neighbours."""
    keys = np.empty(len(found))
    places = np.empty(len(found), dtype=np.int64)
    size = 0
    for place in found:
        votes_here = counts[place]
        if (
            votes_here > counts[place - 1]
            and votes_here >= counts[place + 1]
            and votes_here > counts[place - wide]
            and votes_here >= counts[place + wide]
        ):
            # Most votes first; of equal votes, the first bin.
            keys[size] = place - float(votes_here) * 2.0**32
            places[size] = place
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


@entry
def fit_line(points: FloatArray, members: IntArray, ends: FloatArray) -> tuple[float, float]:
    """(r, theta), normalised, of the line through some points by total least squares; fills its
    ends (2, 2), m.
    """
    middle_x = 0.0
    middle_y = 0.0
    number = len(members)
    for i in members:
        middle_x += points[i, 0]
        middle_y += points[i, 1]
    middle_x = middle_x / number
    middle_y = middle_y / number
    xx = 0.0
    yy = 0.0
    xy = 0.0
    for i in members:
        x = points[i, 0] - middle_x
        y = points[i, 1] - middle_y
        xx = xx + x * x
        yy = yy + y * y
        xy = xy + x * y
    axis = 0.5 * math.atan2(2.0 * xy, xx - yy)
    cos = math.cos(axis)
    sin = math.sin(axis)
    theta = axis + 0.5 * math.pi
    r = middle_x * math.cos(theta) + middle_y * math.sin(theta)
    least = np.inf
    most = -np.inf
    for i in members:
        along = (points[i, 0] - middle_x) * cos + (points[i, 1] - middle_y) * sin
        least = min(least, along)
        most = max(most, along)
    ends[0, 0] = middle_x + least * cos
    ends[0, 1] = middle_y + least * sin
    ends[1, 0] = middle_x + most * cos
    ends[1, 1] = middle_y + most * sin
    return (-r, wrapped(theta + math.pi)) if r < 0.0 else (r, wrapped(theta))


@compiled
def near_line(
    points: FloatArray, free: np.ndarray, r: float, theta: float, most: float
) -> IntArray:
    """Indices (n,) of the free points within ``most``, m, of a line."""
    chosen = np.empty(len(points), dtype=np.int64)
    size = 0
    cos = math.cos(theta)
    sin = math.sin(theta)
    for i in range(len(points)):
        if free[i] and abs(points[i, 0] * cos + points[i, 1] * sin - r) <= most:
            chosen[size] = i
            size += 1
    return chosen[:size]


@compiled
def refined(
    points: FloatArray,
    free: np.ndarray,
    r: float,
    theta: float,
    limits: tuple[float, float],
    votes: int,
) -> tuple[IntArray, FloatArray]:
    """Indices (n,) of a candidate line's points after two refinements, and their positions along
    it, m, sorted.

    Points belong to it within the first of the ``limits``, m, and then within the second one.
    """
    ends = np.empty((2, 2))
    for tolerance in limits:
        members = near_line(points, free, r, theta, tolerance)
        if len(members) < votes:
            return members[:0], np.empty(0)
        r, theta = fit_line(points, members, ends)
    members = near_line(points, free, r, theta, limits[1])
    cos = math.cos(theta)
    sin = math.sin(theta)
    along = np.empty(len(members))
    for i in range(len(members)):
        along[i] = -sin * points[members[i], 0] + cos * points[members[i], 1]
    sort_with(along, members, len(members))
    return members, along


@compiled
def refine_lines(
    points: FloatArray,
    candidates: FloatArray,
    limits: tuple[float, float],
    votes: int,
    gap: float,
    least: float,
    only_best: bool,
    owner: IntArray,
    lines: FloatArray,
    ends: FloatArray,
) -> int:
    """Refine candidate lines on their points, and cut them at gaps; the number k of lines.

    The candidates are (r, theta) about the mean of the points (n, 2), best first. ``limits`` and
    ``votes`` are those of
    :func:`refined`, ``gap`` is the longest gap in a line, and ``least`` its least length, m. Set
    are the ``owner`` of each point (n,), -1 for none, the ``lines`` (k, 2) as (r, theta), and their
    ``ends`` (k, 2, 2), m.
    """
    total = len(points)
    size = 0
    middle_x = 0.0
    middle_y = 0.0
    for i in range(total):
        owner[i] = -1
        middle_x += points[i, 0]
        middle_y += points[i, 1]
    if total < votes:
        return 0
    middle_x = middle_x / total
    middle_y = middle_y / total
    free = np.ones(total, dtype=np.bool_)
    left = total
    for number in range(len(candidates)):
        theta = candidates[number, 1]
        r = candidates[number, 0] + middle_x * math.cos(theta) + middle_y * math.sin(theta)
        members, along = refined(points, free, r, theta, limits, votes)
        first = 0
        before = size
        for i in range(1, len(members) + 1):
            if i < len(members) and along[i] - along[i - 1] <= gap:
                continue
            part = members[first:i]
            first = i
            if len(part) < votes:
                continue
            r_part, theta_part = fit_line(points, part, ends[size])
            x = ends[size, 1, 0] - ends[size, 0, 0]
            y = ends[size, 1, 1] - ends[size, 0, 1]
            if math.sqrt(x * x + y * y) >= least:
                lines[size, 0] = r_part
                lines[size, 1] = theta_part
                for each in part:
                    owner[each] = size
                    free[each] = False
                left -= len(part)
                size += 1
        if (only_best and size > before) or left < votes:
            break
    return size


@entry
def extract_lines(
    points: FloatArray,
    max_gap: float,
    min_votes: int,
    r_step: float,
    theta_step: float,
    near_line: float,
    least: float,
    only_best: bool,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """The lines in a buffer of points (n, 2), m, best first, cut at gaps.

    Each point belongs to at most one line. The points of a line are removed, and the remaining
    points of a weaker candidate must still pass the threshold. So one wall cannot appear twice,
    neither in neighbouring bins nor across theta = 0, where (r, theta) and (-r, theta + pi) are the
    same line.

    Parameters
    ----------
    max_gap, near_line, least
        Longest gap in a line, largest distance of a point from its line, and least length of a
        line, m.
    min_votes, r_step, theta_step
        Threshold, and sizes of the bins, m and rad.
    only_best
        Whether to stop after the first candidate that has lines.

    Returns
    -------
    owner, lines, ends
        The line of each point (n,), -1 for none, the lines (k, 2) as (r, theta), and their end
        points (k, 2, 2), m.
    """
    total = len(points)
    about = points.copy()
    owner = np.full(len(points), -1)
    most = total // max(min_votes, 1) + 1
    lines = np.empty((most, 2))
    ends = np.empty((most, 2, 2))
    if total < min_votes:
        return owner, lines[:0], ends[:0]
    # Votes are counted about the points' centre, where r and theta are nearly independent.
    about[:, 0] -= points[:, 0].sum() / total
    about[:, 1] -= points[:, 1].sum() / total
    candidates = hough_votes(about, min_votes, r_step, theta_step)
    limits = r_step, near_line
    number = refine_lines(
        points, candidates, limits, min_votes, max_gap, least, only_best, owner, lines, ends
    )
    return owner, lines[:number], ends[:number]
