"""Readings beside a map: what they say for it, which of them contradict it, and the likeliest pose near by."""

import math

import numpy as np
import pytest
from support.drives import ROBOT, ranges_at, room
from support.halls import HALL, PART, WAY, drive, known

from limslam_agent.grid.occupancy import GridView
from limslam_agent.kernels.tables import RAY_LENGTH
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.known_map import KnownMap, contradiction_test, drift_fit, slip_fit
from limslam_agent.status.rays import moved, rays_of, step_rays
from limslam_env.geometry import se2

WALLS = room(0.0, 0.0, 2.0, 2.0)
POSE = np.array([1.0, 0.8, 0.3])
UNKNOWN = GridView(np.zeros(2), 0.1, np.zeros((0, 0), dtype=np.int16))
FREE = GridView(np.full(2, -1.0), 0.1, np.full((40, 40), 4, dtype=np.int16))
NOISE = 0.02
STATED = RangeSensor(NOISE)


def explained(segments, ranges=None, covariance=None, grid=FREE, sensor=STATED):
    ranges = ranges_at(POSE, WALLS) if ranges is None else ranges
    rays = moved(step_rays(np.array(ranges), ROBOT, sensor.bias), POSE)
    return KnownMap(segments, grid, sensor).explained(rays, covariance), rays


def test_a_right_map_is_not_contradicted():
    found, rays = explained(WALLS)
    assert found.tested.all()
    assert not found.against.any()
    assert (found.evidence > 0.0).all()
    fit = KnownMap(WALLS, FREE, STATED).fit_here(rays)
    assert fit.evidence == pytest.approx(found.evidence.sum())
    assert (fit.contradictions, fit.tested) == (0, len(rays))


def test_the_evidence_of_a_reading_at_a_wall_is_a_likelihood_ratio():
    wall = np.array([[1.5, -4.0, 1.5, 4.0]])
    rays = np.array([[0.5, 0.0, 1.0, 0.0, 1.03, 1.5, 0.0]])
    (evidence,), _, _ = KnownMap(wall, FREE, RangeSensor(NOISE)).explained(rays, np.diag([0.01, 0.0, 0.04]))
    std = math.sqrt(NOISE**2 + 0.045**2 + 0.01 + 0.04)
    density = math.exp(-0.5 * (0.03 / std) ** 2) / (std * math.sqrt(2.0 * math.pi))
    share_of_wrong, nothing = 0.02, 0.45
    assert evidence == pytest.approx(math.log((1 - share_of_wrong) * density * 1.5 / (1 - nothing) + share_of_wrong))


@pytest.mark.parametrize("ranges", [None, ROBOT.max_ranges], ids=["longer", "nothing seen"])
def test_a_wall_too_near_is_gone_through(ranges):
    found, rays = explained(np.array([[0.3, 1.3, 1.7, 1.3]]), ranges)
    through = (found.against > 0.0) & (found.against < rays[:, RAY_LENGTH])
    assert through.any()
    assert (found.evidence[through] < 0.0).all()


def test_an_unsure_pose_explains_a_miss():
    wall = room(0.0, 0.0, 2.0, 1.6)
    assert explained(wall)[0].against.any()
    assert not explained(wall, covariance=np.diag([0.04, 0.04, 1e-4]))[0].against.any()


def test_ends_of_beams_in_free_space_contradict_unless_they_are_beside_unknown_ground():
    nothing = np.zeros((0, 4))
    found, rays = explained(nothing)
    ended = rays[:, RAY_LENGTH] < ROBOT.max_ranges
    np.testing.assert_array_equal(found.against > 0.0, ended)
    np.testing.assert_allclose(found.against[ended], rays[ended, RAY_LENGTH])
    assert not explained(nothing, ROBOT.max_ranges)[0].against.any()
    values = FREE.values.copy()
    ends = rays[:, :2] + rays[:, RAY_LENGTH, None] * rays[:, 2:4]
    rows, columns = FREE.cells(ends).T
    values[rows, columns + 1] = 0
    assert not explained(nothing, grid=GridView(FREE.low, FREE.cell, values))[0].against.any()


def test_nothing_is_said_on_unknown_ground():
    found, _ = explained(np.zeros((0, 4)), grid=UNKNOWN)
    assert not (found.tested | (found.against > 0.0)).any()
    assert not found.evidence.any()
    assert KnownMap(WALLS, FREE, STATED).fit_here(np.empty((0, 7))).evidence == 0.0


@pytest.mark.parametrize("bias", [0.4, -0.4])
def test_readings_fit_the_map_by_the_sensor_that_is_known_now(bias):
    ranges = np.minimum(ranges_at(POSE, WALLS) + bias, ROBOT.max_ranges - 0.01)
    assert explained(WALLS, ranges)[0].against.any()
    assert not explained(WALLS, ranges, sensor=RangeSensor(NOISE, bias=bias))[0].against.any()


def test_contradictions_are_tested_by_their_rate():
    assert contradiction_test(0, 100) < -10.0
    assert contradiction_test(12, 100) > 20.0
    assert contradiction_test(3, 100) < contradiction_test(3, 50) < contradiction_test(4, 50)
    assert contradiction_test(4, 60) > contradiction_test(4, 60, may_be_bent=True)


@pytest.mark.parametrize("off", [(0.2, -0.1, 0.08), (0.0, 0.0, 0.0)])
def test_the_likeliest_pose_near_by_is_that_of_the_drive(off):
    whole, rays = known(WAY, HALL), rays_of(drive(PART, HALL), ROBOT)
    found = drift_fit(whole, moved(rays, np.array(off)), np.diag([0.1**2, 0.1**2, 0.05**2]))
    np.testing.assert_allclose(found.fit.pose, se2.inverse(np.array(off)), atol=0.06)
    assert found.evidence > 50.0


@pytest.mark.parametrize("turn", [-26.0, 14.0])
def test_a_slip_is_found_by_what_was_read_since_then(turn):
    whole, rays = known(WAY, HALL), rays_of(drive(PART, HALL), ROBOT)
    start = np.array([*rays[0, :2], 0.0])
    slip = se2.compose(se2.compose(start, np.array([0.0, 0.0, math.radians(turn)])), se2.inverse(start))
    found = slip_fit(whole, moved(rays, slip))
    np.testing.assert_allclose(found.fit.pose, se2.inverse(slip), atol=0.06)
    assert found.evidence > whole.fit_here(moved(rays, slip)).evidence + 50.0
