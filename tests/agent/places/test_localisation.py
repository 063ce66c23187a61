"""The place of a drive follows from its readings; places that look alike, and ground without a map, are refused."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from limslam_agent import preset
from limslam_agent.config.exploration import GridConfig
from limslam_agent.config.places import PlaceConfig
from limslam_agent.config.status import ContradictionConfig
from limslam_agent.grid.occupancy import GridView, drawn_grid
from limslam_agent.places.history import LoggedStep, StepLog
from limslam_agent.places.localisation import KnownPlaces, agree, localise
from limslam_agent.places.rays import ends_of, have_ended, moved, rays_of
from limslam_agent.places.recovery import KnownFrame, Recovery
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.contradictions import expected_ranges
from limslam_env.geometry.se2 import compose, inverse, transform_points, wrap_angle
from limslam_env.geometry.segment import distances
from limslam_env.interface import RobotSpec

CONFIG, ROBOT, STD = PlaceConfig(), RobotSpec(), 0.01
# An L-shaped hall with a niche and a pillar: no two places look alike.
HALL = np.array([
    [0, 0, 6, 0], [6, 0, 6, 2.4], [6, 2.4, 2.6, 2.4], [2.6, 2.4, 2.6, 5], [2.6, 5, 0, 5], [0, 5, 0, 3.4],
    [0, 3.4, 0.7, 3.4], [0.7, 3.4, 0.7, 2.6], [0.7, 2.6, 0, 2.6], [0, 2.6, 0, 0],
    [4.2, 0.9, 4.8, 0.9], [4.8, 0.9, 4.8, 1.4], [4.8, 1.4, 4.2, 1.4], [4.2, 1.4, 4.2, 0.9],
], dtype=float)  # fmt: skip
SQUARE = np.array([[0, 0, 3, 0], [3, 0, 3, 3], [3, 3, 0, 3], [0, 3, 0, 0]], dtype=float)
PART = [[1.6, 0.9], [1.6, 1.8], [1.6, 3.6]]
SENSOR = RangeSensor(STD)


def poses_along(corners, spacing=0.03):
    """Poses (n, 3) along straight lines between corners (k, 2)."""
    rows = []
    for start, end in pairwise(corners):
        way = np.subtract(end, start)
        shares = np.arange(0.0, 1.0, spacing / np.hypot(*way))
        rows += [[*(start + share * way), np.arctan2(*way[::-1])] for share in shares]
    return np.array(rows)


def readings(poses, segments, sensor=SENSOR):
    found = expected_ranges(ROBOT, poses, np.zeros((3, 3)), segments, sensor, ContradictionConfig(inset=0.0)).ranges
    return np.minimum(found, ROBOT.max_ranges)


def drive(corners, segments, frame=(0.0, 0.0, 0.0), sensor=SENSOR):
    """The steps of a drive, in the frame of a pose (3,)."""
    poses = poses_along(corners)
    local = compose(inverse(np.array(frame)), poses)
    return [
        LoggedStep({}, *each)
        for each in zip(local, np.zeros_like(local), readings(poses, segments, sensor), strict=True)
    ]


def known(corners, segments):
    """The map of a drive."""
    poses = poses_along(corners)
    ranges = readings(poses, segments)[:, None]
    grid = drawn_grid(GridConfig(), ROBOT, poses[:, None], ranges, np.ones(ranges.shape, dtype=bool))
    return KnownPlaces(segments, grid, SENSOR)


@pytest.fixture(scope="module")
def whole():
    return known([[1.0, 0.7], [5.4, 0.6], [5.4, 1.8], [3.4, 1.8], [1.5, 1.6], [1.7, 4.2], [1.0, 1.0]], HALL)


@pytest.mark.parametrize("frame", [(0.0, 0.0, 0.0), (2.0, -1.0, 1.3), (-3.0, 4.0, -2.9)])
def test_a_drive_is_placed_however_its_frame_is_turned(whole, frame):
    found = localise(whole, rays_of(drive(PART, HALL, frame), ROBOT), CONFIG)
    assert found.is_accepted, found.refusal
    off = compose(inverse(np.array(frame)), found.fit.pose)
    assert np.hypot(*off[:2]) < 0.05
    assert abs(wrap_angle(float(off[2]))) < 0.02
    assert found.fit.contradictions == 0
    assert found.record["accepted"]
    assert found.record["evidence"] > found.record["runner_up"] + CONFIG.lead


def test_a_drive_with_wide_and_biased_beams_is_placed_by_the_sensor_that_was_found():
    wide = RangeSensor(STD, cone=0.2, bias=0.08)
    place = known([[1.0, 0.7], [5.4, 0.6], [5.4, 1.8], [3.4, 1.8], [1.5, 1.6], [1.7, 4.2], [1.0, 1.0]], HALL)
    rays = rays_of(drive(PART, HALL, sensor=wide), ROBOT, wide.bias)
    (as_stated,) = place.weigh(np.zeros((1, 3)), rays)
    place.sensor = wide
    (as_found,) = place.weigh(np.zeros((1, 3)), rays)
    assert as_found.evidence > as_stated.evidence + 50.0
    found = localise(place, rays, CONFIG)
    assert found.is_accepted, found.refusal
    assert np.hypot(*found.fit.pose[:2]) < 0.1


def test_a_building_that_looks_the_same_after_a_turn_is_ambiguous():
    square = known([[0.6, 0.6], [2.4, 0.6], [2.4, 2.4], [0.6, 2.4], [0.6, 0.6]], SQUARE)
    found = localise(square, rays_of(drive([[0.7, 0.6], [2.3, 0.6], [2.3, 2.3]], SQUARE), ROBOT), CONFIG)
    assert found.refusal.startswith("ambiguous")
    assert not found.record["accepted"]


def test_ground_that_the_map_does_not_have_is_refused(whole):
    elsewhere = np.array([[0, 0, 2.2, 0.5], [2.2, 0.5, 1.8, 4], [1.8, 4, 0.2, 3.8], [0.2, 3.8, 0, 0]], dtype=float)
    found = localise(whole, rays_of(drive([[1.0, 0.8], [1.0, 3.4]], elsewhere), ROBOT), CONFIG)
    assert not found.is_accepted
    assert found.fit.is_on_map < CONFIG.on_map


def test_two_searches_agree_on_one_place_only(whole):
    found = localise(whole, rays_of(drive(PART, HALL), ROBOT), CONFIG)
    assert agree(found, found, CONFIG)
    away = replace(found, fit=replace(found.fit, pose=found.fit.pose + np.array([0.5, 0.0, 0.0])))
    assert not agree(found, away, CONFIG)
    assert not agree(found, replace(found, refusal="ambiguous"), CONFIG)


def test_without_rays_or_walls_there_is_nothing_to_compare(whole):
    nothing = KnownPlaces(
        np.zeros((0, 4)), GridView(np.zeros(2), 0.1, np.ones((4, 4), dtype=np.int16)), RangeSensor(STD)
    )
    rays = rays_of(drive(PART, HALL), ROBOT)
    for found in (localise(nothing, rays, CONFIG), localise(whole, rays[:0], CONFIG)):
        assert not found.is_accepted
        assert found.record == {"accepted": False, "reason": "there is nothing to compare"}


def test_rays_end_at_walls_and_move_with_their_frame():
    frame = np.array([2.0, -1.0, 1.3])
    rays = rays_of(drive(PART, HALL, frame), ROBOT)
    ends = ends_of(moved(rays, frame))
    assert distances(ends[have_ended(rays)], HALL).min(axis=1).max() < 1e-5
    assert distances(ends[~have_ended(rays)], HALL).min(axis=1).min() > 0.0
    np.testing.assert_allclose(ends, transform_points(frame, ends_of(rays)), atol=1e-9)


def test_readings_that_say_nothing_have_no_ray():
    steps = drive([[1.0, 0.7], [1.2, 0.7]], HALL)[:6]
    unsaid = np.array([np.nan, 0.0, *steps[0].ranges[2:]])
    assert not len(rays_of([replace(step, ranges=np.full_like(unsaid, np.nan)) for step in steps], ROBOT))
    assert len(rays_of([replace(step, ranges=unsaid) for step in steps], ROBOT)) < len(rays_of(steps, ROBOT))
    # One reading of the longest range may be a dropout of the sensor.
    missed = replace(steps[2], ranges=np.array(ROBOT.max_ranges))
    rays = rays_of([*steps[:2], missed, *steps[3:]], ROBOT)
    assert (~have_ended(rays)).sum() <= (~have_ended(rays_of(steps, ROBOT))).sum()
    assert have_ended(rays).any()


def test_a_robot_whose_readings_fit_another_place_only_is_elsewhere(whole):
    recovery = Recovery(ROBOT, preset("graph"), CONFIG)
    earlier = SimpleNamespace(segments=whole.segments, range_sensor=SENSOR), SimpleNamespace(view=whole.grid)
    steps = drive(PART, HALL)
    begin = len(steps) - 60

    def is_elsewhere(poses, suspected=60):
        recovery.log.steps = [replace(step, pose=pose) for step, pose in zip(steps, poses, strict=True)]
        recovery._copies = [KnownFrame(step, *earlier) for step in (0, begin, begin + 30)]
        recovery._rechecked = CONFIG.recheck
        return recovery.is_elsewhere(SimpleNamespace(suspected=suspected))

    right = np.array([step.pose for step in steps])
    wrong = compose(np.array([3.5, -1.0, -0.4]), right)
    assert not is_elsewhere(right)
    assert is_elsewhere(wrong)
    assert not is_elsewhere(np.concatenate((wrong[:-5], right[-5:])))
    assert not is_elsewhere(wrong, suspected=None), "the readings did not change at once"
    assert is_elsewhere(wrong)
    assert not recovery.is_elsewhere(SimpleNamespace(suspected=60)), "the robot has not driven since then"


def test_the_largest_correction_of_a_log_is_that_of_the_estimator():
    poses = poses_along([[0.0, 0.0], [1.0, 0.0]], spacing=0.1)
    poses[6:, 1] += 0.5
    steps = [LoggedStep({}, pose, np.array([0.1, 0.0, 0.0]), np.zeros(6)) for pose in poses]
    assert StepLog(0, steps).largest_correction == pytest.approx(0.5)
    assert StepLog(0, steps[:6]).largest_correction == pytest.approx(0.0, abs=1e-9)


def test_a_log_whose_first_steps_are_forgotten_gives_all_that_are_left():
    log = StepLog(60, drive(PART, HALL))
    assert log.since(50) == log.steps
    assert log.since(62) == log.steps[2:]


def test_a_renewal_moves_the_latest_steps_of_a_recovery():
    recovery = Recovery(ROBOT, preset("graph"), CONFIG)
    recovery.log.steps = drive(PART, HALL)
    before = [step.pose for step in recovery.log.steps]
    renewed = [np.full(3, 7.0), np.full(3, 8.0)]
    recovery.move(renewed)
    np.testing.assert_array_equal([step.pose for step in recovery.log.steps], [*before[:-2], *renewed])
    recovery.move([np.zeros(3)] * (len(before) + 5))
    assert not np.any([step.pose for step in recovery.log.steps])
