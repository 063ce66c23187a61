"""A robot was carried away if its readings since a sudden change say so: not one beam alone, and not a room like it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.halls import HALL, PART, ROBOT, SENSOR, WAY, drive, known

from limslam_agent import preset
from limslam_agent.places.absence import Absence
from limslam_agent.places.decision import FAR_CONFIRMED
from limslam_agent.places.history import StepLog
from limslam_agent.places.kidnapping import CARRIED, ELSEWHERE, MAYBE_CARRIED, MAYBE_ELSEWHERE, SUSPECTED, Kidnapping
from limslam_agent.places.localisation import ON_MAP, KnownPlaces, is_far, localise, near_fit
from limslam_agent.places.rays import rays_of
from limslam_agent.places.recovery import _CHECKPOINTS, _RECHECK, WRONG_PLACE, Recovery
from limslam_agent.status.contradictions import KnownMap
from limslam_agent.status.status import Status
from limslam_agent.status.sudden_changes import Suspicion
from limslam_env.geometry.se2 import compose, inverse

COVARIANCE = np.diag([0.03**2, 0.03**2, 0.01**2])
AWAY = np.array([3.5, -1.0, -0.4])


@pytest.fixture(scope="module")
def whole():
    return known(WAY, HALL)


def changed(place, step, change=4.0):
    """A sudden change of the readings before a step."""
    return step, Suspicion(step, KnownMap(place.segments, place.grid), change, change, 3, 0.0, set())


def believed(poses=None, ranges=None):
    """The steps of a drive with the poses that the robot believes in."""
    steps = drive(PART, HALL)
    poses = [step.pose for step in steps] if poses is None else poses
    ranges = [step.ranges for step in steps] if ranges is None else ranges
    return StepLog(0, [replace(step, pose=p, ranges=r) for step, p, r in zip(steps, poses, ranges, strict=True)])


def doubt(log, changes, covariance=COVARIANCE, driven=5.0):
    return Kidnapping(ROBOT).doubt(changes, log, covariance, SENSOR, driven)


def moved_log(frame):
    log = believed()
    return believed([compose(np.array(frame), step.pose) for step in log.steps])


def test_readings_that_fit_the_believed_pose_speak_against_a_kidnapping(whole):
    found = doubt(believed(), [changed(whole, 5)])
    assert found.status.level == "ok"
    assert found.evidence < -50.0
    assert doubt(believed(), []) is None, "without a sudden change, a robot was not carried away"


def test_the_likeliest_of_several_changes_says_when(whole):
    """The robot is carried to another place of its map before step 40."""
    right = np.array([step.pose for step in believed().steps])
    poses = np.concatenate((right[:40], compose(AWAY, right[40:])))
    found = doubt(believed(poses), [changed(whole, 2), changed(whole, 40), changed(whole, 70)])
    assert (found.step, found.status, found.is_dated) == (40, CARRIED, True)
    weak = doubt(believed(poses), [changed(whole, 40, 1.5)])
    assert (weak.status, weak.is_dated) == (CARRIED, False), "the readings of that step alone say little"


def test_a_robot_that_has_drifted_a_little_was_not_carried_away(whole):
    log = moved_log([0.12, 0.10, 0.0])
    assert doubt(log, [changed(whole, 5)], covariance=np.diag([0.2**2, 0.2**2, 0.05**2])).status.level == "ok"


@pytest.mark.parametrize("has_fitted", [True, False])
def test_a_robot_whose_readings_have_fitted_since_a_change_may_have_drifted_later(whole, has_fitted):
    """It may also be at a place that looked at first like the one before, so that it still counts as carried away."""
    watched, log, change = Kidnapping(ROBOT), believed(), [changed(whole, 5)]
    log.steps = log.steps[:30]
    if has_fitted:
        assert watched.doubt(change, log, COVARIANCE, SENSOR).status.level == "ok"
    log.steps += 2 * moved_log(AWAY).steps
    recovery, own = Recovery(ROBOT, preset("graph")), SimpleNamespace(status=Status(), doubted=0)
    recovery._doubt = watched.doubt(change, log, COVARIANCE, SENSOR)
    loss = recovery._first_doubt(own, SimpleNamespace(range_sensor=SENSOR))
    assert (recovery._doubt, loss.first, loss.is_carried) == (None, 5, True)
    assert (loss.is_dated, loss.has_fitted) == (not has_fitted, has_fitted)


def test_a_broken_beam_alone_is_no_proof(whole):
    ranges = np.array([step.ranges for step in believed().steps])
    ranges[:, 0] = np.where(np.arange(len(ranges)) % 2, 0.35, 0.55)
    found = doubt(believed(ranges=ranges), [changed(whole, 5)])
    assert found.status != CARRIED


def test_readings_that_fit_another_place_make_a_robot_unsure(whole):
    """The robot believes that it is on ground without a map, which may look like a place of the map."""
    log, changes = moved_log([20.0, 0.0, 0.3]), [changed(whole, 5)]
    assert doubt(log, changes).status == MAYBE_ELSEWHERE
    assert doubt(log, changes, driven=0.0).status.level == "ok", "nothing is searched"
    assert doubt(log, [changed(whole, 5, SUSPECTED)], driven=0.0).status == MAYBE_CARRIED


@pytest.mark.parametrize(("std", "status"), [(0.03, ELSEWHERE), (7.0, MAYBE_CARRIED)])
def test_a_doubtful_robot_whose_readings_fit_another_place_twice_is_lost(whole, std, status):
    """It believes that it is beside its map, 7 m from its place, which a large covariance explains."""
    robot, log, changes = Kidnapping(ROBOT), moved_log([7.0, 0.0, 0.0]), [changed(whole, 5, SUSPECTED + 1.0)]
    covariance = np.diag([std**2, 0.03**2, 0.01**2])
    found = [robot.doubt(changes, log, covariance, SENSOR, 5.0).status for _ in range(2)]
    assert found == [MAYBE_CARRIED, status]


@pytest.mark.parametrize(
    ("frame", "change", "is_held"), [((20.0, 0.0, 0.3), 7.0, True), ((0.0, 0.0, 0.0), 170.0, False)]
)
def test_a_doubtful_change_is_held_until_the_readings_fit(whole, frame, change, is_held):
    """The second robot is doubtful with a large change only, and its readings fit all the same."""
    robot, log, first = Kidnapping(ROBOT), moved_log(frame), changed(whole, 5, change)
    assert robot.doubt([first], log, COVARIANCE, SENSOR).status.level != "ok"
    assert robot.held == 5
    first[1].change = 0.0  # it is no longer doubtful by itself
    found = robot.doubt([], log, COVARIANCE, SENSOR)
    assert (found.status.level != "ok", robot.held == 5) == (is_held, is_held)
    robot.forget()
    assert robot.doubt([], log, COVARIANCE, SENSOR) is None


def test_a_change_is_not_held_beyond_the_steps_that_are_kept(whole):
    robot, log = Kidnapping(ROBOT), moved_log((20.0, 0.0, 0.3))
    robot.doubt([changed(whole, 5, 7.0)], log, COVARIANCE, SENSOR)
    log.forget_before(10)
    assert robot.doubt([], log, COVARIANCE, SENSOR) is None


def test_the_map_from_before_a_doubtful_change_is_kept():
    recovery = Recovery(ROBOT, preset("graph"))
    copies = [SimpleNamespace(step=50 * number) for number in range(_CHECKPOINTS + 4)]
    assert recovery._kept(copies) == copies[4:]
    recovery._kidnapping = SimpleNamespace(held=120)
    assert recovery._kept(copies) == [copies[2], *copies[4:]]
    recovery._kidnapping.held = 220
    assert recovery._kept(copies) == copies[4:]


def test_a_beam_that_fitted_before_several_readings_changed_is_sound(whole):
    """Since step 60, one beam alone speaks for a kidnapping."""
    ranges = np.array([step.ranges for step in believed().steps])
    ranges[60:, 4] = np.where(np.arange(len(ranges) - 60) % 2, 0.35, 0.55)
    log = believed(ranges=ranges)
    change = changed(whole, 60, 60.0)
    assert doubt(log, [change]).status == CARRIED
    assert doubt(log, [(60, replace(change[1], changed=1))]).status != CARRIED


def test_far_places_count_less_for_a_robot_that_has_drifted(whole):
    rays = rays_of(drive(PART, HALL, (3.0, -2.0, 1.3)), ROBOT)
    assert localise(whole, rays).is_accepted
    assert not localise(whole, rays, far=0.0).is_accepted
    near = rays_of(drive(PART, HALL, (0.3, -0.2, 0.1)), ROBOT)
    assert localise(whole, near, far=0.0).is_accepted


@pytest.mark.parametrize(("frame", "is_wrong"), [((0.0, 0.0, 0.0), False), (AWAY, True)])
def test_a_place_that_the_readings_contradict_is_left_again(whole, frame, is_wrong):
    recovery = Recovery(ROBOT, preset("graph"))
    recovery.log = moved_log(frame)
    rays = rays_of(recovery.log.since(0)[:10], ROBOT)
    recovery.absence = Absence(None, 1, "", 1.0, whole, is_carried=True, placed=0.0, rays=rays)
    recovery._rechecked = _RECHECK
    slam = SimpleNamespace(range_sensor=SENSOR, covariance=COVARIANCE)
    own = SimpleNamespace(status=SimpleNamespace(level="ok"), changes=lambda _: [], carried=None)
    assert recovery.is_elsewhere(own, slam) is is_wrong
    assert not recovery.is_elsewhere(own, slam), "the robot has not driven since then"
    assert recovery._first_doubt(own, slam) == (WRONG_PLACE, 1, False, True, False)


@pytest.mark.parametrize(("frame", "is_wrong"), [((0.0, 0.0, 0.0), False), (AWAY, True)])
def test_an_unlikely_place_is_judged_by_the_readings_since_the_return(whole, frame, is_wrong):
    """The rays by which the place was found fit it well, at a wrong place too."""
    recovery, slam = Recovery(ROBOT, preset("graph")), SimpleNamespace(range_sensor=SENSOR)
    recovery.log = moved_log(frame)
    rays = np.tile(rays_of(moved_log((0.0, 0.0, 0.0)).since(0), ROBOT), (20, 1))
    found = Absence(None, 1, "", 1.0, whole, placed=0.0, rays=rays)
    assert not recovery._is_refuted(found, SENSOR)
    found.is_far = True
    assert recovery._is_refuted(found, SENSOR) is is_wrong
    recovery.absence, found.driven = found, FAR_CONFIRMED
    slam.segments = whole.segments
    recovery.confirm(Status(), slam, whole.grid)
    assert (recovery.absence is found) is is_wrong


@pytest.mark.parametrize("is_unlikely", [True, False])
def test_an_unlikely_place_is_not_confirmed_by_the_robots_new_walls_alone(whole, is_unlikely):
    recovery = Recovery(ROBOT, preset("graph"))
    recovery.log = moved_log((0.0, 0.0, 0.0))
    rays = rays_of(recovery.log.since(0), ROBOT)
    grid = replace(whole.grid, low=whole.grid.low + 50.0)
    before = KnownPlaces(whole.segments + 50.0, grid, SENSOR)
    found = Absence(None, 1, "", 1.0, before, driven=FAR_CONFIRMED, placed=0.0, rays=rays)
    recovery.absence, found.is_far = found, is_unlikely
    slam = SimpleNamespace(range_sensor=SENSOR, segments=whole.segments)
    recovery.confirm(Status(), slam, whole.grid)
    assert (recovery.absence is found) is is_unlikely


@pytest.mark.parametrize(("frame", "is_near"), [((0.3, -0.2, 0.1), True), (AWAY, False), ((20.0, 0.0, 0.3), False)])
def test_readings_that_fit_near_the_believed_pose_take_back_that_the_robot_was_carried_away(whole, frame, is_near):
    recovery, rays = Recovery(ROBOT, preset("graph")), rays_of(moved_log(frame).since(0), ROBOT)
    assert recovery._fits_near(near_fit(whole, rays, COVARIANCE), rays, ON_MAP) is is_near
    assert not recovery._fits_near(near_fit(whole, rays[:0], COVARIANCE), rays[:0], ON_MAP)


@pytest.mark.parametrize(("std", "is_carried"), [(0.03, True), (0.5, False)])
def test_a_robot_within_its_uncertainty_was_not_carried_away(whole, std, is_carried):
    """It comes back to known walls after a long way, and is off by 1 m and 7 degrees."""
    log = moved_log([0.9, -0.5, 0.12])
    covariance = np.diag([std**2, std**2, (0.3 * std) ** 2])
    assert (doubt(log, [changed(whole, 5)], covariance=covariance).status == CARRIED) is is_carried


def test_a_few_readings_do_not_lead_away_from_the_likeliest_pose_near_by(whole):
    """A refinement may slide along a wall, where the prior says that the robot is not."""
    log, covariance = moved_log([0.4, -0.3, 0.1]), np.diag([0.4**2, 0.4**2, 0.12**2])
    for count in (6, 12, 24):
        rays = rays_of(log.steps[-count:], ROBOT)
        found = near_fit(whole, rays, covariance)
        (here,) = whole.weigh(np.zeros((1, 3)), rays)
        right = np.array(inverse(np.array([0.4, -0.3, 0.1])))
        assert found.evidence > here.evidence
        assert not is_far(compose(found.fit.pose, inverse(right)), np.zeros(2), 0.9, 0.35)


def test_a_sudden_change_of_readings_that_say_nothing_is_weighed_without_rays(whole):
    """A hand over the sensors: some beams read less than they can, and the others nothing."""
    covered = np.array([0.03, 0.03, *[np.nan] * 4])
    log = moved_log(np.zeros(3))
    log.steps[5:] = [replace(step, ranges=covered) for step in log.steps[5:]]
    assert not len(rays_of(log.since(5), ROBOT))
    assert near_fit(whole, rays_of(log.since(5), ROBOT), COVARIANCE).cost == 0.0
    assert doubt(log, [changed(whole, 5)]) is not None
