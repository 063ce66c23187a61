"""Settings of loops in the graph of local maps: how they are found, tested and closed; m and rad."""

import math
from dataclasses import dataclass

from limslam_agent.config.bounds import Angle, Bounded, Count, NonNegative, Positive

_DEGREE = math.pi / 180.0


@dataclass(frozen=True)
class LocalMapConfig(Bounded):
    """Local maps: chunks of driving drawn into small grids.

    Attributes
    ----------
    half
        Distance driven on either side of a chunk's middle, m.
    hop
        Distance driven between the middles of successive chunks, m.
    cell, hit_radius
        Side of a cell, and radius around a point in which cells are occupied, m.
    """

    half: Positive = 3.5
    hop: Positive = 2.5
    cell: Positive = 0.1
    hit_radius: NonNegative = 0.15


@dataclass(frozen=True)
class MatchConfig(Bounded):
    """Correlative matching of local maps.

    Attributes
    ----------
    block
        Width of the search's smallest blocks, cells.
    prior
        Penalty of a match at the border of its window, for shift and for turn.
    sharpness
        Factor from a difference in score to a difference in log-likelihood, for each point.
    floor_position, floor_turn
        Least standard deviations of a match, m and rad.
    """

    block: Count = 4
    prior: NonNegative = 0.05
    sharpness: NonNegative = 0.25
    floor_position: NonNegative = 0.06
    floor_turn: Angle = 1.2 * _DEGREE


@dataclass(frozen=True)
class LoopConfig(Bounded):
    """Loops along the way, and the agreement with other loops that a loop needs.

    Attributes
    ----------
    min_travel
        Least distance driven between two chunks of a loop, m.
    gate, gate_sigmas, max_distance
        Chunks are matched if their distance is below ``gate`` + ``gate_sigmas`` standard deviations, at most
        ``max_distance``; m.
    window, turn_window, turn_step
        Largest window of a match, m and rad, and the step of its turns, rad.
    least_window, least_turn
        The part of the window that does not depend on the uncertainty, m and rad.
    score, backward_score
        Least score, and least score of the match in the opposite direction.
    best
        Largest number of loops from one chunk.
    agree_distance, agree_turn
        Two loops agree if one loop predicts the other loop within these tolerances, m and rad.
    support_from, support_to
        Least and largest distance driven to a supporting loop, m.
    group_distance, group_turn, group_chunks
        Tolerances of agreement within a group of loops, m and rad, and largest distance between their chunks, in
        chunks.
    """

    min_travel: NonNegative = 10.0
    gate: NonNegative = 2.5
    gate_sigmas: NonNegative = 2.5
    max_distance: NonNegative = 12.0
    window: Positive = 4.0
    turn_window: Angle = 35.0 * _DEGREE
    turn_step: Positive = 3.0 * _DEGREE
    least_window: NonNegative = 0.6
    least_turn: Angle = 8.0 * _DEGREE
    score: NonNegative = 0.60
    backward_score: NonNegative = 0.50
    best: Count = 3
    agree_distance: NonNegative = 0.6
    agree_turn: Angle = 9.0 * _DEGREE
    support_from: NonNegative = 2.2
    support_to: NonNegative = 7.8
    group_distance: NonNegative = 0.7
    group_turn: Angle = 10.0 * _DEGREE
    group_chunks: Count = 3


@dataclass(frozen=True)
class ChunkGraphConfig(Bounded):
    """The pose graph of the chunks.

    Attributes
    ----------
    hop_inflation, hop_position, hop_turn
        The covariance of a hop is the local graph's covariance times this, plus these standard deviations squared; m,
        rad.
    hop_kernel
        Scale of the Cauchy kernel of the hops, as a chi-square.
    loop_kernel
        The parameter of dynamic covariance scaling (DCS) of the loops.
    annealing, refining
        Successive factors of both kernels: from the chain of hops, and from a solution that is nearly right.
    iterations, tolerance
        Largest number of iterations for each factor, and the step (m, rad) below which iteration stops.
    kept
        Loops with a lower weight are not used further.
    bent
        A hop that differs from the local smoothing by a larger chi-square follows it again at the beginning of a round.
    """

    hop_inflation: NonNegative = 6.0
    hop_position: NonNegative = 0.03
    hop_turn: Angle = 1.0 * _DEGREE
    hop_kernel: Positive = 9.0
    loop_kernel: Positive = 3.0
    annealing: tuple[float, ...] = (1e4, 1e3, 300.0, 100.0, 30.0, 10.0, 3.0, 1.0)
    refining: tuple[float, ...] = (10.0, 3.0, 1.0)
    iterations: Count = 8
    tolerance: NonNegative = 1e-3
    kept: NonNegative = 0.3
    bent: NonNegative = 25.0


@dataclass(frozen=True)
class WideSearchConfig(Bounded):
    """The search for places that were not recognised, with a very uncertain pose of the robot.

    Attributes
    ----------
    min_travel, max_distance
        Least distance driven between two chunks (m), and largest distance between them (m).
    window, turn_window, turn_step
        Largest window of a match, m and rad, and the step of its turns, rad.
    least_window, least_turn, sigmas
        The part of the window that does not depend on the uncertainty (m, rad), and the number of standard deviations
        added.
    near
        Chunks are compared up to this distance beyond the window, m, where two chunks can show the same place.
    score
        Least score.
    neighbours, neighbour_window, neighbour_turn
        Number of neighbouring chunks that must match where predicted, within this window, m and rad.
    recognised
        Chunks within this number of chunks of the end of a loop need no wide search.
    """

    min_travel: NonNegative = 15.0
    max_distance: NonNegative = 18.0
    window: Positive = 10.0
    turn_window: Angle = 100.0 * _DEGREE
    turn_step: Positive = 4.0 * _DEGREE
    least_window: NonNegative = 1.5
    least_turn: Angle = 20.0 * _DEGREE
    sigmas: NonNegative = 4.0
    near: NonNegative = 3.0
    score: NonNegative = 0.60
    neighbours: Count = 3
    neighbour_window: NonNegative = 0.7
    neighbour_turn: Angle = 10.0 * _DEGREE
    recognised: Count = 2


@dataclass(frozen=True)
class UnionConfig(Bounded):
    """Matching of a chunk against the union of all chunks of other visits nearby.

    Attributes
    ----------
    radius, min_travel
        Chunks within this distance, and with more than this distance driven between, form the union, m.
    window, turn_window, turn_step
        Largest window of a match, m and rad, and the step of its turns, rad.
    score
        Least score.
    recognised
        Chunks within this number of chunks of the end of a loop are not matched.
    """

    radius: Positive = 8.0
    min_travel: NonNegative = 12.0
    window: Positive = 2.5
    turn_window: Angle = 20.0 * _DEGREE
    turn_step: Positive = 3.0 * _DEGREE
    score: NonNegative = 0.60
    recognised: Count = 1


@dataclass(frozen=True)
class AgreementConfig(Bounded):
    """The score without ground truth, and the decisions that use it.

    Attributes
    ----------
    min_travel, max_distance
        Chunks are compared if the distance driven between them is larger and their distance is smaller than this, m.
    gain
        A group of loops of the wide search is accepted if the score rises by at least this.
    max_groups, max_group
        Largest number of groups that are tried, and largest number of loops in a group.
    doubtful
        Largest number of groups whose removal is tried in a pass.
    prune_gain
        A group of loops is removed if its removal raises the score by this.
    strain
        By how much a mean chi-square of 1 between hops and local smoothing, after the kernel, lowers the score.
    doubtful_share
        A group of loops is refused if other visits contradict a larger share of the points that they confirm or
        contradict because of it, and much more than is usual.
    """

    min_travel: NonNegative = 13.5
    max_distance: NonNegative = 13.0
    gain: NonNegative = 0.001
    max_groups: Count = 40
    max_group: Count = 8
    doubtful: Count = 8
    prune_gain: NonNegative = 0.002
    strain: NonNegative = 0.1
    doubtful_share: NonNegative = 0.12
