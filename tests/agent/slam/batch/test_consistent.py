"""The batch associates wall segments, prunes clones, and merges landmarks as the plain estimator does."""

import copy
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from support.batch_stages import NOISE, assert_same, cached, estimator_after, spec, state_from

from limslam_agent.slam.batch import consistent
from limslam_agent.slam.batch.pending_readings import readings_of
from limslam_agent.slam.batch.segmentation import ANGLE_STD, EXTENT, MIDDLE_X, MIDDLE_Y, THETA
from limslam_agent.slam.batch.state import CLONE, CLONES, CLOSURES, LINES, PENDING, States
from limslam_agent.slam.consistent.consistent import ConsistentEstimator, _Candidate
from limslam_agent.slam.consistent.pending_readings import SIDES
from limslam_agent.slam.consistent.segmentation import WallSegment
from limslam_agent.slam.consistent.segmentation import uncontested as plainly_uncontested
from limslam_agent.slam.core.hough import ExtractedLine
from limslam_agent.slam.core.line_fit import LineFit, fit_line
from limslam_agent.slam.core.wall_faces import NEGATIVE, POSITIVE
from limslam_env.geometry import FloatArray

uncontested, candidates, fits = (
    cached(consistent.uncontested), cached(consistent.candidates), cached(consistent.fits),
)  # fmt: skip
closes_loop, prune, readings_in = cached(consistent.closes_loop), cached(consistent.prune), cached(readings_of)


@pytest.fixture(scope="module")
def recorded() -> ConsistentEstimator:
    return estimator_after(130)


@pytest.fixture
def state(recorded: ConsistentEstimator) -> States:
    return state_from(recorded)


def places_along(count: int) -> list[FloatArray]:
    """Positions (count,) along a wall, m: without a hole, with a hole, and with a hole and beyond the wall's end."""
    whole = np.linspace(-0.3, 0.3, count)
    bridge = whole + 0.4 * (np.arange(count) >= count // 2)
    return [whole, bridge, bridge + 9.0]


def segments_near(estimator: ConsistentEstimator, points: FloatArray) -> list[tuple[WallSegment, FloatArray]]:
    """Segments near each landmark, off it by more and more, and the same as rows of the batch."""
    found = []
    for index, step, along in product(range(estimator._filter.num_lines), range(4), places_along(len(points))):
        theta = estimator._filter.anchored[index, 1]
        normal = np.array([np.cos(theta), np.sin(theta)])
        middle = estimator._filter.anchors[index] + 0.1 * step * normal
        places = middle + along[:, None] * normal[::-1] * [-1, 1]
        segment = WallSegment(
            np.arange(len(points)), theta + 0.05 * step, middle, places, 0.1 + 0.2 * step, 0.01, along, along
        )
        row = np.zeros(8)
        row[[THETA, MIDDLE_X, MIDDLE_Y]] = segment.theta, *segment.middle
        row[EXTENT], row[ANGLE_STD] = segment.length, segment.angle_std
        found.append((segment, row))
    return found


def test_association_gates(recorded: ConsistentEstimator, state: States) -> None:
    settings, ekf, compared, fitting = spec().settings[0], state.filter, 0, set()
    side = int(np.argmax([len(recorded._pending[0].by_side[name]) for name in SIDES]))
    readings = recorded._pending[0].readings(SIDES[side])
    waiting = state.pending[side, : ekf.counts[PENDING + side]]
    places, rows = readings_in(waiting, ekf.clones[: ekf.counts[CLONES]], spec().beams, 0.0)
    room = len(ekf.anchors)
    for segment, row in segments_near(recorded, rows):
        scores, which, told = np.empty(room), np.empty(room, dtype=np.int64), np.empty((room, 2))
        number = candidates(
            ekf, state.walls, places, rows, segment.points, row, settings, scores, which, told
        )  # fmt: skip
        expected = recorded._candidates(readings, segment)
        assert which[:number].tolist() == [each.landmark for each in expected]
        np.testing.assert_allclose(scores[:number], [each.of_line for each in expected], rtol=1e-6)
        compared += number
        for each in expected:
            np.testing.assert_allclose(told[each.landmark], [each.left, each.used], rtol=1e-6)
        for left in (0.0, 100.0):
            for index in range(recorded._filter.num_lines):
                known = _Candidate(5.0, left, 20, index)
                told_fit = fits(ekf, state.walls, index, segment.points, row, 5.0, left, 20.0)
                assert told_fit == recorded._fits(segment, known)
                fitting.add(bool(told_fit))
    assert compared > 5
    assert fitting == {True, False}


def test_merging(recorded: ConsistentEstimator, state: States) -> None:
    settings, number = spec().settings[0], recorded._filter.num_lines
    merged = set()
    for first in range(number):
        # A second landmark on almost the same line, somewhat turned and shifted: some are one wall, some are not.
        for shift, side in product((0.02, 0.2, 2.0), (POSITIVE, NEGATIVE)):
            plain = copy.deepcopy(recorded)
            theta = float(plain._filter.anchored[first, 1])
            middle = plain._map.ends(first).mean(axis=0)
            index = plain._filter.add_line(theta + 0.01, middle + shift * np.array([np.cos(theta), np.sin(theta)]))
            plain._map.add()
            tangent = np.array([-np.sin(theta), np.cos(theta)])
            plain._map.grow(index, middle + np.linspace(-0.3, 0.3, 9)[:, None] * tangent, side)
            arrays = state_from(plain)
            told = closes_loop(arrays.filter, arrays.walls, index, first, settings)
            assert told == plain._closes_loop(index, first, 0)
            assert arrays.filter.counts[CLOSURES] == len(plain.closures) - len(recorded.closures)
            assert_same(arrays.filter, plain._filter, 1e-8)
            for place, each in enumerate(plain._map.walls):
                assert arrays.walls.table[place, 2:].tolist() == [each.groups, each.readings]
                np.testing.assert_allclose(arrays.walls.seen[place], each.seen, rtol=0.0, atol=1e-8)
                np.testing.assert_allclose(arrays.walls.behind[place], each.behind, rtol=0.0, atol=1e-8)
                np.testing.assert_array_equal(
                    arrays.walls.counted[place, :, : len(each.extent._hits)], [each.extent._hits, each.extent._misses]
                )
            merged.add(bool(told))
    assert merged == {True, False}
    assert state.filter.counts[LINES] == number


@pytest.mark.parametrize("most", [70, 8, 3])
def test_pruned_clones(recorded: ConsistentEstimator, state: States, most: int) -> None:
    plain = copy.deepcopy(recorded)
    plain._settings = replace(plain._settings, pending=replace(plain._settings.pending, max_clones=most))
    # Some readings have been consumed, so some clones have none.
    for name in SIDES:
        plain._pending[0].by_side[name] = plain._pending[0].by_side[name][::3]
    arrays = state_from(plain)
    plain._prune()
    prune(arrays.filter, arrays.pending, most)
    assert_same(arrays.filter, plain._filter)
    assert 0 < plain._filter.num_clones <= most
    for side, name in enumerate(SIDES):
        rows = arrays.pending[side, : arrays.filter.counts[PENDING + side]]
        assert rows[:, CLONE].tolist() == [reading.clone for reading in plain._pending[0].by_side[name]]
    assert state.filter.counts[CLONES] == recorded._filter.num_clones


@pytest.mark.parametrize("seed", range(5))
def test_uncontested_members_near_a_corner(seed: int) -> None:
    generator = np.random.default_rng(seed)
    along = np.sort(generator.uniform(0.0, 0.8, (2, 12)), axis=1)
    # One reading of each wall lies near the corner at least.
    along[:, 0] = 0.01
    points = np.vstack((np.column_stack((along[0], np.zeros(12))), np.column_stack((np.zeros(12), along[1]))))
    points += 0.01 * generator.standard_normal(points.shape)
    owner = np.repeat([0, 1], 12)
    fitted: list[LineFit] = [fit_line(points[owner == number], NOISE) for number in range(2)]
    lines = [ExtractedLine(fit, np.flatnonzero(owner == number)) for number, fit in enumerate(fitted)]
    near = float(spec().settings[0]["near_line"])
    expected = {float(line[1]): members for line, members in plainly_uncontested(points, lines, near)}
    rows, ends = np.array([fit.line for fit in fitted]), np.array([fit.ends for fit in fitted])
    for number, fit in enumerate(fitted):
        members = uncontested(points, owner, rows, ends, 2, number, near)
        np.testing.assert_array_equal(members, expected.get(float(fit.line[1]), []))
        assert len(members) < 12
