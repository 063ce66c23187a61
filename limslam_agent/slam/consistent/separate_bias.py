"""Constant errors of odometry and ranges, estimated beside a filter that takes them to be zero.

A filter with these errors in its state estimates them from the first step, and a robot that is as
specified pays for that: a regression on noisy odometry is not exact. Here the filter does not know
of the errors. Beside its state x and covariance P stands the derivative V of x by the errors b,
which each prediction and update of the filter changes by a known linear map. The innovations then
give the estimate of b, and x + V b with the covariance P + V M V^T, where M is the covariance of b,
is what the filter with b in its state would have estimated (B. Friedland, "Treatment of bias in
recursive filtering", 1969). So the filter can wait with its decision until the data require the
errors, and lose nothing.
"""

from typing import NamedTuple

import numpy as np

from limslam_agent.kernels.tables import FLATTEST, LEAST_DIVISOR, POSE, Update
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import angle_between

BENDS = np.array([0.0, 0.03, 0.06, 0.12, 0.25, 0.5])
"""Standard deviations of the curvature of walls that are considered, 1/m."""

FOLDS = 16
"""Groups of walls, each of which is left out in turn."""

NONE = slice(0)
"""No errors."""


class SeparateBias:
    """Constant errors b with a prior covariance (k, k) about zero: what the innovations of a filter
    say of them.

    An error has to explain more than walls do that are not straight. So all is known for walls
    whose curvature has each of the ``BENDS`` as its standard deviation, independently in each
    update: J'J (k + 1, k + 1) of the derivatives and the innovations J, whitened, whose last
    element, chi-square, has twice the logarithm of the likelihood's norm added.
    """

    def __init__(self, prior: FloatArray) -> None:
        self._prior = prior
        size = len(prior) + 1
        # Those of all updates, and those without each group of walls
        self._sums = np.zeros((1 + FOLDS, len(BENDS), size, size))

    @property
    def count(self) -> int:
        """Number of the errors."""
        return len(self._prior)

    def estimate_of(self, part: slice) -> tuple[FloatArray, FloatArray]:
        """Some of the errors (m,) and their covariance (m, m), if the others are zero."""
        rows = self._sums[0, 0, :-1][part]
        return _estimated(self._prior[part, part], rows[:, :-1][:, part], rows[:, -1])

    def evidence_of(self, part: slice | IntArray, against: slice | IntArray = NONE) -> float:
        """Twice the logarithm of the Bayes factor for some of the errors against some others, each
        beside walls of the likeliest curvature.

        It is at most 0 if it is so without the readings of one group of walls: what they say may be
        due to a wall that is not as assumed, and other walls have to say it too.
        """
        evidence = self._evidences_of(part).max(axis=-1) - self._evidences_of(against).max(axis=-1)
        return float(evidence[0] if evidence.min() > 0.0 else evidence.min())

    def _evidences_of(self, part: slice | IntArray) -> FloatArray:
        """Twice the logarithm of the Bayes factor for some of the errors against no errors and
        straight walls, for each of the ``BENDS`` (1 + ``FOLDS``, n): by all readings, and without
        those of each group of walls.
        """
        chi_squares = self._sums[..., -1, -1]
        bent = chi_squares[:, :1] - chi_squares
        rows = self._sums[..., :-1, :][..., part, :]
        if not rows.shape[-2]:
            return np.asarray(bent)
        information = rows[..., :-1][..., part]
        score = rows[..., -1:]
        prior = self._prior[part][:, part]
        narrowed = np.eye(len(prior)) + information @ prior
        gains = np.swapaxes(score, -1, -2) @ prior @ np.linalg.solve(narrowed, score)
        gains = gains[..., 0, 0] - np.linalg.slogdet(narrowed)[1]
        return np.asarray(gains + chi_squares[:, :1] - chi_squares)

    def learn(self, whitened: FloatArray, wall: int) -> None:
        """The filter was updated by measurements of a wall: whitened derivatives (m, k) by the
        errors, innovation, and derivative by the curvature of the wall, side by side (m, k + 2).
        """
        joined = whitened[:, :-1]
        bent = whitened[:, -1]
        shared = joined.T @ bent
        sizes = BENDS**2 * (bent @ bent)
        shares = BENDS**2 / (1.0 + sizes)
        sums = joined.T @ joined - shares[:, None, None] * np.outer(shared, shared)
        sums[:, -1, -1] += np.log1p(sizes)
        self._sums += sums
        self._sums[1 + wall % FOLDS] -= sums


class OdometryErrors(SeparateBias):
    """The constant errors of the odometry of n robots, three numbers each, with a prior covariance
    (3, 3) about zero.

    Attributes
    ----------
    evidence
        Twice the logarithm of the Bayes factor for errors of one robot against no errors, for the
        worst robot. It is the gain in chi-square by the errors, less what three more parameters
        gain by chance (R. Kass and A. Raftery, "Bayes factors", 1995). If there are no errors, it
        ever exceeds g with a probability of at most exp(-g / 2).
    """

    def __init__(self, robots: int, prior: FloatArray) -> None:
        super().__init__(np.asarray(np.kron(np.eye(robots), prior), dtype=float))
        self.evidence = 0.0

    def learn(self, whitened: FloatArray, wall: int) -> None:
        """The filter was updated; see the base class."""
        super().learn(whitened, wall)
        self.evidence = max(
            self.evidence_of(slice(first, first + POSE)) for first in range(0, self.count, POSE)
        )


COMMON = slice(0, 3)
TURNS = slice(3, None)
"""Those of the ``RangeErrors`` that all beams share, and the directions of single beams."""

LENGTHS = slice(0, 2)
DELAY = 2
"""Bias and opening angle, and the place of the delay, among the ``RangeErrors``."""


class RangeErrors(SeparateBias):
    """Constant errors of the ranges.

    The first three are a bias of all ranges, m, by what half the opening angle exceeds the assumed
    one, rad, and by how many steps the ranges are later than the wheels. The others are by what
    each beam is turned to the left, rad, if that is estimated.

    Parameters
    ----------
    stds
        Prior standard deviations of the errors.
    """

    def __init__(self, stds: tuple[float, ...]) -> None:
        super().__init__(np.diag(np.square(stds)))
        self.stds = stds
        # The sums from before the state was corrected, for what is reported.
        self._earlier = np.zeros_like(self._sums[0, 0])

    def corrected(self, errors: FloatArray) -> "RangeErrors":
        """The further errors after the state was corrected for the first of the errors (m,), which
        begin anew.
        """
        further = RangeErrors(self.stds)
        further._earlier = self._earlier + self._sums[0, 0]
        further._earlier[:, -1] -= further._earlier[:, : len(errors)] @ errors
        return further

    @property
    def bend(self) -> tuple[float, float]:
        """The likeliest curvature of walls, 1/m, and twice the logarithm of the Bayes factor for it
        against straight walls, with these errors or without.
        """
        bent = self._evidences_of(NONE)[0]
        straight = self._evidences_of(slice(None)).item(0)
        best = int(bent.argmax())
        return BENDS.item(best), bent.item(best) - max(straight, 0.0)

    @property
    def length_evidence(self) -> FloatArray:
        """Twice the logarithm of the Bayes factor for bias and opening angle (2,).

        Each is compared with the other one alone, so that none is taken for the other one.
        """
        return np.array([self.evidence_of(LENGTHS, np.array([other])) for other in (1, 0)])

    @property
    def delay_evidence(self) -> float:
        """The same for a delay, compared with bias and opening angle."""
        return self.evidence_of(COMMON, LENGTHS)

    @property
    def turns(self) -> tuple[FloatArray, FloatArray]:
        """By what each beam is turned (n_beams,), rad, and the covariance (n_beams, n_beams) of
        that; empty if that is not estimated.

        It is known by all readings, also by those from before a correction, and other errors are
        unknown beside it.
        """
        sums = (self._earlier + self._sums[0, 0])[:-1]
        errors, covariance = _estimated(self._prior, sums[:, :-1], sums[:, -1])
        return errors[TURNS], covariance[TURNS, TURNS]

    @property
    def turn_gain(self) -> float:
        """By how much the estimated directions of the beams lower chi-square, those of the prior
        included.
        """
        turns, covariance = self.estimate_of(TURNS)
        return float(turns @ np.linalg.solve(covariance, turns))

    @property
    def turn_evidence(self) -> float:
        """Twice the logarithm of the Bayes factor for turned beams.

        It is the smaller one of two: turned beams against none, and turned beams beside a bias and
        another opening angle against these alone.
        """
        return min(self.evidence_of(TURNS), self.evidence_of(slice(None), COMMON))


class ConstantErrors:
    """The constant errors that a filter does not know of. Columns of V are those of the odometry,
    then of the ranges.

    Attributes
    ----------
    odometry, ranges
        The errors; None if they are not estimated beside the filter.
    """

    def __init__(self, odometry: OdometryErrors | None, ranges: RangeErrors | None) -> None:
        self.odometry = odometry
        self.ranges = ranges

    @property
    def count(self) -> int:
        """Number of all the errors."""
        return sum(errors.count for errors in (self.odometry, self.ranges) if errors is not None)

    def learn(
        self,
        by_errors: FloatArray,
        update: Update,
        after: FloatArray,
        wall: int,
        seen: "SeenWall | None" = None,
    ) -> None:
        """Change V (s, k) as an update of the filter by measurements of a wall has changed its
        state, and estimate the errors anew.

        ``after`` (s, 3) is what ``correct_state`` has returned, and ``seen`` says what was
        measured, if that are readings.

        Raises
        ------
        LinAlgError
            If the innovation's covariance is not positive.
        """
        if not update.factor[-1, -1] > 0.0:
            raise np.linalg.LinAlgError("the innovation's covariance is not positive")
        if not by_errors.size:
            return
        by_errors += update.moved @ by_errors[:POSE]
        measured = update.H @ by_errors[update.columns]
        by_curvature = np.zeros(len(measured))
        if seen is not None:
            by_curvature = 0.5 * seen.expected[:, 5] ** 2 / seen.expected[:, 4]
            if self.ranges is not None:
                direct = by_range_errors(seen, len(self.ranges.stds[TURNS]))
                measured[:, -direct.shape[1] :] += direct
        joined = np.column_stack((measured, update.innovation, by_curvature))
        scaled = np.asarray(np.linalg.solve(np.tril(update.factor), joined))
        by_errors -= update.W.T @ scaled[:, :-2]
        by_errors += after @ by_errors[:POSE]
        first = 0
        for errors in (self.odometry, self.ranges):
            if errors is not None:
                errors.learn(scaled[:, np.r_[first : first + errors.count, -2, -1]], wall)
                first += errors.count


class SeenWall(NamedTuple):
    """Readings that have updated a line.

    Attributes
    ----------
    rows, expected
        ``Readings.rows`` (n, 6), and what was predicted for them (n, 7).
    headings, theta
        Headings (n,) of the robot, and direction of the line's normal, rad.
    """

    rows: FloatArray
    expected: FloatArray
    headings: FloatArray
    theta: float


def _estimated(
    prior: FloatArray, information: FloatArray, score: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Errors (k,) and their covariance (k, k), from the prior covariance, information and score."""
    covariance = prior @ np.linalg.inv(np.eye(len(prior)) + information @ prior)
    return covariance @ score, 0.5 * (covariance + covariance.T)


def by_range_errors(seen: SeenWall, beams: int) -> FloatArray:
    """Derivatives (n, 3 + beams) of predicted ranges by the errors of ``RangeErrors``, at a given
    state.

    The delay acts by the poses of the clones alone. At the angle phi to the normal, a beam reads r
    tan(phi) more for each radian that it is turned away from the normal. A wider cone reads the
    wall under a ray that is nearer to the perpendicular, and so a shorter range. ``beams`` is 0 if
    directions are not estimated.
    """
    cosines = np.maximum(np.abs(seen.expected[:, 6]), LEAST_DIVISOR)
    sines = np.sqrt(np.maximum(1.0 - cosines**2, 0.0))
    by_width = -seen.expected[:, 0] * sines / cosines
    by_errors = np.zeros((len(cosines), TURNS.start + beams))
    by_errors[:, 0] = 1.0
    by_errors[:, 1] = by_width
    if beams:
        angles = seen.headings + seen.rows[:, 2]
        cones = seen.rows[:, 4]
        numbers = seen.rows[:, 5].astype(int)
        turn = angle_between(seen.theta - seen.headings - seen.rows[:, 2])
        turn = np.where(np.abs(turn) < FLATTEST, np.clip(turn, -cones, cones), 0.0)
        slants = angle_between(angles + turn - seen.theta)
        by_errors[np.arange(len(slants)), TURNS.start + numbers] = -np.sign(slants) * by_width
    return by_errors
