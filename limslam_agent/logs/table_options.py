"""What a table of a log does not say itself: the robot that recorded it, and what its columns
mean.
"""

import math
from dataclasses import dataclass

import numpy as np

from limslam_agent.logs.columns import DIMENSION_OF, UNITS, Column, Dimension, Role
from limslam_env.geometry import FloatArray, IntArray, se2
from limslam_env.interface import RobotSpec

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


_OPTIONS = {
    "range_unit": Dimension.LENGTH,
    "time_unit": Dimension.TIME,
    "angle_unit": Dimension.ANGLE,
    "position_unit": Dimension.LENGTH,
}
_OPTION_OF = {
    Role.TIME: "time_unit",
    Role.RANGE: "range_unit",
    Role.X: "position_unit",
    Role.Y: "position_unit",
    Role.DISTANCE: "position_unit",
    Role.HEADING: "angle_unit",
    Role.YAW: "angle_unit",
    Role.ANGLE: "angle_unit",
    Role.TURN_RATE: "angle_unit",
    Role.YAW_RATE: "angle_unit",
}


def scale(unit: str) -> float:
    """How many s, m, rad, m/s or rad/s a unit is."""
    return UNITS[DIMENSION_OF[unit]][unit]


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


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
        ``m``, ``cm`` or ``mm``. None takes the unit in the names of the columns, or else metres.
    time_unit
        ``s``, ``ms``, ``us`` or ``ns``. None takes the unit in the name of the column, or the one
        that the spacing of the rows shows, or else seconds.
    zone_axes
        Directions of the optical axes of multi-zone sensors in the robot's frame, deg. The columns
        then hold perpendicular distances, along the axis that is nearest to the direction of the
        column. Without axes the columns hold distances along their own directions.
    columns
        What the columns hold, in place of the file's own header: the names that a header would
        have, in any order, ``-`` for a column that is not used, and ``-`` before the name of one
        that counts the other way. Empty if the header of the file is read.
    angle_unit
        Unit of headings and turns, ``rad`` or ``deg``. None takes the unit in the name of the
        column, or the one that the motion shows, or else radians.
    position_unit
        Unit of positions and travelled distances, ``m``, ``cm`` or ``mm``. None takes the unit in
        the name, or else metres.
    wheel_radius
        Radius of the wheels, m, which speeds of wheels in rad/s or turns a minute need.

    Raises
    ------
    ValueError
        If a unit is unknown, the metres per tick are not a number above 0, or an axis is not a
        number. The message names the option of the command line.
    """

    robot: RobotSpec | None = None
    metres_per_tick: float = 1.0
    accumulated: bool = False
    range_unit: str | None = None
    time_unit: str | None = None
    zone_axes: tuple[float, ...] = ()
    columns: tuple[str, ...] = ()
    angle_unit: str | None = None
    position_unit: str | None = None
    wheel_radius: float | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.metres_per_tick) and self.metres_per_tick > 0.0):
            raise ValueError(
                f"--metres-per-tick must be a number above 0, not {self.metres_per_tick:g}"
            )
        radius = self.wheel_radius
        if radius is not None and not (math.isfinite(radius) and radius > 0.0):
            raise ValueError(f"--wheel-radius must be a number above 0, not {radius:g}")
        for name, dimension in _OPTIONS.items():
            unit = getattr(self, name)
            known = UNITS[dimension]
            if unit is not None and unit not in known:
                option = _option(name)
                raise ValueError(f"{option} must be one of {', '.join(known)}, not {unit!r}")
        if not all(map(math.isfinite, self.zone_axes)):
            raise ValueError(f"--zone-axes must be directions in degrees, not {self.zone_axes}")

    def unit_of(self, column: Column) -> str | None:
        """Unit of a column: that in its name, that of an option, or the usual one. None if nothing
        says it. Raises a ValueError if the name and the option do not agree.
        """
        name = _OPTION_OF.get(column.role) if column.role is not None else None
        chosen = None if name is None else getattr(self, name)
        if chosen is not None and column.role in (Role.TURN_RATE, Role.YAW_RATE):
            chosen = f"{chosen}/s"
        if name is not None and chosen is not None and column.unit not in (None, chosen):
            raise ValueError(
                f"the column {column.name[:40]!r} is in {column.unit} by its name, but "
                f"{_option(name)} says {getattr(self, name)}: leave out the option, or name the "
                "column otherwise with --columns"
            )
        return column.unit or chosen or column.usual

    def along_beam(self, degrees: float, unit: str) -> float:
        """Metres along a beam in the direction ``degrees`` for each 1 in its range column, which
        is in ``unit``.

        A multi-zone sensor reports the distance d along its optical axis. At an angle a from this
        axis, the distance along the zone's own direction is d / cos(a). Raises a ValueError if no
        axis of ``zone_axes`` is near this direction.
        """
        metres = UNITS[Dimension.LENGTH][unit]
        if not self.zone_axes:
            return metres
        apart = np.abs(se2.wrap_angle(np.radians(np.array(self.zone_axes) - degrees))).min()
        if apart > math.radians(LARGEST_OFF_AXIS_DEG):
            raise ValueError(
                f"--zone-axes: no axis lies within {LARGEST_OFF_AXIS_DEG:g} deg of the column at "
                f"{degrees:g} deg"
            )
        return metres / math.cos(apart)

    def travel(
        self, columns: FloatArray, metres: FloatArray, fastest: float, period: float
    ) -> tuple[FloatArray, IntArray]:
        """Travel (n, k), m, since the row before, from columns (n, k) of travel or counters, and
        the rows (r,) in which counters begin again at 0.

        ``metres`` (k,) is the travel for each 1 in them, ``fastest`` the largest speed, m/s, and
        ``period`` the usual time between two rows, s.

        The first row has no row before it. The robot counts as standing there, wherever it drove
        earlier. Counters of any number of bits, with or without a sign, are continued where they
        begin again. Those of a board that was switched on again count from there.
        """
        restarts = np.zeros(0, dtype=np.int64)
        if self.accumulated:
            travel = np.diff(columns, axis=0, prepend=columns[:1])
            farthest = SPARE * fastest * period / float(metres.min())
            travel = _continued(travel, columns, farthest)
            is_far = (np.abs(travel) > farthest).any(axis=1)
            restarts = np.flatnonzero(is_far & (np.abs(columns) <= farthest).all(axis=1))
            travel[restarts] = columns[restarts]
        else:
            travel = columns.copy()
        travel[0] = 0.0
        return travel * metres, restarts


def _continued(travel: FloatArray, columns: FloatArray, farthest: float) -> FloatArray:
    """Travel (n, k), ticks, without the jumps of counters (n, k) that begin again after a power of
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
    wheels: FloatArray,
    time: FloatArray,
    robot: RobotSpec,
    options: TableOptions,
    question: str = "",
) -> None:
    """Refuse wheel travel (n, 2), m, that the robot cannot drive between two rows with the times
    (n,), s.

    The message ends with ``question``, or asks about what the options have not said. Raises a
    ValueError if a wheel travels more than ten times as far as the robot's largest wheel speed
    allows.
    """
    lasted = np.maximum(np.diff(time, prepend=time[0]), robot.control_period)
    travelled = np.abs(wheels).max(axis=1)
    farthest = TOO_FAST * robot.max_wheel_speed * lasted
    if not (travelled > farthest).any():
        return
    row = int(np.argmax(travelled > farthest))
    raise ValueError(
        f"a wheel travels {travelled[row]:.3g} m in {lasted[row]:.3g} s at time {time[row]:g} s, "
        f"but the robot's max_wheel_speed is {robot.max_wheel_speed:g} m/s. "
        f"{question or _question(wheels, farthest, options)}"
    )


def _question(wheels: FloatArray, farthest: FloatArray, options: TableOptions) -> str:
    """What to ask about wheel travel (n, 2), m, of which some is more than ``farthest`` (n,), m."""
    if options.accumulated:
        return (
            f"Is --metres-per-tick {options.metres_per_tick:g} right? Counters may begin again "
            "after a power of two"
        )
    changes = np.abs(np.diff(wheels, axis=0)).max(axis=1, initial=0.0)
    if (changes[1:] <= farthest[2:]).all():
        return "They look like counters: --accumulated says that they count from the start"
    return (
        "Are left and right metres since the row before? --metres-per-tick converts ticks, and "
        "--accumulated says that they count from the start"
    )
