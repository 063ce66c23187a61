"""Frontier exploration: drive to the frontier of least cost until no frontier is left or reachable."""

import math
from dataclasses import dataclass

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.grid.frontier import group_places, sight_begins
from limslam_agent.grid.occupancy import GridView
from limslam_agent.grid.planner import wall_distance
from limslam_agent.policies.controller import (
    AHEAD,
    ARRIVED,
    BACK_STEPS,
    PATIENCE,
    REPLAN_PERIOD,
    TURN_RATE,
    back_off,
    follow,
    nearest_beam,
    turn_by,
    wheel_speeds,
)
from limslam_agent.policies.excursion import Excursion
from limslam_agent.policies.goal_memory import GoalMemory
from limslam_agent.policies.policy import NO_PLAN, NOT_EXPLORED, MapExplorer
from limslam_agent.policies.right_of_way import RightOfWay
from limslam_agent.policies.simple_policies import WallFollower
from limslam_agent.policies.targets import (
    LAST_FRONTIER,
    Target,
    has_seen_little,
    is_walled_in,
    islands,
    next_target,
    open_frontier,
)
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.messages import counted

# A frontier counts as reached from the first distance (m), and from the second one if it has at most so many cells and
# nothing stands between the robot and the frontier.
_VIEW, _FAR_VIEW, _SMALL = 0.35, 1.0, 6
_ASIDE_STEPS = 300  # for which a goal that could not be reached is ignored
_POINTED = math.radians(4.0)
# The robot counts as standing when its wheel speeds sum to less than this.
_CREEP = 0.05
# Progress means a shorter path, or that the map has this many more cells.
_NEW_CELLS = 2
_MOST_NAMED = 3
# Number of full turns that a robot makes before it accepts that it is walled in.
_MOST_ROUNDS = 3
# Number of cells that the beams must reach from the middle of the robot, so that they see a free cell beside its own.
_CELLS_SEEN = 1.75

_FROM_AFAR, _FROM_NEAR, _ALL_THE_WAY = range(3)


@dataclass
class _Pursuit:
    """A target, and the progress towards it.

    ``boldness`` is how near the robot goes, ``left`` is the shortest remaining distance so far, m, and ``standing`` is
    the number of steps without motion.
    """

    target: Target
    boldness: int
    left: float = math.inf
    standing: int = 0


class FrontierPolicy(MapExplorer):
    """Drives to the frontier of least cost until there is none left (step 8 of the method).

    Where no wall is in sight, the robot comes back to a known wall from time to time
    (:class:`~limslam_agent.policies.excursion.Excursion`).

    The robot first looks at a frontier with the nearest beam from a distance. If that shows nothing, the robot goes
    nearer. A frontier that the robot cannot reach is set aside for a while and tried again up to twice. The robot looks
    at an unreachable frontier from the nearest place, because the wall between may be an error of the map. A pursuit
    ends when it makes no progress, so exploration always ends.

    A robot whose beams reach less than :func:`least_reach` sees no free cell beside its own, and so no frontier. Such a
    robot follows walls instead until it has seen nothing new for a while, and its stop reason says that the world is
    not explored.

    Parameters
    ----------
    robot, config
        Body and settings. Those of the paper's robot and the default settings if left out.
    index
        The robot's place in its team. Of two robots that meet, the one with the higher index waits.
    """

    def __init__(self, robot: RobotSpec | None = None, config: PolicyConfig | None = None, index: int = 0) -> None:
        robot, self._config = robot or RobotSpec(), config or PolicyConfig()
        self._right_of_way = RightOfWay(index, robot)
        self._step = 0
        self._wall_follower: WallFollower | None = None
        super().__init__(robot)

    def _forget_map(self) -> None:
        self._memory = GoalMemory(_ASIDE_STEPS)
        self._rounds = 0  # number of rounds on the spot

    def _plan_anew(self) -> None:
        self._pursuit: _Pursuit | None = None
        self._excursion = Excursion(self.robot, self._config)
        self._until_plan = self._backing = self._turning = 0
        # Number of steps without progress towards any goal, and largest number of known cells so far.
        self._idle = self._known = 0

    @property
    def goal(self) -> FloatArray | None:
        """Present goal (2,), m, or None."""
        return None if self._pursuit is None else self._pursuit.target.goal

    @property
    def frontier_size(self) -> int | None:
        """Number of cells of the frontier that the robot drives to, or None."""
        return None if self._pursuit is None else len(self._pursuit.target.group)

    def resume(self, belief: Belief) -> bool:
        """Explore again, after the policy has stopped, if there is a frontier that can be reached; whether there is."""
        target = None if self._wall_follower is not None else self._target(belief)
        if target is None or not target.is_reachable:
            return False
        self.stop_reason = None
        return True

    def _follow_walls(self, belief: Belief, follower: WallFollower) -> FloatArray:
        wheels = follower.act(belief)
        if follower.stop_reason is not None:
            self.stop_reason = (
                f"{follower.stop_reason}, and {short_reach(self.robot, belief.grid.cell)}: {NOT_EXPLORED}"
            )
        return wheels

    def _wheels(self, belief: Belief) -> FloatArray:
        self._step += 1
        if self._step == 1 and self.robot.reach < least_reach(self.robot, belief.grid.cell):
            self._wall_follower = WallFollower(self.robot, self._config)
        if self._wall_follower is not None:
            return self._follow_walls(belief, self._wall_follower)
        self._excursion.observe(belief)
        if self._backing > 0:
            self._backing -= 1
            return back_off(belief.pose, belief.grid, self.robot, self._config.speed)
        if self._turning == 0 and (self._until_plan <= 0 or self._pursuit is None):
            self._replan(belief)
        self._until_plan -= 1
        if self._turning > 0:
            self._turning -= 1
            return wheel_speeds(0.0, TURN_RATE, self.robot)
        if self._pursuit is None or self._right_of_way.waits(belief.pose, belief.other_poses):
            return np.zeros(2)
        return self._follow(belief, self._pursuit)

    def _replan(self, belief: Belief) -> None:
        self._until_plan = REPLAN_PERIOD
        target = self._target(belief)
        while (target is None or (self._pursuit is None and not target.is_reachable)) and self._memory.release():
            target = self._target(belief)
        is_lost = target is None or not target.is_reachable
        if is_lost and self._rounds < _MOST_ROUNDS and self._sees_no_way(belief):
            self._rounds += 1
            self._turning = math.ceil(2.0 * math.pi / (TURN_RATE * self.robot.control_period))
            self._drop()
        elif target is None:
            self._drop()
            self.stop_reason = self._reason(belief)
        else:
            self._take_up(belief.grid, target)

    def _sees_no_way(self, belief: Belief) -> bool:
        """Whether a turn on the spot may help: the robot seems walled in, or it faces a corner from nearby."""
        return is_walled_in(belief.grid, belief.pose) or has_seen_little(belief.grid, self.robot.radius)

    def _target(self, belief: Belief) -> Target | None:
        ignored = self._memory.ignored_cells(belief.grid, self._step)
        target = next_target(belief, ignored, self.goal, self.robot, self._config)
        return target and (self._excursion.way_back(belief, target) or target)

    def _take_up(self, grid: GridView, target: Target) -> None:
        """Keep to the old target's frontier, or begin with another one."""
        old = self._pursuit
        if old is not None and np.hypot(*(old.target.goal - target.goal)) < _VIEW:
            old.target = target
        else:
            is_new = self._memory.tries_at(target.goal) == 0
            self._pursuit = old = _Pursuit(target, _FROM_AFAR if is_new and target.is_frontier else _ALL_THE_WAY)
        self.plan = self._cut(grid, target, old.boldness)

    def _cut(self, grid: GridView, target: Target, boldness: int) -> FloatArray:
        """The path (k, 2) up to the place from which the robot looks at its end."""
        if not target.is_reachable or boldness == _ALL_THE_WAY:
            return target.path
        if boldness == _FROM_AFAR:
            return cut_short(target.path, self._view_distance(grid, target))
        cells = grid.cells(target.path)
        has_room = wall_distance(grid)[cells[:, 0], cells[:, 1]] >= self.robot.radius
        return target.path[: int(np.flatnonzero(has_room)[-1]) + 1] if has_room.any() else target.path[:1]

    def _view_distance(self, grid: GridView, target: Target) -> float:
        """Distance (m) from the end of the path at which the robot may look. A small frontier must not be hidden from
        there.
        """
        if len(target.group) > _SMALL:
            return _VIEW
        seen_from = sight_begins(grid, target.path, _FAR_VIEW)
        return max(_VIEW, float(np.hypot(*np.diff(target.path[seen_from:], axis=0).T).sum()))

    def _follow(self, belief: Belief, pursuit: _Pursuit) -> FloatArray:
        off = self.plan - belief.pose[:2]
        away = np.sqrt(off[:, 0] ** 2 + off[:, 1] ** 2)
        if away[-1] < ARRIVED or len(self.plan) == 1:
            return self._look(belief, pursuit)
        action, left = follow(self.plan, away, belief, self.robot, self._config.speed)
        if self._is_stuck(belief.grid, pursuit, left, action):
            self._set_aside(pursuit)
            self._excursion.end()
            self._backing = BACK_STEPS
        return action

    def _is_stuck(self, grid: GridView, pursuit: _Pursuit, left: float, action: FloatArray) -> bool:
        """Whether the robot has stood still for too long, or has come no nearer and seen nothing new for too long."""
        known = int(np.count_nonzero(grid.values))
        is_nearer = left < pursuit.left - AHEAD and math.isfinite(pursuit.left)
        self._idle = 0 if is_nearer or known > self._known + _NEW_CELLS else self._idle + 1
        if self._idle == 0:
            self._known = max(known, self._known)
        if is_nearer or not math.isfinite(pursuit.left):
            pursuit.left = left
        pursuit.standing = pursuit.standing + 1 if abs(float(action[0] + action[1])) < _CREEP else 0
        return pursuit.standing > PATIENCE or self._idle > 3 * PATIENCE

    def _look(self, belief: Belief, pursuit: _Pursuit) -> FloatArray:
        """Point a beam at the target and decide from the reading what the target is."""
        if not pursuit.target.is_frontier:
            self._excursion.end()
            self._drop()
            return np.zeros(2)
        aim = pursuit.target.aim
        beam, error = nearest_beam(belief.pose, aim, self.robot)
        self._idle += 1
        if abs(error) > _POINTED and self._idle <= 3 * PATIENCE:
            return turn_by(error, self.robot)
        distance = float(np.hypot(*(aim - belief.pose[:2]))) - float(np.hypot(*self.robot.beam_origins[beam]))
        reading = float(belief.ranges[beam])
        is_wall = reading < self.robot.too_far[beam] and abs(reading - distance) < 1.5 * belief.grid.cell
        if not pursuit.target.is_reachable:
            self._set_aside(pursuit)
        elif is_wall or pursuit.boldness == _ALL_THE_WAY:
            # From a distance the beam may have hit a wall beside the opening.
            self._memory.settle(pursuit.target.goal, is_near=distance < 1.5 * _VIEW)
            self._drop()
        elif pursuit.boldness == _FROM_AFAR:
            pursuit.boldness, pursuit.left, self._idle = _FROM_NEAR, math.inf, 0
            self._until_plan = 0
        else:
            self._set_aside(pursuit)
        return np.zeros(2)

    def _set_aside(self, pursuit: _Pursuit) -> None:
        """Leave a goal alone: for a while, or for good if it is unreachable."""
        if pursuit.target.is_reachable:
            self._memory.set_aside(pursuit.target.goal, self._step)
        else:
            self._memory.give_up(pursuit.target.group)
        self._drop()

    def _drop(self) -> None:
        self._pursuit, self.plan = None, NO_PLAN
        self._until_plan = self._idle = 0

    def _reason(self, belief: Belief) -> str:
        grid = belief.grid
        ignored = self._memory.settled_cells(grid) | islands(grid, belief.pose)
        places = group_places(grid, open_frontier(grid, LAST_FRONTIER, ignored, self.robot))
        if not len(places):
            return "explored: no frontier is left"
        named = [f"({x:.1f}, {y:.1f})" for x, y in places[:_MOST_NAMED]]
        more = len(places) - len(named)
        if more:
            named.append(counted(more, "more place"))
        near = " and ".join([", ".join(named[:-1]), named[-1]] if len(named) > 1 else named)
        what = f"{counted(len(places), 'frontier')} {'is' if len(places) == 1 else 'are'}"
        return f"explored: {what} left that cannot be reached, near {near}"


def least_reach(robot: RobotSpec, cell: float) -> float:
    """Least reach (m) of the beams from the middle of the robot that frontier exploration needs on a grid of cells of
    a side (m). The beams must see past the body, and a free cell beside the robot's own.
    """
    return max(_CELLS_SEEN * cell, robot.radius + cell)


def short_reach(robot: RobotSpec, cell: float) -> str:
    """The words for a robot whose beams are too short for frontiers."""
    need = least_reach(robot, cell)
    return f"the beams reach {robot.reach:.3f} m, where frontier exploration needs at least {need:.3f} m"


def cut_short(path: FloatArray, distance: float) -> FloatArray:
    """A path (k, 2) without its last ``distance`` (m), so that the robot stops where it can see the end. Keeps one
    point.
    """
    lengths = np.hypot(*np.diff(path, axis=0).T)
    to_go = np.append(np.cumsum(lengths[::-1])[::-1], 0.0)
    return path[: max(int(np.count_nonzero(to_go >= distance)), 1)]
