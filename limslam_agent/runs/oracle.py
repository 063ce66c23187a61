"""The policies of a run by their names, and oracles that know the true map and the true pose.

An oracle is not part of the agent. It lets all estimators listen to the same drive, and it gives a limit that explorers
can be compared with.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.drawing import ReadingDrawer
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.policies.controller import TURN_RATE, bearing_of, wheel_speeds
from limslam_agent.policies.learned.learned import LearnedPolicy
from limslam_agent.policies.policy import NO_PLAN, Policy
from limslam_agent.policies.simple_policies import LAP_SPEED, Laps, RandomPolicy, WallFollower
from limslam_agent.policies.wall_policy import explorer
from limslam_agent.runs.policy_file import file_and_name, file_policies, is_file_policy
from limslam_env.bounds.tours import GOAL, Speeds, closed_tour, coverage_tour, top_speeds
from limslam_env.envs.parallel_env import LimSlamParallelEnv
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.worlds.world import World

POLICIES = ("frontier", "frontier_fast", "wall_follower", "random", "learned", "learned_true_pose", "tour", "oracle")

_PRIVILEGED = ("tour", "oracle", "learned_true_pose")
_ARRIVED = 0.003  # m, smaller than the distance between a tour and the walls
_MOST_TOURS = 4  # largest number of tours that the oracle plans, in case a drive misses cells of its plan

Planner = Callable[[FloatArray, BoolArray | None], FloatArray]
"""Plans waypoints (k, 2), m, from the true pose (3,) and the cells seen so far (None at the start). Empty if there are
none.
"""


class Oracle:
    """Drives a planned tour by the true pose. What is measured or believed plays no role.

    The robot turns on the spot towards each waypoint and then drives straight.

    Parameters
    ----------
    robot, speeds
        Body, and the speeds of driving and turning.
    planner
        Called for waypoints at the start and whenever all waypoints have been passed, at most ``tours`` times.
    tours
        Largest number of calls of the planner.
    goal
        Share of the coverable cells at which the drive is over. None drives the whole tour.
    """

    def __init__(
        self, robot: RobotSpec, speeds: Speeds, planner: Planner, tours: int = 1, goal: float | None = None
    ) -> None:
        self._robot, self._speeds, self._planner, self._tours, self._goal = robot, speeds, planner, tours, goal
        self._pose, self._planned = np.zeros(3), 0
        self.stop_reason: str | None = None
        self.plan: FloatArray = NO_PLAN

    def observe_truth(self, env: LimSlamParallelEnv, pose: FloatArray, coverage: float) -> None:
        """Take the truth of this step: the pose (3,), m and rad, and the coverage (0 to 1)."""
        self._pose = pose
        if self._goal is not None and coverage >= self._goal:
            self.stop_reason, self.plan = f"{self._goal:.0%} of what can be seen was seen", NO_PLAN
        self._pass_waypoints()
        while self.stop_reason is None and not len(self.plan):
            if self._planned < self._tours:
                self.plan = self._planner(pose, env.seen if self._planned else None)
                self._planned += 1
            if not len(self.plan):
                self.stop_reason = "the tour is driven"
            self._pass_waypoints()

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) towards the next waypoint. The belief is ignored."""
        del belief
        if self.stop_reason is not None:
            return np.zeros(2)
        period, (drive, turn) = self._robot.control_period, self._speeds
        error, distance = bearing_of(self._pose, self.plan[0]), self._distance()
        # An error that one step can correct is corrected while driving. A larger error is corrected on the spot.
        speed = min(drive, distance / period) if abs(error) <= turn * period else 0.0
        return wheel_speeds(speed, float(np.clip(error / period, -turn, turn)), self._robot)

    def _distance(self) -> float:
        return math.dist(self._pose[:2], self.plan[0])

    def _pass_waypoints(self) -> None:
        while len(self.plan) and self._distance() < _ARRIVED:
            self.plan = self.plan[1:]


class TruePoseExplorer:
    """The learned policy on a map that is drawn from the true pose: an upper limit of what better pose estimates could
    give.

    The readings keep their noise.

    Parameters
    ----------
    robot, config
        Body, and the settings of grid and policy.
    seed
        Seed of the random numbers.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig, seed: int = 0) -> None:
        self._grid, self._pose = OccupancyGrid(config.grid), np.zeros(3)
        self._drawer = ReadingDrawer(robot)
        self._explorer = LearnedPolicy(robot, config.policy, seed=seed)
        self.plan: FloatArray = NO_PLAN
        self.stop_reason: str | None = None

    def observe_truth(self, env: LimSlamParallelEnv, pose: FloatArray, coverage: float) -> None:
        """Take the true pose (3,), m and rad."""
        del env, coverage
        self._pose = np.array(pose)

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,). Of the belief, only the readings are used."""
        self._drawer.draw(self._grid, 0, self._pose, belief.ranges, np.ones(len(belief.ranges), dtype=bool))
        wheels = self._explorer.act(replace(belief, pose=self._pose, grid=self._grid.view))
        self.stop_reason = self._explorer.stop_reason
        return wheels


def check_policy(policy: str, laps: int, robots: int) -> None:
    """Check that the policy exists and can do what the other settings ask for.

    Raises
    ------
    ValueError
        If it does not exist or cannot.
    """
    if is_file_policy(policy):
        file_and_name(policy)
    elif policy not in POLICIES:
        raise ValueError(f"no policy is called {policy!r}; there are {', '.join(POLICIES)}, or a file: FILE.py:CLASS")
    if laps and policy not in {"frontier", "tour"}:
        raise ValueError(f"laps go with the policies frontier and tour, not with {policy!r}")
    if robots > 1 and (laps or policy in _PRIVILEGED):
        what = "laps are" if laps else f"the policy {policy!r} is"
        raise ValueError(f"{what} for one robot: several would meet on the loop")


def is_privileged(policy: str) -> bool:
    """Whether a policy knows the true pose or the true map."""
    return policy in _PRIVILEGED


def explores(policy: str, laps: int) -> bool:
    """Whether the end of such a run is the end of an exploration."""
    return not laps and policy != "tour"


def policies_for(
    policy: str, robot: RobotSpec, config: AgentConfig, world: World, *, robots: int, laps: int, seed: int
) -> list[Policy] | None:
    """A policy for each robot. None for the frontier policies, which a team makes itself."""
    if policy == "frontier":
        return [Laps(robot, world.loop, laps)] if laps else None
    if policy in _PRIVILEGED:
        return [_privileged_policy(policy, robot, config, world, laps=laps, seed=seed)]
    return policies_by_belief(policy, robot, config, robots=robots, seed=seed)


def check_belief_policy(policy: str) -> None:
    """Check that the policy exists and acts on the belief alone, before there is a robot to make it for.

    Raises
    ------
    ValueError
        If it does not exist or knows the truth.
    """
    check_policy(policy, laps=0, robots=1)
    if policy in _PRIVILEGED:
        raise ValueError(f"the policy {policy!r} knows the truth: use limslam run --policy {policy}")


def policies_by_belief(
    policy: str, robot: RobotSpec, config: AgentConfig, *, robots: int, seed: int
) -> list[Policy] | None:
    """A policy for each robot that acts on the belief alone. None for ``frontier``, whose policies a team makes itself.

    Raises
    ------
    ValueError
        If no policy has this name, or the policy knows the truth.
    """
    check_belief_policy(policy)
    if is_file_policy(policy):
        return file_policies(policy, robot, config.policy, robots=robots, seed=seed)
    if policy == "frontier":
        return None
    return [_policy_for(policy, robot, config, number, seed) for number in range(robots)]


def _policy_for(policy: str, robot: RobotSpec, config: AgentConfig, number: int, seed: int) -> Policy:
    """A policy that acts on the belief."""
    if policy == "frontier_fast":
        fast = replace(config.policy, speed=robot.max_wheel_speed)
        return explorer(robot, replace(config, policy=fast))
    if policy == "wall_follower":
        return WallFollower(robot, config.policy)
    generator = np.random.default_rng([seed, number])
    if policy == "learned":
        return LearnedPolicy(robot, config.policy, seed=generator)
    return RandomPolicy(robot, config.policy, seed=generator)


def _privileged_policy(
    policy: str, robot: RobotSpec, config: AgentConfig, world: World, *, laps: int, seed: int
) -> Policy:
    """A policy that knows the truth."""
    if policy == "learned_true_pose":
        return TruePoseExplorer(robot, config, seed)
    if policy == "oracle":
        return Oracle(
            robot, top_speeds(robot), lambda pose, seen: coverage_tour(world, robot, pose, seen=seen), _MOST_TOURS, GOAL
        )
    # The speeds do not depend on the preset, so that all estimators listen to the same drive.
    speeds = Speeds(LAP_SPEED, TURN_RATE)
    return Oracle(robot, speeds, lambda pose, _: closed_tour(world, robot, pose, laps or 1))
