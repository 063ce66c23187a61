"""Lines out of points: the Hough transform, and the fit that follows it."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limslam_agent.config.shared import HoughConfig
from limslam_agent.kernels import lines
from limslam_agent.kernels.compilation import entry
from limslam_agent.kernels.tables import LineRules
from limslam_agent.slam.core.line_fit import LineFit, extract_lines, fit_line
from limslam_env.geometry import FloatArray, se2
from limslam_env.geometry import line as line_geometry

CONFIG = HoughConfig()

hough_votes = entry(lines.hough_votes.py_func)


def wall(
    r: float,
    theta: float,
    first: float,
    last: float,
    *,
    count: int = 30,
    std: float = 0.005,
    seed: int = 0,
) -> FloatArray:
    """Noisy points (count, 2) along a piece of a line."""
    generator = np.random.default_rng(seed)
    points = line_geometry.at(np.array([r, theta]), np.linspace(first, last, count))
    return points + generator.normal(0.0, std, (count, 2))


def assert_line(found: LineFit, r: float, theta: float) -> None:
    expected = np.array([r, theta])
    np.testing.assert_allclose(
        line_geometry.nearest_form(found.line, expected), expected, atol=0.04
    )


# Where the bins of theta begin and end: a wall there votes for (r, 0) as well as for (-r, pi).
@pytest.mark.parametrize("degrees", [0.0, 0.4, 30.0, 179.6, -45.0])
@pytest.mark.parametrize("std", [0.0, 0.02])
def test_one_wall_is_found_once(degrees: float, std: float) -> None:
    theta = math.radians(degrees)
    for r in (0.0, 0.5, 3.0):
        found = extract_lines(wall(r, theta, -0.4, 0.4, std=std, seed=3), CONFIG, max(std, 0.005))
        assert len(found) == 1
        assert_line(found[0][0], r, theta)
        assert len(found[0][1]) >= 27


def test_a_corner_gives_both_walls() -> None:
    for turn in np.radians(range(-180, 180, 20)):
        points = np.vstack(
            (
                wall(0.5, turn, -0.5, 0.5, count=20),
                wall(0.5, turn + 0.5 * math.pi, -0.5, 0.5, count=16),
            )
        )
        found = extract_lines(points, CONFIG, 0.005)
        assert len(found) == 2
        # Which has more votes depends on how the bins cut the walls. The first 20 points are the
        # first wall's.
        (first, _), (second, _) = sorted(found, key=lambda line: float(np.median(line[1])))
        assert_line(first, 0.5, turn)
        assert_line(second, 0.5, turn + 0.5 * math.pi)


@pytest.mark.parametrize("theta", [0.0, 0.7, math.pi])
def test_walls_are_cut_at_gaps_above_the_setting(theta: float) -> None:
    apart = np.vstack(
        (wall(0.5, theta, -1.0, -0.4, count=15), wall(0.5, theta, 0.4, 1.0, count=15, seed=1))
    )
    found = extract_lines(apart, CONFIG, 0.005)
    assert [fit.length for fit, _ in found] == pytest.approx([0.6, 0.6], abs=0.03)
    assert sorted(tuple(sorted(members.tolist())) for _, members in found) == [
        tuple(range(15)),
        tuple(range(15, 30)),
    ]
    near = np.vstack((wall(0.5, theta, -0.6, -0.1, count=15), wall(0.5, theta, 0.1, 0.6, count=15)))
    assert [fit.length for fit, _ in extract_lines(near, CONFIG, 0.005)] == pytest.approx(
        [1.2], abs=0.03
    )


def test_points_all_over_the_place_and_small_blobs_are_no_wall() -> None:
    for seed in range(10):
        generator = np.random.default_rng(seed)
        assert extract_lines(generator.uniform(-1.0, 1.0, (30, 2)), CONFIG, 0.005) == []
        assert (
            extract_lines(
                np.array([0.4, 0.6]) + generator.normal(0.0, 0.02, (30, 2)), CONFIG, 0.005
            )
            == []
        )


def test_the_threshold_is_of_votes_for_one_line() -> None:
    for count in (0, 1, 7):
        assert extract_lines(wall(0.5, 1.0, -0.4, 0.4, count=count), CONFIG, 0.005) == []
    # Exact points in the middle of a bin: all of them vote for one line.
    points = wall(0.5, 0.0, -0.4, 0.4, count=8, std=0.0)
    assert len(extract_lines(points, HoughConfig(min_votes=8), 0.005)) == 1
    # 30 points, but no wall of theirs has 25.
    points = np.vstack(
        (wall(0.5, 0.0, -0.5, 0.5, count=15), wall(0.5, 0.5 * math.pi, -0.5, 0.5, count=15))
    )
    assert extract_lines(points, HoughConfig(min_votes=25), 0.005) == []


def test_votes_are_those_of_opencv() -> None:
    for seed in range(20):
        generator = np.random.default_rng(seed)
        theta = generator.uniform(0.0, math.pi)
        size = int(generator.integers(20, 80))
        points = np.vstack(
            (
                wall(0.3, theta, -0.5, 0.5, count=size, std=0.02),
                generator.uniform(-1.0, 1.0, (20, 2)),
            )
        )
        reach = float(np.hypot(*points.T).max())
        votes = int(generator.integers(5, 12))
        expected = cv2.HoughLinesPointSet(
            points.astype(np.float32)[:, None],
            lines_max=lines.MAX_CANDIDATES,
            threshold=votes - 1,
            min_rho=-reach - 0.06,
            max_rho=reach + 0.06,
            rho_step=0.06,
            min_theta=0.0,
            max_theta=math.pi,
            theta_step=math.pi / 90,
        )
        rules = LineRules(0.0, 0.0, 0.0, votes, 0.06, math.pi / 90, only_best=False)
        found = hough_votes(points, rules)
        expected = expected.reshape(-1, 3)
        np.testing.assert_allclose(
            found, expected[np.argsort(-expected[:, 0], kind="stable"), 1:], atol=1e-6
        )


angles = st.floats(-math.pi, math.pi)
lengths = st.floats(0.3, 4.0)


def points_on(line: FloatArray, first: float, last: float, count: int = 15) -> FloatArray:
    return line_geometry.at(line, np.linspace(first, last, count))


@settings(deadline=None, max_examples=200)
@given(
    st.one_of(st.floats(0.0, 10.0), st.sampled_from([0.0, 1e-12, 1e-6])),
    angles,
    st.floats(-5.0, 5.0),
    lengths,
)
def test_exact_points_give_the_exact_line_and_its_ends(
    r: float, theta: float, first: float, length: float
) -> None:
    line = np.array([r, theta])
    points = points_on(line, first, first + length)
    fit = fit_line(np.random.default_rng(1).permutation(points), 0.01)
    np.testing.assert_allclose(line_geometry.nearest_form(fit.line, line), line, atol=1e-9)
    assert fit.line[0] >= 0.0
    assert -math.pi < fit.line[1] <= math.pi
    ends = fit.ends if np.linalg.norm(fit.ends[0] - points[0]) < 0.5 * length else fit.ends[::-1]
    np.testing.assert_allclose(ends, points[[0, -1]], atol=1e-9)
    assert fit.length == pytest.approx(length, abs=1e-9)


# Middle of the wall relative to the origin and its direction: beside, ahead, far off, and through
# the origin.
PLACES = [
    ((0.0, 0.5), 0.0),
    ((-1.0, 0.2), 95.0),
    ((-8.0, 9.0), 60.0),
    ((-0.3, -0.3), -135.0),
]


@pytest.mark.parametrize(("middle", "degrees"), PLACES)
def test_the_covariance_is_what_noise_scatters(middle: tuple[float, float], degrees: float) -> None:
    std = 0.01
    runs = 2000
    generator = np.random.default_rng(5)
    pose = np.array([*middle, math.radians(degrees)])
    wall = se2.transform_points(pose, np.column_stack((np.linspace(-0.5, 0.5, 20), np.zeros(20))))
    truth = fit_line(wall, std)
    distances = np.empty(runs)
    differences = np.empty((runs, 2))
    for run in range(runs):
        # Noise across the wall alone: that is what the fit's std means.
        fit = fit_line(
            wall + generator.normal(0.0, std, (20, 1)) * line_geometry.normal(truth.line), std
        )
        difference = line_geometry.nearest_form(truth.line, fit.line) - fit.line
        distances[run] = difference @ np.linalg.solve(fit.covariance, difference)
        # For the scatter all fits must be in one form, which the truth's is.
        differences[run] = line_geometry.nearest_form(fit.line, truth.line) - truth.line
    # Two numbers: mean 2, and the mean of 2000 scatters by 2 / sqrt(2000) = 0.045.
    assert distances.mean() == pytest.approx(2.0, abs=0.18)
    scale = np.sqrt(np.diag(truth.covariance))
    np.testing.assert_allclose(
        np.cov(differences.T) / np.outer(scale, scale),
        truth.covariance / np.outer(scale, scale),
        atol=0.12,
    )
