"""Robots of a team: separate goals, detours around another robot, and who waits."""

import math

import numpy as np
import pytest
from support.beliefs import CELL, CLEAR, CONFIG, CORRIDOR, HALL, ROBOT, place

from limslam_agent import Belief, FrontierPolicy
from limslam_agent.grid.occupancy import GridView
from limslam_agent.policies.controller import PATIENCE
from limslam_env.geometry import FloatArray


def shared(pose: FloatArray, other_poses: list[list[float]], other_goals: list[list[float]]) -> Belief:
    others = np.array(other_poses).reshape(-1, 3), np.array(other_goals).reshape(-1, 2)
    return Belief(pose, np.zeros((3, 3)), CLEAR, np.zeros((0, 4)), HALL, *others)


def test_robots_choose_separate_goals() -> None:
    pose = place(4, 18)
    alone, together = FrontierPolicy(ROBOT, CONFIG), FrontierPolicy(ROBOT, CONFIG)
    alone.act(shared(pose, [], []))
    assert alone.goal is not None
    assert alone.goal[0] < 0.2
    # The other one goes there, so the way to the other end is worth its length.
    together.act(shared(pose, [[1.2, 0.45, math.pi]], [[0.05, 0.45]]))
    assert together.goal is not None
    assert together.goal[0] > 3.9


def test_another_robot_is_driven_round() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG, index=0)
    # All but the left end is known, and another robot stands in between.
    closed = GridView(HALL.low, CELL, np.column_stack((HALL.values, np.full((9, 1), -4, dtype=np.int16))))
    other = np.array([[*place(4, 10)[:2], 0.0]])
    policy.act(Belief(place(4, 20, math.pi), np.zeros((3, 3)), CLEAR, np.zeros((0, 4)), closed, other))
    assert policy.goal is not None
    assert policy.goal[0] < 0.2
    assert np.hypot(*(policy.plan - other[0, :2]).T).min() >= 2.0 * ROBOT.radius


@pytest.mark.parametrize(("index", "waits"), [(0, False), (1, True)])
def test_of_two_that_meet_the_second_waits_but_not_for_ever(index: int, waits: bool) -> None:
    policy = FrontierPolicy(ROBOT, CONFIG, index)
    other = np.array([[*place(3, 15)[:2], math.pi]])
    belief = Belief(place(3, 11), np.zeros((3, 3)), CLEAR, np.zeros((0, 4)), CORRIDOR, other)
    moves = [abs(policy.act(belief)).max() > 0.01 for _ in range(PATIENCE + 2)]
    assert moves[0] != waits
    assert moves[PATIENCE - 1] != waits
    assert moves[-1]
