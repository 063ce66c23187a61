"""Exploration that ends when the walls are whole: frontiers first, and then the stretches of border
without a wall.
"""

import math
from dataclasses import dataclass

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import AgentConfig, PolicyConfig
from limslam_agent.grid.unfinished import Faces
from limslam_agent.policies.controller import (
    PATIENCE,
    TURN_RATE,
    Progress,
    follow,
    nearest_beam,
    turn_by,
    wheel_speeds,
)
from limslam_agent.policies.frontier_policy import FrontierPolicy
from limslam_agent.policies.policy import NO_PLAN, NOT_EXPLORED, MapExplorer, Policy
from limslam_agent.policies.wall_views import View, is_unfinished, next_view, open_border, path_to
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec

# Steps of looking at walls. In a large building there is always another stretch, and little is
# gained by it.
_MOST_STEPS = 9600
_POINTED = math.radians(2.0)
# Number of steps between two checks of the path and of the stretch.
_CHECK_PERIOD = 10
# The sweep goes beyond the ends of a stretch by this angle.
_BEYOND = math.radians(4.0)
# Smallest and largest turn in one step of a sweep, rad. Readings after a smaller turn are not
# collected.
_FINEST = math.radians(1.1)
_COARSEST = math.radians(5.0)
# The readings of a sweep are at most this far apart, m, and at least so many.
_SPACING = 0.03
_FEWEST_READINGS = 14


def explorer(robot: RobotSpec, config: AgentConfig) -> Policy:
    """The policy that explores until everything was seen, or until the walls are whole, as the
    settings say.

    Parameters
    ----------
    robot, config
        Body, and the settings of the agent.
    """
    if config.policy.until == "seen":
        return FrontierPolicy(robot, config.policy)
    return WallPolicy(robot, config.policy)


class WallPolicy(MapExplorer):
    """Explores frontiers, and looks at every stretch where free ground ends and the map has no
    wall.

    A :class:`FrontierPolicy` explores the frontiers. After it has stopped, the robot drives to the
    nearest place from which a stretch without a wall is visible. There the robot turns slowly, so
    that beams sweep along the stretch. A frontier that appears meanwhile is explored first. Each
    stretch is looked at once, and the time for all looks is limited, so exploration always ends.
    The robots of a team divide the stretches: what one has looked at, or is about to look at, is
    left to it.

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

    @property
    def looks(self) -> list[Faces]:
        """The stretches that this robot has looked at, and the one that it is about to look at."""
        looks = [look for look in self._looks if not look.is_stuck]
        looks += [] if self._look is None else [self._look]
        return [look.view.faces for look in looks]

    def _forget_map(self) -> None:
        self._looks: list[Look] = []
        self._looking = 0

    def restart(self) -> None:
        """Explore the frontiers again, and remember the walls that were looked at."""
        self._looks = [look for look in self._looks if not look.is_stuck]
        self._frontiers.restart()
        self._begin()

    def _plan_anew(self) -> None:
        self._look: Look | None = None

    @property
    def goal(self) -> FloatArray | None:
        """Present goal (2,), m, or None."""
        return self._frontiers.goal if self._look is None else self._look.view.stand

    def _wheels(self, belief: Belief) -> FloatArray:
        is_exploring = self._frontiers.stop_reason is None
        if is_exploring:
            wheels = self._frontiers.wanted(belief)
            reason = self._frontiers.stop_reason
            if reason is None or reason.endswith(NOT_EXPLORED):
                self.plan = self._frontiers.plan
                self.stop_reason = reason
                return wheels
        if self._look is None:
            self._choose(belief)
        self.plan = NO_PLAN
        self._looking += 1
        look = self._look
        if look is None:
            return np.zeros(2)
        wheels = look.act(belief)
        self.plan = look.path
        if look.is_over:
            self._looks += [] if look.is_needless else [look]
            self._look = None
            self.plan = NO_PLAN
        return wheels

    def _choose(self, belief: Belief) -> None:
        """After the last frontier: explore a frontier that has appeared, begin the next look, or
        stop.
        """
        if self._frontiers.resume(belief):
            return
        looked_at = [look.view.faces for look in self._looks]
        border = open_border(belief, [*looked_at, *belief.other_looks])
        is_late = self._looking > _MOST_STEPS
        view = None if is_late else next_view(belief, border, self.robot)
        if view is not None:
            self._look = Look(view, self.robot, self._config)
            return
        end = "all walls were looked at"
        if len(border) or any(look.is_stuck for look in self._looks):
            end = (
                "the time for looking at walls is over"
                if is_late
                else "some walls cannot be looked at"
            )
        self.stop_reason = f"{self._frontiers.stop_reason}, and {end}"


@dataclass(frozen=True)
class Sweep:
    """A slow turn on the spot.

    Attributes
    ----------
    start, end
        Headings between which the robot turns, rad. Their difference has the sign of the turn.
    step
        Turn in one step, rad, without a sign.
    """

    start: float
    end: float
    step: float

    @property
    def direction(self) -> float:
        """1 for a turn counter-clockwise, and -1 for a turn clockwise."""
        return math.copysign(1.0, self.end - self.start)

    def left(self, heading: float) -> float:
        """Angle (rad) that is left to turn at a heading (rad). Negative after the end."""
        middle = 0.5 * (self.start + self.end)
        return 0.5 * abs(self.end - self.start) - self.direction * wrap_angle(heading - middle)


def sweep_along(view: View, pose: FloatArray, robot: RobotSpec) -> Sweep:
    """The sweep from a pose (3,) that takes enough readings of a view for a wall of its length.

    One beam sweeps if its readings are enough, and otherwise all beams on that side of the robot.

    Parameters
    ----------
    view
        The stretch.
    pose
        Pose of the robot (3,), m, m, rad.
    robot
        Body and beams.
    """
    first, width = view.bearings(pose[:2])
    beam, _ = nearest_beam(pose, view.middle, robot)
    wanted = max(view.length / _SPACING, _FEWEST_READINGS)
    angles = robot.beam_angles[[beam]]
    if wanted * _FINEST > width:
        angles = robot.beam_angles[[each.side == robot.beams[beam].side for each in robot.beams]]
    step = float(np.clip(width * len(angles) / wanted, _FINEST, _COARSEST))
    low = first - float(angles.max()) - _BEYOND
    high = first + width - float(angles.min()) + _BEYOND
    is_nearer = abs(wrap_angle(low - float(pose[2]))) <= abs(wrap_angle(high - float(pose[2])))
    return Sweep(low, high, step) if is_nearer else Sweep(high, low, step)


class Look:
    """Drives to the place of a view, and sweeps beams along the stretch.

    Parameters
    ----------
    view
        The stretch, the place and the path.
    robot, config
        Body and settings.

    Attributes
    ----------
    view
        The view.
    path
        Path to its place (k, 2), m, as it was planned last.
    is_over, is_needless, is_stuck
        Whether the look has ended. It has if the sweep is done, if the stretch has got its wall
        before (the look was needless), or if the robot cannot reach the place (it is stuck).
    """

    def __init__(self, view: View, robot: RobotSpec, config: PolicyConfig) -> None:
        self.view = view
        self.path = view.path
        self._robot = robot
        self._config = config
        self.is_over = self.is_needless = self.is_stuck = False
        self._sweep: Sweep | None = None
        self._is_pointing = True
        self._progress = Progress()
        self._until_check = _CHECK_PERIOD

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,). Zero if the look ends in this step."""
        if self._sweep is None:
            return self._drive(belief)
        return self._turn(float(belief.pose[2]), self._sweep)

    def _drive(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) along the path."""
        self._until_check -= 1
        if self._until_check < 0:
            self._check(belief)
        step = follow(self.path, belief, self._robot, self._config.speed)
        if self.is_over:
            return np.zeros(2)
        if step is None:
            self._sweep = sweep_along(self.view, belief.pose, self._robot)
            self._progress = Progress()
            return np.zeros(2)
        wheels, left = step
        self._progress.count(left)
        self.is_over = self.is_stuck = self._progress.is_stuck
        return wheels

    def _check(self, belief: Belief) -> None:
        """Plan the path anew, and end if the stretch has got its wall or there is no path any
        more.
        """
        self._until_check = _CHECK_PERIOD
        path = path_to(belief, self.view.stand, self._robot)
        self.is_needless = not is_unfinished(belief, self.view)
        self.is_over = self.is_needless or path is None
        self.path = self.path if path is None else path

    def _turn(self, heading: float, sweep: Sweep) -> FloatArray:
        """Wheel speeds (2,) to the first heading of the sweep, and from there to the last one."""
        self._progress.idle += 1
        idle = self._progress.idle
        error = wrap_angle(sweep.start - heading)
        if self._is_pointing and abs(error) > _POINTED and idle <= 3 * PATIENCE:
            return turn_by(error, self._robot)
        if self._is_pointing:
            self._is_pointing = False
            self._progress = Progress()
        elif (
            sweep.left(heading) < _POINTED
            or idle > 3.0 * abs(sweep.end - sweep.start) / sweep.step + PATIENCE
        ):
            self.is_over = True
            return np.zeros(2)
        rate = min(sweep.step / self._robot.control_period, TURN_RATE)
        return wheel_speeds(0.0, sweep.direction * rate, self._robot)
