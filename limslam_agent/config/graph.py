"""Settings of the graph of local maps, one frozen dataclass a stage. One setting serves all logs; m and rad."""

import math
from dataclasses import dataclass, field

_DEGREE = math.pi / 180.0


@dataclass(frozen=True)
class KeyPoseConfig:
    """Which poses of a log are estimated, and which of its scans are used.

    Attributes
    ----------
    distance, turn
        A new key pose begins after so much driving (m) or turning (rad).
    scan_distance, scan_turn
        A scan gives points only if the robot has moved (m) or turned (rad) so much since the last one that did.
    """

    distance: float = 0.25
    turn: float = 12.0 * _DEGREE
    scan_distance: float = 0.015
    scan_turn: float = 1.0 * _DEGREE


@dataclass(frozen=True)
class MotionConfig:
    """How far odometry is trusted, and what is known of its constant errors beforehand.

    Attributes
    ----------
    along, across
        Standard deviation of the motion in m for the square root of a metre driven.
    slip
        Of both in m for the square root of a radian turned.
    turn_per_metre, turn_per_radian
        Of the heading in rad for the square root of a metre driven and of a radian turned.
    least_position, least_turn
        Least standard deviations between two key poses, m and rad.
    bias_std
        Prior standard deviation of the heading that odometry misses on each metre, rad/m.
    scale_std, turn_gain_std
        Prior standard deviations of the shares by which distances and turns are wrong.
    """

    along: float = 0.05
    across: float = 0.05
    slip: float = 0.03
    turn_per_metre: float = 2.0 * _DEGREE
    turn_per_radian: float = 6.0 * _DEGREE
    least_position: float = 1e-3
    least_turn: float = 0.05 * _DEGREE
    bias_std: float = 1.5 * _DEGREE
    scale_std: float = 0.03
    turn_gain_std: float = 0.03


@dataclass(frozen=True)
class LinkConfig:
    """Normals of points, and links from points to the line through another point.

    Attributes
    ----------
    normal_radius, normal_travel
        Neighbours of a point within this distance (m) and this much driving (m) give its normal.
    min_neighbours, min_spread, max_thickness, max_ratio, min_incidence
        Fewest neighbours; least standard deviation along and largest across the line (m); largest ratio of the two
        variances; least sine of the angle between beam and wall.
    radius, min_travel, travel
        Points are linked within this distance (m) and between these lengths of driving (m).
    bands
        Inner borders of the bands of driving, m; the nearest point of each band is linked.
    min_cosine, max_offset
        Least cosine between the normals, and largest distance from the line as a share of ``radius``.
    std, kernel
        Standard deviation of a link (m), and the residual in standard deviations where the Geman-McClure kernel bends.
    cross_travel, cross_min_cosine
        Links between visits: least driving between the points (m), and least cosine between the normals.
    """

    normal_radius: float = 0.4
    normal_travel: float = 3.0
    min_neighbours: int = 5
    min_spread: float = 0.07
    max_thickness: float = 0.05
    max_ratio: float = 0.15
    min_incidence: float = 0.17
    radius: float = 0.35
    min_travel: float = 0.4
    travel: float = 10.0
    bands: tuple[float, float] = (1.2, 3.0)
    min_cosine: float = 0.85
    max_offset: float = 0.7
    std: float = 0.08
    kernel: float = 2.0
    cross_travel: float = 8.0
    cross_min_cosine: float = 0.8


@dataclass(frozen=True)
class WallLineConfig:
    """Straight walls found by a Hough transform in windows of driving.

    Attributes
    ----------
    window, first_window
        Length of a window (m), and of those of the first iteration; windows overlap by half.
    tolerance
        Largest distance of a point from its line, m.
    offset_bin, angle_bin, spread
        Bins of the Hough space (m, rad), and how many angle bins a point votes for on either side.
    min_points, min_length, max_gap, max_angle
        Fewest points, least length (m), largest gap along the line (m), largest angle between normals (rad).
    max_lines, max_tries
        Most lines in a window, and peaks looked at.
    std, inflation
        Standard deviation of a point about its line (m), and the factor by which it is enlarged.
    """

    window: float = 10.0
    first_window: float = 4.0
    tolerance: float = 0.12
    offset_bin: float = 0.08
    angle_bin: float = 3.0 * _DEGREE
    spread: int = 4
    min_points: int = 10
    min_length: float = 0.8
    max_gap: float = 1.5
    max_angle: float = 20.0 * _DEGREE
    max_lines: int = 25
    max_tries: int = 60
    std: float = 0.06
    inflation: float = 2.0


@dataclass(frozen=True)
class SmoothingConfig:
    """Iterations of the local smoothing with links alone, and with links and lines."""

    link_iterations: int = 5
    line_iterations: int = 10


@dataclass(frozen=True)
class LocalMapConfig:
    """Local maps: chunks of driving drawn into small grids.

    Attributes
    ----------
    half
        Driving to either side of a chunk's middle, m.
    hop
        Driving between the middles of successive chunks, m.
    cell, hit_radius
        Side of a cell, and how far around a point cells count as hit, m.
    """

    half: float = 3.5
    hop: float = 2.5
    cell: float = 0.1
    hit_radius: float = 0.15


@dataclass(frozen=True)
class MatchConfig:
    """Correlative matching of local maps.

    Attributes
    ----------
    block
        Width of the coarse search's blocks, cells.
    prior
        What a match at the border of its window loses, for shift and turn each.
    sharpness
        How a score's lack turns into likelihood, for each point.
    floor_position, floor_turn
        Least standard deviations of a match, m and rad.
    """

    block: int = 8
    prior: float = 0.05
    sharpness: float = 0.25
    floor_position: float = 0.06
    floor_turn: float = 1.2 * _DEGREE


@dataclass(frozen=True)
class LoopConfig:
    """Loops looked for along the way, and the agreement between loops that they need.

    Attributes
    ----------
    min_travel
        Least driving between two chunks of a loop, m.
    gate, gate_sigmas, max_distance
        Chunks are matched if their distance is below ``gate`` + ``gate_sigmas`` standard deviations, at most
        ``max_distance``; m.
    window, turn_window, turn_step
        Largest window of a match, m and rad, and the step of its turns, rad.
    least_window, least_turn
        What of it does not depend on the uncertainty, m and rad.
    score, backward_score
        Least score, and least score of the match the other way round.
    best
        Most loops that are taken from a chunk.
    agree_distance, agree_turn
        Two loops agree if one predicts the other so well, m and rad.
    support_from, support_to
        A supporting loop lies so much driving away, m.
    group_distance, group_turn, group_chunks
        Agreement within a group of loops, m and rad, between chunks so many apart.
    """

    min_travel: float = 10.0
    gate: float = 2.5
    gate_sigmas: float = 2.5
    max_distance: float = 12.0
    window: float = 4.0
    turn_window: float = 35.0 * _DEGREE
    turn_step: float = 3.0 * _DEGREE
    least_window: float = 0.6
    least_turn: float = 8.0 * _DEGREE
    score: float = 0.60
    backward_score: float = 0.50
    best: int = 3
    agree_distance: float = 0.6
    agree_turn: float = 9.0 * _DEGREE
    support_from: float = 2.2
    support_to: float = 7.8
    group_distance: float = 0.7
    group_turn: float = 10.0 * _DEGREE
    group_chunks: int = 3


@dataclass(frozen=True)
class ChunkGraphConfig:
    """The pose graph of the chunks.

    Attributes
    ----------
    hop_inflation, hop_position, hop_turn
        The covariance of a hop is that of the local graph times this, plus these standard deviations squared, m, rad.
    hop_kernel
        Chi-square where the Cauchy kernel of the hops bends.
    loop_kernel
        The parameter of dynamic covariance scaling (DCS) of the loops.
    annealing
        Factors of both kernels, one after the other.
    iterations, tolerance
        Most iterations for each factor, and the step (m, rad) below which they stop.
    kept
        Loops of a lower weight are not used further.
    """

    hop_inflation: float = 6.0
    hop_position: float = 0.03
    hop_turn: float = 1.0 * _DEGREE
    hop_kernel: float = 9.0
    loop_kernel: float = 3.0
    annealing: tuple[float, ...] = (1e4, 1e3, 300.0, 100.0, 30.0, 10.0, 3.0, 1.0)
    iterations: int = 8
    tolerance: float = 1e-3
    kept: float = 0.3


@dataclass(frozen=True)
class WideSearchConfig:
    """The search for places that were not recognised, with hardly any knowledge of where the robot is.

    Attributes
    ----------
    min_travel, max_distance
        Least driving between two chunks (m), and largest distance (m).
    window, turn_window, turn_step
        Of a match, m and rad.
    score
        Least score.
    neighbours, neighbour_window, neighbour_turn
        So many neighbouring chunks must match where predicted, within this window, m and rad.
    recognised
        Chunks so near to the end of a loop, counted in chunks, need no wide search.
    """

    min_travel: float = 15.0
    max_distance: float = 18.0
    window: float = 10.0
    turn_window: float = 100.0 * _DEGREE
    turn_step: float = 4.0 * _DEGREE
    score: float = 0.60
    neighbours: int = 3
    neighbour_window: float = 0.7
    neighbour_turn: float = 10.0 * _DEGREE
    recognised: int = 2


@dataclass(frozen=True)
class UnionConfig:
    """Matching of a chunk against the union of all chunks of other visits nearby.

    Attributes
    ----------
    radius, min_travel
        Chunks within this distance and more than this driving away make the union, m.
    window, turn_window, turn_step
        Of a match, m and rad.
    score
        Least score.
    recognised
        Chunks so near to the end of a loop, counted in chunks, are not matched.
    """

    radius: float = 8.0
    min_travel: float = 12.0
    window: float = 2.5
    turn_window: float = 20.0 * _DEGREE
    turn_step: float = 3.0 * _DEGREE
    score: float = 0.60
    recognised: int = 1


@dataclass(frozen=True)
class BundleConfig:
    """The least-squares problem of all key poses, walls, loops and links between visits.

    Attributes
    ----------
    radius, last_radius
        Points of other visits are linked within this distance in the first and in the last iteration, m.
    link_inflation, cross_inflation
        Factors of the standard deviations of links along the way and between visits.
    max_turn
        A step that turns a pose by more than this (rad) is scaled down.
    damping
        Share of the diagonal that is added to it.
    tolerance
        Iterations stop when no pose turns by more than this, rad.
    """

    radius: float = 0.4
    last_radius: float = 0.2
    link_inflation: float = 1.5
    cross_inflation: float = 2.0
    max_turn: float = 0.3
    damping: float = 1e-6
    tolerance: float = 1e-3


@dataclass(frozen=True)
class AgreementConfig:
    """The score without truth, and the decisions that rest on it.

    Attributes
    ----------
    min_travel, max_distance
        Chunks that are compared are more than this driving and less than this distance apart, m.
    gain
        A group of loops of the wide search is kept if the score rises by this.
    max_groups, max_group
        Most groups that are tried, and most loops of one.
    doubtful
        At most so many groups are tried without in a pass.
    prune_gain
        A group of loops is removed if the score rises by this without it.
    """

    min_travel: float = 13.5
    max_distance: float = 13.0
    gain: float = 0.001
    max_groups: int = 40
    max_group: int = 8
    doubtful: int = 8
    prune_gain: float = 0.002


@dataclass(frozen=True)
class RoundConfig:
    """Rounds in which everything is tested anew.

    Attributes
    ----------
    hops
        The hop between chunks in each round, as a share of ``LocalMapConfig.hop``.
    iterations
        Of the bundle, in each round.
    wide_search
        In how many rounds places are searched widely; afterwards the map is near enough for the union matching.
    trial, hopeless
        After so many rounds of both starts, the start whose score is worse by this is given up.
    settled
        Rounds end when the score rises by less and no new place was recognised.
    """

    hops: tuple[float, ...] = (1.0, 0.8, 1.0, 0.8)
    iterations: tuple[int, ...] = (6, 6, 6, 8)
    wide_search: int = 2
    trial: int = 2
    hopeless: float = 0.15
    settled: float = 0.002


@dataclass(frozen=True)
class GraphConfig:
    """All settings of the graph of local maps."""

    keys: KeyPoseConfig = field(default_factory=KeyPoseConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    links: LinkConfig = field(default_factory=LinkConfig)
    lines: WallLineConfig = field(default_factory=WallLineConfig)
    smoothing: SmoothingConfig = field(default_factory=SmoothingConfig)
    maps: LocalMapConfig = field(default_factory=LocalMapConfig)
    matching: MatchConfig = field(default_factory=MatchConfig)
    loops: LoopConfig = field(default_factory=LoopConfig)
    chunks: ChunkGraphConfig = field(default_factory=ChunkGraphConfig)
    wide: WideSearchConfig = field(default_factory=WideSearchConfig)
    union: UnionConfig = field(default_factory=UnionConfig)
    bundle: BundleConfig = field(default_factory=BundleConfig)
    agreement: AgreementConfig = field(default_factory=AgreementConfig)
    rounds: RoundConfig = field(default_factory=RoundConfig)
