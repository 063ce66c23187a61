"""Settings of exploration and of the occupancy grid. The unit is m or m/s.

The word "ours" marks a choice of this project.
"""

from dataclasses import dataclass
from typing import Annotated

from limslam_agent.config.bounds import Bounded, Bounds, Count, CountOrNone, Positive

UNTIL = ("seen", "walls")
"""When an exploration is over: when everything was seen, or when the walls are whole, too."""


@dataclass(frozen=True)
class GridConfig(Bounded):
    """The low-resolution occupancy grid. All ours.

    Attributes
    ----------
    cell
        Side of a cell, m.
    seen_through, hit
        What a beam adds to the cells that it crosses, and what it subtracts from the cell in which it ends.
    limit
        A cell's value stays between minus and plus this.
    """

    cell: Positive = 0.10
    seen_through: CountOrNone = 1
    hit: CountOrNone = 4
    limit: Annotated[int, Bounds(1, 10_000)] = 20


@dataclass(frozen=True)
class PolicyConfig(Bounded):
    """Exploration: when it is over, how fast the robot is, and which frontiers count. All ours.

    Attributes
    ----------
    until
        When exploration is over: when everything was ``seen``, so that there is no frontier left, or when the
        ``walls`` are whole, so that the robot has also looked at every stretch where free ground ends and the map has
        no wall.
    speed
        Cruising speed while exploring, m/s. A slower robot measures more points on each metre of wall.
    min_frontier
        Least number of cells of a frontier: smaller ones are mostly gaps between beams.
    """

    until: str = "seen"
    speed: Positive = 0.20
    min_frontier: Count = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.until not in UNTIL:
            raise ValueError(f"until must be {' or '.join(UNTIL)}, not {self.until!r}")
