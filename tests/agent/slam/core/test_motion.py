"""Motion: the exact arc and its covariance from wheels, and a log's odometry with its bias taken out."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limslam_agent.config.shared import OdometryConfig
from limslam_agent.slam.core.motion import (
    OdometryCalibration,
    calibrated,
    motion_from_odometry,
    motion_from_wheels,
    motion_of,
)
from limslam_env import NominalNoise, RobotSpec
from limslam_env.geometry import FloatArray

ROBOT = RobotSpec()
NOISE = NominalNoise(0.0, 2e-5)
travels = st.floats(-0.06, 0.06)
metres = st.floats(-0.5, 0.5)


def exact_arc(wheels: FloatArray, axle: float) -> FloatArray:
    """Where the wheels take the robot, as textbooks draw it: a circle about a centre on the axle's line."""
    left, right = wheels
    turn = (right - left) / axle
    if abs(turn) < 1e-9:
        return np.array([0.5 * (left + right), 0.0, turn])
    radius = 0.5 * (left + right) / turn
    return np.array([radius * math.sin(turn), radius * (1.0 - math.cos(turn)), turn])


def numerical_jacobian(wheels: FloatArray, axle: float) -> FloatArray:
    """Central differences of the arc by the two wheels, (3, 2)."""
    step = 1e-5
    columns = [
        (exact_arc(wheels + step * unit, axle) - exact_arc(wheels - step * unit, axle)) / (2.0 * step)
        for unit in np.eye(2)
    ]
    return np.column_stack(columns)


@settings(deadline=None, max_examples=100)
@given(travels, travels)
def test_wheels_move_the_robot_along_the_exact_arc(left: float, right: float) -> None:
    wheels = np.array([left, right])
    np.testing.assert_allclose(motion_from_wheels(wheels, ROBOT, NOISE).increment, exact_arc(wheels, 0.16), atol=1e-9)


@settings(deadline=None, max_examples=100)
@given(travels, travels)
def test_the_covariance_of_wheels_is_theirs_through_the_jacobian_of_the_arc(left: float, right: float) -> None:
    wheels = np.array([left, right])
    by_wheels = numerical_jacobian(wheels, ROBOT.axle)
    expected = by_wheels @ np.diag(NOISE.wheel_variance * np.abs(wheels) + 1e-12) @ by_wheels.T
    covariance = motion_from_wheels(wheels, ROBOT, NOISE).covariance
    np.testing.assert_allclose(covariance, expected, rtol=1e-4, atol=1e-12)


@settings(deadline=None, max_examples=100)
@given(metres, st.floats(-0.1, 0.1), st.floats(-0.5, 0.5), st.floats(-0.1, 0.1))
def test_the_bias_is_made_up_for_in_proportion_to_the_distance(x: float, y: float, turn: float, bias: float) -> None:
    motion = motion_from_odometry(np.array([x, y, turn]), OdometryConfig(turn_bias=bias))
    # The bias is true minus reported heading; its sign is that of the way driven.
    assert motion.increment[2] - turn == pytest.approx(bias * math.copysign(math.hypot(x, y), x), abs=1e-12)
    np.testing.assert_array_equal(motion.increment[:2], [x, y])


@pytest.mark.parametrize("bad", [[math.nan, 0.0, 0.0], [0.0, 0.0, -math.inf], [0.1, 0.1], [0.1] * 4])
def test_odometry_that_is_not_three_finite_numbers_is_refused(bad: object) -> None:
    with pytest.raises(ValueError, match="odometry must be 3 finite numbers"):
        motion_of({"ranges": np.zeros(6), "odometry": np.array(bad)}, ROBOT, NOISE, OdometryConfig())


SIZES = OdometryCalibration(0.02, -0.01, 0.03)
QUIET = NominalNoise(0.0, 1e-9)


@pytest.mark.parametrize("wheels", [(0.05, 0.03), (0.05, 0.047), (-0.04, -0.05), (-0.05, 0.05), (0.0, 0.0)])
def test_larger_wheels_on_a_wider_axle_are_a_robot_that_is_built_so(wheels: tuple[float, float]) -> None:
    travel = np.array(wheels)
    motion = calibrated(motion_from_wheels(travel, ROBOT, NOISE), ROBOT.axle, SIZES)
    np.testing.assert_allclose(motion.increment, exact_arc(np.array([1.02, 0.99]) * travel, 1.03 * 0.16), atol=1e-12)


@pytest.mark.parametrize("wheels", [(0.05, 0.03), (-0.05, -0.03), (-0.05, 0.05)])
def test_the_derivative_by_the_factors_is_that_of_central_differences(wheels: tuple[float, float]) -> None:
    motion = motion_from_wheels(np.array(wheels), ROBOT, QUIET)
    step, at = 1e-6, np.array(SIZES)
    columns = [
        (calibrated(motion, 0.16, OdometryCalibration(*(at + step * unit))).increment
         - calibrated(motion, 0.16, OdometryCalibration(*(at - step * unit))).increment) / (2.0 * step)
        for unit in np.eye(3)
    ]  # fmt: skip
    np.testing.assert_allclose(calibrated(motion, 0.16, SIZES).by_calibration, np.column_stack(columns), atol=1e-9)


def test_a_turn_that_may_be_noise_says_nothing_of_the_axle() -> None:
    motion = motion_from_wheels(np.array([0.0251, 0.0249]), ROBOT, NOISE)
    by_calibration = calibrated(motion, ROBOT.axle, OdometryCalibration(0.0, 0.0, 0.0)).by_calibration
    assert by_calibration is not None
    np.testing.assert_allclose(by_calibration[2], [-0.025 / 0.16, 0.025 / 0.16, 0.0], atol=1e-6)
