"""Policies: from what the robot believes to what its wheels do. Each has ``act(belief) -> action``."""

from limslam_agent.policies.belief import Belief, Policy
from limslam_agent.policies.frontier_policy import FrontierPolicy
from limslam_agent.policies.simple_policies import Laps, RandomPolicy, WallFollower

__all__ = ["Belief", "FrontierPolicy", "Laps", "Policy", "RandomPolicy", "WallFollower"]
