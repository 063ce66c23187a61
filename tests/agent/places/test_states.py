"""The states of one robot: here, lost, or placed, and how it goes from one to another."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.halls import HALL, PART, ROBOT, SENSOR, WAY, drive, known

from limslam_agent import preset
from limslam_agent.places.absence import Absence, Placed
from limslam_agent.places.history import StepLog
from limslam_agent.places.localisation import FAR_SHARE, agree, localise
from limslam_agent.places.recovery import Recovery
from limslam_agent.places.search import PlaceSearch
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


def test_only_a_robot_that_may_have_drifted_is_placed_at_once(whole):
    assert lost(whole, NEAR).may_have_drifted
    assert not lost(whole, NEAR, is_carried=True).may_have_drifted
    assert not lost(whole, NEAR, jump=1.1).may_have_drifted
    assert not lost(whole, NEAR, has_returned=True).may_have_drifted, "the place that was found is wrong"
    assert lost(whole, AWAY).seek_near(SENSOR) is None
    recovery = lost(whole, NEAR, known=SimpleNamespace(step=0))
    assert recovery.seek_near(SENSOR) is None, "the map was copied after the doubt began, and fits in any case"


def monitor(*, is_carried=False, jump=0.0):
    return SimpleNamespace(loss=LOST._replace(is_carried=is_carried), jump=jump)


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
