"""Updates by readings, gates, motions and fits of wall segments: compiled as in plain numpy and LAPACK.

The plain versions are those of textbooks. Both round differently. The condition of an update that determines a new line
from its uninformative prior is 1e7, so that even exact formulas differ by 1e-10 there.
"""

import copy
import math

import numpy as np
import pytest
from support.batch_stages import NOISE, estimator_after, waiting_readings
from support.readings import (
    Expected,
    Readings,
    clone_poses,
    columns_of,
    compared,
    expected_ranges,
    hit_points,
    observe,
    points_of,
)

from limslam_agent.kernels.covariance import dense_block
from limslam_agent.kernels.measurement import error_transport
from limslam_agent.kernels.segments import fit_segment
from limslam_agent.kernels.tables import (
    ANGLE_STD,
    BEND_AT,
    BENT,
    EXTENT,
    FEWEST,
    FEWEST_FOR_SHAPE,
    FEWEST_TO_COMPARE,
    GRAZING,
    KINK_GATE,
    KINKS_AT,
    MIDDLE_X,
    MIDDLE_Y,
    MIN_KINK,
    POSE,
    THETA,
)
from limslam_agent.kernels.updates import involved as clones_of
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.clone_filter import begins_of, clones_from, line_at
from limslam_agent.slam.consistent.consistent import ConsistentEstimator
from limslam_agent.slam.consistent.pending_readings import SIDES, places_of
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import direction, normal


@pytest.fixture(scope="module")
def recorded() -> ConsistentEstimator:
    return estimator_after(120)


def all_readings(estimator: ConsistentEstimator) -> list[Readings]:
    sides = [waiting_readings(estimator, side) for side in range(len(SIDES))]
    return [readings._replace(growth=growth) for readings in sides for growth in (0.0, 0.02) if len(readings.ranges)]


def involved(ekf: CloneEKF, readings: Readings, index: int) -> tuple[Expected, FloatArray, IntArray]:
    """Predicted ranges, H and its columns in the state."""
    own, places = np.unique(readings.clones, return_inverse=True)
    line = line_at(ekf.arrays.counts, index)
    columns = np.append(columns_of(ekf, own).ravel(), [line, line + 1])
    poses = ekf.x[columns[:-2]].reshape(-1, POSE)[places]
    expected = expected_ranges(poses, readings, ekf.x[columns[-2:]], ekf.anchors[index])
    jacobian, rows = np.zeros((len(places), len(columns))), np.arange(len(places))
    for number in range(POSE):
        jacobian[rows, POSE * places + number] = expected.by_pose[:, number]
    jacobian[:, -2:] = expected.by_line
    return expected, jacobian, columns


def clear(ekf: CloneEKF, readings: Readings, index: int) -> Readings:
    expected, _, _ = involved(ekf, readings, index)
    return readings.select(np.flatnonzero((np.abs(expected.cosines) > GRAZING) & (expected.ranges > 0.0)))


def transport_of(ekf: CloneEKF) -> FloatArray:
    arrays = ekf.arrays
    return error_transport(arrays.x, len(ekf.x), begins_of(arrays.counts), arrays.anchors, ekf.num_lines)


def transported(covariance: FloatArray, moved: FloatArray) -> FloatArray:
    covariance = covariance + moved @ covariance[:POSE]
    return np.asarray(covariance + covariance[:, :POSE] @ moved.T)


def plain_update(
    ekf: CloneEKF, readings: Readings, index: int, iterations: int, huber: float
) -> tuple[FloatArray, FloatArray]:
    """State and covariance after an iterated update."""
    ekf, readings = copy.deepcopy(ekf), clear(ekf, readings, index)
    if not len(readings.ranges):
        return ekf.x, ekf.P
    variances, begin, transport = readings.variances(NOISE), ekf.x.copy(), transport_of(ekf)
    change, weights = np.zeros_like(begin), np.ones(len(readings.ranges))
    for _ in range(iterations):
        ekf.x[:] += change
        moved = transport_of(ekf) - transport
        expected, jacobian, columns = involved(ekf, readings, index)
        off, gained = readings.ranges - expected.ranges, jacobian @ transported(ekf.P, moved)[columns]
        spread = gained[:, columns] @ jacobian.T + np.diag(variances / weights)
        so_far = ekf.x - begin
        change = np.linalg.solve(spread, off + jacobian @ so_far[columns]) @ gained - so_far
        if huber:
            weights = np.minimum(1.0, huber * np.sqrt(variances) / np.maximum(np.abs(off), 1e-9))
    covariance = transported(ekf.P, moved) - gained.T @ np.linalg.solve(spread, gained)
    before = transport_of(ekf)
    ekf.x[:] += change
    return ekf.x, transported(covariance, transport_of(ekf) - before)


@pytest.mark.parametrize(("iterations", "huber"), [(1, 0.0), (2, 1.5), (4, 1.5)])
def test_updates(recorded: ConsistentEstimator, iterations: int, huber: float) -> None:
    for readings in all_readings(recorded):
        for index in range(recorded._filter.num_lines):
            ekf = copy.deepcopy(recorded._filter)
            state, covariance = plain_update(ekf, readings, index, iterations, huber)
            observe(ekf, readings, index, NOISE, iterations, huber)
            np.testing.assert_allclose(ekf.x, state, rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(ekf.P, covariance, rtol=0.0, atol=1e-10)


def test_gates(recorded: ConsistentEstimator) -> None:
    ekf, count = recorded._filter, 0
    for readings in all_readings(recorded):
        for index in range(ekf.num_lines):
            found, own = compared(ekf, readings, index, NOISE), clear(ekf, readings, index)
            assert math.isinf(found) == (len(own.ranges) < FEWEST_TO_COMPARE)
            if math.isinf(found):
                continue
            expected, jacobian, columns = involved(ekf, own, index)
            spread = jacobian @ ekf.P[np.ix_(columns, columns)] @ jacobian.T + np.diag(own.variances(NOISE))
            off, by_line = own.ranges - expected.ranges, expected.by_line
            along, information = by_line.T @ np.linalg.solve(spread, off), by_line.T @ np.linalg.solve(spread, by_line)
            wanted = along @ np.linalg.solve(information, along)
            assert found == pytest.approx(wanted, rel=1e-7, abs=1e-9)
            count += 1
    assert count > 2


def drawn(ekf: CloneEKF, shape: str, seed: int) -> tuple[Readings, FloatArray]:
    """Readings of a straight, bent or ending wall beside the clones, and a line through them."""
    generator = np.random.default_rng(seed)
    clones = np.sort(generator.choice(ekf.arrays.clones[: ekf.num_clones], 40))
    poses, origins = clone_poses(ekf, clones), generator.normal(0.0, 0.05, (40, 2))
    heading = float(poses[:, 2].mean()) + 0.5 * math.pi
    anchor = poses[:, :2].mean(axis=0) + 0.8 * normal(np.array([0.0, heading]))
    angles, sources = generator.uniform(0.7, 2.4, 40), np.zeros((40, 2), dtype=int)
    flat = Readings(clones, origins, angles, np.ones(40), sources, growth=0.01)
    ranges = expected_ranges(poses, flat, np.array([0.0, heading]), anchor).ranges
    bent = {"straight": 0.0, "corner": -0.5 * (np.arange(40) > 20) * np.linspace(-0.4, 0.4, 40)}
    ranges += bent.get(shape, 0.12 * (np.arange(40) > 34)) + NOISE * generator.standard_normal(40)
    return flat._replace(ranges=ranges), np.array([anchor @ normal(np.array([0.0, heading])), heading])


def beside(basis: FloatArray, shapes: FloatArray) -> FloatArray:
    return np.asarray(shapes - basis @ (basis.T @ shapes))


@pytest.mark.parametrize("shape", ["straight", "corner", "end"])
@pytest.mark.parametrize("seed", range(2))
def test_fits(recorded: ConsistentEstimator, shape: str, seed: int) -> None:
    ekf = recorded._filter
    readings, line = drawn(ekf, shape, seed)
    places, rows = places_of(ekf.arrays, readings.clones), readings.rows
    points = points_of(ekf, readings)
    members = np.arange(40) if seed else np.arange(0, 40, 5)
    own, state, poses = readings.select(members), np.array([0.0, line[1]]), clone_poses(ekf, readings.clones[members])
    anchor = line[0] * normal(line) + (points[members] @ direction(line)).mean() * direction(line)
    first = expected_ranges(poses, own, state, anchor)
    clear = np.flatnonzero(np.abs(first.cosines) > GRAZING)
    assert len(clear) >= FEWEST - 1
    by_poses = np.zeros((len(members), len(ekf.x)))
    for row, columns in enumerate(columns_of(ekf, own.clones)):
        by_poses[row, columns] = first.by_pose[row]
    spread = (by_poses @ ekf.P @ by_poses.T + np.diag(own.variances(NOISE)))[np.ix_(clear, clear)]
    factor = np.linalg.cholesky(spread)
    for _ in range(2):
        expected = expected_ranges(poses, own, state, anchor)
        off, by_line = (
            np.linalg.solve(factor, each[clear]) for each in (own.ranges - expected.ranges, expected.by_line)
        )
        state = state + np.linalg.lstsq(by_line, off, rcond=None)[0]
    basis = np.linalg.qr(by_line)[0]
    left = beside(basis, off)
    start, segment, along_found = clones_from(ekf.arrays.counts), np.empty(7), np.empty(40)
    columns, begins = clones_of(places, members, (len(ekf.x) - start) // POSE, start, -1)
    residuals, _ = fit_segment(
        ekf.x, start, dense_block(ekf.P, columns), begins, places, rows, points, members, tuple(line.tolist()), NOISE,
        readings.variances(NOISE)[members], segment, along_found,
    )  # fmt: skip
    assert segment[THETA] == pytest.approx(state[1], abs=1e-11)
    np.testing.assert_allclose(segment[[MIDDLE_X, MIDDLE_Y]], anchor, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(residuals, left, rtol=0.0, atol=1e-8)
    met = own._replace(ranges=np.where(np.isin(np.arange(len(members)), clear), expected.ranges, own.ranges))
    along = (hit_points(poses, met) - anchor) @ direction(state)
    np.testing.assert_allclose(along_found[: len(members)], along, rtol=0.0, atol=1e-11)
    assert segment[EXTENT] == pytest.approx(np.ptp(np.sort(along)[1:-1]), abs=1e-11)
    assert segment[ANGLE_STD] == pytest.approx(NOISE / math.sqrt(len(clear) * np.var(along[clear])), rel=1e-9)
    here, cosines = along[clear], expected.cosines[clear]
    if len(here) < FEWEST_FOR_SHAPE:
        assert not segment[BENT]
        return
    kinks = np.quantile(here, KINKS_AT)
    bends = beside(basis, np.linalg.solve(factor, np.maximum(here[:, None] - kinks, 0.0) / cosines[:, None]))
    angles = left @ bends / np.sum(bends**2, axis=0)
    gains = angles**2 * np.sum(bends**2, axis=0)
    best = int(np.argmax(gains))
    is_kinked = gains[best] > KINK_GATE and abs(angles[best]) > MIN_KINK
    assert bool(segment[BENT]) == is_kinked
    assert segment[BEND_AT] == pytest.approx(kinks[best], abs=1e-11)
