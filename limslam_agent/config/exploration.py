"""Settings of exploration and of teams: m, m/s and rad."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TeamConfig:
    """Several robots: beams that may have hit another one, and who looks again.

    Attributes
    ----------
    sigmas
        How many standard deviations of the other's believed place are allowed for. Ours.
    slack
        What is added to that. Ours: the published filter is surer of itself than it should be.
    news
        A robot that had nothing left to do looks again when the others have found more cells than this. Ours.
    """

    sigmas: float = 3.0
    slack: float = 0.05
    news: int = 50


@dataclass(frozen=True)
class GridConfig:
    """The low-resolution occupancy grid.

    Attributes
    ----------
    cell
        Side of a cell. Ours.
    seen_through, hit
        What a beam adds to the cells that it crosses, and takes off the cell in which it ends. Ours.
    limit
        Values stay within plus and minus this. Ours.
    """

    cell: float = 0.10
    seen_through: int = 1
    hit: int = 4
    limit: int = 20


@dataclass(frozen=True)
class PolicyConfig:
    """Where to go and how to get there. All ours.

    Attributes
    ----------
    speed
        Cruising speed while exploring, m/s: slower means more points a metre, and better lines.
    lap_speed
        Cruising speed on laps, m/s.
    turn_rate
        Fastest turn, rad/s.
    lookahead
        Distance of the point on the path that is steered for.
    clearance
        Distance that the planner keeps between the robot's rim and occupied cells if it can.
    margin
        Distance that it keeps unless there is no other way.
    stop_distance
        Free distance ahead of the rim below which the robot only turns.
    min_frontier
        Cells; smaller frontiers are mostly gaps between beams.
    min_last_frontier
        Cells; the smallest frontiers that are gone to when no others are left. Across a corridor of twice
        the robot's width lie but two.
    view_distance
        A frontier cell counts as reached when the way to it is this short.
    far_view_distance, small_frontier
        A frontier of no more than so many cells is looked at from this far, where nothing stands between.
    replan_period
        Steps between two plans.
    patience
        Steps that the robot stands in front of something before it tries something else. Without getting nearer or
        seeing anything new it goes on for three times as long.
    back_steps
        Steps that it then drives back.
    aside_steps
        Steps for which a goal that could not be reached is left alone.
    """

    speed: float = 0.20
    lap_speed: float = 0.25
    turn_rate: float = 2.0
    lookahead: float = 0.25
    clearance: float = 0.15
    margin: float = 0.05
    stop_distance: float = 0.06
    min_frontier: int = 3
    min_last_frontier: int = 2
    view_distance: float = 0.35
    far_view_distance: float = 1.0
    small_frontier: int = 6
    replan_period: int = 5
    patience: int = 30
    back_steps: int = 8
    aside_steps: int = 300
