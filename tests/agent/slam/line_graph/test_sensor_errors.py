"""Noise and beam width that were not specified."""

from dataclasses import replace

import numpy as np
import pytest
from support.smoother_runs import ROUND, WHEEL_VARIANCE, noisy_run, position_error, true_labels

from limslam_agent.config.smoother import SmootherConfig
from limslam_agent.kernels.measurement import read_share
from limslam_agent.replay.joined_lines import joined_run
from limslam_agent.slam.core.diagnostics import AssociationRecord
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.line_graph.problem import by_turns, rows_of, state_from_poses
from limslam_agent.slam.line_graph.reassociation import solve_labels
from limslam_agent.slam.line_graph.sensor_errors import TURN_STD, beam_turns, fitted_sensor, residual_std
from limslam_agent.slam.line_graph.smoother import FilteredRun, settle, smooth_run
from limslam_env.interface import NominalNoise

CONFIG = SmootherConfig()
FOUND = RangeSensor(0.01, growth=0.02, cone=0.03, bias=0.04)


def solved(problem, poses):
    return solve_labels(problem, state_from_poses(problem, np.moveaxis(poses, 0, 1)), true_labels(problem, poses))


def widened(problem, poses, width):
    """The problem with the readings of beams with an opening angle."""
    found = solved(problem, poses)
    cosines = rows_of(problem, found.state, found.labels)[:, 6]
    shares = [read_share(cosine, width) if cosine else 1.0 for cosine in cosines.tolist()]
    return replace(problem, readings=replace(problem.readings, distances=problem.readings.distances * shares))


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.04])
def test_sensors_as_specified_change_nothing(noise):
    problem, poses = noisy_run(1, noise)
    assert fitted_sensor(problem, solved(problem, poses), problem.range_std) is problem


@pytest.mark.parametrize(("true", "told"), [(0.04, 0.02), (0.02, 0.04)])
def test_noise_is_estimated_from_the_residuals(true, told):
    problem, poses = noisy_run(2, true)
    told_wrong = replace(problem, range_std=told)
    found = solved(told_wrong, poses)
    assert fitted_sensor(told_wrong, found, told).range_std == pytest.approx(true, rel=0.1)


def test_the_median_is_that_of_a_distribution_without_tails():
    problem, poses = noisy_run(3, 0.04)
    found = solved(replace(problem, range_std=0.02), poses)
    rows = rows_of(problem, found.state, found.labels)
    is_near = np.abs(problem.readings.distances - rows[:, 0]) < 3.5 * 0.02
    cut = replace(found, solution=replace(found.solution, weights=found.solution.weights * is_near))
    std = residual_std(replace(problem, range_std=0.02), cut, 3.5)
    assert std == pytest.approx(0.04, rel=0.12)


def test_a_beam_width_is_found_and_explains_the_readings():
    problem, poses = noisy_run(4, 0.02, places=3 * ROUND)
    wide = widened(problem, poses, 0.05)
    before = solved(wide, poses)
    fitted = fitted_sensor(wide, before, wide.range_std)
    after = solved(fitted, poses)
    assert fitted.beam_width == pytest.approx(0.05, abs=0.012)
    assert after.solution.chi_square < before.solution.chi_square - 40.0


def test_exact_readings_have_no_beam_width():
    # Chi-square is not exactly quadratic in the width, which looks like a width if the readings are exact enough.
    corners = 1.6 * np.exp(1j * (0.3 + np.arange(7) * np.pi / 3.0)) + 1.5 + 1.2j
    walls = np.column_stack((corners[:-1].real, corners[:-1].imag, corners[1:].real, corners[1:].imag))
    problem, poses = noisy_run(1, 0.0, walls=walls)
    exact = replace(problem, range_std=1e-4)
    states = state_from_poses(exact, np.moveaxis(poses, 0, 1))
    found = solve_labels(exact, states, true_labels(exact, poses, walls))
    assert fitted_sensor(exact, found, exact.range_std).beam_width == 0.0


@pytest.mark.parametrize("width", [0.03, 0.25])
def test_derivatives_of_wide_beams_are_differences(width):
    problem, poses = noisy_run(5, 0.02)
    wide = replace(problem, beam_width=width)
    found = solved(problem, poses)
    state, step = found.state, 1e-6
    rows = rows_of(wide, state, found.labels)
    # The derivative jumps where a wall is just perpendicular to the border of the beam.
    slants = np.arccos(np.minimum(np.abs(rows[:, 6]), 1.0))
    smooth = (found.labels >= 0) & (np.abs(slants - width) > 1e-3) & (np.abs(rows[:, 6]) > 0.2)
    assert np.count_nonzero(smooth & (slants < width))
    for pose, line, column in ((step, 0.0, 3), (0.0, step, 5)):
        after, before = (
            rows_of(
                wide,
                replace(
                    state,
                    poses=state.poses + sign * np.array([0.0, 0.0, pose]),
                    lines=state.lines + sign * np.array([0.0, line]),
                ),
                found.labels,
            )
            for sign in (1.0, -1.0)
        )
        assert ((after - before)[smooth, 0] / (2.0 * step)) == pytest.approx(rows[smooth, column], abs=1e-4)


def padded(state, turns):
    """A state with directions of the beams, rad, in its calibration."""
    return replace(state, calibration=np.hstack((state.calibration, [turns])))


@pytest.mark.parametrize("width", [0.0, 0.25])
def test_derivatives_by_the_directions_of_beams_are_differences(width):
    problem, poses = noisy_run(5, 0.02)
    wide, found, step = replace(problem, beam_width=width), solved(problem, poses), 1e-6
    rows = rows_of(wide, found.state, found.labels)
    slants = np.arccos(np.minimum(np.abs(rows[:, 6]), 1.0))
    smooth = (found.labels >= 0) & (np.abs(slants - width) > 1e-3) & (np.abs(rows[:, 6]) > 0.2)
    after, before = (
        rows_of(wide, padded(found.state, np.full(6, sign * step)), found.labels)[smooth, 0] for sign in (1.0, -1.0)
    )
    assert (after - before) / (2.0 * step) == pytest.approx(by_turns(wide, found.state, rows)[smooth], abs=1e-4)


def test_turned_beams_are_found_and_are_no_width():
    problem, poses = noisy_run(4, 0.02, places=3 * ROUND)
    turns = np.radians([0.0, 4.0, 0.0, -3.0, 0.0, 0.0])
    # The beams that are assumed are turned the other way.
    other = replace(problem, robot=RangeSensor(0.02, turns=tuple(-turns)).mounted(problem.robot))
    fitted = fitted_sensor(other, solved(other, poses), other.range_std)
    assert fitted.beam_width == 0.0
    assert fitted.turns == pytest.approx(turns, abs=np.radians(0.6))
    assert fitted.robot.beam_angles == pytest.approx(problem.robot.beam_angles, abs=np.radians(0.6))
    after = solved(fitted, poses)
    assert position_error(after.state, poses) < position_error(solved(other, poses).state, poses)
    again, covariance = beam_turns(fitted, after)
    off = (again - turns)[1:]  # the first beam sees no wall
    assert off @ np.linalg.solve(covariance[1:, 1:], off) < 16.0
    assert covariance[0, 0] == pytest.approx(TURN_STD**2)


@pytest.mark.parametrize("slant", [0.0, 0.1, 0.4, 1.2])
def test_a_wide_beam_reads_the_nearest_point_of_the_wall_inside_it(slant):
    rays = slant + np.linspace(-0.26, 0.26, 2001)
    nearest = (np.cos(slant) / np.cos(rays)).min()
    assert read_share(np.cos(slant), 0.26) == pytest.approx(nearest, abs=1e-6)


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
    growing = replace(problem, range_std=FOUND.usual_std(problem.robot.reach), growth=2.0)
    rough = growing.range_std * growing.noise * np.random.default_rng(6).standard_normal(len(problem.readings))
    wide = widened(problem, poses, FOUND.cone).readings
    measured = replace(problem, readings=replace(wide, distances=wide.distances + FOUND.bias + rough))
    found = settle(run_of(measured, poses, FOUND), CONFIG)
    assert found.problem.growth == FOUND.growth / FOUND.std
    assert found.problem.range_std == pytest.approx(growing.range_std, rel=0.25)
    assert found.problem.beam_width == pytest.approx(FOUND.cone, abs=0.012)
    assert found.association.state.calibration[0, 3] == pytest.approx(FOUND.bias, abs=0.01)
    assert position_error(found.association.state, poses) < 0.02


def test_two_runs_with_known_turns_are_smoothed_as_one():
    """The turns are not estimated again: their uncertainty is that of the prior."""
    problem, poses = noisy_run(6, 0.02)
    run = run_of(problem, poses, RangeSensor(0.02, turns=(0.01,) * 6))
    smoothed = smooth_run(joined_run([run, run], np.zeros(3)), CONFIG)
    assert smoothed.turns == pytest.approx(np.tile((0.01, TURN_STD), (6, 1)))
    assert smoothed.robot.beam_angles == pytest.approx(problem.robot.beam_angles + 0.01)


def test_a_sensor_as_specified_changes_no_bit():
    problem, poses = noisy_run(7, 0.02)
    stated, told = (settle(run_of(problem, poses, sensor), CONFIG) for sensor in (None, RangeSensor(0.02)))
    assert np.array_equal(stated.association.state.poses, told.association.state.poses)


def test_far_readings_count_less_where_the_noise_grows():
    problem, poses = noisy_run(8, 0.02)
    found = solved(replace(problem, growth=3.0), poses)
    stds, used = RangeSensor(1.0, 3.0).stds(problem.readings.distances), found.solution.weights > 0.0
    product = (found.solution.weights * stds**2)[used]
    assert product == pytest.approx(np.full(used.sum(), product[0]))
