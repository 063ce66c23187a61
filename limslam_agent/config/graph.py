"""Settings of the graph of local maps, one frozen dataclass for each stage. One setting serves all logs; m and rad.

Numbers that nothing sets are constants beside the code (:mod:`limslam_agent.slam.graph`).
"""

import math
from dataclasses import dataclass, field

from limslam_agent.config.bounds import Angle, Bounded, Count, CountOrNone, NonNegative, Positive

_DEGREE = math.pi / 180.0


@dataclass(frozen=True)
class KeyPoseConfig(Bounded):
    """The choice of the poses of a log that are estimated, and of the scans that are used.

    Attributes
    ----------
    distance, turn
        A new key pose begins after this distance driven (m) or this turn (rad).
    scan_distance, scan_turn
        A scan gives points only after this motion (m) or turn (rad) since the last scan that gave points.
    points_per_metre
        Largest number of points for each metre driven. Of more points, those of every k-th beam are used, of other
        beams in each scan.
    """

    distance: Positive = 0.25
    turn: Angle = 12.0 * _DEGREE
    scan_distance: NonNegative = 0.015
    scan_turn: Angle = 1.0 * _DEGREE
    points_per_metre: Positive = 140.0


@dataclass(frozen=True)
class MotionConfig(Bounded):
    """The uncertainty of odometry, and the prior of its constant errors.

    Attributes
    ----------
    along, across
        Standard deviation of the motion, m per square root of a metre driven.
    slip
        Standard deviation of both components, m per square root of a radian turned.
    turn_per_metre, turn_per_radian
        Standard deviation of the heading, rad per square root of a metre driven and of a radian turned.
    least_position, least_turn
        Least standard deviations between two key poses, m and rad.
    bias_std
        Prior standard deviation of the missing heading of odometry per metre, rad/m.
    scale_std, turn_gain_std
        Prior standard deviations of the relative errors of distances and turns.
    delay_std
        Prior standard deviation of the time by which ranges are older than odometry, s.
    direction_std
        Prior standard deviation of the angle between the direction of driving and ahead in the frame of the beams, rad.
    """

    along: NonNegative = 0.05
    across: NonNegative = 0.05
    slip: NonNegative = 0.03
    turn_per_metre: NonNegative = 2.0 * _DEGREE
    turn_per_radian: NonNegative = 6.0 * _DEGREE
    least_position: Positive = 1e-3
    least_turn: Angle = 0.05 * _DEGREE
    bias_std: Positive = 1.5 * _DEGREE
    scale_std: Positive = 0.03
    turn_gain_std: Positive = 0.03
    delay_std: Positive = 0.1
    direction_std: Angle = 2.0 * _DEGREE


@dataclass(frozen=True)
class WallLineConfig(Bounded):
    """Straight walls, found by a Hough transform in windows of distance driven.

    Attributes
    ----------
    window
        Length of a window, m; windows overlap by half.
    tolerance
        Largest distance of a point from its line, m.
    angle_bin, spread
        Bin of the Hough space, rad, and the number of these bins on either side that a point votes for.
    min_points, min_length, max_gap
        Fewest points, least length and largest gap along the line, m.
    max_lines, max_tries
        Largest number of lines in a window, and largest number of peaks that are tested.
    """

    window: Positive = 10.0
    tolerance: NonNegative = 0.12
    angle_bin: Positive = 3.0 * _DEGREE
    spread: Count = 4
    min_points: Count = 10
    min_length: NonNegative = 0.8
    max_gap: NonNegative = 1.5
    max_lines: Count = 25
    max_tries: Count = 60


@dataclass(frozen=True)
class SmoothingConfig(Bounded):
    """Number of iterations of the local smoothing with links alone, and with links and lines."""

    link_iterations: Count = 5
    line_iterations: Count = 10


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
class ReversingConfig(Bounded):
    """The search for stretches that were driven backwards although odometry never says so.

    Attributes
    ----------
    reach
        Logs whose beams reach less are not judged, m: they see too little of the ground ahead of a stop.
    unsigned
        Odometry counts as never reporting it if at most this share of the path is driven backwards by odometry.
    slow
        The robot may turn round where it is slower than this share of its median speed.
    least
        Stretches between such events that are shorter than this are not judged, m.
    before, after, beyond
        The last metres before a stretch are compared with its first metres, and with this distance beyond a short
        stretch, m.
    window, turn_window
        The window of a match, m and rad.
    score, lead, lead_per_metre
        A stretch was driven backwards if this fits with at least this score, and better than driving ahead by ``lead``
        and by ``lead_per_metre`` for each metre, since in a corridor both directions fit.
    contradicted, fewest
        Odometry has no sign if at least ``fewest`` of these stretches contradict that they were driven ahead: at least
        this share of their points would lie where only free space was seen before.
    """

    reach: NonNegative = 2.5
    unsigned: NonNegative = 1e-3
    slow: NonNegative = 0.35
    least: NonNegative = 0.15
    before: Positive = 3.5
    after: Positive = 2.0
    beyond: NonNegative = 1.0
    window: Positive = 0.4
    turn_window: Angle = 9.0 * _DEGREE
    score: NonNegative = 0.45
    lead: NonNegative = 0.12
    lead_per_metre: NonNegative = 0.06
    contradicted: NonNegative = 0.03
    fewest: Count = 2


@dataclass(frozen=True)
class RoundConfig(Bounded):
    """Rounds in which all loops are tested anew.

    Attributes
    ----------
    hops
        The hop between chunks in each round, as a share of ``LocalMapConfig.hop``.
    iterations
        Number of iterations of the bundle in each round.
    orientations
        First headings of the log in the frames of the searches, rad: they decide the bins of the Hough transforms.
    restarts
        If odometry misses much of its heading, its errors are corrected and the log is smoothed again, at most this
        number of times. The result is kept if its score is higher.
    """

    hops: tuple[float, ...] = (1.0, 0.8) * 5
    iterations: tuple[int, ...] = (6, 6, 6, 8, 8, 8, 8, 8, 8, 8)
    orientations: tuple[float, ...] = (0.0, 20.0 * _DEGREE, 45.0 * _DEGREE, 70.0 * _DEGREE)
    restarts: CountOrNone = 3


@dataclass(frozen=True)
class GraphConfig(Bounded):
    """All settings of the graph of local maps."""

    reversing: ReversingConfig = field(default_factory=ReversingConfig)
    keys: KeyPoseConfig = field(default_factory=KeyPoseConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    lines: WallLineConfig = field(default_factory=WallLineConfig)
    smoothing: SmoothingConfig = field(default_factory=SmoothingConfig)
    maps: LocalMapConfig = field(default_factory=LocalMapConfig)
    rounds: RoundConfig = field(default_factory=RoundConfig)
