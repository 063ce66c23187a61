"""What became of the goals that were tried: settled for good, or set aside for a while."""

from dataclasses import dataclass

import cv2
import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray

MOST_TRIES = 3
"""A goal that was set aside this often is given up."""

# Goals as near as this, m, are one goal, and one place.
_SAME_PLACE, _SAME_CELL = 0.25, 0.05
_FAR_AWAY_TIME = 1 << 60


@dataclass
class _Aside:
    place: FloatArray
    until: int
    tries: int


class GoalMemory:
    """Frontiers that are not to be gone to, now or ever again.

    Parameters
    ----------
    wait
        Steps for which a goal is left alone after the first try; after each further one it is twice as long.
    """

    def __init__(self, wait: int) -> None:
        self._wait = wait
        self._settled: list[FloatArray] = []
        self._seen: list[FloatArray] = []
        self._aside: list[_Aside] = []

    def settle(self, place: FloatArray, *, is_near: bool = True) -> None:
        """All that the beams can tell about a place (2,), m, is known; from near by, of the cells beside it too."""
        (self._settled if is_near else self._seen).append(place)

    def set_aside(self, place: FloatArray, step: int) -> None:
        """It did not work out this time; the goal (2,), m, is left alone for a while."""
        tries = self.tries_at(place) + 1
        until = step + (self._wait << (tries - 1)) if tries < MOST_TRIES else _FAR_AWAY_TIME
        # Beside another try it counts as one more, but both places are left alone.
        self._aside = [each for each in self._aside if np.hypot(*(each.place - place)) > _SAME_CELL]
        self._aside.append(_Aside(place, until, tries))

    def give_up(self, places: FloatArray) -> None:
        """Never go to these places (n, 2), m, again."""
        self._aside += [_Aside(place, _FAR_AWAY_TIME, MOST_TRIES) for place in places]

    def tries_at(self, place: FloatArray) -> int:
        """How often a goal here (2,), m, was set aside."""
        near = [each.tries for each in self._aside if np.hypot(*(each.place - place)) < _SAME_PLACE]
        return max(near, default=0)

    def release(self) -> bool:
        """Let all be tried again that were not tried too often. Whether there are any."""
        waiting = [aside for aside in self._aside if 0 < aside.until < _FAR_AWAY_TIME]
        for aside in waiting:
            aside.until = 0
        return bool(waiting)

    def settled_cells(self, grid: GridView) -> BoolArray:
        """Cells (rows, columns) of settled places and those beside them."""
        return _around(grid, self._settled) | _around(grid, self._seen, 0)

    def ignored_cells(self, grid: GridView, step: int) -> BoolArray:
        """Cells (rows, columns) that no goal is to lie in at this step."""
        aside = [each.place for each in self._aside if each.until > step]
        return _around(grid, self._settled + aside) | _around(grid, self._seen, 0)


def _around(grid: GridView, places: list[FloatArray], width: int = 1) -> BoolArray:
    """The cells (rows, columns) of some places, and those up to ``width`` cells beside them."""
    mask = np.zeros(grid.values.shape, dtype=np.uint8)
    if places:
        cells = grid.cells(np.array(places))
        inside = ((cells >= 0) & (cells < mask.shape)).all(axis=1)
        mask[cells[inside, 0], cells[inside, 1]] = 1
        mask = np.asarray(cv2.dilate(mask, np.ones((2 * width + 1, 2 * width + 1), dtype=np.uint8)), dtype=np.uint8)
    return mask > 0
