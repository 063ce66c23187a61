"""What guarantees that an explorer ends: a goal that was tried without gain is not tried for ever.

A gain is a map with more known cells than ever before. A building has finitely many cells, so there
are finitely many gains. Between two gains each goal has one attempt, however often the robot turns
to other goals and back. An attempt goes on only while the way that is left becomes shorter than
ever, and so it ends. Its goal and the cells beside it are no goals any more, and there are finitely
many cells. So the robot comes to its end, whatever makes it change its goals.

This holds in one frame of the map. A robot that is found again in another frame begins anew.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_agent.policies.controller import PATIENCE, Progress
from limslam_env.geometry import FloatArray

SAME_GOAL = 0.35
"""Distance (m) up to which two goals are one: from there, a robot sees what is at a goal."""

# The map has grown when it has this many more cells.
_NEW_CELLS = 2


@dataclass
class Attempt:
    """The attempt to reach a goal (2,), m: how near the robot has come, whether it drives to the
    goal itself, as it saw nothing from a distance, and whether the attempt has ended.
    """

    goal: FloatArray
    progress: Progress = field(default_factory=Progress)
    goes_near: bool = False
    has_ended: bool = False

    @property
    def is_over(self) -> bool:
        """Whether the attempt has ended, or the goal is given up. The map may change the way, and
        turning takes time.
        """
        return self.has_ended or self.progress.idle > 3 * PATIENCE


class Attempts:
    """The attempts since the map has grown for the last time."""

    def __init__(self) -> None:
        self._attempts = list[Attempt]()
        self._known = 0

    def note(self, grid: GridView) -> bool:
        """Begin anew if the map has more cells than ever before; whether it has."""
        known = int(np.count_nonzero(grid.values))
        has_grown = known > self._known + _NEW_CELLS
        if has_grown:
            self._known = known
            self._attempts.clear()
        return has_grown

    def of(self, goal: FloatArray, same: float = SAME_GOAL) -> Attempt:
        """The attempt to reach a goal (2,), m, which may have begun before. Goals that are less
        than ``same``, m, apart are one.
        """
        for attempt in self._attempts:
            if math.dist(attempt.goal, goal) < same:
                return attempt
        self._attempts.append(Attempt(goal))
        return self._attempts[-1]

    def end(self, attempt: Attempt) -> None:
        """Forget an attempt, so that another goal nearby may be tried."""
        self._attempts = [each for each in self._attempts if each is not attempt]
