"""LimSlamAgent: SLAM and a policy for one robot, from observation to action."""

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.policies.policies import Policy
from limslam_agent.slam.slam import LineSlam
from limslam_agent.team import LimSlamTeam, Snapshot
from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation, RobotSpec


class LimSlamAgent:
    """A robot's mind: it maps what its few beams see and explores until nothing is left.

    Parameters
    ----------
    robot
        Body and beams.
    config
        Settings of every stage.
    policy
        What decides where to go; the nearest frontier if left out. It is used for one run.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig | None = None, policy: Policy | None = None) -> None:
        self._team = LimSlamTeam(robot, config, 1, None if policy is None else [policy])
        self.robot, self.config = robot, self._team.config

    def reset(self, start_pose: FloatArray, seed: int | None = None) -> None:
        """Forget everything and begin at a known pose (3,), m, m, rad.

        ``seed`` is for agents that draw numbers; this one draws none.
        """
        self._team.reset(np.asarray(start_pose, dtype=float)[None], seed)

    def act(self, observation: Observation) -> FloatArray:
        """Wheel speeds (2,), fractions of the maximum, in answer to an observation."""
        self.observe(observation)
        return self.decide()

    def observe(self, observation: Observation) -> None:
        """The mapping half of :meth:`act`: where the robot is, and where the walls are."""
        self._team.observe([observation])

    def decide(self) -> FloatArray:
        """The exploring half of :meth:`act`: wheel speeds (2,) from what is believed now."""
        return self._team.decide()[0]

    def finish(self) -> None:
        """Use what is still waiting in the scan buffers: the run is over."""
        self._team.finish()

    @property
    def slam(self) -> LineSlam:
        """The mapping half."""
        return self._team.slam

    @property
    def policy(self) -> Policy:
        """The exploring half."""
        return self._team.policies[0]

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        return self._team.done

    @property
    def stop_reason(self) -> str | None:
        """Why there is nothing left to do, in words; None while there is."""
        return self._team.stop_reason

    def snapshot(self) -> Snapshot:
        """What the agent believes now; it stays as it is while the agent goes on."""
        return self._team.snapshot()
