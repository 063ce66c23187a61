"""A lost robot that is found near the believed pose has drifted: its odometry holds, and it is not soon lost again."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.halls import HALL, PART, ROBOT, SENSOR, WAY, drive, known

from limslam_agent import preset
from limslam_agent.config.places import PlaceConfig
from limslam_agent.places.absence import Absence, Placement
from limslam_agent.places.history import StepLog
from limslam_agent.places.localisation import Localisation
from limslam_agent.places.rays import rays_of
from limslam_agent.places.recovery import Recovery
from limslam_agent.status.status import Status
from limslam_env.geometry.se2 import compose

CONFIG = PlaceConfig()
NEAR, FAR = (0.2, -0.1, 0.08), (3.5, -1.0, -0.4)


@pytest.fixture(scope="module")
def whole():
    return known(WAY, HALL)


def lost(whole, frame, **details):
    """A robot that has just been lost, whose believed poses are moved by a frame (3,)."""
    recovery = Recovery(ROBOT, preset("graph"), CONFIG)
    steps = [replace(step, pose=compose(np.array(frame), step.pose)) for step in drive(PART, HALL)]
    recovery.log = StepLog(0, steps)
    recovery.absence = Absence(None, 1, "", details.pop("jump", 0.0), whole, **details)
    return recovery


def monitor(carried=None, added=0.0):
    return SimpleNamespace(carried=carried, added_covariance=np.full((3, 3), added))


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
    recovery.absence.decisions.append((60, Localisation(fit, 0.0, rays[:, :2].mean(axis=0), "")))
    recovery.has_joined(Placement(40, np.zeros(3), np.eye(3), rays, [], np.zeros(3), None))
    assert recovery.breaks == ([40] if is_break else [])


def test_a_robot_whose_readings_fit_near_the_believed_pose_is_placed_at_once(whole):
    recovery = lost(whole, NEAR)
    found = recovery.seek_near(SENSOR)
    np.testing.assert_allclose(found.pose, drive(PART, HALL)[found.step - 1].pose, atol=0.05)
    recovery.has_joined(found)
    assert recovery.absence.has_drifted
    assert not recovery.breaks


def test_only_a_robot_that_drifted_is_placed_at_once(whole):
    assert lost(whole, FAR).seek_near(SENSOR) is None
    assert lost(whole, NEAR, is_carried=True).seek_near(SENSOR) is None
    assert lost(whole, NEAR, jump=1.1).seek_near(SENSOR) is None
    assert lost(None, NEAR).seek_near(SENSOR) is None


def test_a_drifted_robot_is_lost_again_only_by_all_its_readings(whole):
    rays = rays_of(drive(PART, HALL)[:5], ROBOT)
    fitting = lost(whole, (0.0, 0.0, 0.0), placed=0.0, rays=rays, has_drifted=True)
    assert fitting.still_fits(monitor(), SENSOR)
    assert not fitting.still_fits(monitor(carried=object()), SENSOR)
    assert not fitting.still_fits(monitor(added=1.2), SENSOR), "the odometry has jumped"
    assert not lost(whole, FAR, placed=0.0, rays=rays, has_drifted=True).still_fits(monitor(), SENSOR)
    assert not lost(whole, (0.0, 0.0, 0.0), placed=0.0, rays=rays).still_fits(monitor(), SENSOR)
    fitting.absence = None
    assert not fitting.still_fits(monitor(), SENSOR)


@pytest.mark.parametrize("has_drifted", [True, False])
def test_a_drifted_robot_need_not_wait_for_the_end_of_the_map(whole, has_drifted):
    recovery = lost(whole, (0.0, 0.0, 0.0), placed=0.0, rays=np.empty((0, 6)), has_drifted=has_drifted)
    slam, grid = SimpleNamespace(range_sensor=SENSOR, segments=whole.segments), whole.grid
    recovery.absence.driven = CONFIG.confirmed - 0.1
    recovery.confirm(Status(), slam, grid)
    assert recovery.absence is not None
    recovery.absence.driven = CONFIG.confirmed + 0.1
    recovery.confirm(Status("unsure", "a reason"), slam, grid)
    assert recovery.absence is not None
    recovery.confirm(Status(), slam, grid)
    assert (recovery.absence is None) is has_drifted
