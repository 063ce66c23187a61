"""Planners that only choose targets drive a robot, and always come to an end."""

from pathlib import Path

import numpy as np
import pytest
from support.beliefs import CLEAR, CLOSED, HALL, ROBOT, belief_of, drive, explored, place

from limslam_agent import TargetPolicy
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.runs.policy_file import file_policies
from limslam_env import RobotSpec, World

EXAMPLE = Path(__file__).parents[3] / "examples" / "nearest_node.py"


class Fixed:
    """Chooses given targets one after the other, and then the last one for ever."""

    def __init__(self, *targets):
        self.targets = list(targets)

    def target(self, _grid, _pose):
        return self.targets.pop(0) if len(self.targets) > 1 else self.targets[0]


def driven(policy, grid, most=2000):
    """The places (n, 2) that a robot passes until the policy stops."""
    pose = place(4, 2)
    places = [pose[:2]]
    while policy.stop_reason is None and len(places) < most:
        pose = drive(pose, policy.act(belief_of(pose, grid)))
        places.append(pose[:2])
    return np.array(places)


def test_the_robot_drives_to_each_target_and_ends_when_there_is_none():
    goals = [np.array([3.05, 0.45]), np.array([0.55, 0.25])]
    policy = TargetPolicy(Fixed(*goals, None), ROBOT)
    places = driven(policy, HALL)
    assert policy.stop_reason == "the planner has no target left"
    for goal in goals:
        assert np.hypot(*(places - goal).T).min() < 0.1
    assert policy.goal is None


def test_a_planner_that_chooses_the_same_target_for_ever_comes_to_its_end():
    policy = TargetPolicy(Fixed(np.array([2.05, 0.45])), ROBOT)
    places = driven(policy, HALL)
    assert np.hypot(*(places[-1] - [2.05, 0.45])) < 0.1
    assert policy.stop_reason == (
        "the planner has chosen (2.05, 0.45) again, where nothing new was seen: not explored"
    )


def test_the_cell_beside_a_target_is_another_target():
    policy = TargetPolicy(Fixed(np.array([1.95, 0.45]), np.array([2.05, 0.45]), None), ROBOT)
    driven(policy, HALL)
    assert policy.stop_reason == "the planner has no target left"


def test_a_planner_that_changes_its_mind_for_ever_comes_to_its_end():
    ends = [np.array([3.85, 0.45]), np.array([0.25, 0.45])]
    policy = TargetPolicy(Fixed(*ends * 50), ROBOT)
    assert len(driven(policy, HALL)) < 1000
    assert policy.stop_reason.endswith("not explored")


def test_a_target_without_a_way_is_not_driven_to():
    policy = TargetPolicy(Fixed(np.array([5.0, 5.0]), None), ROBOT)
    assert len(driven(policy, CLOSED)) < 5
    assert policy.stop_reason == "the planner has no target left"


@pytest.mark.parametrize("answer", ["left", [1.0], [np.nan, 0.0], 3.0])
def test_an_answer_that_is_no_target_is_refused_in_one_line(answer):
    policy = TargetPolicy(Fixed(answer), ROBOT)
    with pytest.raises(ValueError, match=r"^Fixed: target must return two finite numbers, x and y"):
        policy.act(belief_of(place(4, 2), HALL, CLEAR))


@pytest.mark.skipif(not EXAMPLE.is_file(), reason="the examples do not travel with the tests")
def test_the_example_in_a_file_explores_a_room():
    walls = [[0, 0, 3, 0], [3, 0, 3, 2], [3, 2, 0, 2], [0, 2, 0, 0], [1.5, 0, 1.5, 1.2]]
    room = World("room", (3.0, 2.0), np.array(walls), starts=np.array([[0.6, 0.6, 0.0]]))
    (policy,) = file_policies(
        f"{EXAMPLE}:NearestNode", RobotSpec.lidar(72), PolicyConfig(), robots=1, seed=0
    )
    assert isinstance(policy, TargetPolicy)
    coverage, contacts = explored(room, policy, 90.0, 5)
    assert coverage > 0.8
    assert contacts == 0
    assert policy.stop_reason is not None


def test_a_planner_without_a_pose_is_refused():
    class Blind:
        def target(self, grid):
            return grid

    with pytest.raises(
        ValueError, match=r"^Blind makes no policy: a planner has target\(grid, pose\)"
    ):
        TargetPolicy(Blind())
