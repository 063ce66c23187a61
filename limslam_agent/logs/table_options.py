"""What a table of a log does not say itself: the robot that recorded it, and what its columns
mean.
"""

import math
from dataclasses import dataclass

from limslam_agent.logs.columns import MEASURED, SCALE_OF, UNITS, Column, Dimension, Role
from limslam_agent.logs.directions import apart
from limslam_env.interface import RobotSpec

LARGEST_OFF_AXIS_DEG = 45.0
"""Directions of zones lie at most this far from the optical axis of their sensor, deg."""

TOO_FAST = 10.0
"""A wheel cannot travel farther than this many times its largest speed allows. A longer travel has
another unit, or its counters are wrong.
"""

_CHOICES = {
    "range_unit": Dimension.LENGTH,
    "time_unit": Dimension.TIME,
    "angle_unit": Dimension.ANGLE,
    "position_unit": Dimension.LENGTH,
}
_CHOICE_OF: dict[Dimension | None, str] = {
    Dimension.TIME: "time_unit",
    Dimension.LENGTH: "position_unit",
    Dimension.ANGLE: "angle_unit",
    Dimension.TURN_RATE: "angle_unit",
}


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
        ``m``, ``cm``, ``mm`` or ``in``. None takes the unit in the names of the columns, or else
        metres.
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
        Unit of positions and travelled distances, ``m``, ``cm``, ``mm`` or ``in``. None takes the
        unit in the name, or else metres.
    wheel_radius
        Radius of the wheels, m. It is needed where a table has turns of the wheels in rad, or their
        speeds in rad/s or turns a minute.
    rate
        How many rows there are in a second, in place of a column of times.

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
    rate: float | None = None

    def __post_init__(self) -> None:
        for name in ("metres_per_tick", "wheel_radius", "rate"):
            number = getattr(self, name)
            if number is not None and not 0.0 < number < math.inf:
                raise ValueError(f"{_option(name)} must be a number above 0, not {number:g}")
        for name, dimension in _CHOICES.items():
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
        dimension = MEASURED.get(column.role)
        name = "range_unit" if column.role is Role.RANGE else _CHOICE_OF.get(dimension)
        chosen = getattr(self, name) if name else None
        if name is None or chosen is None:
            return column.unit or column.usual
        unit = f"{chosen}/s" if dimension is Dimension.TURN_RATE else chosen
        if column.unit not in (None, unit):
            raise ValueError(
                f"the column {column.name[:40]!r} is in {column.unit} by its name, but "
                f"{_option(name)} says {chosen}: leave out the option, or name the column "
                "otherwise with --columns"
            )
        return unit

    def along_beam(self, degrees: float, unit: str) -> float:
        """Metres along a beam in the direction ``degrees`` for each 1 in its range column, which
        is in ``unit``.

        A multi-zone sensor reports the distance d along its optical axis. At an angle a from this
        axis, the distance along the zone's own direction is d / cos(a). Raises a ValueError if no
        axis of ``zone_axes`` is near this direction.
        """
        if not self.zone_axes:
            return SCALE_OF[unit]
        off_axis = float(apart(self.zone_axes, degrees).min())
        if off_axis > LARGEST_OFF_AXIS_DEG:
            raise ValueError(
                f"--zone-axes: no axis lies within {LARGEST_OFF_AXIS_DEG:g} deg of the column at "
                f"{degrees:g} deg"
            )
        return SCALE_OF[unit] / math.cos(math.radians(off_axis))
