"""The turn of each step by the heading of an inertial measurement unit (IMU), beside the wheels.

The heading of an IMU is (1 + k) times the robot's turn, an unknown start, a random walk, and a
drift: the zero error of its gyroscope, summed up. It does not know of slip. So a turn is the
difference of two headings, and the wheels say how far the robot went (J. Borenstein and L. Feng,
"Gyrodometry", 1996). The estimator finds scale and drift; here is what depends on neither.

The wheels give the turn where the IMU has no new reading, where its heading jumps, as that of a
compass does near iron, and while the robot stands, which shows the drift alone. A heading that is
the same as before, although the wheels have turned the robot, is the old reading again.

A heading may be later than the wheels. Then its turns follow those of the wheels of some time ago
better than those of now, and the wheels tell how far the robot has turned since then.
"""

import math
from typing import NamedTuple

import numpy as np

from limslam_agent.slam.core.encoder_ticks import tick_by
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import NominalNoise, RobotSpec

LEAST_VARIANCE = 1e-10
"""Added to the variance of each turn, rad^2."""

LONGEST_GAP = 1.0
"""The next heading says how far the robot turned in a gap up to this long, s. In a longer one, the
error of the wheels' turn moves the position, too.
"""

STILL = 1.0
"""A robot stands if no wheel has moved for this long, s: the encoder of a slow wheel has ticks."""

FASTEST_DRIFT = math.radians(3.0)
"""A standing robot whose heading turns faster than this, rad/s, is being turned."""

JUMP = math.radians(20.0)
"""A heading jumps if it turns by this much more, rad, than slip of both wheels explains."""


_LONGEST_LAG = 14  # steps
# Headings are late if the misfit of their turns grows by so many times its mean from a lag to its
# neighbours, and by more steps than these.
_CLEARLY = 30.0
_LATE = 0.15

_SURE = 3.0  # standard deviations of the wheels' turn


class Turn(NamedTuple):
    """How far a robot turned in one step.

    Attributes
    ----------
    angle, variance
        The turn, rad, and its variance, rad^2.
    measured, seconds
        The turn that the IMU has measured, rad, and for how long, s; both 0 where the wheels give
        the angle. After a gap, they are those of the whole gap.
    jitter
        Variance of the heading about the sum of all turns, rad^2: by the resolution of the IMU, and
        by the wheels until the IMU has its next reading.
    drift, drift_variance
        The drift that a standing robot shows, rad/s, and its variance; None for one that drives.
    """

    angle: float
    variance: float
    measured: float = 0.0
    seconds: float = 0.0
    jitter: float = 0.0
    drift: float | None = None
    drift_variance: float = 0.0


class TurnMeter:
    """Measures the turns of one robot, step by step.

    Attributes
    ----------
    lag
        By how many steps the headings are late.
    """

    def __init__(self, robot: RobotSpec, noise: NominalNoise) -> None:
        self._robot = robot
        self._noise = noise
        self._yaw = math.nan
        self._tick = 0.0
        self._still = 0.0
        self._resolution = 0.0
        self.lag = 0.0
        self._shift = 0.0
        self._readings = 0
        self._turns = np.zeros(_LONGEST_LAG)
        self._misfits = np.zeros(_LONGEST_LAG)
        self._own = math.nan
        self._since_reading()

    def step(self, yaw: float, wheels: FloatArray, more: float = 0.0) -> Turn:
        """The turn of the next step.

        Parameters
        ----------
        yaw
            The heading after the step, rad; NaN without a reading.
        wheels
            Travel (2,) of left and right wheel in the step, m.
        more
            Variance of both wheels' travel in all beyond the noise of encoders, m^2.
        """
        left = float(wheels[0])
        right = float(wheels[1])
        period = self._robot.control_period
        axle = self._robot.axle
        travel = abs(left) + abs(right)
        turn = (right - left) / axle
        self._still = 0.0 if travel else self._still + period
        self._seconds += period
        self._turned += turn
        self._turns = np.append(turn, self._turns[:-1])
        if not math.isnan(self._own):
            self._find_lag(self._own)
        self._own = math.nan
        self._slipping += (travel + _SURE * math.sqrt(more)) / axle
        self._variance += (self._noise.wheel_variance * travel + more) / axle**2 + LEAST_VARIANCE
        if math.isnan(yaw):
            return self._without_reading(turn)
        if math.isnan(self._yaw):
            return self._read(yaw, Turn(turn, self._variance))
        own = float(wrap_angle(yaw - self._yaw))
        unnoticed = max(self._tick, 0.0) + _SURE * math.sqrt(self._variance)
        # A unit whose heading has never changed may not work at all.
        if not own and (not self._tick or abs(self._turned) > unnoticed):
            return self._without_reading(turn, math.nan if self._tick else yaw)
        if self._seconds < 1.5 * period:
            self._own = own
        if not self.lag:
            # A heading that does not change while it does in other steps has coarse steps.
            self._tick = tick_by(self._tick, own) if own else abs(self._tick)
        own += self._turned_late() - self._shift
        return self._read(yaw, self._by_heading(own, turn))

    def _find_lag(self, own: float) -> None:
        """Compare how far the heading turned in the step before, rad, with the wheels in each step
        around.
        """
        self._misfits += (own - self._turns) ** 2
        self._readings += 1
        best = int(self._misfits[1:-1].argmin())
        earlier, least, later = self._misfits[best : best + 3].tolist()
        sharpness = earlier + later - 2.0 * least
        if sharpness * self._readings > _CLEARLY * least:
            lag = best + 0.5 * (earlier - later) / sharpness
            self.lag = lag if lag > _LATE else 0.0

    def _turned_late(self) -> float:
        """How far the wheels have turned the robot since the time of its heading, rad."""
        whole = int(self.lag)
        return float(self._turns[:whole].sum() + (self.lag - whole) * self._turns[whole])

    def _by_heading(self, own: float, by_wheels: float) -> Turn:
        """The turn of a step in which the heading has turned, rad, since its last reading."""
        seconds = self._seconds
        before = self._resolution
        self._resolution = self._resolution_variance
        # What the wheels add to a late heading is as uncertain as their turn.
        jitter = self._resolution + self.lag * self._variance * self._robot.control_period / seconds
        random_walk = self._noise.yaw_std**2 * seconds + LEAST_VARIANCE
        off = float(wrap_angle(own - self._turned))
        if abs(off) > JUMP + self._slipping:
            return Turn(by_wheels, self._variance, jitter=jitter)
        if self._still > STILL and abs(off) < FASTEST_DRIFT * seconds:
            variance = (random_walk + 2.0 * jitter) / seconds**2
            drift = off / seconds
            return Turn(0.0, LEAST_VARIANCE, jitter=jitter, drift=drift, drift_variance=variance)
        first = max(self._resolution - before, 0.0)  # see ``encoder_ticks.first_jitter``
        measured = self._turned + off
        return Turn(by_wheels + off, random_walk + first, measured, seconds, jitter)

    def _without_reading(self, turn: float, after_gap: float = math.nan) -> Turn:
        """The turn of the wheels, whose error ends with the next heading, if that is soon.

        After a long gap, turns are counted from the heading ``after_gap``, rad; NaN for the next.
        """
        if math.isnan(self._yaw) or self._seconds > LONGEST_GAP:
            return self._read(after_gap, Turn(turn, self._variance))
        return Turn(turn, LEAST_VARIANCE, jitter=self._resolution_variance + self._variance)

    def _read(self, yaw: float, turn: Turn) -> Turn:
        self._yaw, self._shift = yaw, self._turned_late()
        self._since_reading()
        return turn

    def _since_reading(self) -> None:
        """Begin to add up the time, s, the wheels' turn, rad, its variance, and the turn by slip of
        all that they travel.
        """
        self._seconds = self._turned = self._variance = self._slipping = 0.0

    @property
    def _resolution_variance(self) -> float:
        return max(self._tick, 0.0) ** 2 / 12.0


def turns_of(
    robot: RobotSpec,
    noise: NominalNoise,
    yaw: FloatArray,
    wheels: FloatArray,
    more: FloatArray | float = 0.0,
) -> list[Turn]:
    """The turns of one robot in t steps, by its headings (t,), rad, and its wheels (t, 2), m.
    ``more`` (t,) are as in :meth:`TurnMeter.step`.
    """
    meter = TurnMeter(robot, noise)
    more = np.broadcast_to(more, len(yaw))
    steps = zip(yaw.tolist(), np.asarray(wheels), more.tolist(), strict=True)
    return [meter.step(*each) for each in steps]
