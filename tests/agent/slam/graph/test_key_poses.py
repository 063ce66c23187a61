"""Key poses: frames there and back, calibration, and what is refused."""

from dataclasses import replace

import numpy as np

from limslam_agent.config.graph import PointConfig
from limslam_agent.slam.graph.key_poses import (
    LogData,
    choose_keys,
    corrected,
    delayed,
    joined_bias,
)
from limslam_env.geometry import se2

RNG = np.random.default_rng(1)


def wandering(count=200, beams=3):
    moves = np.column_stack((RNG.normal(0.05, 0.02, count), RNG.normal(0.0, 0.02, count), RNG.normal(0.0, 0.05, count)))
    odometry = np.zeros((count, 3))
    for row in range(1, count):
        odometry[row] = se2.compose(odometry[row - 1], moves[row])
    angles = np.linspace(-1.5, 1.5, beams)
    ranges = RNG.uniform(0.3, 4.0, (count, beams))
    origins = RNG.normal(0.0, 0.1, (beams, 2))
    return LogData(np.arange(count) * 0.1, odometry, ranges, ranges < 3.5, origins, angles, 5.0)


def keys_of(log):
    return choose_keys(log, PointConfig())


def test_two_corrections_after_each_other_are_one():
    log = wandering()
    first, second = np.array([0.05, 0.03, -0.02, 0.2, 0.02]), np.array([-0.02, 0.01, 0.04, -0.1, 0.01])
    twice = corrected(corrected(log, first), second).odometry
    once = corrected(log, joined_bias(first, second)).odometry
    # The direction of a motion turns by half of the missing heading, which is not exactly additive.
    # Odometry ends with the log, so poses after the end are missing.
    assert np.abs(se2.wrap_angle(twice[:, 2] - once[:, 2]))[2:-2].max() < 1e-3
    assert np.abs(twice[2:-2, :2] - once[2:-2, :2]).max() < 5e-3
    assert np.abs(once - log.odometry).max() > 0.1


def test_a_log_whose_times_do_not_tell_its_events_apart_keeps_its_odometry():
    log = wandering(60)
    same = replace(log, time=np.repeat(np.arange(20.0), 3))
    for delay in (0.0, 0.3):
        np.testing.assert_array_equal(delayed(same, delay).odometry, log.odometry)
    np.testing.assert_array_equal(delayed(log, 0.0).odometry, log.odometry)
