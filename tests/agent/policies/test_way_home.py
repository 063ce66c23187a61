"""The way back to the start: after the exploration, and when somebody asks for it."""

from dataclasses import replace

import numpy as np
import pytest

from limslam_agent import Belief, LimSlamAgent, WallFollower, preset
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.grid.occupancy import GridView
from limslam_agent.policies.way_home import WayHome
from limslam_agent.status.status import Status
from limslam_env import NoiseConfig, NominalNoise, RobotSpec, load_world
from limslam_env.geometry import no_rows
from limslam_env.simulation.simulation import Simulation

ROBOT = RobotSpec()


class Stands:
    """A policy that stands still, and stops after some steps."""

    plan = np.zeros((0, 2))

    def __init__(self, steps):
        self._left, self.stop_reason = steps, None

    def act(self, belief):
        del belief
        self._left -= 1
        self.stop_reason = "everything seen" if self._left <= 0 else None
        return np.zeros(2)


class Turns:
    """A policy that turns for ever."""

    plan, wheels, stop_reason = np.array([[9.0, 9.0]]), np.array([-0.1, 0.1]), None

    def act(self, belief):
        del belief
        return self.wheels


def belief_at(x, y, values=None):
    values = np.full((40, 40), 5, dtype=np.int16) if values is None else values
    grid = GridView(np.array([-2.0, -2.0]), 0.1, values)
    return Belief(np.array([x, y, 0.0]), 1e-6 * np.eye(3), np.full(6, 1.5), no_rows(4), grid)


@pytest.mark.parametrize("always", [True, False])
def test_the_robot_drives_home_when_everything_was_seen_if_it_is_to(always):
    policy = WayHome(Stands(3), ROBOT, PolicyConfig(), always=always)
    for _ in range(3):
        policy.act(belief_at(1.0, 0.5))
    assert (policy.stop_reason, policy.is_going_home) == (None if always else "everything seen", always)
    if always:
        assert np.abs(policy.act(belief_at(1.0, 0.5))).max() > 0.1
        np.testing.assert_array_equal(policy.plan[-1], 0.0)
        policy.act(belief_at(0.02, 0.03))
        assert policy.stop_reason == "everything seen; the robot is back at its start"
    np.testing.assert_array_equal(policy.act(belief_at(1.0, 0.5)), 0.0)


def test_a_robot_that_is_walled_off_says_that_there_is_no_way():
    values = np.full((40, 40), 5, dtype=np.int16)
    values[:, 25] = -5
    policy = WayHome(Stands(100), ROBOT, PolicyConfig())
    policy.go_home()
    policy.act(belief_at(1.5, 0.0, values))
    assert policy.stop_reason == "asked to drive home; the map shows no way back to the start"


def test_while_the_robot_is_lost_its_policy_drives_and_the_way_is_planned_anew_after_that():
    inner = Turns()
    policy = WayHome(inner, ROBOT, PolicyConfig(), home=np.array([1.5, 0.0]))
    policy.go_home()
    for _ in range(50):
        policy.act(belief_at(-1.0, 0.0))
    lost = replace(belief_at(1.5, 0.0), frame=1, status=Status("lost", "carried away"))
    for _ in range(3):
        np.testing.assert_array_equal(policy.act(lost), inner.wheels)
    assert policy.stop_reason is None  # the start of another frame is nothing to arrive at
    np.testing.assert_array_equal(policy.plan, inner.plan)
    policy.act(replace(belief_at(0.0, 1.0), frame=2))
    np.testing.assert_allclose(policy.plan[[0, -1]], [[0.0, 1.0], [1.5, 0.0]], atol=0.1)
    policy.act(replace(belief_at(1.5, 0.0), frame=2))
    assert policy.stop_reason == "asked to drive home; the robot is back at its start"


def test_a_robot_in_a_world_comes_back_to_its_start():
    simulation = Simulation(load_world("env1"), ROBOT)
    readings, truth = simulation.reset(np.random.SeedSequence(3), NoiseConfig(sensor_noise=0.02))
    config = preset("consistent", NominalNoise(0.02))
    policy = WayHome(WallFollower(ROBOT, config.policy), ROBOT, config.policy)
    agent, start = LimSlamAgent(ROBOT, config, policy), truth.poses[0].copy()
    farthest = 0.0
    for step in range(900):
        left, right = agent.act({"ranges": readings.ranges[0], "wheels": readings.wheels[0]})
        readings, truth = simulation.step([(left, right)])
        away = float(np.hypot(*(truth.poses[0] - start)[:2]))
        farthest = max(farthest, away)
        if step == 300:
            policy.go_home()
        if agent.done:
            break
    assert agent.stop_reason == "asked to drive home; the robot is back at its start"
    assert farthest > 1.0
    assert away < 0.2
