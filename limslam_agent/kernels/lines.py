"""Lines in points: the Hough transform finds them, and total least squares refines them.

The Hough transform is that of R. Duda and P. Hart, "Use of the Hough transformation to detect lines
and curves in pictures", 1972, with the arithmetic of OpenCV's ``HoughLinesPointSet``, which is
partly in single precision.
"""

import math

import numpy as np

from limslam_agent.kernels.algebra import order_of, wrapped
from limslam_agent.kernels.compilation import compiled, entry
from limslam_agent.kernels.tables import LineRules
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
def mean_of(points: FloatArray) -> tuple[float, float]:
    """The centre of points (n, 2)."""
    x = 0.0
    y = 0.0
    for i in range(len(points)):
        x += points[i, 0]
        y += points[i, 1]
    return x / len(points), y / len(points)


@compiled
def hough_votes(points: FloatArray, rules: LineRules) -> FloatArray:
    """Lines (k, 2) as (r, theta), m and rad, that enough points (n, 2), m, vote for, best first.

    r may be negative, and theta is in [0, pi). Points that would need more than ``MOST_BINS`` are
    too far apart for a line.
    """
    single = np.float32
    step = rules.r_step
    min_votes = rules.min_votes
    reach = 0.0
    for i in range(len(points)):
        reach = max(reach, math.sqrt(points[i, 0] * points[i, 0] + points[i, 1] * points[i, 1]))
    angles = num_angles(rules.theta_step)
    low = -reach - step
    # A comparison with NaN is false.
    if not (angles + 2) * ((reach + step - low + 1.0) / step + 2.0) < MOST_BINS:
        return np.empty((0, 2))
    inverse = single(1.0) / single(step)
    lowest = single(low) * inverse
    wide = int(np.rint((reach + step - low + 1.0) / step)) + 2
    counts = np.zeros((angles + 2) * wide, dtype=np.int32)
    found = np.empty(len(points) * angles // max(min_votes, 1), dtype=np.int64)
    size = 0
    angle = single(0.0)
    xs = np.empty(len(points), dtype=single)
    ys = np.empty(len(points), dtype=single)
    for i in range(len(points)):
        xs[i] = points[i, 0]
        ys[i] = points[i, 1]
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
        angle += single(rules.theta_step)
    places_found = peaks(counts, wide, found[:size])
    lines = np.empty((len(places_found), 2))
    for i in range(len(places_found)):
        n = places_found[i] // wide - 1
        r = places_found[i] - (n + 1) * wide - 1
        lines[i, 0] = float(single(low) + single(r) * single(step))
        lines[i, 1] = float(single(0.0) + single(n) * single(rules.theta_step))
    return lines


@compiled
def peaks(counts: np.ndarray, wide: int, found: IntArray) -> IntArray:
    """Those bins (k,) of ``found`` that have more votes than their neighbours, best first."""
    keys = np.empty(len(found))
    number = 0
    for place in found:
        votes = counts[place]
        is_peak = votes > counts[place - 1] and votes >= counts[place + 1]
        if is_peak and votes > counts[place - wide] and votes >= counts[place + wide]:
            # Most votes first; of equal votes, the first bin.
            keys[number] = place - votes * 2.0**32
            found[number] = place
            number += 1
    order = order_of(keys[:number])[:MAX_CANDIDATES]
    for i in range(len(order)):
        order[i] = found[order[i]]
    return order


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
def near_line(points: FloatArray, owner: IntArray, r: float, theta: float, most: float) -> IntArray:
    """Indices (n,) of the points without an owner within ``most``, m, of a line."""
    cos = math.cos(theta)
    sin = math.sin(theta)
    members = np.empty(len(points), dtype=np.int64)
    number = 0
    for i in range(len(points)):
        if owner[i] < 0 and abs(points[i, 0] * cos + points[i, 1] * sin - r) <= most:
            members[number] = i
            number += 1
    return members[:number]


@compiled
def refined(
    points: FloatArray, owner: IntArray, r: float, theta: float, rules: LineRules
) -> tuple[IntArray, FloatArray]:
    """Indices (n,) of a candidate line's points after two refinements, and their positions along
    it, m, sorted.

    Points belong to it within a bin of it, and then within ``near_line``.
    """
    ends = np.empty((2, 2))
    members = near_line(points, owner, r, theta, rules.r_step)
    for _ in range(2):
        if len(members) < rules.min_votes:
            return members[:0], np.empty(0)
        r, theta = fit_line(points, members, ends)
        members = near_line(points, owner, r, theta, rules.near_line)
    cos = math.cos(theta)
    sin = math.sin(theta)
    along = np.empty(len(members))
    for i in range(len(members)):
        along[i] = points[members[i], 1] * cos - points[members[i], 0] * sin
    order = order_of(along)
    ordered = np.empty(len(members))
    for i in range(len(members)):
        ordered[i] = along[order[i]]
        order[i] = members[order[i]]
    return order, ordered


@entry
def extract_lines(points: FloatArray, rules: LineRules) -> tuple[IntArray, FloatArray, FloatArray]:
    """The lines in a buffer of points (n, 2), m, best first, cut at gaps.

    Each point belongs to at most one line. The points of a line are removed, and the remaining
    points of a weaker candidate must still pass the threshold. So one wall cannot appear twice,
    neither in neighbouring bins nor across theta = 0, where (r, theta) and (-r, theta + pi) are the
    same line.

    Returns
    -------
    owner, lines, ends
        The line of each point (n,), -1 for none, the lines (k, 2) as (r, theta), and their end
        points (k, 2, 2), m.
    """
    total = len(points)
    votes = rules.min_votes
    owner = np.full(total, -1)
    most = total // max(votes, 1) + 1
    lines = np.empty((most, 2))
    ends = np.empty((most, 2, 2))
    size = 0
    if total < votes:
        return owner, lines[:0], ends[:0]
    # Votes are counted about the points' centre, where r and theta are nearly independent.
    middle_x, middle_y = mean_of(points)
    about = np.empty((total, 2))
    for i in range(total):
        about[i, 0] = points[i, 0] - middle_x
        about[i, 1] = points[i, 1] - middle_y
    candidates = hough_votes(about, rules)
    left = total
    for number in range(len(candidates)):
        theta = candidates[number, 1]
        r = candidates[number, 0] + middle_x * math.cos(theta) + middle_y * math.sin(theta)
        members, along = refined(points, owner, r, theta, rules)
        first = 0
        before = size
        for i in range(1, len(members) + 1):
            if i < len(members) and along[i] - along[i - 1] <= rules.max_gap:
                continue
            part = members[first:i]
            first = i
            if len(part) < votes:
                continue
            r_part, theta_part = fit_line(points, part, ends[size])
            x = ends[size, 1, 0] - ends[size, 0, 0]
            y = ends[size, 1, 1] - ends[size, 0, 1]
            if math.sqrt(x * x + y * y) >= rules.least:
                lines[size, 0] = r_part
                lines[size, 1] = theta_part
                for place in part:
                    owner[place] = size
                left -= len(part)
                size += 1
        if (rules.only_best and size > before) or left < votes:
            break
    return owner, lines[:size], ends[:size]
