"""Settings of the line smoother, which solves for all poses of a run, one frozen dataclass for each stage.

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
    """What is known of constant errors of wheels and beams before they are estimated.

    Attributes
    ----------
    size_std
        Standard deviation of the size of both wheels together, as a share.
    uneven_std
        Of the right wheel beside the left one, as a share.
    axle_std
        Of the axle, as a share.
    bias_std
        Of what all ranges read too much, m.
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
    """How readings are given to lines anew, and lines are merged.

    Attributes
    ----------
    rounds
        At most so many rounds of merging, association and solving.
    settled
        A round that moves no pose farther than this, m, is the last one.
    gate, beyond
        A reading belongs to a line that predicts it within ``gate`` standard deviations and that reaches to
        within ``beyond`` (m) of the place where the beam meets it.
    margin
        A second line must predict the reading worse by so many standard deviations; otherwise it is not used.
    fewest
        A line has at least so many readings.
    one_wall_gate
        Two lines may be one wall below this chi-square (two degrees of freedom).
    max_offset, max_angle, min_overlap
        They must lie this close together, m and rad, and share so much of the wall, m.
    """

    rounds: CountOrNone = 8
    settled: NonNegative = 2e-3
    gate: NonNegative = 3.5
    beyond: NonNegative = 0.10
    margin: NonNegative = 3.0
    fewest: Count = 6
    one_wall_gate: NonNegative = 16.0
    max_offset: NonNegative = 0.15
    max_angle: Angle = 0.12
    min_overlap: NonNegative = 0.15


@dataclass(frozen=True)
class ScoreConfig(Bounded):
    """What a map without truth is worth: log-likelihood of wheels and ranges, less the prices of what it claims.

    Attributes
    ----------
    clip
        A look that no line explains, or that goes through a wall, costs as much as this squared residual, in variances.
    line
        Price of a line.
    """

    clip: NonNegative = 16.0
    line: NonNegative = 24.0


@dataclass(frozen=True)
class MendingConfig(Bounded):
    """How wrong associations of a whole map are taken back.

    Attributes
    ----------
    rounds
        At most so many rounds of moves.
    gain
        A move is kept if the score rises by so much.
    last_rounds
        At most so many rounds of re-association after new lines were founded.
    cut
        A line is cut where it was not read for so far a drive, m.
    max_offset, max_angle, min_overlap
        Pieces that may be one wall lie this close together, m and rad, and share so much of it, m.
    dropped_share, dropped_least
        A line is dropped when beams contradict it more often than this, and than this share of its readings.
    unexplained
        Readings that are farther than so many standard deviations from every line may found new ones.
    reborn_readings
        New lines have at least so many of them.
    doubled_sigmas, doubled_offset, doubled_angle
        Two lines that share a stretch of wall are made one where they are closer than so many standard deviations of a
        range, or this offset, m, and this angle, rad.
    contradicted, unsure_heading
        Mending is tried where beams contradict more than this share of all looks, or where the filter's heading once
        had this standard deviation, rad.
    """

    rounds: CountOrNone = 3
    gain: NonNegative = 5.0
    last_rounds: CountOrNone = 4
    cut: NonNegative = 3.0
    max_offset: NonNegative = 0.8
    max_angle: Angle = 0.4
    min_overlap: NonNegative = 0.10
    dropped_share: Share = 0.2
    dropped_least: CountOrNone = 5
    unexplained: NonNegative = 4.0
    reborn_readings: Count = 8
    doubled_sigmas: NonNegative = 3.0
    doubled_offset: NonNegative = 0.03
    doubled_angle: Angle = math.radians(10.0)
    contradicted: Share = 0.01
    unsure_heading: Angle = math.radians(4.0)


@dataclass(frozen=True)
class SmootherConfig(Bounded):
    """The line smoother.

    Attributes
    ----------
    reassociation, score, mending
        Of its stages.
    calibrate, calibration
        Whether constant errors of wheels, axle and ranges are estimated: ``always``, ``never``, or ``if_needed``; and
        what is known of them.
    calibration_gate, calibration_price
        They are needed where beams contradict the map, or where their estimates are so large, as a chi-square (four
        degrees of freedom a robot). They are believed if the score gains this much.
    max_gap, through_tolerance
        What is drawn as one piece: holes that no beam looked at, m, and beams that passed for each one that hit.
    shown_readings, shown_length, shown_sigmas
        A line is drawn if it was read this often, in pieces of this length, m, or more; and of so many standard
        deviations of a range.
    """

    reassociation: ReassociationConfig = field(default_factory=ReassociationConfig)
    score: ScoreConfig = field(default_factory=ScoreConfig)
    mending: MendingConfig = field(default_factory=MendingConfig)
    calibrate: Literal["always", "if_needed", "never"] = "if_needed"
    calibration: CalibrationPrior = field(default_factory=CalibrationPrior)
    calibration_gate: NonNegative = 40.0
    calibration_price: NonNegative = 20.0
    max_gap: NonNegative = 0.30
    through_tolerance: NonNegative = 1.0
    shown_readings: Count = 10
    shown_length: NonNegative = 0.20
    shown_sigmas: NonNegative = 7.5
