"""LimSlamAgent: a mapper and a policy for one robot, from observation to action."""

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.mapping.team import LimSlamTeam, Snapshot
from limslam_agent.policies.policy import Policy
from limslam_agent.slam.slam import LineSlam
from limslam_agent.status.status import Level
from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation, RobotSpec


class LimSlamAgent:
    """Maps with a few range beams and explores until nothing is left to explore.

    Parameters
    ----------
    robot
        Body and beams.
    config
        Settings of every stage. The preset ``graph`` by default.
    policy
        Chooses the actions. By default the agent explores the nearest frontier. A policy that is given serves for one
        run.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig | None = None, policy: Policy | None = None) -> None:
        self._team = LimSlamTeam(robot, config, 1, None if policy is None else [policy])
        self.robot, self.config = robot, self._team.config

    def reset(self, start_pose: FloatArray, seed: int | None = None) -> None:
        """Forget everything and start again at a known pose (3,): x (m), y (m), heading (rad).

        ``seed`` is for agents that draw random numbers. This class draws none.

        Raises
        ------
        ValueError
            If the pose has another shape or is not finite.
        """
        self._team.reset(np.asarray(start_pose, dtype=float)[None], seed)

    def act(self, observation: Observation) -> FloatArray:
        """Wheel speeds (2,), left and right, as fractions of the maximum, for one observation.

        Raises
        ------
        ValueError
            If the observation has the wrong shape or reports no motion.
        """
        self.observe(observation)
        return self.decide()

    def observe(self, observation: Observation) -> None:
        """The mapping half of :meth:`act`: update pose, walls and grid from one observation."""
        self._team.observe([observation])

    def decide(self) -> FloatArray:
        """The exploring half of :meth:`act`: wheel speeds (2,). The map stays as it is."""
        return self._team.decide()[0]

    def finish(self) -> None:
        """Use the readings that are still buffered. Call this after the last step."""
        self._team.finish()

    @property
    def mapper(self) -> Mapper:
        """The mapping half: SLAM, occupancy grid and odometry."""
        return self._team.mapper

    @property
    def slam(self) -> LineSlam:
        """The SLAM of the mapper."""
        return self._team.slam

    @property
    def policy(self) -> Policy:
        """The exploring half."""
        return self._team.policies[0]

    @property
    def done(self) -> bool:
        """Whether the policy has stopped."""
        return self._team.done

    @property
    def stop_reason(self) -> str | None:
        """Why the policy has stopped, in words. None while the policy is active."""
        return self._team.stop_reason

    @property
    def status(self) -> Level:
        """Whether the estimate can be trusted: ``"ok"``, ``"unsure"`` or ``"lost"``."""
        return self._team.status

    @property
    def status_reason(self) -> str:
        """Why the status is not ``"ok"``, in words. Empty if it is."""
        return self._team.status_reason

    def snapshot(self) -> Snapshot:
        """Everything that the agent believes now. Later steps do not change the snapshot."""
        return self._team.snapshot()
