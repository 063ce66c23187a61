"""Exploration that ends when the walls are whole: frontiers first, and then the stretches of border without a wall."""

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import AgentConfig, PolicyConfig
from limslam_agent.policies.controller import BACK_STEPS, back_off
from limslam_agent.policies.frontier_policy import FrontierPolicy
from limslam_agent.policies.policy import NOT_EXPLORED, MapExplorer, Policy
from limslam_agent.policies.wall_look import Look
from limslam_agent.policies.wall_views import next_view, open_border
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

# Steps of looking at walls. In a large building there is always another stretch, and little is gained by it.
_MOST_STEPS = 9600


def explorer(robot: RobotSpec, config: AgentConfig) -> Policy:
    """The policy that explores until everything was seen, or until the walls are whole, as the settings say.

    Parameters
    ----------
    robot, config
        Body, and the settings of the agent.
    """
    if config.policy.until == "seen":
        return FrontierPolicy(robot, config.policy)
    return WallPolicy(robot, config.policy)


class WallPolicy(MapExplorer):
    """Explores frontiers, and looks at every stretch where free ground ends and the map has no wall.

    A :class:`FrontierPolicy` explores the frontiers. After it has stopped, the robot drives to the nearest place from
    which a stretch without a wall is visible. There the robot turns slowly, so that beams sweep along the stretch. A
    frontier that appears meanwhile is explored first. Each stretch is looked at once, and the time for all looks is
    limited, so exploration always ends.

    Parameters
    ----------
    robot, config
        Body and settings.
    """

    def __init__(self, robot: RobotSpec, config: PolicyConfig) -> None:
        self._config = config
        self._frontiers = FrontierPolicy(robot, config)
        super().__init__(robot)

    def enter(self, belief: Belief) -> None:
        """Also tell the frontier explorer."""
        super().enter(belief)
        self._frontiers.enter(belief)

    def _forget_map(self) -> None:
        self._looks: list[Look] = []
        self._looking = 0

    def _plan_anew(self) -> None:
        self._look: Look | None = None
        self._backing = 0

    @property
    def goal(self) -> FloatArray | None:
        """Present goal (2,), m, or None."""
        return self._frontiers.goal if self._look is None else self._look.view.stand

    def _wheels(self, belief: Belief) -> FloatArray:
        wheels = self._frontier_wheels(belief) if self._frontiers.stop_reason is None else None
        if wheels is None:
            if self._look is None and self._backing == 0:
                self._choose(belief)
            wheels = self._look_wheels(belief)
        self.plan = self._frontiers.plan if self._look is None else self._look.path
        return wheels

    def _frontier_wheels(self, belief: Belief) -> FloatArray | None:
        """Wheel speeds (2,) to the next frontier. None if there is no frontier left."""
        wheels = self._frontiers.wanted(belief)
        reason = self._frontiers.stop_reason
        if reason is None:
            return wheels
        if reason.endswith(NOT_EXPLORED):
            self.stop_reason = reason
            return wheels
        return None

    @property
    def _is_late(self) -> bool:
        """Whether the time for looking at walls is over."""
        return self._looking > _MOST_STEPS

    def _choose(self, belief: Belief) -> None:
        """After the last frontier: explore a frontier that has appeared, begin the next look, or stop."""
        if self._frontiers.resume(belief):
            return
        border = open_border(belief, [look.view.faces for look in self._looks])
        view = None if self._is_late else next_view(belief, border, self.robot)
        if view is not None:
            self._look = Look(view, self.robot, self._config)
            return
        end = "all walls were looked at"
        if len(border) or any(look.is_stuck for look in self._looks):
            late = "the time for looking at walls is over"
            end = late if self._is_late else "some walls cannot be looked at"
        self.stop_reason = f"{self._frontiers.stop_reason}, and {end}"

    def _look_wheels(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) of the present look."""
        self._looking += 1
        if self._backing > 0:
            self._backing -= 1
            return back_off(belief.pose, belief.grid, self.robot, self._config.speed)
        if self._look is None:
            return np.zeros(2)
        wheels = self._look.act(belief)
        if self._look.is_over:
            self._end(self._look)
        return wheels

    def _end(self, look: Look) -> None:
        if not look.is_needless:
            self._looks.append(look)
        self._backing = BACK_STEPS if look.is_stuck else 0
        self._look = None
