"""What a policy is told and what it has to answer: the plug between mapping and deciding."""

from dataclasses import dataclass, field
from typing import Protocol

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import FloatArray, no_rows


@dataclass(frozen=True, eq=False)
class Belief:
    """All that a policy may look at.

    Attributes
    ----------
    pose, covariance
        Believed pose (3,), m, m, rad, and its covariance (3, 3).
    ranges
        The latest readings (n_beams,), m.
    segments
        Walls of the map (N, 4), m.
    grid
        Occupancy.
    other_poses
        Believed poses of all other robots of a team (m, 3), m, m, rad, in the team's order. Empty for one alone.
    other_goals
        Where those of them that have a goal mean to go (k, 2), m.
    """

    pose: FloatArray
    covariance: FloatArray
    ranges: FloatArray
    segments: FloatArray
    grid: GridView
    other_poses: FloatArray = field(default_factory=lambda: no_rows(3))
    other_goals: FloatArray = field(default_factory=lambda: no_rows(2))


class Policy(Protocol):
    """Anything that turns a belief into wheel speeds: a planner, a rule, or a trained network.

    Attributes
    ----------
    stop_reason
        Why the policy wants to do no more, in words; None while it goes on.
    plan
        The way it means to go (k, 2), m; may be empty.
    """

    stop_reason: str | None
    plan: FloatArray

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) from -1 to 1, fractions of the maximum."""
        ...


NO_PLAN = no_rows(2)
NO_PLAN.setflags(write=False)
