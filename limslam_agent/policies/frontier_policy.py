"""Frontier exploration: drive to the frontier of least cost until no frontier is left or
reachable.
"""

import math

import numpy as np
from scipy import ndimage

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.grid.frontier import frontier_cells, group_places
from limslam_agent.grid.occupancy import GridView
from limslam_agent.policies.attempts import SAME_GOAL, Attempt, Attempts
from limslam_agent.policies.controller import (
    REPLAN_PERIOD,
    TURN_RATE,
    Progress,
    follow,
    nearest_beam,
    turn_by,
)
from limslam_agent.policies.policy import NO_PLAN, NOT_EXPLORED, MapExplorer
from limslam_agent.policies.simple_policies import WallFollower
from limslam_agent.policies.targets import Target, next_target
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec
from limslam_env.messages import counted

_POINTED = math.radians(4.0)
_MOST_NAMED = 3
# Number of cells that the beams must reach from the middle of the robot, so that they see a free
# cell beside its own.
_CELLS_SEEN = 1.75


class FrontierPolicy(MapExplorer):
    """Drives to the frontier of least cost until there is none left (step 8 of the method).

    The robot first looks at a frontier with the nearest beam from a distance. If that shows
    nothing, the robot drives to it. What it has looked at, or could not reach, is no goal any more,
    so exploration always ends (:mod:`limslam_agent.policies.attempts`).

    A robot that has not turned round yet, as in front of a corner, does so before it ends, unless
    its map is closed or a goal could not be reached.

    A robot whose beams reach less than :func:`least_reach` sees no free cell beside its own, and so
    no frontier. Such a robot follows walls instead until it has seen nothing new for a while, and
    its stop reason says that the world is not explored.

    Parameters
    ----------
    robot, config
        Body and settings. Those of the paper's robot and the default settings if left out.

    Examples
    --------
    >>> from limslam_agent import LimSlamAgent, FrontierPolicy
    >>> from limslam_env import RobotSpec
    >>> agent = LimSlamAgent(RobotSpec(), policy=FrontierPolicy(RobotSpec()))
    """

    def __init__(self, robot: RobotSpec | None = None, config: PolicyConfig | None = None) -> None:
        robot = robot or RobotSpec()
        self._config = config or PolicyConfig()
        self._wall_follower = WallFollower(robot, self._config)
        # How far the robot has still to turn, rad, until it has looked around.
        self._to_turn = 2.0 * math.pi
        super().__init__(robot)

    def _forget_map(self) -> None:
        # Goals (2,), m, that were looked at, and goals that could not be reached.
        self._settled = list[FloatArray]()
        self._failed = list[FloatArray]()

    def _plan_anew(self) -> None:
        self._drop()
        self._turned_from: float | None = None
        self._attempts = Attempts()
        # Whether the map has not grown since the robot turned to its goal.
        self._is_vain = True

    def _drop(self) -> None:
        self._pursued: Target | None = None
        self.plan = NO_PLAN
        self._until_plan = 0

    @property
    def goal(self) -> FloatArray | None:
        """Present goal (2,), m, or None."""
        return None if self._pursued is None else self._pursued.goal

    def resume(self, belief: Belief) -> bool:
        """Explore again, after the policy has stopped, if there is a frontier that can be reached;
        whether there is.
        """
        if self._target(belief) is None:
            return False
        self.stop_reason = None
        return True

    def _wheels(self, belief: Belief) -> FloatArray:
        if self.robot.reach < least_reach(self.robot, belief.grid.cell):
            return self._follow_walls(belief)
        heading = float(belief.pose[2])
        if self._turned_from is not None:
            self._to_turn -= abs(float(wrap_angle(heading - self._turned_from)))
        self._turned_from = heading
        if self._until_plan <= 0 or self._pursued is None:
            self._replan(belief)
        self._until_plan -= 1
        if self._pursued is not None:
            return self._follow(belief, self._pursued)
        if self.stop_reason is not None:
            return np.zeros(2)
        self._to_turn -= TURN_RATE * self.robot.control_period
        self._turned_from = None
        return turn_by(math.pi, self.robot)

    def _follow_walls(self, belief: Belief) -> FloatArray:
        wheels = self._wall_follower.act(belief)
        reason = self._wall_follower.stop_reason
        if reason is not None:
            self.stop_reason = (
                f"{reason}, and {short_reach(self.robot, belief.grid.cell)}: {NOT_EXPLORED}"
            )
        return wheels

    def _ignored(self, belief: Belief) -> BoolArray:
        return cells_around(belief.grid, self._settled + self._failed)

    def _target(self, belief: Belief) -> Target | None:
        return next_target(belief, self._ignored(belief), self.robot, self._config)

    def _replan(self, belief: Belief) -> None:
        target = self._target(belief)
        if target is None:
            self._drop()
            is_closed = not frontier_cells(belief.grid, 1).any()
            if is_closed or self._failed or self._to_turn <= 0.0:
                self.stop_reason = self._reason(belief)
            return
        if self.goal is None or math.dist(self.goal, target.goal) >= SAME_GOAL:
            self._leave(belief)
            self._is_vain = True
        self._pursued = target
        self._until_plan = REPLAN_PERIOD
        goes_near = self._attempts.of(target.goal).goes_near
        self.plan = target.path if goes_near else cut_short(target.path, SAME_GOAL)

    def _leave(self, belief: Belief) -> None:
        """Turn from a goal. One that has ceased to be a frontier, although the map has not grown,
        flickers, and is settled.
        """
        if self.goal is not None and self._is_vain:
            frontier = frontier_cells(belief.grid, self._config.min_frontier)
            if not (frontier & cells_around(belief.grid, [self.goal])).any():
                self._settled.append(self.goal)

    def _follow(self, belief: Belief, target: Target) -> FloatArray:
        has_grown = self._attempts.note(belief.grid)
        self._is_vain = self._is_vain and not has_grown
        attempt = self._attempts.of(target.goal)
        step = follow(self.plan, belief, self.robot, self._config.speed)
        if step is None:
            return self._look(belief, target, attempt)
        action, left = step
        attempt.progress.count(left, is_new=has_grown)
        if attempt.is_over:
            self._end(attempt, target, self._failed)
        return action

    def _end(self, attempt: Attempt, target: Target, ends: list[FloatArray]) -> None:
        """Keep the target in a list of goals that are none any more."""
        ends.append(target.goal)
        self._attempts.end(attempt)
        self._drop()

    def _look(self, belief: Belief, target: Target, attempt: Attempt) -> FloatArray:
        """Point a beam at the target and decide from the reading what the target is."""
        aim = target.aim
        beam, error = nearest_beam(belief.pose, aim, self.robot)
        attempt.progress.idle += 1
        if abs(error) > _POINTED and not attempt.is_over:
            return turn_by(error, self.robot)
        distance = float(np.hypot(*(aim - belief.pose[:2]))) - float(
            np.hypot(*self.robot.beam_origins[beam])
        )
        reading = float(belief.ranges[beam])
        is_wall = (
            reading < self.robot.too_far[beam] and abs(reading - distance) < 1.5 * belief.grid.cell
        )
        if is_wall or attempt.goes_near:
            self._end(attempt, target, self._settled)
        else:
            attempt.goes_near = True
            attempt.progress = Progress()
            self._until_plan = 0
        return np.zeros(2)

    def _reason(self, belief: Belief) -> str:
        grid = belief.grid
        frontier = frontier_cells(
            grid, self._config.min_frontier, cells_around(grid, self._settled)
        )
        # Beams that pass a wall by an error leave a few free cells behind it, in which the robot
        # has no room.
        regions, _ = ndimage.label(grid.free)
        away = ndimage.distance_transform_edt(np.pad(grid.free, 1))[1:-1, 1:-1]
        has_room = away >= 0.5 + self.robot.radius / grid.cell
        places = group_places(grid, frontier & np.isin(regions, regions[has_room]))
        if not len(places):
            return "explored: no frontier is left"
        named = [f"({x:.1f}, {y:.1f})" for x, y in places[:_MOST_NAMED]]
        more = len(places) - len(named)
        if more:
            named.append(counted(more, "more place"))
        near = " and ".join([", ".join(named[:-1]), named[-1]] if len(named) > 1 else named)
        what = f"{counted(len(places), 'frontier')} {'is' if len(places) == 1 else 'are'}"
        return f"explored: {what} left that cannot be reached, near {near}"


def cells_around(grid: GridView, places: list[FloatArray]) -> BoolArray:
    """The cells (rows, columns) of places (2,), m, and those adjacent to them."""
    mask = np.zeros(grid.values.shape, dtype=bool)
    if places:
        cells = grid.cells(np.array(places))
        inside = ((cells >= 0) & (cells < mask.shape)).all(axis=1)
        mask[cells[inside, 0], cells[inside, 1]] = True
    return np.asarray(ndimage.binary_dilation(mask, np.ones((3, 3), dtype=bool)))


def least_reach(robot: RobotSpec, cell: float) -> float:
    """Least reach (m) of the beams from the middle of the robot that frontier exploration needs on
    a grid of cells of a side (m). The beams must see past the body, and a free cell beside the
    robot's own.
    """
    return max(_CELLS_SEEN * cell, robot.radius + cell)


def short_reach(robot: RobotSpec, cell: float) -> str:
    """The words for a robot whose beams are too short for frontiers."""
    need = least_reach(robot, cell)
    return (
        f"the beams reach {robot.reach:.3f} m, where frontier exploration needs at least "
        f"{need:.3f} m"
    )


def cut_short(path: FloatArray, distance: float) -> FloatArray:
    """A path (k, 2) without its last ``distance`` (m), so that the robot stops where it can see the
    end. Keeps one point.
    """
    lengths = np.hypot(*np.diff(path, axis=0).T)
    to_go = np.append(np.cumsum(lengths[::-1])[::-1], 0.0)
    return path[: max(int(np.count_nonzero(to_go >= distance)), 1)]
