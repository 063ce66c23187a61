"""The states of one robot: here, lost, or placed, and how it goes from one to another."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.halls import HALL, PART, ROBOT, SENSOR, WAY, drive, known

from limslam_agent import Mapper, preset
from limslam_agent.frames import ProcessedAgain
from limslam_agent.places.absence import Absence, Placed
from limslam_agent.places.history import StepLog
from limslam_agent.places.localisation import FAR_SHARE, Localisation, agree, localise
from limslam_agent.places.recovery import Recovery
from limslam_agent.places.search import CONFIRMED, FAR_CONFIRMED, PlaceSearch
from limslam_agent.status.known_map import PlaceFit
from limslam_agent.status.monitor import Loss
from limslam_agent.status.rays import rays_of
from limslam_agent.status.status import Status
from limslam_env.geometry.se2 import compose, inverse

NEAR, AWAY = (0.2, -0.1, 0.08), (3.5, -1.0, -0.4)
HERE = (0.0, 0.0, 0.0)
LOST = Loss(Status("lost", "a reason"), 3)
NO_RAYS = np.empty((0, 7))


@pytest.fixture(scope="module")
def whole():
    return known(WAY, HALL)


def lost(whole, frame=HERE, *, explains=False, **details):
    """A robot that has just been lost, whose believed poses are moved by a frame (3,)."""
    recovery = Recovery(ROBOT, preset("graph"))
    steps = [replace(step, pose=compose(np.array(frame), step.pose)) for step in drive(PART, HALL)]
    recovery.log = StepLog(0, steps)
    first = details.pop("first", 1)
    found = {"since": first, "known": SimpleNamespace(step=-1, explains=lambda *_: explains), **details}
    recovery.absence = Absence("a reason", first, search=PlaceSearch(whole), **found)
    return recovery


def placement_at(recovery, place, pose):
    """Where the robot goes on if its search has found a pose (3,) of its frame."""
    rays = rays_of(recovery.log.since(recovery.absence.first), ROBOT)
    (fit,) = place.weigh(np.array([pose]), rays)
    found = Localisation(fit, 0.0, rays[:, :2].mean(axis=0), "")
    return recovery._placement(recovery.absence, rays, found, SENSOR)


@pytest.mark.parametrize(
    ("off", "details", "is_break"),
    [
        (0.3, {}, False),
        (0.3, {"is_carried": True}, False),
        (1.0, {}, False),
        (1.0, {"is_carried": True}, True),
        (1.0, {"jump": 1.1}, True),
        (3.0, {}, True),
        (3.0, {"explains": True}, False),
        (3.0, {"explains": True, "is_carried": True}, True),
    ],
)
def test_the_odometry_holds_for_a_robot_that_has_drifted(whole, off, details, is_break):
    recovery = lost(whole, **details)
    recovery.has_joined(placement_at(recovery, whole, (off, 0.0, 0.0)))
    assert recovery.breaks == ([1] if is_break else [])
    assert recovery.is_placed
    assert recovery.status(Status()).level == "unsure"


def test_two_searches_in_succession_place_a_robot_that_was_carried_away(whole):
    recovery = lost(whole, AWAY, is_carried=True, is_dated=True)
    assert recovery.seek(SENSOR) is None
    assert recovery.guesses
    found = recovery.seek(SENSOR)
    np.testing.assert_allclose(found.pose, drive(PART, HALL)[found.step - 1].pose, atol=0.05)
    assert not found.has_drifted


def test_a_robot_whose_readings_fit_near_the_believed_pose_is_placed_at_once(whole):
    recovery = lost(whole, NEAR)
    found = recovery.seek_near(SENSOR)
    np.testing.assert_allclose(found.pose, drive(PART, HALL)[found.step - 1].pose, atol=0.05)
    assert found.has_drifted
    assert lost(whole, NEAR, first=len(recovery.log.steps) - 12).seek_near(SENSOR) is not None, "few readings suffice"


def test_only_a_robot_that_has_drifted_is_placed_at_once(whole):
    assert lost(whole, AWAY).seek_near(SENSOR) is None
    assert lost(whole, NEAR, is_carried=True).seek_near(SENSOR) is None
    assert lost(whole, NEAR, jump=1.1).seek_near(SENSOR) is None
    assert lost(whole, NEAR, has_returned=True).seek_near(SENSOR) is None, "the place that was found is wrong"
    recovery = lost(whole, NEAR, known=SimpleNamespace(step=0))
    assert recovery.seek_near(SENSOR) is None, "the map was copied after the doubt began, and fits in any case"


def test_a_renewal_is_tried_for_a_robot_that_nothing_says_was_moved(whole):
    assert lost(whole, NEAR).may_be_renewed
    assert not lost(whole, NEAR, is_carried=True).may_be_renewed
    assert not lost(whole, NEAR, jump=1.1).may_be_renewed
    assert not lost(whole, NEAR, has_returned=True).may_be_renewed


def monitor(*, is_carried=False, jump=0.0):
    return SimpleNamespace(loss=LOST._replace(is_carried=is_carried), jump=jump)


def test_a_robot_that_a_renewal_has_found_is_unsure_until_nothing_contradicts_the_renewed_map(whole):
    recovery, right = lost(whole, AWAY), [step.pose for step in drive(PART, HALL)]
    slam, grid = SimpleNamespace(segments=whole.segments, range_sensor=SENSOR), SimpleNamespace(view=whole.grid)
    recovery.has_been_renewed(right, slam, grid)
    assert recovery.status(Status()).level == "unsure"
    np.testing.assert_array_equal([step.pose for step in recovery.log.steps], right)
    assert recovery.still_fits(monitor(), SENSOR), "the renewed map is not contradicted"
    recovery.log.steps = [replace(step, pose=compose(np.array(AWAY), step.pose)) for step in recovery.log.steps]
    assert not recovery.still_fits(monitor(), SENSOR)
    assert not recovery.may_be_renewed, "one renewal is enough"


def test_a_drifted_robot_is_lost_again_only_by_all_its_readings(whole):
    rays = rays_of(drive(PART, HALL)[:5], ROBOT)
    placed = Placed(0.0, rays, whole, has_drifted=True)
    fitting = lost(whole, placed=placed, driven=2.0)
    assert fitting.still_fits(monitor(), SENSOR)
    assert fitting.absence.placed.at == 2.0, "the distance without contradictions begins again"
    assert not fitting.still_fits(monitor(is_carried=True), SENSOR)
    assert not fitting.still_fits(monitor(jump=1.2), SENSOR), "the odometry has jumped"
    assert not lost(whole, AWAY, placed=placed).still_fits(monitor(), SENSOR)
    assert not lost(whole, placed=placed._replace(has_drifted=False)).still_fits(monitor(), SENSOR)


@pytest.mark.parametrize(("frame", "is_wrong"), [(HERE, False), (AWAY, True)])
def test_a_place_that_the_readings_contradict_is_refuted(whole, frame, is_wrong):
    assert lost(whole, frame, placed=Placed(0.0, NO_RAYS, whole)).is_refuted(SENSOR) is is_wrong


def test_a_place_that_is_refuted_is_taken_back_as_a_whole(whole):
    believed = [replace(step, pose=step.pose + 7.0) for step in drive(PART, HALL)[:10]]
    recovery = lost(whole, first=10, steps=believed, placed=Placed(1.0, NO_RAYS, whole), has_returned=True)
    recovery.breaks = [3, 8]
    recovery.absence.first = 40
    recovery.lose(LOST, 0.0, None, None)
    assert (recovery.absence.first, recovery.breaks) == (10, [3])
    assert recovery.is_lost
    np.testing.assert_array_equal(recovery.log[9].pose, believed[9].pose)
    recovery.lose(LOST, 1.1, None, None)
    assert recovery.absence.first == recovery.log.end - 4, "the local frame begins again at the new doubt"


def test_a_robot_that_is_lost_again_in_its_local_frame_was_carried_away_before(whole):
    recovery = lost(whole, first=30, since=12, is_dated=True)
    placement = placement_at(recovery, whole, (3.0, 0.0, 0.0))
    assert placement.step == 12
    np.testing.assert_allclose(placement.pose, compose(np.array([3.0, 0.0, 0.0]), recovery.log[11].pose), atol=1.2)


@pytest.mark.parametrize("has_drifted", [True, False])
def test_a_drifted_robot_need_not_wait_for_the_end_of_the_map(whole, has_drifted):
    recovery = lost(whole, placed=Placed(0.0, NO_RAYS, whole, has_drifted=has_drifted))
    slam, grid = SimpleNamespace(range_sensor=SENSOR, segments=whole.segments), whole.grid
    recovery.absence.driven = CONFIRMED - 0.1
    recovery.confirm(Status(), slam, grid)
    assert recovery.absence is not None
    recovery.absence.driven = CONFIRMED + 0.1
    recovery.confirm(Status("unsure", "a reason"), slam, grid)
    assert recovery.absence is not None
    recovery.confirm(Status(), slam, grid)
    assert (recovery.absence is None) is has_drifted
    if not has_drifted:
        recovery.absence.driven = FAR_CONFIRMED + 0.1
        recovery.confirm(Status(), slam, grid)
        assert recovery.absence is None, "all its readings fit in one place of the map"


def test_a_place_is_confirmed_although_the_heading_of_the_whole_map_is_uncertain():
    mapper = Mapper(ROBOT, preset("graph"))
    mapper._recovery.absence = Absence("", 1, 1, driven=5.0, placed=Placed(1.0, NO_RAYS, None, has_drifted=True))
    mapper._present.monitors[0].status = Status("unsure", "the heading's standard deviation is 5.0 deg")
    mapper.finish()
    assert [each["event"] for each in mapper.places.records] == ["confirmed"]


def test_a_robot_that_is_lost_is_as_uncertain_as_it_was_before(whole):
    covariance = np.diag([0.8, 0.5, 0.01])
    recovery = lost(whole, NEAR, covariance=covariance, left=np.zeros(3))
    x, y, _ = recovery.log.steps[-1].pose
    recovery.absence.left = np.array([x, y, 2.0])
    np.testing.assert_allclose(recovery.added_covariance, covariance, atol=1e-12)
    # An error of the heading moves the pose 5 m away across the way from there.
    recovery.absence.left = np.array([x - 3.0, y - 4.0, 2.0])
    away = covariance + 0.01 * np.array([[16.0, -12.0, -4.0], [-12.0, 9.0, 3.0], [-4.0, 3.0, 0.0]])
    np.testing.assert_allclose(recovery.added_covariance, away, atol=1e-12)


def test_the_likeliest_place_near_the_believed_one_is_compared_with_far_ones(whole):
    frame = np.array(AWAY)
    steps = [replace(step, pose=compose(frame, step.pose)) for step in drive(PART, HALL)]
    rays = rays_of(steps, ROBOT)
    alone = localise(whole, rays, far=FAR_SHARE)
    assert not alone.is_near
    np.testing.assert_allclose(alone.fit.pose, inverse(frame), atol=0.1)
    near = PlaceFit(np.zeros(3), 0.6 * alone.fit.evidence, 3, 90)
    found = localise(whole, rays, far=FAR_SHARE, near=[near])
    assert found.fit is near
    assert found.is_near
    assert found.is_accepted, "contradictions need only not speak against a place near the believed one"
    assert agree(found, found)
    assert not localise(whole, rays, far=FAR_SHARE, near=[replace(near, contradictions=6)]).is_accepted


def test_the_copies_from_before_a_suspicion_are_kept():
    mapper = Mapper(ROBOT, preset("graph"))
    recovery, step = mapper._recovery, drive(PART, HALL)[0]
    for number in range(400):
        recovery.note(step, mapper.slam, mapper._present.grid, is_suspicious=number > 120)
    assert recovery._copies[-1].step <= 120
    assert recovery.log.begin == recovery._copies[0].step


def placed_at_once(mapper):
    """Place the robot of a mapper that was lost in its first step."""
    recovery = SimpleNamespace(has_joined=lambda *_: None, log=SimpleNamespace(begin=0, end=0, steps=[]))
    recovery.absence = SimpleNamespace(known=SimpleNamespace(copied=lambda: (mapper._slam_at(np.zeros((1, 3))), None)))
    placement = SimpleNamespace(step=0)
    placement.put = lambda *_: (placement, None)
    mapper._go_on_at(recovery, placement)


def test_readings_that_are_processed_again_at_a_place_make_no_robot_lost(monkeypatch):
    mapper = Mapper(ROBOT)

    def replay(*_):
        mapper._present.monitors[0].status = Status("lost", "4 of 31 readings contradict the map")
        return ProcessedAgain(np.zeros((1, 1, 3)), np.zeros((1, 1, 3, 3)), was_lost=True)

    monkeypatch.setattr(mapper, "_replay", replay)
    placed_at_once(mapper)
    assert mapper._present.monitors[0].status == Status()
