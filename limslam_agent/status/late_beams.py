"""Beams that report their readings late, and by how much, found by the ranges that the map predicts.

A beam that is late by tau reads at time t what it should have read at t - tau. Its readings then fit the ranges that
the map predicts for the poses of that time, and not the ranges that it predicts for the present poses. So for each beam
and each of several delays, the readings of the last seconds are compared with both.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.contradictions import INSET, LEAST_COSINE, SIGMAS
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import RobotSpec

if TYPE_CHECKING:
    from limslam_agent.kernels.crossings import Predicted

_WINDOW = 12.0  # s of which the readings are tested
_LONGEST_DELAY = 2.0  # s
# A reading fits within so many standard deviations. No squared residual counts more than the second number, in
# variances: it limits the effect of a single reading.
_LIMITS = SIGMAS, 4.0
# A beam is late if the ranges that the map predicts for the poses of a while ago fit its readings better than those for
# the present poses, by at least this sum of squared residuals in variances.
_EVIDENCE = 40.0
_BEYOND_END = 1.0  # m: how far beyond a wall's known end a reading may show it
# m and rad: if the estimator corrects the pose by more than this in one step, the readings before are not used.
_MAX_CORRECTION, _MAX_TURN_CORRECTION = 0.05, math.radians(2.0)

_MOST_BEAMS = 8
"""Number of beams of one search; robots with more beams search among them in turn."""

_BOTH_SIGNS = 6.0
"""The evidence counts at most so many times as much as its smaller part: by readings that are too long, or too short.

A wall that is missing in the map, or that is not there, makes many readings wrong, but all of them in one direction.
"""


_COUNTER_EVIDENCE = 2.0
"""So many times the evidence that finds a late beam is needed to say that the beam is no longer late.

A beam that is late draws walls by its own readings, and later these readings fit those walls.
"""


@dataclass(frozen=True)
class LateBeam:
    """A beam that reports late.

    Attributes
    ----------
    beam
        Number of the beam.
    angle
        Its direction in the robot's frame, rad.
    delay, std
        By how much it is late, and the standard deviation of that, s.
    """

    beam: int
    angle: float
    delay: float
    std: float

    @property
    def words(self) -> str:
        """What was found, in words."""
        return f"the beam at {math.degrees(self.angle):.0f} deg is late by {self.delay:.1f} s (+- {self.std:.1f} s)"


class _Steps(NamedTuple):
    """Poses (n, 3), clipped readings (n, n_beams), those that count, and variances of position and heading (n, 2)."""

    poses: FloatArray
    ranges: FloatArray
    usable: BoolArray
    variances: FloatArray

    @classmethod
    def none(cls, beams: int) -> "_Steps":
        """No steps of a robot with so many beams."""
        return cls(np.zeros((0, 3)), np.zeros((0, beams)), np.zeros((0, beams), dtype=bool), np.zeros((0, 2)))


class LateBeams:
    """Watches all beams of a robot.

    Attributes
    ----------
    robot
        Body, and beams as they are taken to be mounted.
    found
        The beam that is late; None if no beam is. It stays until twice as much evidence says that the beam is
        not late.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self.robot = robot
        longest = max(round(_LONGEST_DELAY / robot.control_period), 1)
        self._delays = np.unique(np.linspace(min(2, longest), longest, 10).round().astype(int))
        self._most = max(round(_WINDOW / robot.control_period), longest + 2)
        self._steps = _Steps.none(len(robot.beams))
        self._first_beam, self._lag, self._since = 0, 0, 0
        self.found: LateBeam | None = None

    def note(self, looks: list[tuple[FloatArray, FloatArray, FloatArray, BoolArray]], covariance: FloatArray) -> None:
        """Remember successive steps: pose (3,), reported increment (3,), readings (n_beams,), m, and the new ones.

        What was seen before a large correction of the pose is forgotten: it does not fit the corrected map.
        """
        from limslam_agent.kernels.crossings import last_correction

        poses, increments, ranges, measured = (np.array(each) for each in zip(*looks, strict=True))
        known = self._steps
        clipped = np.minimum(ranges, self.robot.max_ranges)
        variances = np.empty((len(poses), 2))
        variances[:] = covariance[0, 0] + covariance[1, 1], covariance[2, 2]
        joined = np.concatenate((known.poses, poses))
        moves = np.concatenate((np.zeros_like(known.poses[-1:]), increments))
        tail = joined[len(joined) - len(moves) :]
        corrected = last_correction(tail, moves, _MAX_CORRECTION, _MAX_TURN_CORRECTION)
        first = max(len(joined) - len(moves) + corrected if corrected else 0, len(joined) - self._most)
        self._steps = _Steps(
            joined[first:],
            np.concatenate((known.ranges, clipped))[first:],
            np.concatenate((known.usable, measured & (clipped > self.robot.too_near)))[first:],
            np.concatenate((known.variances, variances))[first:],
        )
        self._since += len(poses)

    def forget(self) -> None:
        """Forget the steps so far, after which a step is missing."""
        self._steps = _Steps.none(len(self.robot.beams))

    def search(self, segments: FloatArray, sensor: RangeSensor) -> None:
        """Look for a late beam by the walls (k, 4), m, of the map, and the sensor, as they are known now."""
        from limslam_agent.kernels.crossings import evidence_of_delays, sum_gains

        if len(self._steps.poses) < 2 * self._delays[0] or not len(segments):
            return
        if self.found is not None:
            seen = self._compared(segments, sensor, np.array([self.found.beam]))
            gained = sum_gains(seen, 0, self._lag, max(self._since, 1), *_LIMITS)
            if gained < -_COUNTER_EVIDENCE * _EVIDENCE:
                self.found = None
            return
        count = len(self.robot.beams)
        beams = np.unique((self._first_beam + np.arange(min(count, _MOST_BEAMS))) % count)
        self._first_beam = (self._first_beam + _MOST_BEAMS) % count
        seen = self._compared(segments, sensor, beams)
        delays = self._delays[self._delays < len(self._steps.poses) - 2]
        evidence = np.empty((len(delays), len(beams)))
        evidence_of_delays(seen, delays, *_LIMITS, _BOTH_SIGNS, evidence)
        if evidence.size and evidence.max() > _EVIDENCE:
            row, column = np.unravel_index(evidence.argmax(), evidence.shape)
            self._lag, self._since = int(delays[row]), 0
            delay, std = self._delay(seen, int(column), self._lag)
            beam = int(beams[column])
            self.found = LateBeam(beam, float(self.robot.beam_angles[beam]), delay, std)

    def _compared(self, segments: FloatArray, sensor: RangeSensor, beams: IntArray) -> "Predicted":
        """The last steps beside the map, for some beams."""
        from limslam_agent.kernels.crossings import WALL_COLUMNS, Predicted, compare_steps

        poses, ranges, usable, variances = self._steps
        table = np.array(self.robot.beam_table[beams])
        ranges, usable = np.take(ranges, beams, axis=1), np.take(usable, beams, axis=1)
        rules = np.array([INSET, LEAST_COSINE, *_LIMITS, _BEYOND_END])
        seen = Predicted.of(ranges, usable)
        scratch = np.empty((len(segments), WALL_COLUMNS))
        compare_steps(poses, variances, segments, table, sensor.numbers, rules, scratch, seen)
        return seen

    def _delay(self, seen: "Predicted", column: int, lag: int) -> tuple[float, float]:
        """The delay of a beam and its standard deviation, s: by the derivative of the predicted range with time."""
        before, at, after = slice(0, -lag - 1), slice(1, -lag), slice(2, len(seen.ranges) - lag + 1)
        period = self.robot.control_period
        known, ranges = seen.known[:, column], seen.predicted[:, column]
        slope = (ranges[after] - ranges[before]) / (2.0 * period)
        residual = seen.ranges[lag + 1 :, column] - ranges[at]
        std = seen.stds[at, column]
        both = known[before] & known[at] & known[after] & seen.usable[lag + 1 :, column] & seen.ended[lag + 1 :, column]
        fits = both & (np.abs(residual) < 3.0 * std)
        weights = np.where(fits, (slope / std) ** 2, 0.0)
        total = float(weights.sum())
        # The tested delays are this far apart.
        spread = max(float(np.diff(self._delays).max(initial=1)), 1.0) * period
        if total * spread**2 < 1.0:
            return lag * period, spread
        shift = -float(np.sum(weights * np.where(fits, residual / np.where(slope == 0.0, 1.0, slope), 0.0))) / total
        return lag * period + min(max(shift, -spread), spread), max(1.0 / math.sqrt(total), 0.5 * period)
