"""What a table of a log does not say itself: the robot that recorded it, and what its columns
mean.
"""

import math
from dataclasses import dataclass

import numpy as np

from limslam_env.geometry import FloatArray, se2
from limslam_env.interface import RobotSpec

LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Units of ranges, m."""

TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
"""Units of times, s."""

LARGEST_OFF_AXIS_DEG = 45.0
"""Directions of zones lie at most this far from the optical axis of their sensor, deg."""

CLOCK_COUNTS = 2.0**32
"""A clock in ms or us begins again after so many counts: that in us every 72 minutes."""

LONGEST_PAUSE = 10.0
"""Longest time between two rows in which a clock begins again because it is full, s."""

FEWEST_COUNTER_BITS = 8
"""Counters that begin again have at least so many bits."""

SPARE = 2.0
"""Without the jump of a counter that begins again, a wheel travels at most this many times what its
largest speed allows.
"""

TOO_FAST = 10.0
"""A wheel cannot travel farther than this many times its largest speed allows. A longer travel has
another unit, or its counters are wrong.
"""


@dataclass(frozen=True)
class TableOptions:
    """The robot of a table, and how its numbers become metres and seconds.

    Attributes
    ----------
    robot
        Body and beams of the robot. A table of wheel travel needs it. None for a table of poses
        means a robot whose beams start at its centre.
    metres_per_tick
        Wheel travel, m, for each 1 in the columns ``left`` and ``right``: the circumference of a
        wheel divided by the ticks in one turn of the wheel. 1 if the columns are in metres.
    accumulated
        Whether the columns ``left`` and ``right`` count from the start of the robot, as encoder
        counters do. Otherwise they hold the travel since the row before.
    range_unit
        ``m``, ``cm`` or ``mm``.
    time_unit
        ``s``, ``ms`` or ``us``.
    zone_axes
        Directions of the optical axes of multi-zone sensors in the robot's frame, deg. The columns
        then hold perpendicular distances, along the axis that is nearest to the direction of the
        column. Without axes the columns hold distances along their own directions.
    columns
        What the columns hold, in place of the file's own header: the names that a header would
        have, in any order, and ``-`` for a column that is not used. Empty if the header of the file
        is read.

    Raises
    ------
    ValueError
        If a unit is unknown, the metres per tick are not a number above 0, or an axis is not a
        number. The message names the option of the command line.
    """

    robot: RobotSpec | None = None
    metres_per_tick: float = 1.0
    accumulated: bool = False
    range_unit: str = "m"
    time_unit: str = "s"
    zone_axes: tuple[float, ...] = ()
    columns: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not (math.isfinite(self.metres_per_tick) and self.metres_per_tick > 0.0):
            raise ValueError(
                f"--metres-per-tick must be a number above 0, not {self.metres_per_tick:g}"
            )
        for option, unit, known in (
            ("--range-unit", self.range_unit, LENGTHS),
            ("--time-unit", self.time_unit, TIMES),
        ):
            if unit not in known:
                raise ValueError(f"{option} must be one of {', '.join(known)}, not {unit!r}")
        if not all(map(math.isfinite, self.zone_axes)):
            raise ValueError(f"--zone-axes must be directions in degrees, not {self.zone_axes}")

    @property
    def seconds(self) -> float:
        """Seconds for each 1 in the time column."""
        return TIMES[self.time_unit]

    def along_beam(self, degrees: float) -> float:
        """Metres along a beam in the direction ``degrees`` for each 1 in its range column.

        A multi-zone sensor reports the distance d along its optical axis. At an angle a from this
        axis, the distance along the zone's own direction is d / cos(a). Raises a ValueError if no
        axis of ``zone_axes`` is near this direction.
        """
        if not self.zone_axes:
            return LENGTHS[self.range_unit]
        apart = np.abs(se2.wrap_angle(np.radians(np.array(self.zone_axes) - degrees))).min()
        if apart > math.radians(LARGEST_OFF_AXIS_DEG):
            raise ValueError(
                f"--zone-axes: no axis lies within {LARGEST_OFF_AXIS_DEG:g} deg of the column at "
                f"{degrees:g} deg"
            )
        return LENGTHS[self.range_unit] / math.cos(apart)

    def wheel_travel(self, columns: FloatArray, robot: RobotSpec) -> FloatArray:
        """Travel of both wheels (n, 2), m, since the row before, from the columns ``left`` and
        ``right`` (n, 2).

        The first row has no row before it. The robot counts as standing there, wherever it drove
        earlier. Counters of any number of bits, with or without a sign, are continued where they
        begin again. The control period of ``robot`` is the usual time between two rows.
        """
        travel = (
            np.diff(columns, axis=0, prepend=columns[:1]) if self.accumulated else columns.copy()
        )
        travel[0] = 0.0
        if self.accumulated:
            farthest = SPARE * robot.max_wheel_speed * robot.control_period / self.metres_per_tick
            travel = _continued(travel, columns, farthest)
        return travel * self.metres_per_tick


def _continued(travel: FloatArray, columns: FloatArray, farthest: float) -> FloatArray:
    """Travel (n, 2), ticks, without the jumps of counters (n, 2) that begin again after a power of
    two.

    They count as such counters if the jump is right in at least one row: without it, no wheel
    travels more than ``farthest``.
    """
    largest = float(np.ptp(columns, axis=0).max())
    if not largest < 2.0**63:  # no counter has more bits
        return travel
    bits = max(int(largest).bit_length(), FEWEST_COUNTER_BITS)
    jumps = np.round(travel / 2.0**bits)
    continued = travel - jumps * 2.0**bits
    is_proof = jumps.any(axis=1) & (np.abs(continued) <= farthest).all(axis=1)
    return continued if is_proof.any() and (columns == np.round(columns)).all() else travel


def check_travel(
    wheels: FloatArray, time: FloatArray, robot: RobotSpec, options: TableOptions
) -> None:
    """Refuse wheel travel (n, 2), m, that the robot cannot drive between two rows with the times
    (n,), s.

    The message asks about what the options have not said. Raises a ValueError if a wheel travels
    more than ten times as far as the robot's largest wheel speed allows.
    """
    lasted = np.maximum(np.diff(time, prepend=time[0]), robot.control_period)
    farthest = np.abs(wheels).max(axis=1)
    is_too_far = farthest > TOO_FAST * robot.max_wheel_speed * lasted
    if not is_too_far.any():
        return
    row = int(np.argmax(is_too_far))
    question = (
        f"Is --metres-per-tick {options.metres_per_tick:g} right? Counters may begin again after a "
        "power of two"
        if options.accumulated
        else "Are left and right metres since the row before? --metres-per-tick converts ticks, "
        "and --accumulated says that they count from the start"
    )
    raise ValueError(
        f"a wheel travels {farthest[row]:.3g} m in {lasted[row]:.3g} s at time {time[row]:g} s, "
        f"but the robot's max_wheel_speed is {robot.max_wheel_speed:g} m/s. {question}"
    )
