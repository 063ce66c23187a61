"""The frontiers of a moment, and what it costs each robot to drive there."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from scipy import ndimage

from limslam_agent.config.presets import PolicyConfig
from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.grid.occupancy import GridView
from limslam_agent.policies.targets import ways_from
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

MOST_GROUPS = 24
"""Only so many frontiers are kept, the largest ones."""

Frontiers: TypeAlias = list[tuple[FloatArray, list[float | None]]]
"""Of each connected group of free cells beside unknown ones the centres of its cells (n, 2), m, and the cost of the
cheapest path of each robot, m, increased near walls; None where there is no path.
"""


def frontiers_of(grid: GridView, poses: Sequence[FloatArray], robot: RobotSpec, config: PolicyConfig) -> Frontiers:
    """All frontiers of a grid, the largest first, for robots at poses (3,).

    Frontiers that the policy ignores, because it could not see anything new there, are among them.
    """
    cells = frontier_cells(grid, config.min_frontier)
    labels, count = ndimage.label(cells, structure=np.ones((3, 3), dtype=int))
    if not count:
        return []
    costs = [ways_from(pose[:2], grid, robot).cost for pose in poses]
    groups = sorted((np.argwhere(labels == label) for label in range(1, count + 1)), key=len, reverse=True)
    return [
        (grid.centres(group), [_finite(float(each[tuple(group.T)].min())) for each in costs])
        for group in groups[:MOST_GROUPS]
    ]


def _finite(cost: float) -> float | None:
    return round(cost, 2) if np.isfinite(cost) else None
