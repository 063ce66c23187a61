"""How the consistent estimator takes the range sensor to measure: as specified, until the readings
say otherwise.
"""

import math

import numpy as np

from limslam_agent.config.consistent import RangeErrorConfig
from limslam_agent.slam.consistent.range_noise import RangeNoise
from limslam_agent.slam.consistent.separate_bias import COMMON, DELAY, LENGTHS, TURNS, RangeErrors
from limslam_agent.slam.core.late_ranges import LONGEST
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import FloatArray
from limslam_env.interface import LARGEST_CONE

LEAST_BIAS = 2e-3
LEAST_ANGLE = math.radians(0.25)
LEAST_DELAY = 0.1
"""A bias, m, an opening angle or the directions of all beams, rad, and a delay, in steps, that
differ by less are as assumed.
"""

LEAST_SCALE = 5e-3
_SURE = 3.5
"""The same for a scale, a share; and the standard deviations by which the size of the wheels must
differ.
"""


class AssumedSensor:
    """The sensor that is assumed, and the residuals since then.

    The sensor is assumed to be as ``specified`` by the robot's settings at first; its longest range
    is ``reach``, m.

    Attributes
    ----------
    sensor, specified
        The assumed sensor, and the one that the robot's settings state.
    """

    def __init__(self, specified: RangeSensor, reach: float, config: RangeErrorConfig) -> None:
        self.specified = specified
        self._reach = reach
        self._config = config
        self.assume(specified)

    def assume(self, sensor: RangeSensor) -> None:
        """Take the sensor to measure like this from now on."""
        self.sensor, config = sensor, self._config
        # Turned beams say nothing of noise and opening angle, and while they are known roughly,
        # they look like both.
        self._is_specified = (
            sensor._replace(turns=(), delay=0.0, broken=(), bend=0.0) == self.specified
        )
        ratio = config.least_ratio if self._is_specified else config.further_ratio
        self._noise = RangeNoise(sensor, self._reach, config.least_std, ratio)
        self._is_counted = False

    @property
    def usual_std(self) -> float:
        """Standard deviation of a range of usual length, m."""
        return self.sensor.usual_std(self._reach)

    def count(self, residuals: FloatArray, ranges: FloatArray) -> None:
        """Count the residuals (n,) of a piece of wall that is used, in standard deviations, and its
        ranges (n,), m.
        """
        self._noise.count(residuals, ranges)
        self._is_counted = True

    def correction(self, errors: RangeErrors | None) -> RangeSensor | None:
        """The sensor that the readings so far require; None if the assumed one will do, or nothing
        is new.

        The errors are those that are estimated beside the filter; None if they are not.
        """
        if not self._is_counted or errors is None:
            return None
        self._is_counted = False
        config = self._config
        sensor = self.sensor
        noise = self._noise.estimate
        change = errors.estimate_of(LENGTHS)[0]
        change[1] = np.clip(change[1], -sensor.cone, LARGEST_CONE - sensor.cone)
        is_large = np.abs(change) > (LEAST_BIAS, LEAST_ANGLE)
        evidence = np.where(is_large, errors.length_evidence if is_large.any() else 0.0, 0.0)
        gate = config.gate
        noise_gate = config.noise_gate
        if not self._is_specified:
            gate = noise_gate = config.further_gate
        bend, of_bend = errors.bend
        if of_bend > config.gate:
            return sensor._replace(bend=math.hypot(sensor.bend, bend))
        turned = self._turned(errors)
        if turned is not None:
            return turned
        # What a model of wide cones leaves unexplained would be taken for a bias. A known one has
        # to be corrected.
        may_be_biased = sensor.cone == self.specified.cone or sensor.bias != 0.0
        is_biased = may_be_biased and evidence[0] > (
            config.further_gate if sensor.bias else config.gate
        )
        if not is_biased and evidence[1] < gate and noise.evidence < noise_gate:
            return None
        # Too little noise looks like an opening angle, and the reverse. So once one of them is
        # known to be wrong, any evidence for the other one counts. A bias is not found that early.
        change = np.where([is_biased, evidence[1] > 0.0], change, 0.0)
        std, growth = (
            (noise.std, noise.growth) if noise.evidence > 0.0 else (sensor.std, sensor.growth)
        )
        cone = sensor.cone + float(change[1])
        bias = sensor.bias + float(change[0])
        return sensor._replace(std=std, growth=growth, cone=cone, bias=bias)

    def delayed(self, errors: RangeErrors | None) -> RangeSensor | None:
        """The sensor with another delay of its ranges, if the readings so far require that."""
        if errors is None:
            return None
        delay = self.sensor.delay
        gate = self._config.further_gate if self.sensor.delay else self._config.gate
        further = float(errors.estimate_of(COMMON)[0][DELAY])
        if abs(further) < LEAST_DELAY or delay + further < 0.0 or errors.delay_evidence < gate:
            return None
        return self.sensor._replace(delay=min(delay + further, LONGEST), bend=0.0)

    def scaled(
        self, errors: RangeErrors | None, size: float, std: float, prior: float
    ) -> RangeSensor | None:
        """The sensor with another scale, if the wheels seem to be larger by ``size``, a share.

        Larger wheels and longer ranges show the same, a larger building: the readings tell the sum
        of both alone, here with the standard deviation ``std``. So the sum is divided as the
        variances of both are before the drive; ``prior`` is the standard deviation of the wheels'
        size. What each of them may have more, and the other one less, remains unknown. A bias has
        to be found before, since it makes the wheels seem larger, too.
        """
        sensor = self.sensor
        own = self._config.scale_std
        both = math.hypot(own, prior)
        if errors is None or not own or abs(size) < _SURE * std:
            return None
        scale = (own / both) ** 2 * (size + sensor.scale)
        if abs(scale - sensor.scale) < LEAST_SCALE or errors.length_evidence[0] > 0.0:
            return None
        return sensor._replace(scale=scale, scale_std=own * prior / both)

    def _turned(self, errors: RangeErrors) -> RangeSensor | None:
        """The sensor with other directions of its beams, if the readings require that.

        Turned beams look like noise, a bias or an opening angle, so they are corrected first and
        alone. Beams that are known to be turned are corrected whenever that explains the readings
        better than chance would: the first estimate, from few metres, is some tenths of a degree
        off.
        """
        sensor = self.sensor
        count = len(errors.stds[TURNS])
        if not count:
            return None
        turns = errors.estimate_of(TURNS)[0]
        if np.abs(turns).max() < LEAST_ANGLE:
            return None
        if sensor.turns:
            # The gain is that beside a prior about the assumed directions. The prior of all turns
            # is about zero.
            gain = errors.turn_gain
            gate = self._config.further_gate + count
            evidence = gain - 2.0 * float(turns @ np.array(sensor.turns)) / self._config.turn_std**2
        else:
            evidence = errors.turn_evidence
            gate = self._config.gate
        if evidence < gate:
            return None
        turns = turns + (sensor.turns or np.zeros(count))
        return sensor._replace(turns=tuple(turns.tolist()), bend=0.0)
