"""A memory of the goals that were tried: some are settled for good, some are set aside for a while."""

from dataclasses import dataclass

import cv2
import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray

MOST_TRIES = 3
"""A goal that was set aside this many times is given up."""

# Goals closer than the first distance (m) count as one goal, and closer than the second as one place.
_SAME_PLACE, _SAME_CELL = 0.25, 0.05
_FAR_AWAY_TIME = 1 << 60


@dataclass
class _Aside:
    place: FloatArray
    until: int
    tries: int


class GoalMemory:
    """Remembers which frontiers the robot must not drive to, for a while or for good.

    Parameters
    ----------
    wait
        Number of steps for which a goal is set aside after the first try. Each further try doubles this number.
    """

    def __init__(self, wait: int) -> None:
        self._wait = wait
        self._settled: list[FloatArray] = []
        self._seen: list[FloatArray] = []
        self._aside: list[_Aside] = []

    def settle(self, place: FloatArray, *, is_near: bool = True) -> None:
        """Mark a place (2,), m, as fully observed. If it was observed from near, the adjacent cells are marked, too."""
        (self._settled if is_near else self._seen).append(place)

    def set_aside(self, place: FloatArray, step: int) -> None:
        """Leave a goal (2,), m, alone for a while because the robot failed to reach it."""
        tries = self.tries_at(place) + 1
        until = step + (self._wait << (tries - 1)) if tries < MOST_TRIES else _FAR_AWAY_TIME
        # A try close to an earlier one counts as one more try, but both places are set aside.
        self._aside = [each for each in self._aside if np.hypot(*(each.place - place)) > _SAME_CELL]
        self._aside.append(_Aside(place, until, tries))

    def give_up(self, places: FloatArray) -> None:
        """Never drive to these places (n, 2), m, again."""
        self._aside += [_Aside(place, _FAR_AWAY_TIME, MOST_TRIES) for place in places]

    def tries_at(self, place: FloatArray) -> int:
        """Number of times that a goal near this place (2,), m, was set aside."""
        near = [each.tries for each in self._aside if np.hypot(*(each.place - place)) < _SAME_PLACE]
        return max(near, default=0)

    def release(self) -> bool:
        """Allow all goals again that were not given up. Returns whether there are any."""
        waiting = [aside for aside in self._aside if 0 < aside.until < _FAR_AWAY_TIME]
        for aside in waiting:
            aside.until = 0
        return bool(waiting)

    def settled_cells(self, grid: GridView) -> BoolArray:
        """Cells (rows, columns) of settled places, and the cells adjacent to them."""
        return _around(grid, self._settled) | _around(grid, self._seen, 0)

    def ignored_cells(self, grid: GridView, step: int) -> BoolArray:
        """Cells (rows, columns) in which no goal may lie at this step."""
        aside = [each.place for each in self._aside if each.until > step]
        return _around(grid, self._settled + aside) | _around(grid, self._seen, 0)


def _around(grid: GridView, places: list[FloatArray], width: int = 1) -> BoolArray:
    """Cells (rows, columns) of places, and the cells up to ``width`` cells away from them."""
    mask = np.zeros(grid.values.shape, dtype=np.uint8)
    if places:
        cells = grid.cells(np.array(places))
        inside = ((cells >= 0) & (cells < mask.shape)).all(axis=1)
        mask[cells[inside, 0], cells[inside, 1]] = 1
        mask = np.asarray(cv2.dilate(mask, np.ones((2 * width + 1, 2 * width + 1), dtype=np.uint8)), dtype=np.uint8)
    return mask > 0
