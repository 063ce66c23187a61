"""What a recording keeps of the occupancy grid: its changes from one frame to the next, and its
frontiers.
"""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from scipy import ndimage

from limslam_agent.config.presets import PolicyConfig
from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.grid.occupancy import GridView
from limslam_agent.inspect.columns import rounded
from limslam_agent.policies.targets import ways_from
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.interface import RobotSpec

UNKNOWN = 0
FREE = 1
OCCUPIED = 2
"""Kinds of cells."""

MOST_GROUPS = 24
"""Only so many frontiers are kept, the largest ones."""

Frontiers: TypeAlias = list[tuple[FloatArray, list[float | None]]]
"""Of each connected group of free cells beside unknown ones the centres of its cells (n, 2), m, and
the cost of the cheapest path of each robot, m, increased near walls; None where there is no path.
"""


class GridChanges:
    """Compares each grid with the one before it.

    Rows and columns of cells count from the origin of the map's frame, so that they remain valid
    when the grid grows.
    """

    def __init__(self) -> None:
        self._kinds = np.zeros((0, 0), dtype=np.int8)
        self._place = np.zeros(2, dtype=int)

    def since_last(self, grid: GridView) -> IntArray:
        """Runs (k, 4) of cells that have changed: row, first column, number of cells, and their new
        kind.
        """
        kinds = np.where(
            grid.values > 0, FREE, np.where(grid.values < 0, OCCUPIED, UNKNOWN)
        ).astype(np.int8)
        place = np.rint(grid.low / grid.cell).astype(int)[::-1]
        old = self._place if self._kinds.size else place
        low = np.minimum(old, place)
        high = np.maximum(old + self._kinds.shape, place + kinds.shape)
        before, after = (
            np.pad(each, np.column_stack((at - low, high - at - each.shape)))
            for at, each in ((old, self._kinds), (place, kinds))
        )
        self._place = place
        self._kinds = kinds
        rows, columns = np.nonzero(before != after)
        found = after[rows, columns]
        is_first = np.ones(len(rows), dtype=bool)
        is_first[1:] = (np.diff(rows) != 0) | (np.diff(columns) != 1) | (np.diff(found) != 0)
        firsts = np.flatnonzero(is_first)
        lengths = np.diff(np.append(firsts, len(rows)))
        return np.column_stack(
            (rows[firsts] + low[0], columns[firsts] + low[1], lengths, found[firsts])
        )


def frontiers_of(
    grid: GridView, poses: Sequence[FloatArray], robot: RobotSpec, config: PolicyConfig
) -> Frontiers:
    """All frontiers of a grid, the largest first, for robots at poses (3,).

    Frontiers that the policy ignores, because it could not see anything new there, are among them.
    """
    cells = frontier_cells(grid, config.min_frontier)
    labels, count = ndimage.label(cells, structure=np.ones((3, 3), dtype=int))
    if not count:
        return []
    costs = [ways_from(pose[:2], grid, robot).cost for pose in poses]
    groups = sorted(
        (np.argwhere(labels == label) for label in range(1, count + 1)), key=len, reverse=True
    )
    return [
        (grid.centres(group), rounded([each[tuple(group.T)].min() for each in costs], 2))
        for group in groups[:MOST_GROUPS]
    ]
