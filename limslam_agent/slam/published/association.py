"""Association of an observed line with landmarks: the Mahalanobis distance, and four exclusion
tests.

Exclusion 1 is by the end points along the wall, 2 by what the beams can see, 3 by the distance from
the robot, and 4 by the direction of the line and the distance of its middle.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from limslam_agent.config.published import AssociationConfig
from limslam_agent.slam.core.diagnostics import CandidateTest
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.line import direction, from_frame, normal
from limslam_env.geometry.se2 import transform_points, wrap_angle
from limslam_env.geometry.segment import distances as segment_distances


@dataclass(frozen=True, eq=False)
class ObservedLine:
    """A line that the robot has observed, in its present frame.

    Attributes
    ----------
    line, covariance
        (r, theta) and its covariance (2, 2).
    ends
        End points (2, 2), m.
    origins, points
        Origins and end points (n, 2), m, of the beams that observed the line.
    """

    line: FloatArray
    covariance: FloatArray
    ends: FloatArray
    origins: FloatArray
    points: FloatArray


_BEHIND = 0.05
"""A beam may begin this far behind a line, m, because noise moves the line."""

_MOST_UNSEEN = 0.35
"""A landmark may continue this far beyond its known ends, m, besides the effect of noise."""

Innovation = Callable[[FloatArray, FloatArray, int], tuple[FloatArray, FloatArray]]


def associate(
    observed: ObservedLine,
    pose: FloatArray,
    lines: FloatArray,
    segments: FloatArray,
    innovation: Innovation,
    max_range: float,
    config: AssociationConfig,
) -> list[CandidateTest]:
    """All landmarks with the exclusion that throws each of them out; without one, an observation
    may show it.

    The landmarks are lines (N, 2), and segments (N, 4), m, in the world, and the robot is estimated
    to be at a pose (3,). ``innovation`` makes of observed line, its covariance and a landmark's
    index their difference (2,) and the covariance of both (2, 2). The robot's beams measure up to
    ``max_range``, m, from its centre.
    """
    if len(lines) == 0:
        return []
    ends = transform_points(pose, observed.ends)
    line = from_frame(observed.line, pose)
    tests = []
    (angles, offsets), gaps = difference(line, ends, lines), end_gaps(ends, lines, segments)
    passed = passed_tests(
        observed, pose, segments, (angles, offsets, gaps), max_range + config.range_slack, config
    )
    for index in range(len(lines)):
        excluded = next((name for name, passes in passed.items() if not passes[index]), "")
        squared = np.nan
        if not excluded:
            off, covariance = innovation(observed.line, observed.covariance, index)
            squared = float(off @ np.linalg.solve(covariance, off))
            excluded = "gate" if squared > config.gate else ""
        angle = float(angles[index])
        offset = float(offsets[index])
        gap = float(gaps[index])
        tests.append(CandidateTest(index, excluded, angle, offset, gap, squared))
    return tests


def passed_tests(
    observed: ObservedLine,
    pose: FloatArray,
    segments: FloatArray,
    off: tuple[FloatArray, FloatArray, FloatArray],
    reach: float,
    config: AssociationConfig,
) -> dict[str, BoolArray]:
    """Which landmarks (N,) pass each of the four exclusion tests, by angles, offsets and gaps (N,)
    and their reach, m.

    By the test of the ends, two walls on one line with a door between them remain two landmarks.
    """
    # Beams must meet the landmark even where the test of the ends is disabled.
    seen_past_ends = min(config.max_end_gap, _MOST_UNSEEN) + config.range_slack
    return {
        "ends": off[2] <= config.max_end_gap,
        "range": segment_distances(pose[None, :2], segments)[0] <= reach,
        "direction": (off[0] <= config.max_angle) & (off[1] <= config.max_distance),
        "hidden": visible(observed, pose, segments, reach, seen_past_ends),
    }


def end_gaps(ends: FloatArray, lines: FloatArray, segments: FloatArray) -> FloatArray:
    """Gaps (N,), m, along landmarks between their ends and those of an observation (2, 2); negative
    for an overlap.
    """
    directions = direction(lines)
    observed = np.sort(directions @ ends.T, axis=1)
    known = np.sort(
        np.column_stack(
            (
                np.sum(segments[:, :2] * directions, axis=1),
                np.sum(segments[:, 2:] * directions, axis=1),
            )
        ),
        axis=1,
    )
    return np.asarray(np.maximum(observed[:, 0] - known[:, 1], known[:, 0] - observed[:, 1]))


def visible(
    observed: ObservedLine, pose: FloatArray, segments: FloatArray, max_range: float, slack: float
) -> BoolArray:
    """Landmarks (N,) that the beams which made the observation can see.

    Most of those beams must meet the landmark, lengthened by ``slack`` (m) at its ends, ahead of
    them and within ``max_range`` (m). A landmark behind another one counts as visible, because
    after a loop the map may hold the same wall twice, and the younger landmark must not hide the
    older one.
    """
    origins = transform_points(pose, observed.origins)
    reaches = transform_points(pose, observed.points) - origins
    reaches /= np.maximum(np.linalg.norm(reaches, axis=1, keepdims=True), 1e-12)
    return np.asarray(
        (_crossings(origins, reaches, segments, slack) < max_range).mean(axis=0) >= 0.5
    )


def _crossings(
    origins: FloatArray, directions: FloatArray, segments: FloatArray, slack: float
) -> FloatArray:
    """Ranges (n, N), m, at which beams meet each lengthened segment; infinite where they do not
    meet it.
    """
    start = segments[:, :2]
    span = segments[:, 2:] - start
    length = np.maximum(np.linalg.norm(span, axis=1), 1e-12)
    tangent = span / length[:, None]
    offset = start[None] - origins[:, None]
    cross = directions[:, :1] * tangent[:, 1] - directions[:, 1:] * tangent[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = (offset[..., 0] * tangent[:, 1] - offset[..., 1] * tangent[:, 0]) / cross
        position = (offset[..., 0] * directions[:, 1:] - offset[..., 1] * directions[:, :1]) / cross
    met = (ahead > -_BEHIND) & (position > -slack) & (position < length + slack)
    return np.where(met, ahead, np.inf)


def difference(
    line: FloatArray, ends: FloatArray, lines: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Angles (N,), rad, between a line and landmarks, and the distances (N,), m, of its middle from
    them.
    """
    angles = np.abs(wrap_angle(lines[:, 1] - line[1]))
    return np.minimum(angles, np.pi - angles), np.abs(
        normal(lines) @ ends.mean(axis=0) - lines[:, 0]
    )
