"""The place of a drive follows from its readings; places that look alike, and ground without a map, are refused."""

from dataclasses import replace

import numpy as np
import pytest
from support.halls import HALL, PART, ROBOT, SQUARE, STD, WAY, drive, known

from limslam_agent.grid.occupancy import GridView
from limslam_agent.places.localisation import FAR_SHARE, LEAD, KnownPlaces, agree, localise
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.known_map import DECIDED, PlaceFit
from limslam_agent.status.rays import have_ended, moved, rays_of
from limslam_env.geometry import se2


@pytest.fixture(scope="module")
def whole():
    return known(WAY, HALL)


@pytest.mark.parametrize("frame", [(0.0, 0.0, 0.0), (2.0, -1.0, 1.3), (-3.0, 4.0, -2.9)])
def test_a_drive_is_placed_however_its_frame_is_turned(whole, frame):
    found = localise(whole, rays_of(drive(PART, HALL, frame), ROBOT))
    assert found.is_accepted, found.refusal
    off = se2.compose(se2.inverse(np.array(frame)), found.fit.pose)
    assert np.hypot(*off[:2]) < 0.05
    assert abs(se2.wrap_angle(float(off[2]))) < 0.02
    assert found.fit.contradictions == 0
    assert found.record["accepted"]
    assert found.record["evidence"] > found.record["runner_up"] + LEAD


def test_a_drive_with_wide_and_biased_beams_is_placed_by_the_sensor_that_was_found():
    wide = RangeSensor(STD, cone=0.2, bias=0.08)
    place = known([[1.0, 0.7], [5.4, 0.6], [5.4, 1.8], [3.4, 1.8], [1.5, 1.6], [1.7, 4.2], [1.0, 1.0]], HALL)
    rays = rays_of(drive(PART, HALL, sensor=wide), ROBOT, wide)
    (as_stated,) = place.weigh(np.zeros((1, 3)), rays)
    place.sensor = wide
    (as_found,) = place.weigh(np.zeros((1, 3)), rays)
    assert as_found.evidence > as_stated.evidence + 50.0
    found = localise(place, rays)
    assert found.is_accepted, found.refusal
    assert np.hypot(*found.fit.pose[:2]) < 0.1


def test_a_building_that_looks_the_same_after_a_turn_is_ambiguous():
    square = known([[0.6, 0.6], [2.4, 0.6], [2.4, 2.4], [0.6, 2.4], [0.6, 0.6]], SQUARE)
    found = localise(square, rays_of(drive([[0.7, 0.6], [2.3, 0.6], [2.3, 2.3]], SQUARE), ROBOT))
    assert found.refusal.startswith("ambiguous")
    assert not found.record["accepted"]


def test_ground_that_the_map_does_not_have_is_refused(whole):
    elsewhere = np.array([[0, 0, 2.2, 0.5], [2.2, 0.5, 1.8, 4], [1.8, 4, 0.2, 3.8], [0.2, 3.8, 0, 0]], dtype=float)
    found = localise(whole, rays_of(drive([[1.0, 0.8], [1.0, 3.4]], elsewhere), ROBOT))
    assert not found.is_accepted
    assert found.fit.is_on_map < DECIDED


def test_a_pose_does_not_slide_along_walls_that_are_not_quite_parallel():
    """A corridor of 1 m is drawn 2 % wider or narrower with each metre, and is 1 m wide a metre ahead."""
    corridor = np.array([[0.0, 0.0, 20.0, 0.0], [0.0, 1.0, 20.0, 1.0]])
    rays = rays_of(drive([[5.0, 0.5], [8.0, 0.5]], corridor), ROBOT)
    drawn = np.array([[0.0, 0.075, 20.0, -0.125], [0.0, 0.925, 20.0, 1.125]])
    place = KnownPlaces(drawn, GridView(np.zeros(2), 0.1, np.ones((4, 4), dtype=np.int16)), RangeSensor(STD))
    (found,) = place.refined(np.array([[0.0, 0.06, 0.02]]), rays)
    middle = se2.transform_points(found, rays[:, :2].mean(axis=0)[None])[0] - rays[:, :2].mean(axis=0)
    assert abs(middle[0]) < 0.3
    assert abs(middle[1]) < 0.01
    assert abs(found[2]) < 0.01


def test_the_likeliest_place_near_the_believed_one_is_compared_with_far_ones(whole):
    rays = moved(rays_of(drive(PART, HALL), ROBOT), np.array([3.5, -1.0, -0.4]))
    alone = localise(whole, rays, far=FAR_SHARE)
    assert not alone.is_near
    near = PlaceFit(np.zeros(3), 0.6 * alone.fit.evidence, 3, 90)
    found = localise(whole, rays, far=FAR_SHARE, near=[near])
    assert found.fit is near
    assert found.is_accepted, "contradictions need only not speak against a place near the believed one"
    assert not localise(whole, rays, far=FAR_SHARE, near=[replace(near, contradictions=6)]).is_accepted


def test_two_searches_agree_on_one_place_only(whole):
    found = localise(whole, rays_of(drive(PART, HALL), ROBOT))
    assert agree(found, found)
    away = replace(found, fit=replace(found.fit, pose=found.fit.pose + np.array([0.6, 0.0, 0.0])))
    assert not agree(found, away)
    assert not agree(found, replace(found, refusal="ambiguous"))
    assert agree(replace(found, refusal="ambiguous"), found), "it was the best place before"
    # Three robots were placed wrongly with so many contradictions, on ground without a map.
    alike = replace(found, fit=replace(found.fit, contradictions=4, tested=142))
    assert alike.fit.is_on_map > DECIDED
    assert not agree(found, alike)
    assert agree(found, alike, may_be_bent=True)
    assert agree(found, replace(alike, is_near=True)), "a robot that has drifted is likely near"


def test_without_rays_or_walls_there_is_nothing_to_compare(whole):
    nothing = KnownPlaces(
        np.zeros((0, 4)), GridView(np.zeros(2), 0.1, np.ones((4, 4), dtype=np.int16)), RangeSensor(STD)
    )
    rays = rays_of(drive(PART, HALL), ROBOT)
    for found in (localise(nothing, rays), localise(whole, rays[:0])):
        assert not found.is_accepted
        assert found.record == {"accepted": False, "reason": "there is nothing to compare"}


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
