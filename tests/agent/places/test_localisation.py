"""Where a robot is by its readings: searches in a known map, and what moves with a place that is
found.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.halls import HALL, PART, ROBOT, SQUARE, STD, WAY, drive, known

from limslam_agent.grid.occupancy import GridView
from limslam_agent.kernels.extents import add_wall, count_hits
from limslam_agent.kernels.tables import LENGTH, LOW, empty_walls
from limslam_agent.places.localisation import FAR_SHARE, LEAD, KnownPlaces, agree, localise
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.map_state import MapState, lines_moved_with
from limslam_agent.slam.consistent.wall_map import NEW, Wall, WallExtent
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.known_map import DECIDED, PlaceFit
from limslam_agent.status.rays import have_ended, moved, rays_of
from limslam_env.geometry import FloatArray, se2
from limslam_env.geometry import line as line_geometry
from limslam_env.geometry import segment as segment_geometry


def wall_along(number: int, along: FloatArray, known_as: int = NEW) -> Wall:
    """A landmark on which beams ended at positions (n,), m along its line."""
    walls = empty_walls(1, 4000)
    add_wall(walls, 0)
    count_hits(walls, 0, np.asarray(along, dtype=float))
    low, length = walls.table[0, [LOW, LENGTH]].tolist()
    extent = WallExtent(low, walls.counted[0, :, :length], walls.reached[0, :, :length])
    return Wall(number, extent, 1, len(along), known_as=known_as)


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
    place = known(WAY, HALL)
    rays = rays_of(drive(PART, HALL, sensor=wide), ROBOT, wide)
    as_stated = place.fit_here(rays)
    place.sensor = wide
    as_found = place.fit_here(rays)
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
    elsewhere = np.array(
        [[0, 0, 2.2, 0.5], [2.2, 0.5, 1.8, 4], [1.8, 4, 0.2, 3.8], [0.2, 3.8, 0, 0]], dtype=float
    )
    found = localise(whole, rays_of(drive([[1.0, 0.8], [1.0, 3.4]], elsewhere), ROBOT))
    assert not found.is_accepted
    assert found.fit.log_ratio_on_map < DECIDED


def test_a_pose_does_not_slide_along_walls_that_are_not_quite_parallel():
    """A corridor of 1 m is drawn 2 % wider or narrower with each metre, and is 1 m wide a metre
    ahead.
    """
    corridor = np.array([[0.0, 0.0, 20.0, 0.0], [0.0, 1.0, 20.0, 1.0]])
    rays = rays_of(drive([[5.0, 0.5], [8.0, 0.5]], corridor), ROBOT)
    drawn = np.array([[0.0, 0.075, 20.0, -0.125], [0.0, 0.925, 20.0, 1.125]])
    place = KnownPlaces(
        drawn, GridView(np.zeros(2), 0.1, np.ones((4, 4), dtype=np.int16)), RangeSensor(STD)
    )
    (found,) = place.refined(np.array([[0.0, 0.06, 0.02]]), rays)
    middle = se2.transform_points(found, rays[:, :2].mean(axis=0)[None])[0] - rays[:, :2].mean(
        axis=0
    )
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
    assert found.is_accepted, (
        "contradictions need only not speak against a place near the believed one"
    )
    assert not localise(
        whole, rays, far=FAR_SHARE, near=[replace(near, contradictions=6)]
    ).is_accepted


def test_two_searches_agree_on_one_place_only(whole):
    found = localise(whole, rays_of(drive(PART, HALL), ROBOT))
    assert agree(found, found)
    away = replace(found, fit=replace(found.fit, pose=found.fit.pose + np.array([0.6, 0.0, 0.0])))
    assert not agree(found, away)
    assert not agree(found, replace(found, refusal="ambiguous"))
    assert agree(replace(found, refusal="ambiguous"), found), "it was the best place before"
    # Three robots were placed wrongly with so many contradictions, on ground without a map.
    alike = replace(found, fit=replace(found.fit, contradictions=4, tested=142))
    assert alike.fit.log_ratio_on_map > DECIDED
    assert not agree(found, alike)
    assert agree(found, alike, may_be_bent=True)
    assert agree(found, replace(alike, is_near=True)), "a robot that has drifted is likely near"


def test_without_rays_or_walls_there_is_nothing_to_compare(whole):
    nothing = KnownPlaces(
        np.zeros((0, 4)),
        GridView(np.zeros(2), 0.1, np.ones((4, 4), dtype=np.int16)),
        RangeSensor(STD),
    )
    rays = rays_of(drive(PART, HALL), ROBOT)
    for found in (localise(nothing, rays), localise(whole, rays[:0])):
        assert not found.is_accepted
        assert found.record == {"accepted": False, "reason": "there is nothing to compare"}


def test_readings_that_say_nothing_have_no_ray():
    steps = drive([[1.0, 0.7], [1.2, 0.7]], HALL)[:6]
    unsaid = np.array([np.nan, 0.0, *steps[0].ranges[2:]])
    assert not len(
        rays_of([step._replace(ranges=np.full_like(unsaid, np.nan)) for step in steps], ROBOT)
    )
    assert len(rays_of([step._replace(ranges=unsaid) for step in steps], ROBOT)) < len(
        rays_of(steps, ROBOT)
    )
    # One reading of the longest range may be a dropout of the sensor.
    missed = steps[2]._replace(ranges=np.array(ROBOT.max_ranges))
    rays = rays_of([*steps[:2], missed, *steps[3:]], ROBOT)
    assert (~have_ended(rays)).sum() <= (~have_ended(rays_of(steps, ROBOT))).sum()
    assert have_ended(rays).any()


MATCH = np.diag([0.05, 0.05, 0.03]) ** 2
POSE = np.array([2.5, 1.0, 0.4])
ROOM = np.array([[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0]], dtype=float)
LINES = np.array([[0.0, 0.5 * np.pi], [4.0, 0.0], [3.0, 0.5 * np.pi], [0.0, 0.0]])
WORLD = np.diag([0.8, 0.6, 0.0]) ** 2  # covariance of the whole room in the world


def room_in_an_uncertain_world(count):
    """A filter, and its map of the first walls of a room."""
    ekf = CloneEKF(np.array([9.0, 9.0, 0.0]), np.diag([0.01] * 3))
    walls = []
    for number, (segment, line) in enumerate(zip(ROOM[:count], LINES, strict=False)):
        points, _ = segment_geometry.sample(segment[None], 0.05)
        middle = points.mean(axis=0)
        ekf.add_known_line(line, 1e-8 * np.eye(2), middle)
        walls.append(wall_along(number, (points - middle) @ line_geometry.direction(line)))
    by_world = lines_moved_with((0.0, 0.0), ekf.anchored, ekf.anchors)
    ekf.P[3:, 3:] += by_world @ WORLD @ by_world.T
    return ekf, MapState(ekf.pose, ekf.anchored, ekf.anchors, ekf.marginal(), walls)


def ends(count):
    return segment_geometry.sample(ROOM[:count], 0.1)[0] + 0.02


def test_a_placed_robot_moves_with_the_walls_that_it_was_matched_with():
    ekf, state = room_in_an_uncertain_world(4)
    by_lines = state.by_walls(POSE, ends(4))
    with_all = by_lines @ lines_moved_with((2.5, 1.0), state.lines, state.anchors)
    np.testing.assert_allclose(with_all, np.eye(3), atol=1e-12)
    ekf.relocate(POSE, MATCH, by_lines=by_lines)
    np.testing.assert_array_equal(ekf.pose, POSE)
    np.testing.assert_allclose(ekf.joint_pose_covariance, WORLD + MATCH, atol=1e-5)
    # A later correction moves the right wall by 0.5 m. The robot follows, and is known as well as
    # its match then.
    gain = ekf.P[:, 5] / (ekf.P[5, 5] + 1e-8)
    ekf.x[:] += 0.5 * gain
    ekf.P[:] -= np.outer(gain, ekf.P[5])
    np.testing.assert_allclose(ekf.pose, POSE + np.array([0.5, 0.0, 0.0]), atol=1e-3)
    np.testing.assert_allclose(
        np.sqrt(np.diag(ekf.joint_pose_covariance)), [0.05, np.hypot(0.6, 0.05), 0.03], atol=1e-3
    )
