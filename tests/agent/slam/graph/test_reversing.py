"""Stretches that were driven backwards are found in logs whose odometry counts every distance as driven ahead."""

from dataclasses import replace

import numpy as np
import pytest
from support.corridors import EVERY, FOUR_BEAMS, SIX_BEAMS, corridor_log, walls
from support.drives import drive, room, straight, turn

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.key_poses import LogData, integrate
from limslam_agent.slam.graph.reversing import reversed_distance, with_reversing
from limslam_agent.slam.online_graph.online_graph import OnlineGraph
from limslam_env.geometry import se2

CONFIG = GraphConfig()
STOP = [(0.0, 0.0)] * 12
START = np.array([1.0, 1.0, 0.0])


def there_and_back(robot=SIX_BEAMS, noise=0.01):
    """A log with true odometry: ahead to a corner, back and round it, back twice more, and on."""
    turned = turn(90.0, robot)
    wheels = straight(9.8) + STOP + straight(-1.6) + STOP + straight(1.6) + turned + straight(3.0) + STOP
    wheels += straight(-0.6) + STOP + straight(1.2) + STOP + straight(-0.6) + STOP + straight(3.0)
    return recorded_drive(walls(), wheels, robot, noise)


def recorded_drive(world, wheels, robot=SIX_BEAMS, noise=0.01):
    observations, poses = drive(world, START, wheels, robot, noise)
    rows = np.arange(0, len(poses), EVERY)
    ranges = np.array([observations[row]["ranges"] for row in rows], dtype=float)
    hit = (ranges > robot.too_near) & (ranges < robot.too_far)
    time = 0.1 * np.asarray(rows, dtype=float)
    return LogData(time, poses[rows], ranges, hit, robot.beam_origins, robot.beam_angles, 5.0, noise)


def without_signs(log):
    moves = se2.between(log.odometry[:-1], log.odometry[1:])
    moves[moves[:, 0] < 0.0, :2] *= -1.0
    return replace(log, odometry=integrate(log.odometry[0], moves))


# With four beams only one stretch contradicts clearly that it was driven ahead.
@pytest.mark.parametrize(("robot", "fewest"), [(SIX_BEAMS, 2), (FOUR_BEAMS, 1)])
def test_all_stretches_are_found(robot, fewest):
    signed = there_and_back(robot)
    recorded = without_signs(signed)
    directed = with_reversing(recorded, replace(CONFIG, reversing=replace(CONFIG.reversing, fewest=fewest)))
    assert reversed_distance(recorded, directed) == (pytest.approx(2.8, abs=0.3), 3)
    assert np.hypot(*(recorded.odometry - signed.odometry)[-1, :2]) > 3.0
    assert np.hypot(*(directed.odometry - signed.odometry)[-1, :2]) < 0.5


def test_a_stretch_is_found_while_driving():
    wheels = straight(9.8) + STOP + straight(-1.6) + STOP + straight(1.6) + turn(90.0, SIX_BEAMS) + straight(6.0)
    signed = recorded_drive(walls(), wheels)
    log, config = without_signs(signed), replace(CONFIG, reversing=replace(CONFIG.reversing, fewest=1))
    graph = OnlineGraph(log, log.odometry[0], config)
    for event in zip(log.time, log.odometry, log.ranges, log.hit, strict=True):
        graph.step(*event)
    assert np.hypot(*(log.odometry - signed.odometry)[-1, :2]) > 3.0
    assert np.hypot(*(graph.pose - signed.odometry[-1])[:2]) < 0.5


def test_odometry_that_reports_driving_backwards_is_believed():
    signed = there_and_back()
    assert with_reversing(signed, CONFIG) is signed


def test_a_drive_ahead_stays_as_it_is():
    log, _ = corridor_log(laps=1)
    assert with_reversing(log, CONFIG) is log
    blind = replace(log, hit=np.zeros_like(log.hit))
    assert with_reversing(blind, CONFIG) is blind


def test_a_log_of_short_beams_is_not_judged():
    # Beams of 1.5 m do not see the ground ahead of a stop, and driving back over known ground would fit better.
    recorded = replace(without_signs(there_and_back()), max_range=1.5)
    assert with_reversing(recorded, CONFIG) is recorded


def test_a_corridor_with_stops_stays_as_it_is():
    # The known ground behind fits better than the new ground ahead, but nothing contradicts that the robot drove ahead.
    corridor = np.vstack((room(0.0, 0.0, 24.0, 2.0), room(9.0, -0.3, 9.9, 0.0), room(14.0, 1.8, 15.0, 2.0)))
    wheels = straight(6.0) + STOP
    for length in (0.5, 0.4, 0.6, 3.0, 0.5, 0.4, 3.0):
        wheels += straight(length) + STOP
    log = recorded_drive(corridor, wheels)
    assert with_reversing(log, CONFIG) is log
    by_score_alone = replace(CONFIG, reversing=replace(CONFIG.reversing, contradicted=0.0, fewest=1))
    assert reversed_distance(log, with_reversing(log, by_score_alone))[0] > 0.3
