"""What a table of a log does not say itself: the robot that recorded it, and the units of its columns."""

import math
from dataclasses import dataclass

import numpy as np

from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Units of ranges, m."""

TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
"""Units of times, s."""

TOO_FAST = 10.0
"""A wheel cannot travel farther than this many times its largest speed allows. A longer travel has another unit."""


@dataclass(frozen=True)
class TableOptions:
    """The robot of a table, and how its numbers become metres and seconds.

    Attributes
    ----------
    robot
        Body and beams of the robot. A table of wheel travel needs it. None for a table of poses means a robot whose
        beams start at its centre.
    metres_per_tick
        Wheel travel, m, for each 1 in the columns ``left`` and ``right``: the circumference of a wheel divided by the
        ticks in one turn of the wheel. 1 if the columns are in metres.
    accumulated
        Whether the columns ``left`` and ``right`` count from the start of the robot, as encoder counters do. Otherwise
        they hold the travel since the row before.
    range_unit
        ``m``, ``cm`` or ``mm``.
    time_unit
        ``s``, ``ms`` or ``us``.

    Raises
    ------
    ValueError
        If a unit is unknown, or the metres per tick are not a number above 0. The message names the option of the
        command line.
    """

    robot: RobotSpec | None = None
    metres_per_tick: float = 1.0
    accumulated: bool = False
    range_unit: str = "m"
    time_unit: str = "s"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.metres_per_tick) and self.metres_per_tick > 0.0):
            raise ValueError(f"--metres-per-tick must be a number above 0, not {self.metres_per_tick:g}")
        for option, unit, known in (
            ("--range-unit", self.range_unit, LENGTHS),
            ("--time-unit", self.time_unit, TIMES),
        ):
            if unit not in known:
                raise ValueError(f"{option} must be one of {', '.join(known)}, not {unit!r}")

    @property
    def metres(self) -> float:
        """Metres for each 1 in a range column."""
        return LENGTHS[self.range_unit]

    @property
    def seconds(self) -> float:
        """Seconds for each 1 in the time column."""
        return TIMES[self.time_unit]

    def wheel_travel(self, columns: FloatArray) -> FloatArray:
        """Travel of both wheels (n, 2), m, since the row before, from the columns ``left`` and ``right`` (n, 2).

        The first row has no row before it. The robot counts as standing there, wherever it drove earlier.
        """
        travel = np.diff(columns, axis=0, prepend=columns[:1]) if self.accumulated else columns.copy()
        travel[0] = 0.0
        return travel * self.metres_per_tick


def check_travel(wheels: FloatArray, time: FloatArray, robot: RobotSpec) -> None:
    """Refuse wheel travel (n, 2), m, that the robot cannot drive between two rows with the times (n,), s.

    Raises
    ------
    ValueError
        If a wheel travels more than ten times as far as the robot's largest wheel speed allows.
    """
    lasted = np.maximum(np.diff(time, prepend=time[0]), robot.control_period)
    farthest = np.abs(wheels).max(axis=1)
    is_too_far = farthest > TOO_FAST * robot.max_wheel_speed * lasted
    if not is_too_far.any():
        return
    row = int(np.argmax(is_too_far))
    raise ValueError(
        f"a wheel travels {farthest[row]:.3g} m in {lasted[row]:.3g} s at time {time[row]:g} s, but the robot's "
        f"max_wheel_speed is {robot.max_wheel_speed:g} m/s. Are left and right metres since the row before? "
        "--metres-per-tick converts ticks, and --accumulated says that they count from the start"
    )
