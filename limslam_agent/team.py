"""LimSlamTeam: one mind for several robots, from their observations to their actions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from limslam_agent.config.presets import AgentConfig, preset
from limslam_agent.grid.occupancy import GridView, OccupancyGrid
from limslam_agent.policies.belief import Belief, Policy
from limslam_agent.policies.policies import FrontierPolicy
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.slam import LineSlam
from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation, RobotSpec


@dataclass(frozen=True, eq=False)
class Snapshot:
    """What a mind believes at a moment; read-only.

    Attributes
    ----------
    poses, covariances
        Of each robot (n, 3), m, m, rad, and (n, 3, 3).
    landmarks
        The walls with their covariances.
    segments
        The walls (N, 4), m.
    grid
        Occupancy.
    plans
        The way that each robot means to go (k, 2), m.
    """

    poses: FloatArray
    covariances: FloatArray
    landmarks: list[Landmark]
    segments: FloatArray
    grid: GridView
    plans: list[FloatArray]

    @property
    def pose(self) -> FloatArray:
        """The pose of the first robot (3,)."""
        return np.asarray(self.poses[0])

    @property
    def covariance(self) -> FloatArray:
        """The covariance of the first robot's pose (3, 3)."""
        return np.asarray(self.covariances[0])

    @property
    def plan(self) -> FloatArray:
        """The first robot's plan (k, 2), m."""
        return self.plans[0]


class LimSlamTeam:
    """One map and one filter for all robots, and a policy for each (step 9 of the method).

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage.
    num_robots
        How many there are.
    policies
        What decides where each goes; frontiers, shared out, if left out. They are used for one run.

    Raises
    ------
    ValueError
        If there is not one policy for each robot.
    """

    def __init__(
        self,
        robot: RobotSpec,
        config: AgentConfig | None = None,
        num_robots: int = 2,
        policies: Sequence[Policy] | None = None,
    ) -> None:
        if num_robots < 1:
            raise ValueError(f"a team has one robot or more, not {num_robots}")
        if policies is not None and len(policies) != num_robots:
            raise ValueError(f"{len(policies)} policies for {num_robots} robots")
        self.robot, self.config, self.num_robots = robot, config or preset("consistent"), num_robots
        self.names = [f"robot_{number}" for number in range(num_robots)]
        self._given_policies = policies
        self.reset(np.zeros((num_robots, 3)))

    def reset(self, start_poses: FloatArray, seed: int | None = None) -> None:
        """Forget everything and begin at known poses (n, 3), m, m, rad.

        ``seed`` is for minds that draw numbers; this one draws none.

        Raises
        ------
        ValueError
            If there is not one pose for each robot.
        """
        del seed
        poses = np.asarray(start_poses, dtype=float)
        if poses.shape != (self.num_robots, 3):
            raise ValueError(f"{self.num_robots} robots need start poses ({self.num_robots}, 3), not {poses.shape}")
        self.slam = LineSlam(self.robot, self.config, poses)
        self._grid = OccupancyGrid(self.config.grid)
        self.policies: list[Policy] = list(
            self._given_policies or [self._new_policy(number) for number in range(self.num_robots)]
        )
        # How many cells were known when each robot stopped.
        self._known_at_stop: dict[int, int] = {}

    def act(self, observations: Mapping[str, Observation]) -> dict[str, FloatArray]:
        """Wheel speeds (2,) of each robot by its name, fractions of the maximum, in answer to their observations."""
        self.observe([observations[name] for name in self.names])
        return dict(zip(self.names, self.decide(), strict=True))

    def observe(self, observations: Sequence[Observation]) -> None:
        """The mapping half of :meth:`act`: where the robots are, and where the walls are."""
        self.slam.step(*observations)

    def decide(self) -> list[FloatArray]:
        """The exploring half of :meth:`act`: wheel speeds (2,) of each robot from what is believed now."""
        slam = self.slam
        poses, covariances, segments = slam.poses, slam.covariances, slam.segments
        for pose, front in zip(poses, slam.robots, strict=True):
            self._grid.update(pose, self.robot, front.ranges, front.measured)
        view, actions = self._grid.view, []
        self._call_up_who_stopped(view)
        for number, policy in enumerate(self.policies):
            belief = Belief(
                poses[number], covariances[number], slam.robots[number].ranges, segments, view,
                np.delete(poses, number, axis=0), self._goals_besides(number),
            )  # fmt: skip
            actions.append(policy.act(belief))
        return actions

    def finish(self) -> None:
        """Use what is still waiting in the scan buffers: the run is over."""
        self.slam.finish()

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do for anybody."""
        return all(policy.stop_reason is not None for policy in self.policies)

    @property
    def stop_reason(self) -> str | None:
        """Why there is nothing left to do, in words; None while there is."""
        reasons = [policy.stop_reason for policy in self.policies if policy.stop_reason is not None]
        if len(reasons) < self.num_robots:
            return None
        return reasons[0] if len(set(reasons)) == 1 else "; ".join(reasons)

    def snapshot(self) -> Snapshot:
        """What is believed now; it stays as it is while the team goes on."""
        slam, view = self.slam, self._grid.view
        values = view.values.copy()
        values.setflags(write=False)
        grid = GridView(view.low, view.cell, values)
        plans = [policy.plan.copy() for policy in self.policies]
        return Snapshot(slam.poses, slam.covariances, slam.landmarks, slam.segments, grid, plans)

    def _new_policy(self, number: int) -> Policy:
        return FrontierPolicy(self.robot, self.config.policy, number)

    def _call_up_who_stopped(self, view: GridView) -> None:
        """Who saw nothing left to do looks again when the others have found enough that is new."""
        if self._given_policies is not None or self.num_robots == 1 or self.done:
            return
        known = int(np.count_nonzero(view.values))
        for number, policy in enumerate(self.policies):
            if policy.stop_reason is None:
                self._known_at_stop.pop(number, None)
            elif known - self._known_at_stop.setdefault(number, known) > self.config.team.news:
                self.policies[number] = self._new_policy(number)
                self._known_at_stop[number] = known

    def _goals_besides(self, number: int) -> FloatArray:
        goals = [getattr(policy, "goal", None) for other, policy in enumerate(self.policies) if other != number]
        return np.array([goal for goal in goals if goal is not None]).reshape(-1, 2)
