"""The status of one robot, from made-up readings in a square room."""

import math

import numpy as np
import pytest
from support.drives import ROBOT, ranges_at, room

from limslam_agent.grid.occupancy import GridView
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.known_map import KnownMap
from limslam_agent.status.monitor import CARRIED, WINDOW, StatusMonitor
from limslam_agent.status.rays import Sight
from limslam_agent.status.status import Status, status_scores, worst

WALLS = room(0.0, 0.0, 2.0, 2.0)
SURE = np.diag([1e-6, 1e-6, 1e-6])
SENSOR = RangeSensor(0.02)
UNKNOWN = GridView(np.zeros(2), 0.1, np.zeros((0, 0), dtype=np.int16))
FREE = GridView(np.array([-1.0, -1.0]), 0.1, np.full((40, 40), 4, dtype=np.int16))
WIDE = GridView(np.array([-4.0, -4.0]), 0.1, np.full((100, 100), 4, dtype=np.int16))
KNOWN = KnownMap(WALLS, FREE, SENSOR)


def blind(distance, turn=0.0):
    """A step without new readings."""
    return Sight(np.array([1.0, 1.0, 0.0]), np.full(6, np.nan), np.array([distance, 0.0, turn]))


def monitor():
    return StatusMonitor(ROBOT, SENSOR)


def place(number):
    """A pose on a small circle about the middle of the room."""
    angle = 0.1 * number
    return np.array([1.0 + 0.2 * math.cos(angle), 1.0 + 0.2 * math.sin(angle), angle])


def drive(watched, steps, walls=WALLS, known=KNOWN, covariance=SURE, begin=0, length=0.11):
    """Check at each step what a robot sees whose surroundings are ``walls``; the levels."""
    levels = []
    for number in range(begin, begin + steps):
        sight = Sight(place(number), ranges_at(place(number), walls), np.array([length, 0.0, 0.0]))
        assert watched.observe(sight, is_busy=True)
        watched.check(covariance, known)
        levels.append(watched.status.level)
    return levels


def test_a_robot_in_a_right_map_is_ok():
    watched = monitor()
    assert set(drive(watched, 100)) == {"ok"}
    assert watched.status == Status()
    assert not watched.added_covariance.any()


def test_a_robot_whose_walls_are_gone_is_lost_at_once_and_says_why():
    watched = monitor()
    drive(watched, 40)
    levels = drive(watched, 10, walls=np.zeros((0, 4)), begin=40)
    assert levels.index("lost") <= 4
    # The contradictions alone would suffice before it is known that the readings changed suddenly, and when.
    assert watched.status == CARRIED
    assert watched.loss.is_dated
    assert watched.loss.is_carried
    assert watched.loss.ago == 9, "the walls are gone since the first of the ten steps"


def test_a_robot_that_was_carried_away_is_lost_although_its_map_is_redrawn_around_it():
    watched = monitor()
    drive(watched, 40)
    wrong = room(-3.0, -3.0, 3.0, 3.0)
    # After a step without readings, nothing has changed at once.
    watched.observe(blind(0.01), is_busy=True)
    levels = drive(watched, 200, walls=wrong, known=KnownMap(wrong, WIDE, SENSOR), begin=40)
    assert levels.index("lost") < 10
    assert set(levels[levels.index("lost") :]) == {"lost"}


def test_a_lost_robot_is_ok_again_when_the_earlier_map_fits():
    watched = monitor()
    drive(watched, 40)
    began = drive(watched, 10, walls=np.zeros((0, 4)), begin=40).index("lost")
    assert watched.added_covariance.any()
    levels = drive(watched, 200, begin=50)
    steps = levels.index("ok") + 10 - began
    assert WINDOW <= 0.11 * steps <= WINDOW + 1.0
    assert set(levels[levels.index("ok") :]) == {"ok"}
    assert not watched.added_covariance.any()


def test_a_closed_loop_moves_the_map_and_raises_no_doubt():
    """The map was 0.4 m off, and a change before the loop was closed is not weighed yet."""
    watched, off = monitor(), np.array([0.4, 0.4, 0.0])
    before = KnownMap(room(0.4, 0.4, 2.4, 2.4), FREE, SENSOR)
    for number in range(44):
        ranges = ranges_at(place(number), WALLS) - 0.1 * (number == 41)
        watched.observe(Sight(place(number) + off, ranges, np.array([0.11, 0.0, 0.0])), is_busy=True)
        if number < 40:
            watched.check(SURE, before)
    assert watched.status == Status()
    watched.forget_map()
    assert set(drive(watched, 60, begin=44)) == {"ok"}


def test_a_jump_of_the_odometry_is_noticed_in_the_same_step():
    watched = monitor()
    drive(watched, 40)
    assert watched.observe(Sight(place(40), ranges_at(place(40), WALLS), np.array([5.0, 0.0, 0.0])), is_busy=False)
    watched.check(SURE, KNOWN)
    assert watched.status == Status("lost", "the odometry reports a motion of 5.0 m in one step")
    assert math.sqrt(watched.added_covariance[0, 0]) == pytest.approx(5.0)
    assert not watched.observe(blind(0.01), is_busy=True)


def test_a_beam_alone_is_no_proof():
    """Its readings change again and again, and contradict the map."""
    watched, free = monitor(), GridView(np.array([-3.0, -3.0]), 0.1, np.full((60, 60), 9, dtype=np.int16))
    for number in range(100):
        ranges = ROBOT.max_ranges.copy()
        ranges[2] = 0.3 + 0.1 * (number % 9)
        if watched.observe(Sight(place(number), ranges, np.array([0.05, 0.0, 0.0])), is_busy=True):
            watched.check(SURE, KnownMap(np.zeros((0, 4)), free, SENSOR))
        assert watched.status.level != "lost"
    assert watched.status.level == "unsure"


@pytest.mark.parametrize("counts", [True, False])
def test_bodies_around_the_robot_make_it_lost_only_if_free_space_counts(counts):
    watched, levels = monitor(), []
    known = KnownMap(WALLS, FREE, SENSOR, free_space_counts=counts)
    drive(watched, 40, known=known)
    for number in range(40, 80):
        ranges = np.where(np.arange(6) < 5, 0.25, ranges_at(place(number), WALLS))
        if watched.observe(Sight(place(number), ranges, np.array([0.11, 0.0, 0.0])), is_busy=True):
            watched.check(SURE, known)
        levels.append(watched.status.level)
    assert ("lost" in levels) == counts


def test_an_uncertain_heading_is_unsure():
    watched = monitor()
    drive(watched, 10, covariance=np.diag([1e-6, 1e-6, math.radians(5.0) ** 2]))
    assert watched.status == Status("unsure", "the heading's standard deviation is 5.0 deg")
    assert watched.by_readings == Status(), "the readings fit the map all the same"
    drive(watched, 1, begin=10)
    assert watched.status == Status()


def test_the_worst_robot_counts_and_is_named():
    lost, unsure = Status("lost", "a jump"), Status("unsure", "a doubt")
    assert worst([lost]) == lost
    assert worst([Status(), unsure, lost]) == Status("lost", "robot 3: a jump")
    assert worst([Status(), Status()]) == Status()
    assert (lost.words, Status().words) == ("lost: a jump", "ok")


def test_the_scores_say_how_long_each_level_lasted():
    time = 3.0 + np.arange(6.0)
    levels = np.array([[0, 0], [1, 0], [1, 0], [0, 2], [0, 2], [0, 1]])
    scores = status_scores(time, levels, Status("unsure", "a doubt"))
    assert scores == {
        "status": "unsure", "status_reason": "a doubt", "ok_s": 1.0, "unsure_s": 2.0, "lost_s": 2.0,
        "first_lost_s": 3.0,
    }  # fmt: skip
    assert status_scores(time, np.zeros((6, 1), dtype=int), Status())["first_lost_s"] is None
