"""How a range sensor measures: its noise, its beams, and the bias and the delay of its ranges."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

USUAL_RANGE = 0.7
"""The usual length of a range is this share of the longest one."""


class RangeSensor(NamedTuple):
    """How a range sensor measures.

    Attributes
    ----------
    std
        Standard deviation of short ranges, m.
    growth
        Further noise, 1/m: its standard deviation is this times the squared range.
    cone
        Half the opening angle of the beams, rad; 0 for rays.
    bias
        By what all ranges are too long, m.
    scale
        Further share by which all ranges are too long.
    scale_std
        What is unknown of the scale: its standard deviation, that of the size of the whole map.
    turns
        By what each beam is turned to the left against the robot's settings, rad; empty if no beam
        is.
    delay
        By how many steps the ranges are later than the wheels.
    broken
        Numbers of the beams that are left out, since they always read the same.
    bend
        Of the walls that it reads: standard deviation of their curvature, 1/m; 0 if they are
        straight.
    """

    std: float
    growth: float = 0.0
    cone: float = 0.0
    bias: float = 0.0
    turns: tuple[float, ...] = ()
    delay: float = 0.0
    broken: tuple[int, ...] = ()
    scale: float = 0.0
    scale_std: float = 0.0
    bend: float = 0.0

    @property
    def numbers(self) -> tuple[float, float, float]:
        """Noise and opening angle as plain numbers, for compiled code."""
        return float(self.std), float(self.growth), float(self.cone)

    @property
    def places(self) -> tuple[Any, ...]:
        """What decides where the ends of beams are drawn."""
        return self.bias, self.scale, self.turns

    def corrected(self, ranges: FloatArray, robot: RobotSpec) -> FloatArray:
        """Reported ranges (..., n_beams) as they should have been, m.

        Those that show no wall, at the sensor's limits, remain as they are, and no other one
        becomes one of them.
        """
        if not (self.bias or self.scale):
            return ranges
        near = robot.too_near
        far = robot.too_far
        is_wall = (ranges > near) & (ranges < far)
        within = np.clip(self.true(ranges), np.nextafter(near, far), np.nextafter(far, near))
        return np.where(is_wall, within, ranges)

    def true(self, ranges: FloatArray) -> FloatArray:
        """Distances at which ranges are reported, m."""
        return np.asarray((ranges - self.bias) / (1.0 + self.scale))

    def reported(self, distances: FloatArray) -> FloatArray:
        """Ranges that are reported at distances, m."""
        return np.asarray(distances * (1.0 + self.scale) + self.bias)

    def variances(self, ranges: FloatArray) -> FloatArray:
        """Variances of ranges (n,), m^2."""
        return np.asarray(self.std**2 + (self.growth * ranges**2) ** 2)

    def stds(self, ranges: FloatArray) -> FloatArray:
        """Standard deviations of ranges (n,), m."""
        return np.sqrt(self.variances(ranges))

    def usual_std(self, reach: float) -> float:
        """Standard deviation of a range of usual length, m, if the longest one is ``reach``, m."""
        return float(self.stds(np.array([USUAL_RANGE * reach]))[0]) if self.growth else self.std

    def mounted(self, robot: RobotSpec) -> RobotSpec:
        """The robot with its beams as they are mounted. Each beam keeps its side."""
        if not self.turns:
            return robot
        beams = zip(robot.beams, self.turns, strict=True)
        return replace(
            robot, beams=tuple(replace(beam, angle=beam.angle + turn) for beam, turn in beams)
        )

    def found(self, specified: "RangeSensor", period: float) -> dict[str, Any]:
        """What was found about a sensor that is not as specified, for a ``result.json``; empty if
        it is as specified.

        ``period`` is the time of a step, s.
        """
        own, assumed = (each._asdict() for each in (self, specified))
        names = {
            "std": "noise_m",
            "growth": "noise_growth_per_m",
            "cone": "cone_rad",
            "bias": "bias_m",
            "scale": "scale",
            "scale_std": "scale_std",
            "bend": "wall_curvature_per_m",
        }
        numbers = {name: own[part] for part, name in names.items() if own[part] != assumed[part]}
        delay = {"delay_s": self.delay * period} if self.delay else {}
        return {**numbers, **delay, **({"broken_beams": list(self.broken)} if self.broken else {})}

    def change_from(self, other: "RangeSensor") -> FloatArray:
        """By what bias, opening angle, delay and the turns of the beams, if there are any, exceed
        another sensor's.
        """
        count = max(len(self.turns), len(other.turns))
        turns = np.subtract(self.turns or np.zeros(count), other.turns or np.zeros(count))
        return np.array(
            [self.bias - other.bias, self.cone - other.cone, self.delay - other.delay, *turns]
        )
