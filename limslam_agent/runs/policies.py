"""The policies of a run by their names, and a tour that is driven by the true pose.

The tour is not part of the agent: it lets all estimators listen to the same drive.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import AgentConfig
from limslam_agent.policies.controller import TURN_RATE, bearing_of, wheel_speeds
from limslam_agent.policies.learned.learned import LearnedPolicy
from limslam_agent.policies.policy import NO_PLAN, Policy
from limslam_agent.policies.simple_policies import LAP_SPEED, RandomPolicy, WallFollower
from limslam_agent.policies.wall_policy import explorer
from limslam_agent.runs.policy_file import file_and_name, file_policies, is_file_policy
from limslam_env.bounds import Speeds
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

TOUR = "tour"
KEYBOARD = "keyboard"
FROM_OUTSIDE = (TOUR, KEYBOARD)
"""Policies that act on what no agent knows."""

BELIEF_POLICIES = ("frontier", "frontier_fast", "wall_follower", "random", "learned")
"""Policies that act on the belief alone."""

TOUR_SPEEDS = Speeds(LAP_SPEED, TURN_RATE)
"""Speeds of a tour. They do not depend on the preset, so that all estimators listen to the same
drive.
"""

_ARRIVED = 0.003  # m, smaller than the distance between a tour and the walls


class Tour:
    """Drives past waypoints by the true pose. What is measured or believed plays no role.

    The robot turns on the spot towards each waypoint and then drives straight. ``planner`` plans
    waypoints (k, 2), m, from the true pose (3,): at the start, and whenever all have been passed,
    ``tours`` times at most.
    """

    def __init__(
        self, robot: RobotSpec, planner: Callable[[FloatArray], FloatArray], tours: int = 1
    ) -> None:
        self._robot = robot
        self._planner = planner
        self._tours = tours
        self._pose = np.zeros(3)
        self.stop_reason: str | None = None
        self.plan: FloatArray = NO_PLAN

    def observe_truth(self, pose: FloatArray) -> None:
        """Take the true pose (3,) of this step, m and rad."""
        self._pose = pose
        self._pass_waypoints()
        while not len(self.plan) and self._tours:
            self.plan, self._tours = self._planner(pose), self._tours - 1
            self._pass_waypoints()
        if not len(self.plan):
            self.stop_reason = "the tour is driven"

    def act(self, belief: Belief | None) -> FloatArray:
        """Wheel speeds (2,) towards the next waypoint. The belief is ignored."""
        del belief
        if self.stop_reason is not None:
            return np.zeros(2)
        period, (drive, turn) = self._robot.control_period, TOUR_SPEEDS
        error = bearing_of(self._pose, self.plan[0])
        distance = self._distance()
        # An error that one step can correct is corrected while driving. A larger error is corrected
        # on the spot.
        speed = min(drive, distance / period) if abs(error) <= turn * period else 0.0
        return wheel_speeds(speed, float(np.clip(error / period, -turn, turn)), self._robot)

    def _distance(self) -> float:
        return math.dist(self._pose[:2], self.plan[0])

    def _pass_waypoints(self) -> None:
        while len(self.plan) and self._distance() < _ARRIVED:
            self.plan = self.plan[1:]


def check_policy(policy: str, laps: int, robots: int) -> None:
    """Check that the policy exists and can do what the other settings ask for.

    Raises
    ------
    ValueError
        If it does not exist or cannot.
    """
    if is_file_policy(policy):
        file_and_name(policy)
    elif policy not in {*BELIEF_POLICIES, *FROM_OUTSIDE}:
        known = ", ".join((*BELIEF_POLICIES, *FROM_OUTSIDE))
        raise ValueError(
            f"no policy is called {policy!r}; there are {known}, or a file: FILE.py:CLASS"
        )
    if laps and policy not in {"frontier", TOUR}:
        raise ValueError(f"laps go with the policies frontier and tour, not with {policy!r}")
    if robots > 1 and (laps or policy in FROM_OUTSIDE):
        what = "laps are" if laps else f"the policy {policy!r} is"
        raise ValueError(f"{what} for one robot")


def check_belief_policy(policy: str) -> None:
    """Check that the policy exists and acts on the belief alone, before there is a robot to make it
    for.
    """
    check_policy(policy, laps=0, robots=1)
    if policy in FROM_OUTSIDE:
        raise ValueError(
            f"the policy {policy!r} does not act on a belief: use limslam run --policy {policy}"
        )


def policies_by_belief(
    policy: str, robot: RobotSpec, config: AgentConfig, *, robots: int, seed: int
) -> list[Policy] | None:
    """A policy for each robot that acts on the belief alone. None for ``frontier``: a team makes
    those itself.
    """
    check_belief_policy(policy)
    if is_file_policy(policy):
        return file_policies(policy, robot, config.policy, robots=robots, seed=seed)
    if policy == "frontier":
        return None
    return [_policy_for(policy, robot, config, number, seed) for number in range(robots)]


def _policy_for(
    policy: str, robot: RobotSpec, config: AgentConfig, number: int, seed: int
) -> Policy:
    """A policy that acts on the belief."""
    if policy == "frontier_fast":
        fast = replace(config.policy, speed=robot.max_wheel_speed)
        return explorer(robot, replace(config, policy=fast))
    if policy == "wall_follower":
        return WallFollower(robot, config.policy)
    generator = np.random.default_rng([seed, number])
    if policy == "learned":
        return LearnedPolicy(robot, config.policy, seed=generator)
    if policy == "random":
        return RandomPolicy(robot, config.policy, seed=generator)
    raise ValueError(f"nothing makes the policy {policy!r}")
