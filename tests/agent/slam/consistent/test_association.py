"""Which wall segments update a landmark that they disagree with, and what that does to a filter that is too sure."""

import math

import numpy as np
from support.drives import ROBOT, drive, recorded, straight

from limslam_agent import BatchSlam, LineSlam, preset
from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.slam.consistent.limits import FAR_GATE
from limslam_agent.slam.core.diagnostics import Comparison
from limslam_env import Observation
from limslam_env.geometry import FloatArray, se2

START = np.zeros(3)
CONFIG = preset("consistent")
GATE = ConsistentConfig().association.gate
WALL = np.array([[-1.0, 0.5, 5.0, 0.5]])
BACK_AND_FORTH = [*straight(3.0), *straight(-2.5), *straight(2.0)]
FALSE_TURN = range(len(straight(5.5)) + 1, len(straight(5.5)) + 5)


def misled(degrees: float) -> tuple[list[Observation], FloatArray]:
    """A drive along a wall that is known already, whose odometry turns by an angle that is none, and the last pose."""
    observations, poses = drive(WALL, START, BACK_AND_FORTH)
    each = 0.5 * ROBOT.axle * math.radians(degrees) / len(FALSE_TURN)
    for step in FALSE_TURN:
        observations[step]["wheels"] += np.array([-each, each], dtype=np.float32)
    return observations, poses[-1]


def test_a_filter_that_is_too_sure_is_corrected_by_the_only_wall_nearby() -> None:
    observations, pose = misled(6.0)
    heard = list[Comparison]()
    slam = LineSlam(ROBOT, CONFIG, START)
    slam.on_comparison = heard.append
    for seen in observations:
        slam.step(seen)
    assert np.abs(slam.pose - pose).max() < 0.005
    assert len(slam.all_landmarks) == 1
    # The first comparison after the false turn lies between the gates, and it is said that the landmark was taken.
    tests = [each.tests[0] for each in heard if each.step > FALSE_TURN[0]]
    refused = [test for test in tests if GATE < test.distance < FAR_GATE]
    assert refused
    assert refused[0].excluded == ""


def test_the_batch_is_corrected_alike() -> None:
    observations, _ = misled(6.0)
    slam, batch = LineSlam(ROBOT, CONFIG, START), BatchSlam(ROBOT, CONFIG, 1, num_threads=1, size=0)
    batch.reset(START[None])
    for seen in observations:
        slam.step(seen)
        beliefs = batch.step(seen["ranges"][None], seen["wheels"][None])
        np.testing.assert_allclose(beliefs.pose[0], slam.pose, rtol=0.0, atol=1e-6)
        np.testing.assert_allclose(beliefs.covariance[0], slam.covariance, rtol=0.0, atol=1e-6)
    assert batch.num_landmarks[0] == 1


def test_a_turn_beyond_the_far_gate_is_not_taken_back() -> None:
    observations, pose = misled(10.0)
    slam, _ = recorded(observations, CONFIG, START)
    assert abs(se2.wrap_angle(float(slam.pose[2] - pose[2]))) > math.radians(5.0)
