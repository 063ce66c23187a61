"""Settings of the agent, one frozen dataclass a stage, and the presets that put them together.

Lengths are in metres, angles in radians unless a name says degrees. The paper gives hardly a
number; where a comment says "ours", the choice is this project's, tuned on seeds that are not
reported.
"""

import math
from dataclasses import dataclass, field

from limslam_env.interface import NominalNoise


@dataclass(frozen=True)
class OdometryConfig:
    """The motion of a log that holds odometry poses instead of wheel travel.

    Attributes
    ----------
    distance_variance
        Variance of the travelled distance, m^2 per metre.
    turn_variance_per_metre
        Variance of the heading, rad^2 per metre driven.
    turn_variance_per_radian
        Variance of the heading, rad^2 per radian turned.
    turn_bias
        True minus reported heading for each metre driven, rad per metre.
    distance_scale
        True distance over reported distance.
    """

    distance_variance: float = 0.05**2
    turn_variance_per_metre: float = math.radians(0.8) ** 2
    turn_variance_per_radian: float = math.radians(4.0) ** 2
    turn_bias: float = 0.0
    distance_scale: float = 1.0


@dataclass(frozen=True)
class BufferConfig:
    """The pseudo-dense scans.

    Attributes
    ----------
    size
        Points at which a buffer is handed on. Ours.
    min_distance, min_turn
        A side takes no new points before the robot has driven or turned this far. Ours: points
        measured while standing still say nothing new about a line.
    max_gap
        Distance driven without a measurement after which the wall has ended: what is in the
        buffer is handed on and the next measurement begins a new wall. Ours.
    """

    size: int = 30
    min_distance: float = 0.01
    min_turn: float = math.radians(1.0)
    max_gap: float = 0.25


@dataclass(frozen=True)
class HoughConfig:
    """Lines in a buffer of points.

    Attributes
    ----------
    theta_step
        Angle bins. Ours.
    r_step
        Distance bins; never finer than three standard deviations of the ranges, because the
        votes of one wall would split. Ours.
    min_votes
        The threshold: *every* line with this many votes is taken, not only the best. Ours.
    max_offset
        Points this far from a line belong to it, or 2.5 standard deviations if that is more. Ours.
    max_gap
        A hole in a line's points that makes two pieces of it. Ours.
    min_length
        Shorter pieces are no walls. Ours.
    only_best
        Ablation: take only the line with the most votes.
    """

    theta_step: float = math.radians(2.0)
    r_step: float = 0.02
    min_votes: int = 8
    max_offset: float = 0.03
    max_gap: float = 0.30
    min_length: float = 0.25
    only_best: bool = False


@dataclass(frozen=True)
class AssociationConfig:
    """When an observed line is a landmark that is known already.

    Attributes
    ----------
    gate
        Largest squared Mahalanobis distance. Ours: wider than chi-square's, because the published filter is
        surer of itself than it should be.
    max_end_gap
        Largest distance along the wall between the observation and the landmark's end points. Ours: a little
        more than the gap that ends a wall in the buffer. `ablations` leaves this gate out.
    max_angle, max_distance
        Largest difference of direction, and distance of the observation's middle from the line. Ours.
    range_slack
        How far past its sensors' range a landmark may lie and still count as seen. Ours.
    min_new_length
        An observation that is no known landmark becomes a new one when it is at least this long. Ours:
        the direction of a short stretch is poorly known, and everything later leans on it.
    min_new_share
        The same as a share of the sensors' reach: those who see farther take their points farther apart. Ours.
    """

    gate: float = 16.0
    max_end_gap: float = 0.35
    max_angle: float = math.radians(15.0)
    max_distance: float = 0.35
    range_slack: float = 0.25
    min_new_length: float = 0.30
    min_new_share: float = 0.14


@dataclass(frozen=True)
class LoopClosingConfig:
    """When the two landmarks nearest to an observation are one wall.

    Attributes
    ----------
    enabled
        False is the ablation without loop closing.
    gate
        Largest squared Mahalanobis distance between the two. Ours.
    min_overlap
        They must share at least this length of wall. Ours: two walls on one line with a door between them
        share none.
    max_angle, max_distance
        Largest difference of direction, and distance of the younger's middle from the older's line. Ours.
    floor_distance, floor_angle
        Least standard deviations that the difference of two landmarks is credited with, m and rad. Ours.
    """

    enabled: bool = True
    gate: float = 12.0
    min_overlap: float = 0.20
    max_angle: float = math.radians(15.0)
    max_distance: float = 0.35
    floor_distance: float = 0.01
    floor_angle: float = math.radians(0.5)


@dataclass(frozen=True)
class MapConfig:
    """When a landmark is a wall of the map. Until then it is provisional: used, but not shown.

    Attributes
    ----------
    min_observations
        Observed lines that it must be made of. Ours.
    min_length
        Its least length. Ours.
    """

    min_observations: int = 2
    min_length: float = 0.30


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
class FilterConfig:
    """The extended Kalman filter.

    Attributes
    ----------
    min_range_std
        Least standard deviation that a range is credited with, m; quantities are never exact.
    drift_share
        Besides its fit's covariance, an observed line is credited in angle with this share of the variance that
        odometry's heading has gathered since its points were measured. Ours; 0 is the fit alone.
    correct
        False is the ablation without a filter: lines are drawn at the odometry's poses.
    """

    min_range_std: float = 0.005
    drift_share: float = 1.0
    correct: bool = True


@dataclass(frozen=True)
class StraightConfig:
    """When readings about one line are no straight wall (consistent estimator). All ours.

    Attributes
    ----------
    kink_gate, min_kink
        Chi-square (one degree of freedom) gained by a kink, and the least angle of one, rad.
    curve_gate
        Chi-square (three degrees of freedom) gained by a smooth curve.
    end_zone, end_gate
        Points within this far of an end, m, are another wall's if it gains so much chi-square to have them aside.
    """

    kink_gate: float = 12.0
    min_kink: float = math.radians(8.0)
    curve_gate: float = 14.0
    end_zone: float = 0.10
    end_gate: float = 6.0


@dataclass(frozen=True)
class CloneConfig:
    """The consistent estimator: readings wait until it is clear which wall they show. All ours.

    Attributes
    ----------
    batch
        New readings of a side after which it looks for lines.
    max_age
        Readings that have waited for this long, m driven, are given up.
    max_clones
        More are not kept.
    wall_end
        Distance driven without a hit after which a wall has ended.
    passed
        A piece of wall of which nothing was seen for this far, m driven, is complete.
    new_length, new_length_noisy
        Least length of a new landmark, for exact ranges and for noisy ones (std of 1 cm or more), m.
    new_length_complete
        The same for a complete piece.
    max_angle_std
        Of a new landmark, rad.
    gate
        Largest chi-square (two degrees of freedom) by which readings may disagree with a landmark.
    far_gate
        Readings between the two gates are neither of the landmark nor of a new one.
    left_sigmas
        Of what is left unexplained, in standard deviations of its chi-square.
    ambiguity
        Readings that a second landmark explains as well but for this chi-square are left out.
    min_length
        Shorter pieces are not used, m.
    end_slack, beyond_length, beyond_gate, beyond_angle_std
        Readings mostly more than ``end_slack`` beyond a landmark's known ends must be so long a piece, fit this well,
        and have a direction known this well.
    max_end_gap, max_angle, max_offset
        Limits for readings and a landmark, and for two landmarks, before anything is computed: m, rad, m.
    huber
        Standard deviations beyond which a reading counts less.
    iterations, first_iterations
        Of the iterated update, for a known landmark and a new one.
    one_wall_gate, min_overlap
        Two landmarks are one wall below this chi-square, if they share so much of it, m.
    through_sigmas, through_slack
        A beam has gone through a wall if it went on for so many standard deviations and so far beyond it.
    max_gap, through_tolerance
        What is drawn as one piece: holes that nobody looked at, m, and beams that passed for each one that hit.
    shown_readings, shown_length
        A landmark is a wall of the map if it was read this often and is so long, m.
    beams
        At most so many beams of a side are used in a step.
    gap_ahead
        Hole between points of the beams ahead that may be one wall, m.
    """

    batch: int = 12
    max_age: float = 1.5
    max_clones: int = 70
    wall_end: float = 0.25
    passed: float = 0.15
    new_length: float = 0.7
    new_length_noisy: float = 1.0
    new_length_complete: float = 0.25
    max_angle_std: float = math.radians(3.0)
    gate: float = 16.0
    far_gate: float = 25.0
    left_sigmas: float = 3.0
    ambiguity: float = 9.0
    min_length: float = 0.20
    end_slack: float = 0.05
    beyond_length: float = 0.30
    beyond_gate: float = 9.0
    beyond_angle_std: float = math.radians(4.0)
    max_end_gap: float = 0.35
    max_angle: float = math.radians(20.0)
    max_offset: float = 0.5
    huber: float = 1.5
    iterations: int = 2
    first_iterations: int = 4
    one_wall_gate: float = 16.0
    min_overlap: float = 0.15
    through_sigmas: float = 3.0
    through_slack: float = 0.05
    max_gap: float = 0.30
    through_tolerance: float = 1.0
    shown_readings: int = 10
    shown_length: float = 0.20
    beams: int = 8
    gap_ahead: float = 0.9
    hough: HoughConfig = field(default_factory=lambda: HoughConfig(min_length=0.20))
    straight: StraightConfig = field(default_factory=StraightConfig)


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


@dataclass(frozen=True)
class AgentConfig:
    """Everything that an agent is told, besides its robot.

    Attributes
    ----------
    preset
        Name of the preset that these settings began as.
    estimator
        ``published`` or ``consistent``: how readings become a map.
    noise
        Nominal noise of the robot, as its builder knows it.
    """

    preset: str = "paper"
    estimator: str = "published"
    noise: NominalNoise = field(default_factory=NominalNoise)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    buffer: BufferConfig = field(default_factory=BufferConfig)
    hough: HoughConfig = field(default_factory=HoughConfig)
    association: AssociationConfig = field(default_factory=AssociationConfig)
    closing: LoopClosingConfig = field(default_factory=LoopClosingConfig)
    filter: FilterConfig = field(default_factory=FilterConfig)
    map: MapConfig = field(default_factory=MapConfig)
    team: TeamConfig = field(default_factory=TeamConfig)
    grid: GridConfig = field(default_factory=GridConfig)
    policy: PolicyConfig = field(default_factory=PolicyConfig)
    clones: CloneConfig = field(default_factory=CloneConfig)

    @property
    def range_std(self) -> float:
        """Standard deviation that a range is credited with, m."""
        return max(self.noise.range_std, self.filter.min_range_std)


PRESETS = ("consistent", "paper", "odometry")


def preset(name: str, noise: NominalNoise | None = None) -> AgentConfig:
    """The settings of a preset.

    Raises
    ------
    ValueError
        If there is no such preset.
    """
    if name not in PRESETS:
        raise ValueError(f"no preset is called {name!r}; there are {', '.join(PRESETS)}")
    return AgentConfig(
        preset=name,
        estimator="consistent" if name == "consistent" else "published",
        noise=noise or NominalNoise(),
        filter=FilterConfig(correct=name != "odometry"),
    )
