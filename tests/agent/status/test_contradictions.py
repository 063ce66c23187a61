"""The comparison of readings with the map: beams that pass through walls, and beams that end in free space."""

import numpy as np
import pytest
from support.drives import ROBOT, ranges_at, room

from limslam_agent.grid.occupancy import GridView
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.contradictions import FREE as LEAST_FREE
from limslam_agent.status.contradictions import FREE_CELLS, KnownMap, compare, expected_ranges
from limslam_env.geometry.se2 import transform_points

WALLS = room(0.0, 0.0, 2.0, 2.0)
POSE = np.array([1.0, 0.8, 0.3])
SURE = np.diag([1e-6, 1e-6, 1e-6])
EVERY = np.ones(len(ROBOT.beams), dtype=bool)
UNKNOWN = GridView(np.zeros(2), 0.1, np.zeros((0, 0), dtype=np.int16))
FREE = GridView(np.full(2, -1.0), 0.1, np.full((40, 40), LEAST_FREE, dtype=np.int16))
NOISE = 0.02
STATED = RangeSensor(NOISE)


def compared(segments, ranges=None, covariance=SURE, measured=EVERY, grid=UNKNOWN, sensor=STATED):
    ranges = ranges_at(POSE, WALLS) if ranges is None else ranges
    predicted = expected_ranges(ROBOT, POSE[None], covariance, segments, sensor)
    known, expected = KnownMap(segments, grid), (predicted.ranges[0], predicted.stds[0])
    return compare(ROBOT, POSE, ranges, measured, known, *expected, sensor)


def test_a_right_map_is_not_contradicted():
    found = compared(WALLS, grid=FREE)
    assert not (found.through | found.in_free).any()
    np.testing.assert_array_equal(found.fits, found.expected)
    assert found.counts == (6, 0, found.expected.sum(), found.expected.sum())
    assert found.expected.sum() >= 4


def test_expected_ranges_are_those_of_the_walls():
    poses = np.array([POSE, [0.6, 1.2, -2.0]])
    predicted = expected_ranges(ROBOT, poses, SURE, WALLS, RangeSensor(NOISE))
    for pose, ranges, stds in zip(poses, predicted.ranges, predicted.stds, strict=True):
        is_known = np.isfinite(ranges)
        assert is_known.sum() >= 3
        np.testing.assert_allclose(ranges[is_known], ranges_at(pose, WALLS)[is_known], atol=1e-9)
        assert (stds[is_known] >= NOISE).all()


@pytest.mark.parametrize("ranges", [None, ROBOT.max_ranges], ids=["longer", "nothing seen"])
def test_a_wall_too_near_is_gone_through(ranges):
    found = compared(np.array([[0.3, 1.3, 1.7, 1.3]]), ranges)
    np.testing.assert_array_equal(found.through, found.expected)
    assert found.through.any()


def test_an_unsure_pose_explains_a_miss():
    wall = np.array([[0.0, 1.75, 2.0, 1.75]])
    assert compared(wall).through.any()
    assert not compared(wall, covariance=np.diag([0.01, 0.01, 1e-4])).through.any()


def test_ends_of_walls_do_not_count():
    # Beam 0 points to the left: it meets this wall 5 cm inside its end.
    heading = POSE[2] + ROBOT.beam_angles[0]
    x = POSE[0] + np.cos(heading) * 0.5 / np.sin(heading) + 0.05
    assert not compared(np.array([[0.0, 1.3, x, 1.3]])).expected[0]
    assert compared(np.array([[0.0, 1.3, x + 0.2, 1.3]])).expected[0]


def test_ends_of_beams_in_free_space_contradict_unless_a_wall_is_near():
    nothing = np.zeros((0, 4))
    found = compared(nothing, grid=FREE)
    np.testing.assert_array_equal(found.in_free, found.ended)
    assert found.counts[:2] == (found.ended.sum(), found.ended.sum())
    assert not compared(WALLS, grid=FREE).in_free.any()
    assert not compared(nothing, ROBOT.max_ranges, grid=FREE).in_free.any()


def test_one_cell_that_is_not_free_makes_its_surroundings_count_for_nothing():
    end = POSE[:2] + (ROBOT.beam_origins[0] + 0.5 * ROBOT.beam_directions[0]) @ np.array(
        [[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]]
    )
    row, column = FREE.cells(end[None])[0]
    for away, expected in ((FREE_CELLS, False), (FREE_CELLS + 1, True)):
        values = FREE.values.copy()
        values[row, column + away] = LEAST_FREE - 1
        grid = GridView(FREE.low, FREE.cell, values)
        assert compared(np.zeros((0, 4)), np.full(6, 0.5), grid=grid).in_free[0] == expected


def test_nothing_is_said_without_walls_or_readings():
    assert not compared(np.zeros((0, 4))).expected.any()
    assert compared(WALLS, measured=~EVERY, grid=FREE).counts == (0, 0, 0, 0)


@pytest.mark.parametrize(
    ("sensor", "ranges"),
    [
        (RangeSensor(NOISE, bias=0.2), ranges_at(POSE, WALLS) + 0.2),
        (RangeSensor(NOISE, bias=-0.2), ranges_at(POSE, WALLS) - 0.2),
        (RangeSensor(NOISE, growth=0.06), ranges_at(POSE, WALLS) + 0.17),
    ],
    ids=["too long", "too short", "growing noise"],
)
def test_readings_fit_the_map_by_the_sensor_that_is_known_now(sensor, ranges):
    stated, known = (compared(WALLS, ranges, grid=FREE, sensor=each) for each in (STATED, sensor))
    assert (stated.through | stated.in_free | ~stated.fits)[stated.expected].any()
    assert not (known.through | known.in_free).any()
    np.testing.assert_array_equal(known.fits, known.expected)


def test_a_wide_beam_should_read_the_nearest_point_inside_of_it():
    wall, cone = np.array([[-9.0, 1.6, 9.0, 1.6]]), 0.26
    predicted = expected_ranges(ROBOT, POSE[None], SURE, wall, STATED._replace(cone=cone)).ranges[0]
    beams = np.flatnonzero(np.isfinite(predicted))
    origins = transform_points(POSE, ROBOT.beam_origins)[beams]
    rays = (POSE[2] + ROBOT.beam_angles[beams])[:, None] + np.linspace(-cone, cone, 2001)
    nearest = ((1.6 - origins[:, 1:]) / np.sin(rays)).min(axis=1)
    assert len(beams) >= 3
    np.testing.assert_allclose(predicted[beams], nearest, atol=1e-6)
