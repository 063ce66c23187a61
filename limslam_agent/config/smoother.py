"""Settings of the line smoother, which estimates all poses of a run: one frozen dataclass for each stage.

All values are choices of this project, tuned on seeds that are not reported. Lengths are in metres, angles in radians.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np

from limslam_agent.config.bounds import Angle, Bounded, Bounds, Count, CountOrNone, NonNegative, Share
from limslam_env.geometry import FloatArray

_StdShare = Annotated[float, Bounds(1e-6, 0.999)]


@dataclass(frozen=True)
class CalibrationPrior(Bounded):
    """The prior of the constant errors of wheels and beams.

    Attributes
    ----------
    size_std
        Standard deviation of the common relative size error of both wheels.
    uneven_std
        Standard deviation of the right wheel's relative size error with respect to the left wheel.
    axle_std
        Standard deviation of the axle's relative size error.
    bias_std
        Standard deviation of the bias of all ranges, m.
    """

    size_std: _StdShare = 0.03
    uneven_std: _StdShare = 0.03
    axle_std: _StdShare = 0.03
    bias_std: _StdShare = 0.02

    @property
    def information(self) -> FloatArray:
        """Inverse covariance (4, 4) of the calibration: left wheel, right wheel, axle, bias."""
        both, half = self.size_std**2, 0.25 * self.uneven_std**2
        covariance = np.diag([both + half, both + half, self.axle_std**2, self.bias_std**2])
        covariance[[0, 1], [1, 0]] = both - half
        return np.asarray(np.linalg.inv(covariance))


@dataclass(frozen=True)
class ReassociationConfig(Bounded):
    """Association of readings with lines, and merging of lines.

    Attributes
    ----------
    rounds
        Largest number of rounds of merging, association and solving.
    settled
        The last round is the first round that moves no pose farther than this, m.
    gate, beyond
        A reading belongs to a line if the line predicts it within ``gate`` standard deviations. The beam must meet the
        line at most ``beyond`` (m) beyond the line's ends.
    margin
        The second-best line must predict the reading worse by at least this, in standard deviations. Otherwise the
        reading is not used.
    fewest
        Least number of readings of a line.
    bend_gate
        A line is divided into two where two lines fit its readings better by this much in chi-square.
    run_gate
        Successive readings of one beam are not used if the sum of their residuals exceeds this number of standard
        deviations of such a sum: they lie on one side of their line.
    end_guard, exact_std
        Readings close to an end of their line do not count for the final poses, since they may be of the next wall. The
        guard, m, is ``end_guard`` times the excess of the standard deviation of a range over ``exact_std``, m. Two
        walls that meet at 25 degrees differ by less than ``gate`` standard deviations over 7.5 standard deviations of
        their length, and ``beyond`` covers this up to ``exact_std``.
    one_wall_gate
        Two lines may be one wall if their chi-square (two degrees of freedom) is below this gate.
    max_offset, max_angle, min_overlap
        Largest differences of two lines that may be one wall, m and rad, and the least length of their overlap, m.
    """

    rounds: CountOrNone = 8
    settled: NonNegative = 2e-3
    gate: NonNegative = 3.5
    beyond: NonNegative = 0.10
    margin: NonNegative = 3.0
    fewest: Count = 6
    bend_gate: NonNegative = 16.0
    run_gate: NonNegative = 4.0
    end_guard: NonNegative = 4.0
    exact_std: NonNegative = 0.02
    one_wall_gate: NonNegative = 16.0
    max_offset: NonNegative = 0.15
    max_angle: Angle = 0.12
    min_overlap: NonNegative = 0.15


@dataclass(frozen=True)
class ScoreConfig(Bounded):
    """The score of a map without ground truth: log-likelihood of wheels and ranges, minus a price for each line.

    Attributes
    ----------
    clip
        Squared residual, in variances, of a look that no line explains or that passes through a wall.
    line
        Price of a line.
    """

    clip: NonNegative = 16.0
    line: NonNegative = 24.0


@dataclass(frozen=True)
class MendingConfig(Bounded):
    """Correction of wrong associations of a whole map.

    Attributes
    ----------
    rounds
        Largest number of rounds of moves.
    gain
        A move is accepted if the score rises by at least this.
    last_rounds
        Largest number of rounds of re-association after new lines were created.
    cut
        A line is cut where it was not read for this distance driven, m.
    max_offset, max_angle, min_overlap
        Largest differences of segments that may be one wall, m and rad, and the least length of their overlap, m.
    most_lines
        A move that begins with more lines than this is not tried, because its time grows with the third power of their
        number.
    dropped_share, dropped_least
        A line is dropped if the number of beams that contradict it exceeds ``dropped_least``, and also this share of
        its readings.
    unexplained
        Readings farther than this number of standard deviations from every line may create new lines.
    reborn_readings
        Least number of readings of a new line.
    doubled_sigmas, doubled_offset, doubled_angle
        Two lines that share a stretch of wall are merged if their distance and their angle are small. The limit of the
        distance is this number of standard deviations of a range, or this offset, m, if that is larger. The limit of
        the angle is in rad.
    contradicted, unsure_heading
        Correction is tried if beams contradict more than this share of all looks, or if the filter's heading had this
        standard deviation, rad, at any step.
    remaining, unavoidable
        A corrected map is kept if at most this share of the contradictions remains, or if the contradictions are at
        most this share of all looks, as in correct maps.
    """

    rounds: CountOrNone = 3
    gain: NonNegative = 5.0
    last_rounds: CountOrNone = 4
    cut: NonNegative = 3.0
    max_offset: NonNegative = 0.8
    max_angle: Angle = 0.4
    min_overlap: NonNegative = 0.10
    most_lines: Count = 600
    dropped_share: Share = 0.2
    dropped_least: CountOrNone = 5
    unexplained: NonNegative = 4.0
    reborn_readings: Count = 8
    doubled_sigmas: NonNegative = 3.0
    doubled_offset: NonNegative = 0.03
    doubled_angle: Angle = math.radians(10.0)
    contradicted: Share = 0.01
    unsure_heading: Angle = math.radians(4.0)
    remaining: Share = 0.6
    unavoidable: Share = 0.002


@dataclass(frozen=True)
class SensorConfig(Bounded):
    """Errors of the range sensors that were not specified.

    Attributes
    ----------
    rounds
        Largest number of times that they are estimated, each time with a new solution; 0 takes sensors to be as
        specified.
    noise_ratio
        The noise is as specified if the standard deviation of the residuals differs from it by at most this factor.
    turn_gate, turn_std
        Beams are turned if twice the logarithm of the Bayes factor for turned beams exceeds the gate; and the standard
        deviation of the direction of a beam, rad.
    width_gate
        The beams have an opening angle if chi-square falls by more than this.
    max_width
        Largest half of the opening angle, rad.
    """

    rounds: CountOrNone = 4
    noise_ratio: Annotated[float, Bounds(1.0, 100.0)] = 1.25
    turn_gate: NonNegative = 40.0
    turn_std: Annotated[float, Bounds(1e-6, 1.0)] = 0.05
    width_gate: NonNegative = 40.0
    max_width: Angle = math.radians(10.0)


@dataclass(frozen=True)
class SmootherConfig(Bounded):
    """All settings of the line smoother.

    Attributes
    ----------
    reassociation, score, mending, sensor
        Settings of the stages.
    calibrate, calibration
        Whether constant errors of wheels, axle and ranges are estimated (``always``, ``never``, or ``if_needed``), and
        the prior of these errors.
    calibration_gate, calibration_price
        Calibration is needed if beams contradict the map, or if the chi-square of the estimated errors (four degrees of
        freedom for each robot) exceeds the gate. It is accepted if the score rises by the price.
    max_gap, through_tolerance
        Largest hole without looks inside a drawn wall segment, m, and largest number of passing beams for each beam
        that hit.
    shown_readings, shown_length, shown_sigmas
        A line is drawn if it has at least this number of readings. A segment of it is drawn if it is at least this
        long, m, and at least this number of standard deviations of a range.
    """

    reassociation: ReassociationConfig = field(default_factory=ReassociationConfig)
    score: ScoreConfig = field(default_factory=ScoreConfig)
    mending: MendingConfig = field(default_factory=MendingConfig)
    sensor: SensorConfig = field(default_factory=SensorConfig)
    calibrate: Literal["always", "if_needed", "never"] = "if_needed"
    calibration: CalibrationPrior = field(default_factory=CalibrationPrior)
    calibration_gate: NonNegative = 40.0
    calibration_price: NonNegative = 20.0
    max_gap: NonNegative = 0.30
    through_tolerance: NonNegative = 1.0
    shown_readings: Count = 10
    shown_length: NonNegative = 0.20
    shown_sigmas: NonNegative = 7.5


@dataclass(frozen=True)
class RenewalConfig(Bounded):
    """When the last minutes of a drive are smoothed while the robot drives on, and the online estimate is renewed.

    Attributes
    ----------
    period
        Longest time between two renewals, s.
    least
        Least time between two renewals, s, if the robot is lost and does not go on in a local frame.
    end_noise
        By how much the position of each end of a known wall becomes less certain at each renewal, in standard
        deviations of a range. It stands for errors that a wall has in each stretch again.
    """

    period: NonNegative = 900.0
    least: NonNegative = 30.0
    end_noise: NonNegative = 1.0
