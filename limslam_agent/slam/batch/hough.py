"""Lines in the readings of one side: `hough` and `line_fit` for kernels, vote by vote as OpenCV counts them."""

import math

import numpy as np

from limslam_agent.slam.batch.algebra import sort_with, wrapped
from limslam_agent.slam.batch.compilation import compiled
from limslam_agent.slam.batch.state import Settings
from limslam_env.geometry import FloatArray, IntArray

_MOST_CANDIDATES = 200
_BESIDE_CORNER = 0.15  # m
_FEWEST = 6


@compiled
def num_angles(step: float) -> int:
    """How many bins OpenCV makes of half a turn."""
    number = math.floor(math.pi / step) + 1
    return number - 1 if number > 1 and abs(math.pi - (number - 1) * step) < 0.5 * step else number


@compiled
def votes(points: FloatArray, settings: Settings) -> FloatArray:
    """Lines (k, 2) as (r, theta) with enough votes, best first: `hough.hough_votes`.

    The arithmetic is that of OpenCV's ``HoughLinesPointSet``, in single precision where it is.
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
            # Each place comes past the threshold once.
            if counts[place] == settings.min_votes:
                found[size] = place
                size += 1
        angle += single(settings.theta_step)
    return peaks(counts, wide, found[:size], single(low), settings)


@compiled
def peaks(
    counts: np.ndarray, wide: int, found: IntArray, low: np.float32, settings: Settings
) -> FloatArray:  # fmt: skip
    """The lines of those places that have more votes than their neighbours."""
    keys, places, size = np.empty(len(found)), np.empty(len(found), dtype=np.int64), 0
    for place in found:
        votes_here = counts[place]
        if (
            votes_here > counts[place - 1]
            and votes_here >= counts[place + 1]
            and votes_here > counts[place - wide]
            and votes_here >= counts[place + wide]
        ):
            # Most votes first, of equal ones the earlier place.
            keys[size], places[size] = place - float(votes_here) * 2.0**32, place
            size += 1
    sort_with(keys, places, size)
    size = min(size, _MOST_CANDIDATES)
    lines = np.empty((size, 2))
    for i in range(size):
        n = places[i] // wide - 1
        r = places[i] - (n + 1) * wide - 1
        lines[i, 0] = float(low + np.float32(r) * np.float32(settings.r_step))
        lines[i, 1] = float(np.float32(0.0) + np.float32(n) * np.float32(settings.theta_step))
    return lines


@compiled
def fit(points: FloatArray, members: IntArray, ends: FloatArray) -> tuple[float, float]:
    """(r, theta), normalised, by total least squares, and where it ends (2, 2): `line_fit.fit_line`."""
    middle_x, middle_y, number = 0.0, 0.0, len(members)
    for i in members:
        middle_x += points[i, 0]
        middle_y += points[i, 1]
    middle_x, middle_y = middle_x / number, middle_y / number
    xx, yy, xy = 0.0, 0.0, 0.0
    for i in members:
        x, y = points[i, 0] - middle_x, points[i, 1] - middle_y
        xx, yy, xy = xx + x * x, yy + y * y, xy + x * y
    axis = 0.5 * math.atan2(2.0 * xy, xx - yy)
    cos, sin, theta = math.cos(axis), math.sin(axis), axis + 0.5 * math.pi
    r = middle_x * math.cos(theta) + middle_y * math.sin(theta)
    least, most = np.inf, -np.inf
    for i in members:
        along = (points[i, 0] - middle_x) * cos + (points[i, 1] - middle_y) * sin
        least, most = min(least, along), max(most, along)
    ends[0, 0], ends[0, 1] = middle_x + least * cos, middle_y + least * sin
    ends[1, 0], ends[1, 1] = middle_x + most * cos, middle_y + most * sin
    return (-r, wrapped(theta + math.pi)) if r < 0.0 else (r, wrapped(theta))


@compiled
def near(points: FloatArray, free: np.ndarray, r: float, theta: float, most: float) -> IntArray:
    """The free points within ``most`` (m) of a line."""
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
    """The points of a candidate line (n,), refined on them twice, and where they fall along it, in order."""
    ends = np.empty((2, 2))
    for tolerance in (settings.r_step, settings.near_line):
        members = near(points, free, r, theta, tolerance)
        if len(members) < settings.min_votes:
            return members[:0], np.empty(0)
        r, theta = fit(points, members, ends)
    members = near(points, free, r, theta, settings.near_line)
    cos, sin, along = math.cos(theta), math.sin(theta), np.empty(len(members))
    for i in range(len(members)):
        along[i] = -sin * points[members[i], 0] + cos * points[members[i], 1]
    sort_with(along, members, len(members))
    return members, along


@compiled
def extract(
    points: FloatArray, max_gap: float, settings: Settings, owner: IntArray, lines: FloatArray, ends: FloatArray
) -> int:
    """How many lines there are in points (n, 2): `hough.extract_lines`.

    Each point's line goes into ``owner`` (n,), -1 for none; the lines as (r, theta) into ``lines`` (k, 2), and where
    they end into ``ends`` (k, 2, 2).
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
    for candidate in votes(about, settings):
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
            r_part, theta_part = fit(points, part, ends[size])
            x, y = ends[size, 1, 0] - ends[size, 0, 0], ends[size, 1, 1] - ends[size, 0, 1]
            if math.sqrt(x * x + y * y) >= settings.piece_length:
                lines[size, 0], lines[size, 1] = r_part, theta_part
                for each in part:
                    owner[each], free[each] = size, False
                left -= len(part)
                size += 1
        if (settings.only_best and size > before) or left < settings.min_votes:
            break
    return size


@compiled
def uncontested(
    points: FloatArray, owner: IntArray, lines: FloatArray, ends: FloatArray, size: int, index: int, most: float
) -> IntArray:
    """The points of one line without those near a corner that could as well be another's; few are none."""
    chosen, count = np.empty(len(points), dtype=np.int64), 0
    for i in range(len(points)):
        is_own = owner[i] == index
        for other in range(size):
            if not is_own or other == index:
                continue
            cos, sin = math.cos(lines[other, 1]), math.sin(lines[other, 1])
            first = -sin * ends[other, 0, 0] + cos * ends[other, 0, 1]
            last = -sin * ends[other, 1, 0] + cos * ends[other, 1, 1]
            along = -sin * points[i, 0] + cos * points[i, 1]
            is_beside = min(first, last) - _BESIDE_CORNER < along < max(first, last) + _BESIDE_CORNER
            off = abs(points[i, 0] * cos + points[i, 1] * sin - lines[other, 0])
            is_own = not (is_beside and off < most)
        if is_own:
            chosen[count] = i
            count += 1
    return chosen[:count] if count >= _FEWEST else chosen[:0]
