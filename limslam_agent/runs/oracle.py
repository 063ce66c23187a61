"""Who drives a run: the policies by their names, and a pilot that knows map and pose.

A pilot is no part of any agent: it may see what is true, so that all estimators can listen to one and the same drive,
and so that explorers can be measured by one that has nothing to find out.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.policies.policy import NO_PLAN, Policy
from limslam_agent.config.presets import AgentConfig, PolicyConfig
from limslam_agent.policies.controller import bearing_of, wheel_speeds
from limslam_agent.policies.learned.learned import WEIGHTS, LearnedPolicy
from limslam_agent.policies.learned.network import load_network
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.policies.frontier_policy import FrontierPolicy
from limslam_agent.policies.simple_policies import Laps, RandomPolicy, WallFollower
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.envs.parallel_env import LimSlamParallelEnv
from limslam_env.bounds.tours import GOAL, Speeds, closed_tour, coverage_tour, top_speeds
from limslam_env.worlds.world import World

POLICIES = ("frontier", "frontier_fast", "wall_follower", "random", "learned", "learned_true_pose", "tour", "oracle")

_PILOTED = ("tour", "oracle", "learned_true_pose")
_ARRIVED = 0.003  # m: less than a way's distance from the walls
_MOST_TOURS = 4  # that the oracle plans, should a drive not show what the plan had promised

Planner = Callable[[FloatArray, BoolArray | None], FloatArray]
"""From the true pose (3,) and, but at the start, the cells seen so far to waypoints (k, 2), m; none: nothing to do."""


class Pilot:
    """Drives a planned tour by the true pose, whatever is measured or believed.

    On the spot it turns towards each waypoint, then it drives there straight.

    Parameters
    ----------
    robot, speeds
        Body, and how fast it goes.
    planner
        Asked for waypoints at the start and whenever they have been passed, as often as ``tours``.
    tours
        How often it may be asked.
    goal
        Share of the coverable cells at which the drive is over; None drives the whole tour.
    """

    def __init__(
        self, robot: RobotSpec, speeds: Speeds, planner: Planner, tours: int = 1, goal: float | None = None
    ) -> None:
        self._robot, self._speeds, self._planner, self._tours, self._goal = robot, speeds, planner, tours, goal
        self._pose, self._planned = np.zeros(3), 0
        self.stop_reason: str | None = None
        self.plan: FloatArray = NO_PLAN

    def look(self, env: LimSlamParallelEnv, pose: FloatArray, coverage: float) -> None:
        """Take in the truth of this step: the pose (3,), m and rad, and the share covered."""
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
        """Wheel speeds (2,) towards the next waypoint; what is believed is not asked."""
        del belief
        if self.stop_reason is not None:
            return np.zeros(2)
        period, (drive, turn) = self._robot.control_period, self._speeds
        error, distance = bearing_of(self._pose, self.plan[0]), self._distance()
        # What one step can turn, it turns while driving; more than that, on the spot.
        speed = min(drive, distance / period) if abs(error) <= turn * period else 0.0
        return wheel_speeds(speed, float(np.clip(error / period, -turn, turn)), self._robot)

    def _distance(self) -> float:
        return math.dist(self._pose[:2], self.plan[0])

    def _pass_waypoints(self) -> None:
        while len(self.plan) and self._distance() < _ARRIVED:
            self.plan = self.plan[1:]


class TruePose:
    """The learned explorer on a map that is drawn by the true pose: what better estimating could give it at most.

    The readings have their noise. Weights are those that were learned on the true pose.

    Parameters
    ----------
    robot, config
        Body, and the settings of grid and policy.
    seed
        Of the numbers drawn.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig, seed: int = 0) -> None:
        self._robot, self._grid, self._pose = robot, OccupancyGrid(config.grid), np.zeros(3)
        self._explorer = LearnedPolicy(robot, config.policy, load_network(WEIGHTS / "true_pose.npz"), seed=seed)
        self.plan: FloatArray = NO_PLAN
        self.stop_reason: str | None = None

    def look(self, env: LimSlamParallelEnv, pose: FloatArray, coverage: float) -> None:
        """Take in the true pose (3,), m and rad."""
        del env, coverage
        self._pose = np.array(pose)

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,); of what is believed, only the readings are asked."""
        self._grid.update(self._pose, self._robot, belief.ranges, np.ones(len(belief.ranges), dtype=bool))
        wheels = self._explorer.act(replace(belief, pose=self._pose, grid=self._grid.view))
        self.stop_reason = self._explorer.stop_reason
        return wheels


def check_policy(policy: str, laps: int, robots: int) -> None:
    """Make sure that there is such a policy, and that it can do what is asked.

    Raises
    ------
    ValueError
        If not.
    """
    if policy not in POLICIES:
        raise ValueError(f"no policy is called {policy!r}; there are {', '.join(POLICIES)}")
    if laps and policy not in {"frontier", "tour"}:
        raise ValueError(f"laps are driven by the belief, or with the policy tour by the truth, not by {policy!r}")
    if robots > 1 and (laps or policy in _PILOTED):
        what = "laps are" if laps else f"the policy {policy!r} is"
        raise ValueError(f"{what} for one robot: several would meet on the loop")


def needs_loop(policy: str, laps: int) -> bool:
    """Whether it can only be driven in a world with a loop."""
    return laps > 0 and policy == "frontier"


def explores(policy: str, laps: int) -> bool:
    """Whether the end of such a run is the end of an exploration."""
    return not laps and policy != "tour"


def policies_for(
    policy: str, robot: RobotSpec, config: AgentConfig, world: World, *, robots: int, laps: int, seed: int
) -> list[Policy] | None:
    """A policy for each robot; None for the frontier explorers that a team makes itself."""
    if policy == "frontier":
        return [Laps(robot, config.policy, world.loop, laps)] if laps else None
    if policy in _PILOTED:
        return [_pilot_for(policy, robot, config, world, laps=laps, seed=seed)]
    return [_policy_for(policy, robot, config.policy, number, seed) for number in range(robots)]


def _policy_for(policy: str, robot: RobotSpec, config: PolicyConfig, number: int, seed: int) -> Policy:
    """A policy that acts on what is believed."""
    if policy == "frontier_fast":
        return FrontierPolicy(robot, replace(config, speed=robot.max_wheel_speed), number)
    if policy == "wall_follower":
        return WallFollower(robot, config)
    kind = LearnedPolicy if policy == "learned" else RandomPolicy
    return kind(robot, config, seed=np.random.default_rng([seed, number]))


def _pilot_for(policy: str, robot: RobotSpec, config: AgentConfig, world: World, *, laps: int, seed: int) -> Policy:
    """Whoever knows the truth."""
    if policy == "learned_true_pose":
        return TruePose(robot, config, seed)
    if policy == "oracle":
        return Pilot(robot, top_speeds(robot), _oracle(world, robot), _MOST_TOURS, GOAL)
    # The speeds of laps, and never those of a preset: all estimators are to listen to the same drive.
    speeds = Speeds(PolicyConfig().lap_speed, PolicyConfig().turn_rate)
    return Pilot(robot, speeds, lambda pose, _: closed_tour(world, robot, pose, laps or 1))


def _oracle(world: World, robot: RobotSpec) -> Planner:
    def plan(pose: FloatArray, seen: BoolArray | None) -> FloatArray:
        return coverage_tour(world, robot, pose, seen=seen)

    return plan
