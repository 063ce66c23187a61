"""Hough: every wall in a buffer once, each piece of it, and nothing where there is none."""

import math
from typing import Any

import cv2
import numpy as np
import pytest

from limslam_agent.config.shared import HoughConfig
from limslam_agent.slam.core.hough import ExtractedLine, extract_lines, hough_votes
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import at, nearest_form

CONFIG = HoughConfig()


def wall(
    r: float, theta: float, first: float, last: float, *, count: int = 30, std: float = 0.005, seed: int = 0
) -> FloatArray:
    """Noisy points (count, 2) along a piece of a line."""
    generator = np.random.default_rng(seed)
    points = at(np.array([r, theta]), np.linspace(first, last, count))
    return points + generator.normal(0.0, std, (count, 2))


def assert_line(found: ExtractedLine, r: float, theta: float) -> None:
    expected = np.array([r, theta])
    np.testing.assert_allclose(nearest_form(found.fit.line, expected), expected, atol=0.04)


# Where OpenCV's bins begin and end: a wall there votes for (r, 0) as well as for (-r, pi).
ANGLES_DEG = (0.0, 0.4, -0.4, 1.0, -1.0, 30.0, 89.6, 90.0, 135.0, 179.0, 179.6, 180.0, -179.6, -90.0, -45.0)


@pytest.mark.parametrize("degrees", ANGLES_DEG)
@pytest.mark.parametrize("std", [0.0, 0.005, 0.02])
@pytest.mark.parametrize("r", [0.0, 0.5, 3.0])
def test_one_wall_is_found_once(degrees: float, std: float, r: float) -> None:
    theta = math.radians(degrees)
    points = wall(r, theta, -0.4, 0.4, std=std, seed=3)
    found = extract_lines(points, CONFIG, max(std, 0.005))
    assert len(found) == 1
    assert_line(found[0], r, theta)
    assert len(found[0].members) >= 27


@pytest.mark.parametrize("turn_deg", range(-180, 180, 20))
def test_a_corner_gives_both_walls(turn_deg: int) -> None:
    turn = math.radians(turn_deg)
    points = np.vstack((wall(0.5, turn, -0.5, 0.5, count=20), wall(0.5, turn + 0.5 * math.pi, -0.5, 0.5, count=16)))
    found = extract_lines(points, CONFIG, 0.005)
    assert len(found) == 2
    # Which has more votes depends on how the bins cut the walls. The first 20 points are the first wall's.
    first, second = sorted(found, key=lambda line: float(np.median(line.members)))
    assert_line(first, 0.5, turn)
    assert_line(second, 0.5, turn + 0.5 * math.pi)


def test_only_best_takes_the_wall_with_the_most_votes() -> None:
    points = np.vstack((wall(0.5, 0.0, -0.5, 0.5, count=12), wall(0.5, 0.5 * math.pi, -0.5, 0.5, count=18)))
    found = extract_lines(points, HoughConfig(only_best=True), 0.005)
    assert len(found) == 1
    assert_line(found[0], 0.5, 0.5 * math.pi)


def test_two_parallel_walls_are_two() -> None:
    points = np.vstack((wall(0.5, 0.7, -0.4, 0.4, count=20), wall(0.9, 0.7, -0.4, 0.4, count=20)))
    found = extract_lines(points, CONFIG, 0.005)
    assert sorted(round(float(line.fit.line[0]), 1) for line in found) == [0.5, 0.9]


@pytest.mark.parametrize("degrees", [0.0, 40.0, 90.0, 180.0])
def test_walls_on_one_line_with_a_gap_between_are_two_pieces(degrees: float) -> None:
    theta = math.radians(degrees)
    points = np.vstack((wall(0.5, theta, -1.0, -0.4, count=15), wall(0.5, theta, 0.4, 1.0, count=15, seed=1)))
    found = extract_lines(points, CONFIG, 0.005)
    assert len(found) == 2
    lengths = [line.fit.length for line in found]
    assert lengths == pytest.approx([0.6, 0.6], abs=0.03)
    # Neither reaches over the gap.
    assert sorted(tuple(sorted(line.members.tolist())) for line in found) == [tuple(range(15)), tuple(range(15, 30))]


def test_a_gap_shorter_than_the_setting_keeps_the_wall_whole() -> None:
    points = np.vstack((wall(0.5, 0.3, -0.6, -0.1, count=15), wall(0.5, 0.3, 0.1, 0.6, count=15)))
    found = extract_lines(points, CONFIG, 0.005)
    assert len(found) == 1
    assert found[0].fit.length == pytest.approx(1.2, abs=0.03)


@pytest.mark.parametrize("seed", range(10))
def test_points_all_over_the_place_are_no_wall(seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (30, 2))
    assert extract_lines(points, CONFIG, 0.005) == []


@pytest.mark.parametrize("seed", range(10))
def test_a_small_blob_has_the_votes_but_is_too_short_for_a_wall(seed: int) -> None:
    points = np.array([0.4, 0.6]) + np.random.default_rng(seed).normal(0.0, 0.02, (30, 2))
    assert len(hough_votes(points - points.mean(axis=0), CONFIG.min_votes, 0.02, CONFIG.theta_step)) > 0
    assert extract_lines(points, CONFIG, 0.005) == []


def test_outliers_do_not_move_the_wall() -> None:
    outliers = np.random.default_rng(4).uniform(-1.0, 1.0, (6, 2))
    points = np.vstack((wall(0.5, 1.0, -0.4, 0.4, count=24), outliers))
    found = extract_lines(points, CONFIG, 0.005)
    assert len(found) == 1
    np.testing.assert_allclose(found[0].fit.line, [0.5, 1.0], atol=0.02)


@pytest.mark.parametrize("count", [0, 1, 7])
def test_fewer_points_than_the_threshold_give_nothing(count: int) -> None:
    assert extract_lines(wall(0.5, 1.0, -0.4, 0.4, count=count), CONFIG, 0.005) == []


def test_as_many_votes_as_the_threshold_are_a_wall() -> None:
    # Exact points in the middle of a bin: all of them vote for one line. "Every line with this many votes is taken."
    points = wall(0.5, 0.0, -0.4, 0.4, count=8, std=0.0)
    assert len(extract_lines(points, HoughConfig(min_votes=7), 0.005)) == 1
    assert len(extract_lines(points, HoughConfig(min_votes=8), 0.005)) == 1


def test_the_threshold_is_of_votes_for_one_line() -> None:
    # 30 points, but no wall of theirs has 25.
    points = np.vstack((wall(0.5, 0.0, -0.5, 0.5, count=15), wall(0.5, 0.5 * math.pi, -0.5, 0.5, count=15)))
    assert extract_lines(points, HoughConfig(min_votes=25), 0.005) == []


def test_opencv_finding_nothing_at_all_is_no_wall(monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(*_: Any, **__: Any) -> None:
        return None

    monkeypatch.setattr(cv2, "HoughLinesPointSet", nothing)
    points = wall(0.5, 1.0, -0.4, 0.4)
    assert hough_votes(points, CONFIG.min_votes, 0.02, CONFIG.theta_step).shape == (0, 3)
    assert extract_lines(points, CONFIG, 0.005) == []


def test_votes_come_best_first_and_pass_the_threshold() -> None:
    points = np.vstack((wall(0.5, 0.0, -0.3, 0.3, count=12, std=0.0), wall(-0.1, 1.8, -0.5, 0.5, count=18)))
    votes, r, theta = hough_votes(points, CONFIG.min_votes, 0.02, CONFIG.theta_step).T
    assert len(votes) >= 3
    assert (np.diff(votes) <= 0.0).all()
    assert votes.min() >= CONFIG.min_votes
    # The exact wall lies in the middle of a bin and gets all its points' votes.
    exact = (theta < 1e-6) & (np.abs(r - 0.5) < 0.011)
    assert votes[exact].max() >= 12
    assert ((theta >= 0.0) & (theta < math.pi)).all()


@pytest.mark.parametrize("seed", range(8))
def test_each_point_belongs_to_at_most_one_line(seed: int) -> None:
    # Four crossing walls, so that many points lie near two of them.
    generator = np.random.default_rng(seed)
    parts = [
        wall(generator.uniform(0.0, 0.3), t, -0.6, 0.6, count=25, std=0.01, seed=seed) for t in (0.1, 0.9, 1.7, 2.6)
    ]
    points = np.vstack(parts)
    found = extract_lines(points, CONFIG, 0.01)
    assert len(found) >= 3
    members = np.concatenate([line.members for line in found])
    assert len(members) == len(set(members.tolist()))
    for line in found:
        assert len(line.members) >= CONFIG.min_votes
        assert line.fit.length >= CONFIG.min_length


def test_where_the_buffer_lies_does_not_matter() -> None:
    # Votes are counted about the middle of the points: a wall far from the origin is no harder.
    for shift in ((0.0, 0.0), (30.0, -20.0)):
        points = wall(0.5, 0.9, -0.4, 0.4, std=0.01) + np.array(shift)
        found = extract_lines(points, CONFIG, 0.01)
        assert len(found) == 1
        assert len(found[0].members) == 30
