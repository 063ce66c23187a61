"""What a policy of one's own gives is checked once, with one line that names the policy."""

import numpy as np
import pytest

from limslam_agent import LimSlamAgent
from limslam_env import RobotSpec

ROBOT = RobotSpec()
SEEN = {"ranges": ROBOT.max_ranges.astype(np.float32), "wheels": np.zeros(2, dtype=np.float32)}


class Mine:
    """A policy that gives what it is told to give."""

    def __init__(self, action=(0.0, 0.0), plan=(), stop_reason=None):
        self.action, self.plan, self.stop_reason = action, plan, stop_reason

    def act(self, _belief):
        return self.action


def agent_of(policy):
    agent = LimSlamAgent(ROBOT, policy=policy)
    agent.reset(np.zeros(3))
    return agent


@pytest.mark.parametrize("plan", [(), np.zeros((0, 2)), np.zeros(0)])
def test_an_empty_plan_may_be_written_in_any_way(plan):
    agent = agent_of(Mine(plan=plan))
    agent.act(SEEN)
    assert agent.snapshot().plan.shape == (0, 2)


def test_a_plan_may_be_a_list_and_a_snapshot_keeps_a_copy():
    policy = Mine(plan=[[0.0, 1.0], [2.0, 3.0]])
    snapshot = agent_of(policy).snapshot()
    policy.plan[0][0] = 9.0
    assert snapshot.plan.tolist() == [[0.0, 1.0], [2.0, 3.0]]


@pytest.mark.parametrize("action", [None, (1.0,), (np.nan, 0.0), "ahead"])
def test_an_action_is_two_finite_numbers(action):
    with pytest.raises(ValueError, match=r"^Mine: act must return two finite numbers") as refusal:
        agent_of(Mine(action)).act(SEEN)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("plan", [None, np.zeros((2, 3)), [[np.nan, 0.0]]])
def test_a_plan_is_a_list_of_finite_points(plan):
    with pytest.raises(ValueError, match=r"^Mine: plan must be an array \(k, 2\)") as refusal:
        agent_of(Mine(plan=plan)).snapshot()
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("reason", [True, 0, b"enough"])
def test_a_stop_reason_is_a_text(reason):
    with pytest.raises(ValueError, match=r"^Mine: stop_reason must be None or a text"):
        agent_of(Mine(stop_reason=reason)).act(SEEN)
