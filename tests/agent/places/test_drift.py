"""A lost robot that is found near the believed pose has drifted: its odometry holds, and it is not soon lost again."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.halls import HALL, PART, ROBOT, SENSOR, WAY, drive, known

from limslam_agent import Mapper, preset
from limslam_agent.places.absence import Absence
from limslam_agent.places.decision import CONFIRMED
from limslam_agent.places.history import StepLog
from limslam_agent.places.kidnapping import CARRIED, Doubt
from limslam_agent.places.localisation import ON_MAP, Localisation, near_fit
from limslam_agent.places.rays import rays_of
from limslam_agent.places.recovery import Recovery
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.core.ekf import LineEKF
from limslam_agent.status.status import Status
from limslam_env.geometry.se2 import compose

NEAR, FAR = (0.2, -0.1, 0.08), (3.5, -1.0, -0.4)


@pytest.fixture(scope="module")
def whole():
    return known(WAY, HALL)


def lost(whole, frame, **details):
    """A robot that has just been lost, whose believed poses are moved by a frame (3,)."""
    recovery = Recovery(ROBOT, preset("graph"))
    steps = [replace(step, pose=compose(np.array(frame), step.pose)) for step in drive(PART, HALL)]
    recovery.log = StepLog(0, steps)
    recovery.absence = Absence(None, 1, "", details.pop("jump", 0.0), whole, **details)
    return recovery


def monitor(carried=None, jump=0.0):
    return SimpleNamespace(carried=carried, jump=jump)


@pytest.mark.parametrize(
    ("off", "details", "is_break"),
    [
        (0.3, {}, False),
        (0.3, {"is_carried": True}, False),
        (1.0, {}, False),
        (1.0, {"is_carried": True}, True),
        (1.0, {"jump": 1.1}, True),
        (3.0, {}, True),
    ],
)
def test_the_odometry_holds_for_a_robot_that_is_found_near(whole, off, details, is_break):
    recovery = lost(whole, (0.0, 0.0, 0.0), **details)
    rays = rays_of(recovery.log.steps, ROBOT)
    (fit,) = whole.weigh(np.array([[off, 0.0, 0.0]]), rays)
    found = Localisation(fit, 0.0, rays[:, :2].mean(axis=0), "")
    recovery.absence.decisions.append(found)
    recovery.has_joined(recovery._placement(recovery.absence, rays, found, SENSOR))
    assert recovery.breaks == ([1] if is_break else [])


def test_a_robot_whose_readings_fit_near_the_believed_pose_is_placed_at_once(whole):
    recovery = lost(whole, NEAR)
    found = recovery.seek_near(SENSOR)
    np.testing.assert_allclose(found.pose, drive(PART, HALL)[found.step - 1].pose, atol=0.05)
    recovery.has_joined(found)
    assert recovery.absence.has_drifted
    assert not recovery.breaks


def test_a_few_readings_suffice_near_the_believed_pose(whole):
    """They say little against ground that the map does not have, and nothing says that the robot was carried away."""
    recovery = lost(whole, NEAR)
    recovery.absence.first = recovery.log.end - 12
    rays = rays_of(recovery.log.since(recovery.absence.first), ROBOT)
    near = near_fit(whole, rays, recovery.absence.covariance)
    assert not recovery._fits_near(near, rays, ON_MAP)
    assert recovery.seek_near(SENSOR) is not None


def test_only_a_robot_that_drifted_is_placed_at_once(whole):
    assert lost(whole, FAR).seek_near(SENSOR) is None
    assert lost(whole, NEAR, is_carried=True).seek_near(SENSOR) is None
    assert lost(whole, NEAR, jump=1.1).seek_near(SENSOR) is None
    assert lost(None, NEAR).seek_near(SENSOR) is None
    assert lost(whole, NEAR, returned=20).seek_near(SENSOR) is None, "the place that was found is wrong"
    recovery = lost(whole, NEAR)
    recovery.absence.known = SimpleNamespace(step=0)
    assert recovery.seek_near(SENSOR) is None, "the map was copied after the doubt began, and fits in any case"


def test_a_robot_that_a_renewal_has_found_is_unsure_until_nothing_contradicts_the_renewed_map(whole):
    recovery, right = lost(whole, FAR), [step.pose for step in drive(PART, HALL)]
    assert recovery.may_be_renewed
    slam, grid = SimpleNamespace(segments=whole.segments, range_sensor=SENSOR), SimpleNamespace(view=whole.grid)
    recovery.has_been_renewed(right, slam, grid)
    assert recovery.status(Status()).level == "unsure"
    np.testing.assert_array_equal([step.pose for step in recovery.log.steps], right)
    assert recovery.still_fits(monitor(), SENSOR), "the renewed map is not contradicted"
    recovery.log.steps = [replace(step, pose=compose(np.array(FAR), step.pose)) for step in recovery.log.steps]
    assert not recovery.still_fits(monitor(), SENSOR)
    assert not recovery.may_be_renewed, "one renewal is enough"


@pytest.mark.parametrize("details", [{"is_carried": True}, {"jump": 1.1}])
def test_a_robot_that_was_moved_is_not_sought_by_a_renewal(whole, details):
    assert not lost(whole, NEAR, **details).may_be_renewed


@pytest.mark.parametrize("has_fitted", [True, False])
@pytest.mark.parametrize("jump", [0.0, 1.1])
def test_a_renewal_is_tried_for_a_robot_whose_readings_have_fitted_since_a_change(whole, monkeypatch, has_fitted, jump):
    """Otherwise it is lost like every robot that may have been carried away."""
    recovery = lost(whole, FAR)
    recovery.absence, recovery._doubt = None, Doubt(40, 20.0, is_dated=True, status=CARRIED, has_fitted=has_fitted)
    slam = SimpleNamespace(covariance=np.eye(3), pose=np.zeros(3), range_sensor=SENSOR)
    own = SimpleNamespace(status=Status(), doubted=0, jump=jump, added_covariance=np.diag([jump**2, jump**2, 0.0]))
    known = SimpleNamespace(step=0, grid=SimpleNamespace(view=whole.grid), places=whole)
    monkeypatch.setattr(recovery, "_copy", lambda *_: known)
    recovery.lose(own, slam, None)
    assert recovery.absence.is_carried
    assert recovery.absence.jump > 1.5, "it may be anywhere in the map"
    assert recovery.may_be_renewed is (has_fitted and jump == 0.0)
    assert recovery.seek_near(SENSOR) is None
    steps = [step.pose for step in recovery.log.steps]
    grid = SimpleNamespace(view=whole.grid)
    recovery.has_been_renewed(steps, SimpleNamespace(segments=whole.segments, range_sensor=SENSOR), grid)
    assert not recovery.absence.was_moved, "the renewal says that it has drifted"


def test_a_drifted_robot_is_lost_again_only_by_all_its_readings(whole):
    rays = rays_of(drive(PART, HALL)[:5], ROBOT)
    fitting = lost(whole, (0.0, 0.0, 0.0), placed=0.0, rays=rays, has_drifted=True)
    fitting.absence.driven = 2.0
    assert fitting.still_fits(monitor(), SENSOR)
    assert fitting.absence.placed == 2.0, "the distance without contradictions begins again"
    assert not fitting.still_fits(monitor(carried=object()), SENSOR)
    assert not fitting.still_fits(monitor(jump=1.2), SENSOR), "the odometry has jumped"
    assert not lost(whole, FAR, placed=0.0, rays=rays, has_drifted=True).still_fits(monitor(), SENSOR)
    assert not lost(whole, (0.0, 0.0, 0.0), placed=0.0, rays=rays).still_fits(monitor(), SENSOR)
    fitting.absence = None
    assert not fitting.still_fits(monitor(), SENSOR)


@pytest.mark.parametrize("has_drifted", [True, False])
def test_a_drifted_robot_need_not_wait_for_the_end_of_the_map(whole, has_drifted):
    recovery = lost(whole, (0.0, 0.0, 0.0), placed=0.0, rays=np.empty((0, 6)), has_drifted=has_drifted)
    slam, grid = SimpleNamespace(range_sensor=SENSOR, segments=whole.segments), whole.grid
    recovery.absence.driven = CONFIRMED - 0.1
    recovery.confirm(Status(), slam, grid)
    assert recovery.absence is not None
    recovery.absence.driven = CONFIRMED + 0.1
    recovery.confirm(Status("unsure", "a reason"), slam, grid)
    assert recovery.absence is not None
    recovery.confirm(Status(), slam, grid)
    assert (recovery.absence is None) is has_drifted


def test_a_place_is_confirmed_although_the_heading_of_the_whole_map_is_uncertain():
    mapper = Mapper(ROBOT, preset("graph"))
    mapper._recovery.absence = Absence(
        None, 1, "", 0.0, None, driven=5.0, placed=1.0, rays=np.empty((0, 6)), has_drifted=True
    )
    mapper._present.monitors[0].status = Status("unsure", "the heading's standard deviation is 5.0 deg")
    mapper.finish()
    assert [each["event"] for each in mapper.places.records] == ["confirmed"]


def test_a_robot_that_is_lost_is_as_uncertain_as_it_was_before(whole):
    covariance = np.diag([0.8, 0.5, 0.01])
    recovery = lost(whole, NEAR, covariance=covariance)
    x, y, _ = recovery.log.steps[-1].pose
    recovery.absence.left = np.array([x, y, 2.0])
    np.testing.assert_allclose(recovery.added_covariance, covariance, atol=1e-12)
    # An error of the heading moves the pose 5 m away across the way from there.
    recovery.absence.left = np.array([x - 3.0, y - 4.0, 2.0])
    away = covariance + 0.01 * np.array([[16.0, -12.0, -4.0], [-12.0, 9.0, 3.0], [-4.0, 3.0, 0.0]])
    np.testing.assert_allclose(recovery.added_covariance, away, atol=1e-12)


def test_a_robot_that_is_shifted_is_as_uncertain_as_the_walls_around_it():
    """The whole world may be turned about the start. The robot is shifted within it, and remains tied to its walls."""
    ekf, match = LineEKF(np.array([[4.0, 0.0, 0.0]])), np.diag([0.05**2, 0.05**2, 0.03**2])
    turn, pose = np.deg2rad(3.0), np.array([4.3, 0.5, 0.1])
    ekf.augment(np.array([2.0, 0.5 * np.pi]), 1e-9 * np.eye(2), 0)
    by_turn = np.array([0.0, 4.0, 1.0, 0.0, 1.0])  # the pose and the wall, which is 2 m from the origin
    ekf.P[:] = turn**2 * np.outer(by_turn, by_turn)
    ekf.shift(pose, match)
    np.testing.assert_array_equal(ekf.x[:3], pose)
    by_turn[:2] = -0.5, 4.3
    np.testing.assert_allclose(ekf.P[:3, :3], turn**2 * np.outer(by_turn, by_turn)[:3, :3] + match, atol=1e-12)
    np.testing.assert_allclose(ekf.P[:3, 3:], turn**2 * np.outer(by_turn, by_turn)[:3, 3:], atol=1e-12)


def test_the_errors_beside_the_filter_are_shifted_with_the_pose():
    ekf = CloneEKF(np.zeros(3), np.diag([0.01, 0.01, 0.01]) ** 2)
    ekf.predict(np.array([1.0, 0.0, 0.5]), 1e-4 * np.eye(3), by_calibration=np.eye(3))
    before = ekf._bias.by_errors.copy()
    ekf.shift(np.array([1.2, 0.4, 0.6]), 1e-4 * np.eye(3))
    turned = np.array([[1.0, 0.0, -0.4], [0.0, 1.0, 0.2], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(ekf._bias.by_errors[:3], turned @ before[:3])


def placed_at_once(mapper):
    """Place the robot of a mapper that was lost in its first step."""
    recovery = SimpleNamespace(has_joined=lambda *_: None, log=SimpleNamespace(begin=0, end=0, steps=[]))
    recovery.absence = SimpleNamespace(known=SimpleNamespace(copied=lambda: (mapper._slam_at(np.zeros((1, 3))), None)))
    placement = SimpleNamespace(gone=[(np.zeros(3), np.eye(3))], carried_at=0, step=0)
    placement.put = lambda *_: (placement, None)
    mapper._go_on_at(recovery, placement)


def test_who_listens_to_associations_still_hears_them_after_a_placement_at_once():
    mapper, heard = Mapper(ROBOT), [].append
    mapper.slam.on_association = heard
    placed_at_once(mapper)
    assert mapper.slam.on_association is heard


def test_readings_that_are_processed_again_at_a_place_make_no_robot_lost(monkeypatch):
    mapper = Mapper(ROBOT)

    def play(*_):
        mapper._present.monitors[0].status = Status("lost", "4 of 31 readings contradict the map")
        return [(np.zeros(3), np.eye(3))]

    monkeypatch.setattr(mapper, "_play", play)
    placed_at_once(mapper)
    assert mapper._present.monitors[0].status == Status()
