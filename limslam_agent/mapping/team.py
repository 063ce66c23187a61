"""LimSlamTeam: one shared map and a policy for each of several robots. LimSlamAgent: the same for
one robot.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.occupancy import GridView
from limslam_agent.mapping.joining import JoiningMapper
from limslam_agent.mapping.mapper import Mapper, MapSnapshot
from limslam_agent.places.saved_map import SavedMap
from limslam_agent.policies.policy import MapExplorer, Policy, checked_action, checked_plan
from limslam_agent.policies.wall_policy import explorer
from limslam_agent.slam.slam import Estimator
from limslam_agent.status.status import Level, Status, worst
from limslam_env.geometry import FloatArray
from limslam_env.geometry.numbers import check_count, floats
from limslam_env.interface import Observation, RobotSpec

MOST_ROBOTS = 64
"""Most robots of a team."""

# cells that teammates discover, after which a robot that had finished looks for frontiers again
_NEWS = 50


@dataclass(frozen=True, eq=False)
class Snapshot(MapSnapshot):
    """Everything that a team believes at one moment. Later steps do not change a snapshot.

    Attributes
    ----------
    plans
        The path (k, 2), m, that each robot intends to drive.
    statuses
        Whether the estimate of each robot can be trusted.
    """

    plans: list[FloatArray]
    statuses: list[Status]

    @property
    def status(self) -> Level:
        """The worst status of all robots: ``"ok"``, ``"unsure"`` or ``"lost"``."""
        return worst(self.statuses).level

    @property
    def status_reason(self) -> str:
        """Why the status is not ``"ok"``, in words. Empty if it is."""
        return worst(self.statuses).reason

    @property
    def plan(self) -> FloatArray:
        """The path (k, 2), m, that the first robot intends to drive."""
        return self.plans[0]


class _Explorers:
    """A mapper for one robot or several, and a policy for each of them."""

    def __init__(
        self, mapper: Mapper, policies: Sequence[Policy] | None, starts: FloatArray
    ) -> None:
        self.mapper = mapper
        self.robot = mapper.robot
        self.config = mapper.config
        self.num_robots = len(starts)
        self._given_policies = policies
        self._begin(starts)

    def _begin(self, starts: FloatArray) -> None:
        """Forget everything and start again at known poses (n, 3)."""
        self.mapper.reset(starts)
        self.policies: list[Policy] = list(
            self._given_policies
            or [explorer(self.robot, self.config) for _ in range(self.num_robots)]
        )
        # Number of known cells at the time when each robot stopped.
        self._known_at_stop: dict[int, int] = {}
        self._frame = self.mapper.frame
        self._map_number = self.mapper.map_number
        self._left: dict[int, list[Policy]] = {}

    def finish(self) -> None:
        """Use the readings that are still buffered. Call this after the last step."""
        self.mapper.finish()

    @property
    def slam(self) -> Estimator:
        """The SLAM of the mapper."""
        return self.mapper.slam

    @property
    def done(self) -> bool:
        """Whether the policies of all robots have stopped."""
        return self.stop_reason is not None

    @property
    def stop_reason(self) -> str | None:
        """Why all robots have stopped, in words. None while a robot is still active."""
        reasons = [policy.stop_reason for policy in self.policies if policy.stop_reason is not None]
        if len(reasons) < self.num_robots:
            return None
        return reasons[0] if len(set(reasons)) == 1 else "; ".join(reasons)

    @property
    def status(self) -> Level:
        """Whether the estimate can be trusted, the worst of all robots: ``"ok"``, ``"unsure"`` or
        ``"lost"``.
        """
        return worst(self.mapper.statuses).level

    @property
    def status_reason(self) -> str:
        """Why the status is not ``"ok"``, in words. Empty if it is."""
        return worst(self.mapper.statuses).reason

    def snapshot(self) -> Snapshot:
        """Everything that is believed now. Later steps do not change the snapshot.

        Raises
        ------
        ValueError
            If the plan of a policy is not an array (k, 2) of finite points.
        """
        plans = [checked_plan(policy) for policy in self.policies]
        return Snapshot(**vars(self.mapper.snapshot()), plans=plans, statuses=self.mapper.statuses)

    def _actions(self) -> list[FloatArray]:
        """Wheel speeds (2,) of each robot."""
        beliefs = self.mapper.beliefs
        self._renew_in_another_frame()
        if not self.mapper.is_apart:
            self._restart_stopped(beliefs[0].grid)
        # The robots decide in order, so that each one knows the new goals of those before it.
        return [
            checked_action(policy, self._with_plans_of_others(beliefs[number], number))
            for number, policy in enumerate(self.policies)
        ]

    def _policy_in_new_frame(self, number: int) -> Policy:
        """What a robot does in another frame: a lost robot hurries to see as much as possible."""
        config = self.config
        if self.mapper.statuses[number].level == "lost":
            fast = replace(config.policy, speed=self.robot.max_wheel_speed)
            config = replace(config, policy=fast)
        return explorer(self.robot, config)

    def _renew_in_another_frame(self) -> None:
        """Plan anew where the frame of the map has changed. Policies that were given keep their
        plans.

        In a map that was there before, the policies still know what was settled there. Otherwise a
        robot whose map is moved now and then would look at the same places again and again, and
        never end. Robots whose starts are unknown begin in another map when they are joined.
        """
        if self._frame != self.mapper.frame and self._given_policies is None:
            if not isinstance(self.mapper, JoiningMapper):
                self._left[self._map_number] = self.policies
            self._map_number = self.mapper.map_number
            kept = self._left.pop(self._map_number, None)
            self.policies = kept or [
                self._policy_in_new_frame(number) for number in range(self.num_robots)
            ]
        self._frame = self.mapper.frame

    def _restart_stopped(self, grid: GridView) -> None:
        """Let a robot that has stopped explore again, once the other robots have mapped enough new
        cells.
        """
        if self._given_policies is not None or self.num_robots == 1 or self.done:
            return
        known = int(np.count_nonzero(grid.values))
        for number, policy in enumerate(self.policies):
            if policy.stop_reason is None:
                self._known_at_stop.pop(number, None)
            elif (
                isinstance(policy, MapExplorer)
                and known - self._known_at_stop.setdefault(number, known) > _NEWS
            ):
                policy.restart()
                self._known_at_stop[number] = known

    def _with_plans_of_others(self, belief: Belief, number: int) -> Belief:
        if self.num_robots == 1 or self.mapper.is_apart:
            return belief
        others = [policy for other, policy in enumerate(self.policies) if other != number]
        goals = [getattr(policy, "goal", None) for policy in others]
        return replace(
            belief,
            other_goals=np.array([goal for goal in goals if goal is not None]).reshape(-1, 2),
            other_looks=[faces for policy in others for faces in getattr(policy, "looks", ())],
        )


class LimSlamTeam(_Explorers):
    """One mapper for all robots of a team, and a policy for each robot (step 9 of the method).

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage. The preset ``graph`` by default.
    num_robots
        Number of robots.
    policies
        One policy for each robot. By default each robot explores frontiers, and the robots divide
        the frontiers among themselves. Policies that are given serve for one run.
    prior_map
        The map of an earlier run, in which one robot is at an unknown place (:class:`Mapper`).
    unknown_starts
        Whether the second of two robots starts at an unknown place. Its start pose is then one in a
        frame of its own.

    Attributes
    ----------
    mapper
        The mapping half: SLAM, occupancy grid and odometry.
    policies
        The policy of each robot.
    names
        The names of the robots: ``robot_0``, ``robot_1`` and so on.

    Raises
    ------
    ValueError
        If there is no robot, or not one policy for each robot.

    Examples
    --------
    >>> import numpy as np
    >>> import limslam_env
    >>> from limslam_agent import LimSlamTeam
    >>> env = limslam_env.parallel_env(world="env1", num_robots=2, sensor_noise=0.02)
    >>> observations, infos = env.reset(seed=0)
    >>> team = LimSlamTeam(env.robot, num_robots=2)
    >>> team.reset(np.array([infos[name]["pose"] for name in team.names]), seed=0)
    >>> sorted(team.act(observations))
    ['robot_0', 'robot_1']
    """

    def __init__(
        self,
        robot: RobotSpec,
        config: AgentConfig | None = None,
        num_robots: int = 2,
        policies: Sequence[Policy] | None = None,
        *,
        prior_map: SavedMap | None = None,
        unknown_starts: bool = False,
    ) -> None:
        check_count("the number of robots in a team", num_robots, MOST_ROBOTS)
        if policies is not None and len(policies) != num_robots:
            raise ValueError(f"{len(policies)} policies for {num_robots} robots")
        if unknown_starts and (num_robots != 2 or prior_map is not None):
            raise ValueError("unknown starts are for two robots without the map of an earlier run")
        starts = np.zeros((num_robots, 3))
        mapper = (
            JoiningMapper(robot, config)
            if unknown_starts
            else Mapper(robot, config, starts, prior_map=prior_map)
        )
        self.names = [f"robot_{number}" for number in range(num_robots)]
        super().__init__(mapper, policies, starts)

    def reset(self, start_poses: FloatArray, seed: int | None = None) -> None:
        """Forget everything and start again at known poses (n, 3): x (m), y (m), heading (rad).

        ``seed`` is for teams that draw random numbers. This class draws none.

        Raises
        ------
        ValueError
            If there is not one pose for each robot, or a pose is not finite.
        """
        del seed
        poses = floats(start_poses)
        if poses.shape != (self.num_robots, 3):
            raise ValueError(
                f"{self.num_robots} robots need start poses ({self.num_robots}, 3), not "
                f"{poses.shape}"
            )
        self._begin(poses)

    def act(self, observations: Mapping[str, Observation]) -> dict[str, FloatArray]:
        """Wheel speeds (2,) of each robot by its name, as fractions of the maximum, for one
        observation of each.
        """
        self.observe([observations[name] for name in self.names])
        return dict(zip(self.names, self.decide(), strict=True))

    def observe(self, observations: Sequence[Observation]) -> None:
        """The mapping half of :meth:`act`: update poses, walls and grid from one observation of
        each robot.
        """
        self.mapper.step(*observations)

    def decide(self) -> list[FloatArray]:
        """The exploring half of :meth:`act`: wheel speeds (2,) of each robot. The map stays as it
        is.

        Raises
        ------
        ValueError
            If a policy does not answer with two finite numbers.
        """
        return self._actions()


class LimSlamAgent(_Explorers):
    """Maps with a few range beams and explores until nothing is left to explore.

    Parameters
    ----------
    robot
        Body and beams.
    config
        Settings of every stage. The preset ``graph`` by default.
    policy
        Chooses the actions. By default the agent explores the nearest frontier. A policy that is
        given serves for one run.
    prior_map
        The map of an earlier run, in which the robot is at an unknown place (:class:`Mapper`).

    Examples
    --------
    >>> import gymnasium as gym
    >>> import limslam_env
    >>> from limslam_agent import LimSlamAgent, preset
    >>> env = gym.make("LimSlam-Env1-v0", sensor_noise=0.02).unwrapped
    >>> observation, info = env.reset(seed=0)
    >>> agent = LimSlamAgent(env.robot, preset("graph", env.nominal_noise))
    >>> agent.reset(info["pose"], seed=0)
    >>> for _ in range(20):
    ...     observation, *_ = env.step(agent.act(observation))
    >>> agent.done
    False
    """

    def __init__(
        self,
        robot: RobotSpec,
        config: AgentConfig | None = None,
        policy: Policy | None = None,
        *,
        prior_map: SavedMap | None = None,
    ) -> None:
        mapper = Mapper(robot, config, np.zeros((1, 3)), prior_map=prior_map)
        super().__init__(mapper, None if policy is None else [policy], np.zeros((1, 3)))

    def reset(self, start_pose: FloatArray, seed: int | None = None) -> None:
        """Forget everything and start again at a known pose (3,): x (m), y (m), heading (rad).

        ``seed`` is for agents that draw random numbers. This class draws none.

        Raises
        ------
        ValueError
            If the pose has another shape or is not finite.
        """
        del seed
        pose = floats(start_pose)
        if pose.shape != (3,):
            raise ValueError(f"a robot needs a start pose (3,), not {pose.shape}")
        self._begin(pose[None])

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
        self.mapper.step(observation)

    def decide(self) -> FloatArray:
        """The exploring half of :meth:`act`: wheel speeds (2,). The map stays as it is."""
        return self._actions()[0]

    @property
    def policy(self) -> Policy:
        """The exploring half."""
        return self.policies[0]
