"""Settings of exploration, of the occupancy grid and of teams. The unit is m, m/s or rad.

The word "ours" marks a choice of this project.
"""

from dataclasses import dataclass
from typing import Annotated

from limslam_agent.config.bounds import Bounded, Bounds, Count, CountOrNone, NonNegative, Positive

UNTIL = ("seen", "walls")
"""When an exploration is over: when everything was seen, or when the walls are whole, too."""


@dataclass(frozen=True)
class TeamConfig(Bounded):
    """Several robots: which beams may have hit a teammate, and when a robot that had finished explores again.

    Attributes
    ----------
    sigmas
        A beam is dropped if it may have hit a teammate whose pose errs by this many standard deviations. Ours.
    slack
        Length that is added to that distance, m. Ours: the covariance of the published filter is too small.
    """

    sigmas: NonNegative = 3.0
    slack: NonNegative = 0.05


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
    """Exploration: which frontier the robot drives to, and how it drives there. All ours.

    Attributes
    ----------
    until
        When exploration is over: when everything was ``seen``, so that there is no frontier left, or when the
        ``walls`` are whole, so that the robot has also looked at every stretch where free ground ends and the map has
        no wall.
    speed
        Cruising speed while exploring, m/s. A slower robot measures more points on each metre of wall.
    turn_rate
        Fastest turn, rad/s.
    clearance
        Distance that the planner keeps between the robot's rim and occupied cells where there is enough space, m.
    margin
        Distance that it keeps unless there is no other path, m.
    large_map
        Size of the map, m, from which on a metre of path without a wall in sight costs three times as much. Paths then
        stay near walls, and frontiers near walls are explored first.
    longest_excursion
        Distance that the robot drives without a wall in sight before it comes back to a wall of the map, m. A frontier
        that is farther away from all walls is approached all the same.
    stop_distance
        Free distance ahead of the rim below which the robot only turns, m.
    min_frontier
        Least number of cells of a frontier: smaller ones are mostly gaps between beams.
    view_distance
        A frontier cell counts as reached when the path to it is this short, m.
    small_frontier
        A frontier of at most this number of cells counts as reached from 1 m, if nothing stands between the robot and
        the frontier.
    patience
        Number of steps for which the robot waits in front of an obstacle before it tries another way. Three times as
        many steps without progress end the approach of a goal.
    looks, min_stretch_again
        Largest number of looks at one stretch, and least length of a stretch that is looked at more than once, m.
    """

    until: str = "seen"
    speed: Positive = 0.20
    turn_rate: Annotated[float, Bounds(0.01, 100.0)] = 2.0
    clearance: NonNegative = 0.15
    margin: NonNegative = 0.05
    large_map: NonNegative = 12.0
    longest_excursion: NonNegative = 8.0
    stop_distance: NonNegative = 0.06
    min_frontier: Count = 3
    view_distance: NonNegative = 0.35
    small_frontier: CountOrNone = 6
    patience: Count = 30
    looks: Count = 2
    min_stretch_again: NonNegative = 0.35

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.until not in UNTIL:
            raise ValueError(f"until must be {' or '.join(UNTIL)}, not {self.until!r}")
