"""LimSlamAgent: SLAM and a policy, from observation to action."""

from dataclasses import dataclass

import numpy as np

from limslam_agent.config import AgentConfig
from limslam_agent.line_map import Landmark
from limslam_agent.occupancy import GridView, OccupancyGrid
from limslam_agent.policies import Belief, FrontierPolicy, Policy
from limslam_agent.slam import LineSlam
from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation, RobotSpec


@dataclass(frozen=True, eq=False)
class Snapshot:
    """What the agent believes at a moment; read-only.

    Attributes
    ----------
    pose, covariance
        (3,) m, m, rad, and (3, 3).
    landmarks
        The walls with their covariances.
    segments
        The walls (N, 4), m.
    grid
        Occupancy.
    plan
        The way it means to go (k, 2), m.
    """

    pose: FloatArray
    covariance: FloatArray
    landmarks: list[Landmark]
    segments: FloatArray
    grid: GridView
    plan: FloatArray


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
        self.robot, self.config = robot, config or AgentConfig()
        self._given_policy = policy
        self.reset(np.zeros(3))

    def reset(self, start_pose: FloatArray, seed: int | None = None) -> None:
        """Forget everything and begin at a known pose (3,), m, m, rad.

        ``seed`` is for agents that draw numbers; this one draws none.
        """
        del seed
        self.slam = LineSlam(self.robot, self.config, np.asarray(start_pose, dtype=float))
        self._grid = OccupancyGrid(self.config.grid)
        self.policy: Policy = self._given_policy or FrontierPolicy(self.robot, self.config.policy)

    def act(self, observation: Observation) -> FloatArray:
        """Wheel speeds (2,), fractions of the maximum, in answer to an observation."""
        self.observe(observation)
        return self.decide()

    def observe(self, observation: Observation) -> None:
        """The mapping half of :meth:`act`: where the robot is, and where the walls are."""
        self.slam.step(observation)

    def decide(self) -> FloatArray:
        """The exploring half of :meth:`act`: wheel speeds (2,) from what is believed now."""
        slam = self.slam
        self._grid.update(slam.pose, self.robot, slam.ranges, slam.measured)
        belief = Belief(slam.pose, slam.covariance, slam.ranges, slam.segments, self._grid.view)
        return self.policy.act(belief)

    def finish(self) -> None:
        """Use what is still waiting in the scan buffers: the run is over."""
        self.slam.finish()

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        return self.policy.stop_reason is not None

    @property
    def stop_reason(self) -> str | None:
        """Why there is nothing left to do, in words; None while there is."""
        return self.policy.stop_reason

    def snapshot(self) -> Snapshot:
        """What the agent believes now; it stays as it is while the agent goes on."""
        slam, view = self.slam, self._grid.view
        values = view.values.copy()
        values.setflags(write=False)
        grid = GridView(view.low, view.cell, values)
        return Snapshot(slam.pose, slam.covariance, slam.landmarks, slam.segments, grid, self.policy.plan.copy())
