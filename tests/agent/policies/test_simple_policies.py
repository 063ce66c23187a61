"""Laps, WallFollower and RandomPolicy: how they drive, and when and why they stop."""

import math

import numpy as np
import pytest
from support.beliefs import BLOCKED, CLEAR, CLOSED, CONFIG, ROBOT, actions_until_stopped, belief_of, explored, place

from limslam_agent import Belief, Laps, RandomPolicy, WallFollower
from limslam_agent.policies.controller import PATIENCE
from limslam_env.geometry import FloatArray

SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])


@pytest.mark.parametrize("corner", range(2))
def test_laps_that_are_blocked_stop_and_name_the_corner(corner: int) -> None:
    before, ahead = SQUARE[corner - 1], SQUARE[corner]
    heading = math.atan2(*(ahead - before)[::-1])
    policy = Laps(ROBOT, SQUARE, 3)
    actions = actions_until_stopped(policy, belief_of(np.array([*before, heading]), CLOSED, BLOCKED))
    assert policy.stop_reason == f"stopped: something is in the way to corner {corner + 1} of the loop"
    assert PATIENCE < len(actions) < PATIENCE + 3
    np.testing.assert_allclose(actions, 0.0, atol=1e-9)


def test_a_wall_follower_goes_round() -> None:
    coverage, contacts = explored("env1", WallFollower(ROBOT, CONFIG), 180.0)
    assert coverage > 0.6
    assert contacts == 0


def test_a_wall_follower_stops_when_there_is_nothing_new() -> None:
    policy = WallFollower(ROBOT, CONFIG)
    actions = actions_until_stopped(policy, belief_of(place(4, 4), CLOSED))
    assert policy.stop_reason == "stopped: nothing new was seen along the wall for 90 s"
    assert len(actions) == 902
    np.testing.assert_array_equal(policy.act(belief_of(place(4, 4), CLOSED)), [0.0, 0.0])


def seeing(**distances: float) -> Belief:
    """Beams from left to right are called a to f."""
    ranges = CLEAR.copy()
    for name, distance in distances.items():
        ranges["abcdef".index(name)] = distance
    return belief_of(place(4, 4), CLOSED, ranges)


def test_a_wall_follower_keeps_its_distance() -> None:
    def turn(**distances: float) -> float:
        left, right = WallFollower(ROBOT, CONFIG).act(seeing(**distances))
        return float(left - right)

    assert turn(f=0.25) == pytest.approx(0.0, abs=1e-9)
    assert turn(f=0.15) < -0.05
    assert turn(f=0.40) > 0.05
    # Something ahead: away from the wall, where it stands.
    assert turn(f=0.25, c=0.1, d=0.1) < -0.3


def test_a_random_walk_gets_about() -> None:
    coverage, contacts = explored("env1", RandomPolicy(ROBOT, CONFIG, 3), 200.0)
    assert coverage > 0.4
    assert contacts <= 1


def test_a_random_walk_is_its_seeds() -> None:
    belief = belief_of(place(4, 4), CLOSED, BLOCKED)

    def walk(seed: int | np.random.Generator) -> FloatArray:
        policy = RandomPolicy(ROBOT, CONFIG, seed)
        return np.array([policy.act(belief) for _ in range(50)])

    np.testing.assert_array_equal(walk(1), walk(np.random.default_rng(1)))
    assert any((walk(1) != walk(seed)).any() for seed in (2, 3, 4))
