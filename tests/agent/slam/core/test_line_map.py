"""The line map: end points grow with what is seen and stay on their lines when the filter moves those."""

import math

import numpy as np
import pytest

from limslam_agent.slam.core.line_map import LineMap
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import along, at, distance, normalise

LINE = np.array([1.0, 0.5 * math.pi])  # y = 1


def wall(first: float, last: float, line: FloatArray = LINE) -> FloatArray:
    return at(line, np.array([first, last]))


def extent(segment: FloatArray, line: FloatArray = LINE) -> list[float]:
    """From where to where a segment (4,) reaches along a line, rounded to the micrometre."""
    return sorted(np.round(along(line, segment.reshape(2, 2)), 6).tolist())


@pytest.mark.parametrize(
    ("seen", "expected"),
    [
        ((0.5, 1.5), [0.0, 1.5]),  # onwards
        ((-0.6, 0.2), [-0.6, 1.0]),  # before
        ((0.2, 0.8), [0.0, 1.0]),  # inside: a wall does not shrink
        ((-1.0, 2.0), [-1.0, 2.0]),  # all of it and more
        ((1.3, 1.8), [0.0, 1.8]),  # past a short gap
        ((1.5, 0.5), [0.0, 1.5]),  # ends the other way round
    ],
)
def test_a_landmark_grows_to_what_is_seen_and_never_shrinks(seen: tuple[float, float], expected: list[float]) -> None:
    walls = LineMap()
    walls.add(wall(0.0, 1.0))
    walls.grow(0, LINE, wall(*seen))
    assert extent(walls.segments(LINE[None])[0]) == expected


@pytest.mark.parametrize("degrees", range(-180, 180, 30))
def test_segments_follow_their_line_when_it_moves(degrees: int) -> None:
    theta = math.radians(degrees)
    before, after = np.array([1.0, theta]), normalise(np.array([1.05, theta + 0.03]))
    walls = LineMap()
    walls.add(wall(0.2, 1.2, before))
    segment = walls.segments(after[None])[0].reshape(2, 2)
    np.testing.assert_allclose(distance(after, segment), 0.0, atol=1e-12)
    # The ends go where they fall on the line, by the shortest way: what they were along it hardly changes.
    assert np.linalg.norm(segment - wall(0.2, 1.2, before), axis=1).max() < 0.12
    np.testing.assert_allclose(distance(np.array([0.0, after[1] + 0.5 * math.pi]), segment),
                               along(after, wall(0.2, 1.2, before)), atol=1e-12)  # fmt: skip
