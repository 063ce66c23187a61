"""An explorer of another form, for laser scanners: ``limslam run --robot lidar --policy
examples/nearest_node.py:NearestNode``.

It knows no robot and no wheels. From the map and the pose it says where to drive to next.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from limslam_agent.grid.occupancy import GridView

Array = NDArray[Any]

SPACING = 2  # cells between two nodes
SIGHT = 12  # cells within which a node sees a frontier
FEWEST = 3  # cells of frontiers that make a node worth a visit
STEPS = ((0, SPACING), (SPACING, 0), (SPACING, SPACING), (SPACING, -SPACING))


class NearestNode:
    """Drive to the nearest node of a graph that was not visited and sees frontiers."""

    def __init__(self) -> None:
        self._visited = set[tuple[int, ...]]()

    def target(self, grid: GridView, pose: Array) -> Array | None:
        """The place of that node (2,), m. None if there is none."""
        free = grid.values > 0
        frontier = np.argwhere(free & ndimage.binary_dilation(grid.values == 0, border_value=1))
        corner = np.rint(grid.low[::-1] / grid.cell).astype(int)
        inside = np.argwhere(ndimage.binary_erosion(free, np.ones((3, 3), dtype=bool)))
        nodes = inside[((inside + corner) % SPACING == 0).all(axis=1)]
        if not len(nodes):
            return None
        number = {tuple(cell): index for index, cell in enumerate(nodes)}
        edges = [
            (number[tuple(cell)], number[tuple(cell + step)], np.hypot(*step))
            for cell in nodes
            for step in STEPS
            if tuple(cell + step) in number and sees(free, cell, cell + step)
        ]
        starts, ends, lengths = np.array(edges).reshape(-1, 3).T
        graph = coo_array((lengths, (starts.astype(int), ends.astype(int))), (len(nodes),) * 2)
        away = np.hypot(*(grid.centres(nodes) - pose[:2]).T)
        here = away.argmin()
        self._visited |= {tuple(cell + corner) for cell in nodes[away < 0.12]}
        ways = dijkstra(graph.tocsr(), directed=False, indices=here)
        for index in np.argsort(ways)[: np.isfinite(ways).sum()]:
            cell = nodes[index]
            near = frontier[np.hypot(*(frontier - cell).T) <= SIGHT]
            is_new = tuple(cell + corner) not in self._visited
            if is_new and sum(sees(free, cell, each) for each in near) >= FEWEST:
                place: Array = grid.centres(cell[None])[0]
                return place
        return None


def sees(free: Array, one: Array, other: Array) -> bool:
    """Whether all cells between two cells are free."""
    count = 2 * int(np.abs(other - one).max()) + 1
    cells = np.rint(np.linspace(one, other, count)).astype(int)
    return bool(free[tuple(cells.T)].all())
