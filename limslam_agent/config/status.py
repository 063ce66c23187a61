"""Settings of the status: when an estimate is unsure or lost.

All values are choices of this project, tuned on seeds that are not reported. Lengths are in metres, angles in radians.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated

from limslam_agent.config.bounds import Angle, Bounded, Bounds, Count, NonNegative, Positive, Share


@dataclass(frozen=True)
class ContradictionConfig(Bounded):
    """When a reading contradicts the map.

    Attributes
    ----------
    inset
        A beam should end at a wall if it meets the wall at least this far inside the wall's ends, m.
    sigmas, slack
        A beam has passed through a wall if its reading exceeds the expected range by more than this number of standard
        deviations plus ``slack``, m.
    least_cosine
        Beams whose angle to the wall's normal has a smaller cosine are not compared with the wall.
    free, free_cells
        A beam has ended in free space if all cells around its end have at least the value ``free``, up to this number
        of cells to each side, and no wall of the map is near its end. A wall is near if its distance is less than
        ``sigmas`` standard deviations of a range plus ``slack``. Walls are corrected when a loop is closed, and the
        grid is not.
    """

    inset: NonNegative = 0.10
    sigmas: NonNegative = 3.0
    slack: NonNegative = 0.10
    least_cosine: Share = 0.35
    free: Count = 4
    free_cells: Annotated[int, Bounds(0, 100)] = 2


@dataclass(frozen=True)
class LateBeamConfig(Bounded):
    """When a beam seems to report its readings late.

    Attributes
    ----------
    window
        Time of which the readings are tested, s.
    longest_delay
        Longest delay that is tested, s.
    sigmas
        Largest residual that counts, in standard deviations. It limits the effect of a single reading.
    evidence
        A beam is late if the ranges that the map predicts for the poses of a while ago fit its readings better than
        those for the present poses, by at least this sum of squared residuals in variances.
    beyond_end
        A reading may show a wall up to this far beyond the wall's known end, m.
    max_correction, max_turn_correction
        If the estimator corrects the pose by more than this in one step, m and rad, the readings before are not used.
    every
        The search is made at each comparison with this number.
    """

    window: Positive = 12.0
    longest_delay: Positive = 2.0
    sigmas: Positive = 2.0
    evidence: Positive = 40.0
    beyond_end: NonNegative = 1.0
    max_correction: Positive = 0.05
    max_turn_correction: Angle = math.radians(2.0)
    every: Annotated[int, Bounds(1, 1000)] = 2


@dataclass(frozen=True)
class SuddenChangeConfig(Bounded):
    """When readings change so suddenly that the robot must have been carried away.

    Evidence is the logarithm of a likelihood ratio: of "the robot was carried away in this step" against "it was not".

    Attributes
    ----------
    begin
        A suspicion begins with a step whose readings give more evidence than this. It ends when its evidence is used
        up, or after ``longest``.
    most
        Largest number of suspicions at the same time.
    longest
        Distance after which a suspicion ends, m. A turn by one radian counts like ``turn_length``, m.
    contradiction, fit, place
        Evidence of a place that contradicts the map of the time before the step, half as much for each further place by
        the same beam, and loss of evidence at a place where a reading fits that map. Each place of this size, m, counts
        once.
    unsure, lost, lost_contradicted
        The estimate is unsure or lost with this evidence. Less suffices to be lost if a place contradicts the map.
    """

    begin: Positive = 1.0
    most: Count = 3
    longest: Positive = 4.0
    contradiction: NonNegative = 4.0
    fit: NonNegative = 1.0
    place: Positive = 0.3
    unsure: Positive = 8.0
    lost: Positive = 12.0
    lost_contradicted: Positive = 10.0


@dataclass(frozen=True)
class RecoveryConfig(Bounded):
    """When a lost robot knows its pose again, and how uncertain it is until then.

    Attributes
    ----------
    window
        The robot must have driven so far since it became lost, m. The readings over this distance count.
    fewest, fitting
        Least number of these readings that should have ended at walls of the earlier map, and the least share of them
        that must have done so.
    position_growth, heading_growth
        Increase of the standard deviations of position and heading with the distance driven, m per metre and rad per
        metre.
    position_limit
        Largest standard deviation of the position that is added, m.
    """

    window: Positive = 10.0
    fewest: Count = 150
    fitting: Share = 0.95
    position_growth: NonNegative = 2.0
    heading_growth: NonNegative = 1.0
    position_limit: NonNegative = 10.0


@dataclass(frozen=True)
class SmoothedStatusConfig(Bounded):
    """When the result of the smoother of a finished run is unsure or lost.

    Attributes
    ----------
    unsure_share, lost_share
        The result is unsure or lost if this share of the readings contradicts the smoothed map.
    doubted_share
        From this share on, a robot that was unsure or lost while it drove remains so.
    moved, moved_nees
        The result is unsure if the smoother moved a pose by more than ``moved``, m, and the mean NEES / 3 of the filter
        against the smoothed path exceeds ``moved_nees``.
    unsure_heading
        The result is unsure if the smoothed heading's standard deviation exceeds this at any step, rad.
    """

    unsure_share: Annotated[float, Bounds(1e-6, 1.0)] = 0.01
    lost_share: Annotated[float, Bounds(1e-6, 1.0)] = 0.03
    doubted_share: Annotated[float, Bounds(1e-6, 1.0)] = 0.0025
    moved: NonNegative = 0.30
    moved_nees: Positive = 5.0
    unsure_heading: Angle = math.radians(4.0)


@dataclass(frozen=True)
class StatusConfig(Bounded):
    """All settings of the status.

    Attributes
    ----------
    contradictions, late_beams, sudden_changes, recovery, smoothed
        Settings of the parts.
    spacing, longest_spacing, turn_length
        The readings are compared with the map when the robot has moved by ``spacing``, m, and the estimator extracts
        lines in the same step, or when it has moved by ``longest_spacing``, m. A turn by one radian counts like
        ``turn_length``, m.
    window, fewest, fewest_places
        Length of the last part of the drive that counts, m, and the least number of readings that give a share: this
        many, and from at least this many places.
    unsure_share, lost_share
        The estimate is unsure or lost if this share of the readings contradicts the map.
    fewest_contradictions, apart
        Least number of contradicting readings of a lost estimate. They must be of two beams, and two of them must be
        this far apart, m.
    unsure_heading
        The estimate is unsure if the heading's standard deviation exceeds this, rad.
    max_jump
        The estimate is lost if the odometry reports a longer motion in one step, m.
    """

    contradictions: ContradictionConfig = field(default_factory=ContradictionConfig)
    late_beams: LateBeamConfig = field(default_factory=LateBeamConfig)
    sudden_changes: SuddenChangeConfig = field(default_factory=SuddenChangeConfig)
    recovery: RecoveryConfig = field(default_factory=RecoveryConfig)
    smoothed: SmoothedStatusConfig = field(default_factory=SmoothedStatusConfig)
    spacing: Positive = 0.10
    longest_spacing: Positive = 0.30
    turn_length: NonNegative = 0.40
    window: Positive = 3.0
    fewest: Count = 25
    fewest_places: Count = 8
    unsure_share: Annotated[float, Bounds(1e-6, 1.0)] = 0.03
    lost_share: Annotated[float, Bounds(1e-6, 1.0)] = 0.06
    fewest_contradictions: Count = 3
    apart: NonNegative = 0.3
    unsure_heading: Angle = math.radians(4.0)
    max_jump: Positive = 1.0
