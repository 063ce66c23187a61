"""The line fit: exact on exact points, all round the circle, and its covariance is what noise scatters."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limslam_agent.slam.core.line_fit import fit_line
from limslam_env.geometry import FloatArray, se2
from limslam_env.geometry import line as line_geometry

angles, lengths = st.floats(-math.pi, math.pi), st.floats(0.3, 4.0)


def points_on(line: FloatArray, first: float, last: float, count: int = 15) -> FloatArray:
    return line_geometry.at(line, np.linspace(first, last, count))


@settings(deadline=None, max_examples=200)
@given(st.one_of(st.floats(0.0, 10.0), st.sampled_from([0.0, 1e-12, 1e-6])), angles, st.floats(-5.0, 5.0), lengths)
def test_exact_points_give_the_exact_line_and_its_ends(r: float, theta: float, first: float, length: float) -> None:
    line = np.array([r, theta])
    points = points_on(line, first, first + length)
    fit = fit_line(np.random.default_rng(1).permutation(points), 0.01)
    np.testing.assert_allclose(line_geometry.nearest_form(fit.line, line), line, atol=1e-9)
    assert fit.line[0] >= 0.0
    assert -math.pi < fit.line[1] <= math.pi
    ends = fit.ends if np.linalg.norm(fit.ends[0] - points[0]) < 0.5 * length else fit.ends[::-1]
    np.testing.assert_allclose(ends, points[[0, -1]], atol=1e-9)
    assert fit.length == pytest.approx(length, abs=1e-9)


# Middle of the wall relative to the origin and its direction: beside, ahead, far off, and through the origin.
PLACES = [
    ((0.0, 0.5), 0.0), ((-1.0, 0.2), 95.0), ((-8.0, 9.0), 60.0), ((-0.3, -0.3), -135.0),
]  # fmt: skip


@pytest.mark.parametrize(("middle", "degrees"), PLACES)
def test_the_covariance_is_what_noise_scatters(middle: tuple[float, float], degrees: float) -> None:
    std, runs = 0.01, 2000
    generator = np.random.default_rng(5)
    pose = np.array([*middle, math.radians(degrees)])
    wall = se2.transform_points(pose, np.column_stack((np.linspace(-0.5, 0.5, 20), np.zeros(20))))
    truth = fit_line(wall, std)
    distances, differences = np.empty(runs), np.empty((runs, 2))
    for run in range(runs):
        # Noise across the wall alone: that is what the fit's std means.
        fit = fit_line(wall + generator.normal(0.0, std, (20, 1)) * line_geometry.normal(truth.line), std)
        difference = line_geometry.nearest_form(truth.line, fit.line) - fit.line
        distances[run] = difference @ np.linalg.solve(fit.covariance, difference)
        # For the scatter all fits must be in one form, which the truth's is.
        differences[run] = line_geometry.nearest_form(fit.line, truth.line) - truth.line
    # Two numbers: mean 2, and the mean of 2000 scatters by 2 / sqrt(2000) = 0.045.
    assert distances.mean() == pytest.approx(2.0, abs=0.18)
    scale = np.sqrt(np.diag(truth.covariance))
    np.testing.assert_allclose(np.cov(differences.T) / np.outer(scale, scale),
                               truth.covariance / np.outer(scale, scale), atol=0.12)  # fmt: skip
