"""Excursions: how far a robot drives where no wall is in sight, and the way back to the walls.

Without walls the robot knows its heading only by its wheels. In large open spaces the errors add up until readings can
no longer be associated with the map. So the robot comes back to a known wall from time to time, and corrects its pose.
"""

import math

import cv2
import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.grid.occupancy import GridView
from limslam_agent.grid.planner import wall_distance
from limslam_agent.policies.targets import MARGIN, Target, sight_of, ways_from
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec

# A reading that ends this close (m) to a wall of the map is of this wall. So many readings in a step show a wall.
_ON_WALL, _FEWEST = 0.2, 2
# Distance (m) from a wall up to which the robot comes back.
_BACK_AT = 0.6
# Excursions shorter than this (m) are never interrupted.
_SHORT = 2.0
# An excursion to a place that is farther away than allowed may be longer than planned by this share, and this much, m.
_LONGER, _SPARE = 1.2, 1.0


class Excursion:
    """Measures the distance driven without a wall in sight, and decides when the robot has to come back.

    Parameters
    ----------
    robot, config
        Body and settings.

    Attributes
    ----------
    driven
        Distance since a wall of the map was in sight, m.
    """

    def __init__(self, robot: RobotSpec, config: PolicyConfig) -> None:
        self._robot, self._config = robot, config
        self._sight = sight_of(robot)
        self._place: FloatArray | None = None
        self._begun: FloatArray | None = None
        self.driven = self._allowed = 0.0
        self._is_returning = False

    def observe(self, belief: Belief) -> None:
        """Note the motion and the readings of one step."""
        place = belief.pose[:2]
        self.driven += 0.0 if self._place is None else float(np.hypot(*(place - self._place)))
        self._place = place
        if self._sees_wall(belief):
            self.end()

    def end(self) -> None:
        """Begin to measure anew: the robot is back."""
        self.driven, self._is_returning = 0.0, False

    def way_back(self, belief: Belief, target: Target) -> Target | None:
        """The way to the nearest wall, if the robot has to come back before it drives to a target; otherwise None."""
        if not (self._is_returning or self._is_too_far(belief, target)):
            return None
        shore = self._shore(belief)
        self._is_returning = shore is not None
        return shore

    def _sees_wall(self, belief: Belief) -> bool:
        from limslam_agent.kernels.nearness import count_on_walls

        beams = self._robot.beam_table
        return count_on_walls(belief.pose, belief.ranges, beams, belief.segments, _ON_WALL) >= _FEWEST

    def _is_too_far(self, belief: Belief, target: Target) -> bool:
        """Whether the way to a target and from there to the nearest wall would be too long without a wall in sight."""
        if self.driven <= _SHORT:
            self._begun = target.path
            return False
        if self._begun is not None:
            # The robot may drive as far as the target needs with which it began, or it would never be reached.
            needed = _SHORT + _LONGER * self._without_wall(belief.grid, self._begun) + _SPARE
            self._allowed, self._begun = max(self._config.longest_excursion, needed), None
        return self.driven + self._without_wall(belief.grid, target.path) > self._allowed

    def _without_wall(self, grid: GridView, path: FloatArray) -> float:
        """Length (m) of a path (k, 2), m, up to the first place near a wall, or up to its end and back to a wall."""
        cells = grid.cells(path)
        away = wall_distance(grid)[cells[:, 0], cells[:, 1]] - self._sight
        lengths = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))
        near = np.flatnonzero(away <= 0.0)
        if near.size:
            return float(lengths[near[0]])
        return float(lengths[-1]) + min(float(away[-1]), self._config.longest_excursion)

    def _shore(self, belief: Belief) -> Target | None:
        """The nearest place beside a wall of the map, as a target; None if there is none that can be reached."""
        grid, robot = belief.grid, self._robot
        has_room = wall_distance(grid) > robot.radius + MARGIN
        wanted = _beside(grid, belief.segments) & grid.free & has_room
        if not wanted.any():
            return None
        ways = ways_from(belief.pose[:2], grid, robot, self._config, targets=wanted)
        cost = np.where(wanted, ways.cost, math.inf)
        best = int(np.argmin(cost))
        if not np.isfinite(cost.flat[best]):
            return None
        row, column = divmod(best, cost.shape[1])
        path = grid.centres(ways.path_to((row, column)))
        return Target(path[-1], path[-1], path[-1:], path, is_reachable=True, is_frontier=False)


def _beside(grid: GridView, segments: FloatArray) -> BoolArray:
    """Cells (rows, columns) near the walls (n, 4), m."""
    image = np.ones(grid.values.shape, dtype=np.uint8)
    ends = np.round((segments.reshape(-1, 2) - grid.low) / grid.cell - 0.5).astype(np.int32).reshape(-1, 1, 2, 2)
    cv2.polylines(image, [*ends.reshape(-1, 2, 1, 2)], isClosed=False, color=0)
    away = cv2.distanceTransform(image, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(away * grid.cell <= _BACK_AT)
