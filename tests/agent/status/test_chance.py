"""The chance that a pose is off: by its covariance, and by evidence for another place."""

import math

import numpy as np
import pytest

from limslam_agent.status.chance import (
    FAR,
    LIMIT,
    TURNED,
    chance_mistaken,
    chance_off,
    either,
    in_words,
    rate_evidence,
)
from limslam_agent.status.known_map import DECIDED, DOUBTED, UNLIKELY


@pytest.mark.parametrize(
    "stds",
    [(0.2, 0.2, 0.01), (0.2, 0.0, 0.0), (0.5, 0.02, 0.1), (0.3, 0.1, 0.05), (0.05, 0.0, 0.1)],
)
def test_the_chance_is_the_share_of_errors_that_are_too_large(stds):
    errors = np.random.default_rng(0).standard_normal((400_000, 3)) * stds
    share = np.mean((np.hypot(*errors[:, :2].T) > FAR) | (np.abs(errors[:, 2]) > TURNED))
    turn = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    covariance = turn @ np.diag(stds) ** 2 @ turn.T
    assert float(chance_off(covariance)) == pytest.approx(share, rel=0.03, abs=1e-3)


def test_each_of_many_poses_has_its_chance():
    covariances = np.array([np.zeros((3, 3)), np.diag([0.2**2, 0.2**2, 0.0]), 100.0 * np.eye(3)])
    none, some, all_but = chance_off(covariances)
    assert (none, some) == (0.0, pytest.approx(math.exp(-0.5 * (FAR / 0.2) ** 2)))
    assert all_but > 0.99


def test_a_doubt_of_the_rays_is_at_the_limit_and_a_decision_is_not():
    assert chance_mistaken(DOUBTED) == pytest.approx(LIMIT, abs=0.01)
    assert LIMIT < chance_mistaken(DECIDED) < 0.5
    assert chance_mistaken(UNLIKELY) > 0.9
    assert chance_mistaken(-1e6) == 0.0
    assert chance_mistaken(1e6) == 1.0
    assert either(0.1, 0.2) == pytest.approx(0.28)


def test_a_rate_says_more_the_more_was_tested():
    few, many = (rate_evidence(0.15 * count, count, 0.06, 0.135) for count in (10, 200))
    assert 0.0 < few < DOUBTED < many
    assert rate_evidence(0, 0, 0.06, 0.135) == 0.0
    assert rate_evidence(12, 200, 0.06, 0.135) < 0.0


def test_the_words_name_the_heading_only_if_it_is_uncertain():
    covariance = np.diag([0.18**2, 0.24**2, math.radians(3.0) ** 2])
    assert in_words(0.123, covariance) == (
        "the chance that the pose is more than 0.5 m or 10 deg off is 12 % "
        "(standard deviation 0.30 m and 3.0 deg)"
    )
    covariance[2, 2] = 0.0
    assert in_words(0.123, covariance, "a pose of the path") == (
        "the chance that a pose of the path is more than 0.5 m off is 12 % "
        "(standard deviation 0.30 m)"
    )
