"""The stages together: the sensor is as the filter has found it, and constant errors are estimated where needed."""

from dataclasses import replace

import numpy as np
import pytest
from support.smoother_runs import ROUND, WHEEL_VARIANCE, noisy_run, position_error, true_labels

from limslam_agent.config.smoother import SmootherConfig
from limslam_agent.kernels.measurement import read_share
from limslam_agent.slam.core.diagnostics import AssociationRecord
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.line_graph.problem import RELATIVE_PRIOR, expected, state_from_poses
from limslam_agent.slam.line_graph.reassociation import solve_labels
from limslam_agent.slam.line_graph.smoother import FilteredRun, beside, settle, smooth_run, smooth_with_unknown_start
from limslam_env import NominalNoise
from limslam_env.geometry import se2

CONFIG = SmootherConfig()
FOUND = RangeSensor(0.01, growth=0.02, cone=0.03, bias=0.04)


def widened(problem, poses, width):
    """The problem with the readings of beams with an opening angle."""
    state, labels = state_from_poses(problem, np.moveaxis(poses, 0, 1)), true_labels(problem, poses)
    cosines = expected(problem, solve_labels(problem, state, labels).state, labels).cosines
    shares = [read_share(cosine, width) for cosine in cosines.tolist()]
    return replace(problem, readings=replace(problem.readings, distances=problem.readings.distances * shares))


def run_of(problem, poses, sensor):
    """The run of a problem of one robot, with a filter that was right about poses and walls."""
    steps, beams = problem.steps, len(problem.robot.beams)
    ranges, readings = np.tile(problem.robot.max_ranges, (steps, 1, 1)), problem.readings
    ranges[readings.places, 0, readings.beams] = readings.distances
    wheels = np.concatenate((np.zeros((1, 1, 2)), np.moveaxis(problem.wheels[..., :2], 1, 0)))
    labels, sources = true_labels(problem, poses), np.column_stack((readings.places, readings.beams))
    members = [sources[labels == wall] for wall in range(labels.max() + 1)]
    records = [AssociationRecord(wall, is_new=True, readings=each) for wall, each in enumerate(members)]
    return FilteredRun(
        problem.robot, NominalNoise(0.02, WHEEL_VARIANCE), wheels, ranges, np.ones((steps, 1, beams), dtype=bool),
        np.moveaxis(poses, 0, 1), np.zeros((steps, 1, 3, 3)), records, [], sensor=sensor,
    )  # fmt: skip


def test_the_sensor_that_the_filter_found_is_taken_over():
    problem, poses = noisy_run(6, 0.0)
    rough = replace(problem, sensor=FOUND).stds * np.random.default_rng(6).standard_normal(len(problem.readings))
    wide = widened(problem, poses, FOUND.cone).readings
    measured = replace(problem, readings=replace(wide, distances=wide.distances + FOUND.bias + rough))
    found = settle(run_of(measured, poses, FOUND), CONFIG)
    assert found.problem.sensor == FOUND
    assert found.state.calibration[0, 3] == pytest.approx(FOUND.bias, abs=0.01)
    assert position_error(found.state, poses) < 0.02


def test_poses_with_coarse_encoders_are_about_as_wrong_as_believed():
    problem, poses = noisy_run(6, 0.02)
    run, tick = run_of(problem, poses, None), 0.01
    totals = np.cumsum(run.wheels, axis=0) + np.random.default_rng(6).uniform(0.0, tick, 2)
    wheels = np.diff(np.floor(totals / tick) * tick, axis=0, prepend=np.zeros((1, 1, 2)))
    found = smooth_run(replace(run, wheels=wheels), CONFIG)
    errors = (found.poses - run.poses)[1:, 0]
    errors[:, 2] = se2.wrap_angle(errors[:, 2])
    assert np.hypot(*errors[:, :2].T).mean() < 0.1
    assert (
        np.einsum("ti,ti->t", errors, np.linalg.solve(found.covariances[1:, 0], errors[..., None])[..., 0]).mean() < 6.0
    )


def test_two_runs_with_known_turns_are_smoothed_as_one():
    problem, poses = noisy_run(6, 0.02)
    run = run_of(problem, poses, RangeSensor(0.02, turns=(0.01,) * 6))
    smoothed = smooth_with_unknown_start(beside(run, run, np.zeros(3)), CONFIG)
    assert smoothed.robot.beam_angles == pytest.approx(problem.robot.beam_angles + 0.01)


def test_constant_errors_are_estimated_only_where_they_are_significant():
    problem, poses = noisy_run(4, places=[*ROUND, *ROUND])
    assert smooth_run(run_of(problem, poses, None), CONFIG).calibration is None
    uneven, poses = noisy_run(4, mismatch=0.02, places=[*ROUND, *ROUND])
    found = smooth_run(run_of(uneven, poses, None), CONFIG)
    assert found.calibration[0, :2] == pytest.approx([-0.02, 0.02], abs=0.006)
    assert smooth_run(run_of(uneven, poses, None), SmootherConfig("never")).calibration is None


def test_rough_sensors_have_relative_errors_only():
    """What a wide beam reads looks like a common error of all sizes with a bias."""
    problem, poses = noisy_run(4, mismatch=0.02, places=[*ROUND, *ROUND])
    found = settle(run_of(problem, poses, RangeSensor(0.02, growth=1e-3)), CONFIG)
    assert found.problem.prior is RELATIVE_PRIOR
    assert found.state.calibration[0] == pytest.approx([-0.02, 0.02, 0.0, 0.0], abs=0.01)
