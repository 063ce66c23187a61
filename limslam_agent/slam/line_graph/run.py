"""A run as the filter leaves it, which is smoothed, and what smoothing gives."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from limslam_agent.slam.core.diagnostics import AssociationRecord, Closure
from limslam_agent.slam.core.encoder_ticks import ticks_of
from limslam_agent.slam.core.late_ranges import behind, headings_held_back, held_back
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import compose, turned
from limslam_env.interface import NominalNoise, RobotSpec

FOUND_STDS = np.array([0.3, 0.3, math.radians(10.0)])
"""How far the place at which a carried robot was found may be off beyond the covariances of its
poses, m, m, rad. It is so wide that the readings decide, and so narrow that they are still
associated with the walls around that place.
"""

# The fields of a run that have a row for each step, and what these hold of a robot that stands
# still at its end. Its poses remain.
_ROWS = ("wheels", "ranges", "usable", "poses", "covariances", "waiting", "yaw", "wheel_variances")
_STANDING = {
    "wheels": 0.0,
    "ranges": math.nan,
    "usable": False,
    "yaw": math.nan,
    "wheel_variances": 0.0,
}


@dataclass(frozen=True, eq=False)
class FilteredRun:
    """A run of n robots in t steps: the observations and the filter's estimates."""

    # robot, noise: body and beams of each robot, and the specified noise
    robot: RobotSpec
    noise: NominalNoise
    # wheels, ranges: observations (t, n, 2) and (t, n, n_beams), m; row 0 is the observation at the
    # reset
    wheels: FloatArray
    ranges: FloatArray
    # Mask (t, n, n_beams) of the readings that are of walls, without readings that may be of other
    # robots
    usable: BoolArray
    # poses, covariances: the filter's estimates at each step (t, n, 3) and (t, n, 3, 3); the first
    # poses are the known starts
    poses: FloatArray
    covariances: FloatArray
    # associations, closures: the associations of the observed lines, and the merged landmarks, in
    # order
    associations: Sequence[AssociationRecord] = ()
    closures: Sequence[Closure] = ()
    # Step of the drive that row 0 belongs to, if the run is a part of a drive. It decides which
    # readings a slow sensor repeats.
    first_step: int = 0
    # Robots and steps before which a robot was carried away. The poses before and after say where
    # to.
    breaks: tuple[tuple[int, int], ...] = ()
    # Robots and parts of the drive, from a step to before another one, in one step of which a robot
    # has slipped
    slips: tuple[tuple[int, int, int], ...] = ()
    # How the sensor measures, as the filter has found out. None if it is as ``robot`` and ``noise``
    # state.
    sensor: RangeSensor | None = None
    # The ticks (n, 2) of the encoders, m, as the filter has found them; by ``wheels`` if left out
    ticks: FloatArray | None = None
    # Travel (t, n, 2) that waits for late ranges, m. With it, each pose is that of the readings of
    # its step.
    waiting: FloatArray | None = None
    # Headings (t, n) by inertial measurement units, rad, NaN without a reading; None without such
    # sensors
    yaw: FloatArray | None = None
    # Variances (t, n, 2) of the wheels' travel beyond the noise of encoders, m^2; None if it is
    # known everywhere
    wheel_variances: FloatArray | None = None

    @property
    def rows(self) -> dict[str, Any]:
        """The arrays (t, ...) that have a row for each step, by their names."""
        every = {name: getattr(self, name) for name in _ROWS}
        return {name: values for name, values in every.items() if values is not None}

    @property
    def headings(self) -> FloatArray | None:
        """The headings, if a robot has ever reported one."""
        return None if self.yaw is None or np.isnan(self.yaw).all() else self.yaw

    @property
    def corrected(self) -> "FilteredRun":
        """The run with readings that are corrected for what is known of its sensor."""
        sensor = self.sensor
        if sensor is None:
            return self
        ranges = sensor.corrected(self.ranges, self.robot)
        return replace(self, ranges=ranges, sensor=sensor._replace(bias=0.0, scale=0.0))

    @property
    def unknown(self) -> FloatArray:
        """Variances (t, n, 2) of the wheels' travel beyond the noise of encoders, m^2, also where
        the wheels may have slipped in any step of a part of the drive. The readings say in which.
        """
        known = self.wheel_variances
        variances = np.zeros(self.wheels.shape) if known is None else known.copy()
        wheel = FOUND_STDS[2] * self.robot.axle / math.sqrt(2.0)
        for number, first, last in self.slips:
            part = slice(max(first, 1), last)
            variances[part, number] += wheel**2 / max(last - part.start, 1)
        return variances

    @property
    def synchronous(self) -> "FilteredRun":
        """The run with wheels that wait for late ranges."""
        delay = 0.0 if self.sensor is None else self.sensor.delay
        if not delay or self.waiting is not None:
            return self
        wheels = held_back(self.wheels, delay)
        waiting = np.cumsum(self.wheels - wheels, axis=0)
        poses = behind(self.poses, waiting, self.robot.axle)
        ticks = ticks_of(self.wheels)
        yaw = None if self.yaw is None else headings_held_back(self.yaw, delay)
        return replace(self, wheels=wheels, poses=poses, ticks=ticks, waiting=waiting, yaw=yaw)

    def until(self, step: int | None) -> "FilteredRun":
        """The run before a step of its own, with what the filter had found out by then."""
        if step is None:
            return self
        end = self.first_step + step
        slips = [(number, first, min(last, step)) for number, first, last in self.slips]
        return replace(
            self,
            **{name: values[:step] for name, values in self.rows.items()},
            associations=[each for each in self.associations if each.readings[:, 0].max() < end],
            closures=[each for each in self.closures if each.step < end],
            breaks=tuple(each for each in self.breaks if each[1] < step),
            slips=tuple(each for each in slips if each[1] < step),
        )

    def lasting(self, steps: int) -> dict[str, Any]:
        """The ``rows`` for so many steps, at least as many as there are: the robots stand still at
        the end.
        """
        rest = steps - len(self.poses)
        return {
            name: np.concatenate(
                (
                    values,
                    np.full((rest, *values.shape[1:]), _STANDING.get(name, values[-1])),
                )
            )
            for name, values in self.rows.items()
        }


def beside(first: FilteredRun, second: FilteredRun, frame: FloatArray) -> FilteredRun:
    """Two runs of one robot each as a run of two robots, of which the one whose run is shorter
    stands still at its end.

    ``frame`` (3,) is the pose of the second run's frame in that of the first one.
    """
    moved = replace(
        second,
        poses=compose(frame, second.poses),
        covariances=turned(second.covariances, float(frame[2])),
    )
    steps = max(len(first.poses), len(second.poses))
    one, other = (
        replace(each.corrected, wheel_variances=each.unknown).lasting(steps)
        for each in (first, moved)
    )
    apart = 1 + max((record.landmark for record in first.associations), default=-1)
    seconds = [
        replace(each, landmark=each.landmark + apart, robot=1) for each in second.associations
    ]
    united = [
        replace(each, older=each.older + apart, younger=each.younger + apart)
        for each in second.closures
    ]
    # The readings of the longer run say more about the sensor.
    longer = max((first.corrected, second.corrected), key=lambda each: len(each.poses))
    columns: dict[str, Any] = {
        name: np.concatenate((one[name], other[name]), axis=1) for name in one if name in other
    }
    return FilteredRun(
        robot=first.robot,
        noise=first.noise,
        associations=[*first.associations, *seconds],
        closures=[*first.closures, *united],
        breaks=(*first.breaks, *((1, step) for _, step in second.breaks)),
        sensor=longer.sensor,
        **columns,
    )


@dataclass(frozen=True, eq=False)
class SmoothedRun:
    """The smoothed estimate of a run."""

    # poses, covariances: poses (t, n, 3), m and rad, and covariances (t, n, 3, 3)
    poses: FloatArray
    covariances: FloatArray
    # the poses (t, n, 3) at which the ranges were read: others than ``poses`` if these are late
    read_at: FloatArray
    # landmarks, segments: the walls of the map: their lines as landmarks with covariances, and
    # their segments (k, 4), m
    landmarks: list[Landmark]
    segments: FloatArray
    # The readings of each robot that lie on each landmark, by its place in ``landmarks``
    associations: list[AssociationRecord]
    # Calibration (n, 5): relative excess of left wheel, right wheel and axle over their specified
    # values, or with a heading sensor the numbers of ``HeadingCalibration``; and the bias, m,
    # and the scale of all ranges. None where the robots are taken to be as specified, and neither
    # is known.
    calibration: FloatArray | None
    ranges: FloatArray  # the readings (t, n, n_beams), m, corrected for all that is known of them
    contradictions: float  # share of all looks that passed through a wall of the solution
    robot: RobotSpec  # the robot with its beams as they are mounted
