"""Each operation of the batch's filter gives what the plain filter gives."""

import copy

import numpy as np
import pytest
from support.batch_stages import NOISE, ROBOT, assert_same, cached, estimator_after, spec, state_from, waiting_readings

from limslam_agent.slam.batch import clone_ekf
from limslam_agent.slam.batch.motion import motion_from_wheels
from limslam_agent.slam.batch.state import Filter, States
from limslam_agent.slam.consistent import filter_access
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.consistent import ConsistentEstimator
from limslam_agent.slam.core import motion
from limslam_env.interface import NominalNoise

predict, clone, keep_clones = (cached(each) for each in (clone_ekf.predict, clone_ekf.clone, clone_ekf.keep_clones))
add_line, observe, compare = (cached(each) for each in (clone_ekf.add_line, clone_ekf.observe, clone_ekf.compare))
difference, merge, moved = cached(clone_ekf.difference), cached(clone_ekf.merge), cached(motion_from_wheels)
STEPS = 130


@pytest.fixture(scope="module")
def recorded() -> ConsistentEstimator:
    return estimator_after(STEPS)


@pytest.fixture
def plain(recorded: ConsistentEstimator) -> CloneEKF:
    return copy.deepcopy(recorded._filter)


@pytest.fixture
def state(recorded: ConsistentEstimator) -> States:
    return state_from(recorded)


def test_the_arrays_hold_the_plain_filter(state: States, plain: CloneEKF) -> None:
    assert plain.num_lines > 1
    assert plain.num_clones > 2
    assert_same(state.filter, plain, 1e-12)


def test_wheel_travel_is_the_same_motion() -> None:
    generator = np.random.default_rng(0)
    drives = [*generator.normal(0.0, 0.05, (30, 2)), np.zeros(2), np.array([0.05, 0.05]), np.array([0.05, 0.05 + 1e-9])]
    settings = spec().settings[0]
    for wheels in drives:
        increment, covariance = moved(wheels, settings)
        expected = motion.motion_from_wheels(wheels, ROBOT, NominalNoise(NOISE))
        np.testing.assert_allclose(increment, expected.increment, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(covariance, expected.covariance, rtol=1e-9, atol=1e-15)


def test_predictions_and_clones(state: States, plain: CloneEKF) -> None:
    generator = np.random.default_rng(1)
    for _ in range(5):
        increment, root = generator.normal(0.0, 0.3, 3), generator.normal(0.0, 0.02, (3, 3))
        plain.predict(increment, root @ root.T)
        predict(state.filter, increment, root @ root.T)
        assert clone(state.filter) == plain.clone()
    assert_same(state.filter, plain)


def test_marginalised_clones(state: States, plain: CloneEKF) -> None:
    wanted = np.random.default_rng(2).random(plain.num_clones) < 0.5
    kept = {int(plain._clones.numbers[place]) for place in np.flatnonzero(wanted)}
    assert 0 < len(kept) < plain.num_clones
    plain.keep_clones(kept)
    keep_clones(state.filter, np.array(sorted(kept), dtype=float))
    assert_same(state.filter, plain)


def test_new_lines(state: States, plain: CloneEKF) -> None:
    for theta, anchor in ((0.3, [1.0, 2.0]), (-2.0, [-0.5, 0.25])):
        assert add_line(state.filter, theta, *anchor) == plain.add_line(theta, np.array(anchor))
    assert_same(state.filter, plain)


@pytest.mark.parametrize("iterations", [1, 2, 4])
def test_updates(recorded: ConsistentEstimator, state: States, plain: CloneEKF, iterations: int) -> None:
    readings = max((waiting_readings(recorded, side) for side in range(3)), key=lambda each: len(each.ranges))
    places, rows, variances = plain.places(readings.clones), readings.rows, readings.variances(NOISE)
    for index in range(plain.num_lines):
        plain.observe(places, rows, index, variances, iterations)
        observe(state.filter, places, rows, index, variances, iterations)
        assert_same(state.filter, plain, 1e-8)


def test_gates(recorded: ConsistentEstimator, state: States, plain: CloneEKF) -> None:
    compared = 0
    for side in range(3):
        readings = waiting_readings(recorded, side)
        places, rows, variances = plain.places(readings.clones), readings.rows, readings.variances(NOISE)
        for index in range(plain.num_lines):
            expected = filter_access.compare(plain, places, rows, index, variances)
            np.testing.assert_allclose(compare(state.filter, places, rows, index, variances), expected, rtol=1e-6)
            compared += expected[2] > 0
    assert compared > 2


@pytest.mark.parametrize("place_std", [0.0, 2.0])
def test_merged_lines(recorded: ConsistentEstimator, place_std: float) -> None:
    estimator = copy.deepcopy(recorded)
    plain = estimator._filter
    by_world = place_std * plain._error_transport()
    plain.P += by_world @ by_world.T
    plain.x[6] = plain.x[4] + 0.05  # the lines are not parallel
    ekf: Filter = state_from(estimator).filter
    offset, covariance = plain.difference(0, 1)
    off, block = difference(ekf, 0, 1)
    np.testing.assert_allclose(off, offset, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(block, covariance, rtol=0.0, atol=1e-9)
    plain.merge(0, 1)
    merge(ekf, 0, 1, 1)
    assert_same(ekf, plain, 1e-8)
