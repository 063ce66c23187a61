"""Wheels that wait for late ranges."""

import numpy as np
import pytest

from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.separate_bias import DELAY
from limslam_agent.slam.core.late_ranges import WaitingTravel, ahead, behind, held_back
from limslam_agent.slam.core.motion import Motion
from limslam_env.geometry import se2

TRAVEL = np.random.default_rng(0).normal(0.03, 0.02, (40, 2, 2))


def told(travel, delays):
    """What is given of the travel (t, n, 2), step by step, and what waits after each step."""
    waiting, given, waits = WaitingTravel(travel.shape[1]), [], []
    for row, delay in zip(travel, delays, strict=True):
        seen = waiting.synchronous([{"wheels": wheels, "ranges": np.ones(1)} for wheels in row], delay)
        given.append([each["wheels"] for each in seen])
        waits.append(waiting.travel)
    return np.array(given), np.array(waits)


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 2.7])
def test_travel_waits_for_so_many_steps(delay):
    given, waits = told(TRAVEL, [delay] * len(TRAVEL))
    np.testing.assert_allclose(given, held_back(TRAVEL, delay), atol=1e-15)
    np.testing.assert_allclose(waits, np.cumsum(TRAVEL - given, axis=0), atol=1e-15)
    whole, share = int(delay), delay - int(delay)
    expected = (1.0 - share) * TRAVEL[10 - whole] + share * TRAVEL[9 - whole]
    np.testing.assert_allclose(given[10], expected, atol=1e-15)


def test_no_travel_is_lost_when_the_delay_changes():
    given, waits = told(TRAVEL, [0.0] * 10 + [2.5] * 10 + [1.0] * 20)
    np.testing.assert_allclose(given.sum(axis=0) + waits[-1], TRAVEL.sum(axis=0), atol=1e-14)


def test_ahead_is_the_arc_of_the_travel_and_behind_leads_back():
    pose, axle = np.array([1.0, 2.0, 0.5]), 0.2
    quarter = 0.25 * np.pi * axle
    # A quarter turn on the spot, and a quarter of a circle of radius 1 m to the left.
    np.testing.assert_allclose(ahead(pose, np.array([-quarter, quarter]), axle), [1.0, 2.0, 0.5 + 0.5 * np.pi])
    turned = ahead(np.zeros(3), 0.5 * np.pi * np.array([0.9, 1.1]), axle)
    np.testing.assert_allclose(turned, [1.0, 1.0, 0.5 * np.pi], atol=1e-12)
    back = behind(ahead(pose, TRAVEL[:, 0], axle), TRAVEL[:, 0], axle)
    np.testing.assert_allclose(se2.wrap_angle(back - pose), np.zeros_like(back), atol=1e-12)


def test_a_clone_is_where_late_ranges_were_read():
    start, step, turn = np.array([1.0, 2.0, 0.3]), 0.03, 0.02
    ekf = CloneEKF(start, range_errors=(0.02, 0.05, 1.0))
    ekf.predict(Motion(se2.arc(step, turn), np.zeros((3, 3))))
    ekf.clone()
    late, early = (se2.compose(start, se2.arc((1.0 - delay) * step, (1.0 - delay) * turn)) for delay in (0.1, -0.1))
    np.testing.assert_allclose(ekf.by_errors[-3:, DELAY], (late - early) / 0.2, atol=5e-4)
    np.testing.assert_array_equal(ekf.by_errors[:3, DELAY], np.zeros(3))
