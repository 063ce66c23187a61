"""Settings of map merging: when two logs become one map. Lengths are in metres, angles in radians.

They can be changed in Python only: a settings file has no table for them.
"""

import math
from dataclasses import dataclass, field

from limslam_agent.config.bounds import Angle, Bounded, Count, NonNegative, Positive, Share
from limslam_agent.config.graph_loops import LocalMapConfig

_DEGREE = math.pi / 180.0


@dataclass(frozen=True)
class MapMergingConfig(Bounded):
    """How a log is placed in another log, and when the placement counts.

    Attributes
    ----------
    pieces
        Local maps of the second log that are matched with the whole map of the first log. They are longer than the
        chunks of the graph, because nothing is known about their place.
    coarse
        Side of a cell of the first search, m.
    turn_step
        Step of the turns of the first search, rad.
    likely
        Turns are searched at which the walls of both logs agree at least so well, as a share of the best turn.
    peaks
        Number of places of a local map that are kept.
    coarse_score, score
        Least scores of a place in the first search, and after its refinement.
    agree_distance, agree_growth, agree_turn
        Two local maps agree if the place of one predicts the place of the other within this distance, m, which grows by
        a share of the distance between them, and within this turn, rad.
    placements
        Number of placements that are compared.
    contradiction
        Price of a contradicted point, in confirmed points.
    spread
        Least distance driven between local maps that agree, m: with less, they share most of their readings.
    least_points
        Least number of points of walls that the other log confirms. Points of overlapping local maps count repeatedly.
    placed_contradicted, joined_contradicted
        Largest share of contradicted points among those that the other log has seen: of a placement, and of the
        smoothed map of both logs.
    runner_up
        Largest value of another placement, as a share of the best one.
    discount, discounted
        The value of another placement counts only for the share ``discount`` if its share of contradicted points is
        larger than that of the best placement by more than ``discounted``.
    least_loops
        Least number of loops between the logs in the smoothed map.
    fall
        Largest fall of the score G of each log by itself.
    """

    pieces: LocalMapConfig = field(default_factory=lambda: LocalMapConfig(half=6.0, hop=4.0))
    coarse: Positive = 0.2
    turn_step: Angle = 3.0 * _DEGREE
    likely: Share = 0.6
    peaks: Count = 25
    coarse_score: NonNegative = 0.5
    score: NonNegative = 0.55
    agree_distance: Positive = 0.7
    agree_growth: NonNegative = 0.05
    agree_turn: Angle = 9.0 * _DEGREE
    placements: Count = 30
    contradiction: NonNegative = 2.0
    spread: NonNegative = 8.0
    least_points: Count = 600
    placed_contradicted: Share = 0.25
    joined_contradicted: Share = 0.2
    runner_up: Share = 0.5
    discount: Share = 0.5
    discounted: Share = 0.03
    least_loops: Count = 3
    fall: NonNegative = 0.1
