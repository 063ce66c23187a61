"""Turns the odometry of a table into wheel travel or poses: counters, speeds, travelled distances
and turns. A heading or a turn rate of an inertial measurement unit is compared with the wheels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from limslam_agent.logs.columns import Dimension, Role
from limslam_agent.logs.headings import FULL_TURN, heading_beside_wheels
from limslam_agent.logs.lost_reports import gaps_in
from limslam_agent.logs.table_layout import Form, Layout
from limslam_agent.logs.table_options import TableOptions, scale
from limslam_env.geometry import FloatArray, se2
from limslam_env.interface import RobotSpec

_WHEELS = (Role.LEFT, Role.RIGHT)
_QUATERNION = (Role.QX, Role.QY, Role.QZ, Role.QW)
_SPEEDS = {Dimension.SPEED, Dimension.TURN_RATE}
# rad/s: a robot that turns faster for more than one row in twenty has its heading in degrees
_FASTEST_TURN = 2.0 * np.pi
_MOST_NAMED = 5  # times in a note


@dataclass(frozen=True)
class Odometry:
    """The odometry of a table, with one row for each of its rows.

    Attributes
    ----------
    wheels
        Left and right wheel travel since the row before (n, 2), m, or None.
    poses
        Poses (n, 3), m, m, rad, or None. There are either wheels or poses.
    yaw
        Heading by an inertial measurement unit (n,), rad, counter-clockwise, NaN where it has no
        reading, or None.
    units
        The unit in which each column was read.
    is_speed
        Whether the odometry was calculated from speeds.
    question
        What to ask where the travel is impossible. Empty for the travel of wheels.
    notes
        What was found and assumed, in words.
    gaps
        The rows before which reports of the wheels are missing.
    """

    wheels: FloatArray | None
    poses: FloatArray | None
    yaw: FloatArray | None
    units: dict[Role, str]
    is_speed: bool
    question: str
    notes: tuple[str, ...]
    gaps: Sequence[int] = ()


def odometry_of(
    layout: Layout,
    values: Mapping[Role, FloatArray],
    time: FloatArray,
    period: float,
    options: TableOptions,
) -> Odometry:
    """The odometry of a table.

    Parameters
    ----------
    layout
        What the columns are used for.
    values
        The numbers (n,) of each column that is used, as they stand in the file, but with the sign
        of the column.
    time
        Times (n,), s.
    period
        Usual time between two rows, s.
    options
        The robot and the units that the user has named.

    Raises
    ------
    ValueError
        If the robot or the radius of its wheels is needed and not given, or a unit in a name and
        an option do not agree.
    """
    return _Conversion(layout, values, time, period, options).odometry()


class _Conversion:
    """The columns of one table with what was found about them so far."""

    def __init__(
        self,
        layout: Layout,
        values: Mapping[Role, FloatArray],
        time: FloatArray,
        period: float,
        options: TableOptions,
    ) -> None:
        self.layout = layout
        self.values = values
        self.options = options
        self.period = period
        self.time = time
        self.spacing = np.maximum(np.diff(time, prepend=time[:1]), 0.0)
        # A speed says how far the robot drove until the row, and not in all of a gap before it.
        has_gaps = self.spacing > (1.5 * period if options.robot else np.inf)
        self.lasted = np.where(has_gaps, period, self.spacing)
        self.units: dict[Role, str] = {}
        self.notes: list[str] = []
        self.is_speed = False

    def odometry(self) -> Odometry:
        wheels = poses = yaw = None
        robot = self.options.robot
        if self.layout.form is Form.POSES:
            poses = self._poses()
        elif self.layout.form is Form.WHEELS:
            if robot is None:
                raise ValueError(
                    "a table of wheel travel needs --robot FILE, with the robot's axle, radius "
                    "and beams"
                )
            wheels = self._wheels(robot)
            yaw = self._inertial(np.diff(wheels, axis=1)[:, 0] / robot.axle)
        else:
            forward, turn = self._motion()
            axle = 1.0 if robot is None else robot.axle
            wheels = np.column_stack((forward - 0.5 * axle * turn, forward + 0.5 * axle * turn))
        gaps = list[int]()
        if wheels is not None and robot is None:
            start = np.zeros(3)
            poses = np.vstack((start, se2.driven(wheels[1:], axle, start)))
            wheels = None
        elif wheels is not None and (self.is_speed or not self.options.accumulated):
            gaps = gaps_in(wheels, self.time, self.period).tolist()
        question = ""
        if self.is_speed:
            question = "Are the speeds in m/s and rad/s? --columns names others, as in left_mm_s"
        elif self.layout.form is Form.MOTION:
            question = (
                "Is the distance in metres, since the row before? --position-unit and "
                "--accumulated say otherwise"
            )
        return Odometry(
            wheels,
            poses,
            yaw,
            self.units,
            self.is_speed,
            question,
            tuple(self.notes),
            gaps,
        )

    def _scaled(self, role: Role, usual: str) -> FloatArray:
        """A column in m, rad, m/s or rad/s. ``usual`` is its unit where nothing says another."""
        unit = self.options.unit_of(self.layout.column(role)) or usual
        self.units[role] = unit
        return self.values[role] * scale(unit)

    def _wheels(self, robot: RobotSpec) -> FloatArray:
        """Travel of both wheels (n, 2), m, since the row before."""
        columns = [self.layout.column(role) for role in _WHEELS]
        if columns[0].dimension in _SPEEDS:
            self._say_that_ticks_do_not_matter()
            speeds = np.column_stack([self._wheel_speed(role) for role in _WHEELS])
            return speeds * self.lasted[:, None]
        metres = np.full(2, self.options.metres_per_tick)
        for place, column in enumerate(columns):
            is_length = column.dimension is Dimension.LENGTH
            metres[place] = scale(column.unit or "m") if is_length else metres[place]
            ticks = f"{self.options.metres_per_tick:g} m for each 1"
            self.units[_WHEELS[place]] = (column.unit or "m") if is_length else ticks
        if columns[0].dimension is Dimension.LENGTH and self.options.metres_per_tick != 1.0:
            self.notes.append(
                f"--metres-per-tick is not used: by its name {columns[0].name} is in "
                f"{columns[0].unit}"
            )
        counters = np.column_stack([self.values[role] for role in _WHEELS])
        travel, restarts = self.options.travel(counters, metres, robot.max_wheel_speed, self.period)
        if len(restarts):
            when = ", ".join(f"{self.time[row]:.1f} s" for row in restarts[:_MOST_NAMED])
            more = ", ..." if len(restarts) > _MOST_NAMED else ""
            self.notes.append(
                f"the counters of the wheels begin again at 0 at {when}{more}, as of a board that "
                "was switched on again: how the robot moved there is not known"
            )
        return travel

    def _wheel_speed(self, role: Role) -> FloatArray:
        """Speed of a wheel (n,), m/s."""
        column = self.layout.column(role)
        speed = self._scaled(role, "m/s")
        if column.dimension is Dimension.SPEED:
            return speed
        if self.options.wheel_radius is None:
            raise ValueError(
                f"the column {column.name[:40]!r} is the speed of a wheel in {self.units[role]}: "
                "--wheel-radius says the radius of the wheels, m; or --columns names a speed in "
                "m/s, as in left_m_s"
            )
        return speed * self.options.wheel_radius

    def _motion(self) -> tuple[FloatArray, FloatArray]:
        """Travelled distance (n,), m, and turn (n,), rad, since the row before."""
        roles = self.layout.motion
        if Role.DISTANCE in roles:
            forward = self._since_before(self._scaled(Role.DISTANCE, "m"))
        else:
            spans = Role.HEADING in roles or Role.YAW in roles
            forward = self._scaled(Role.SPEED, "m/s") * (self.spacing if spans else self.lasted)
        if Role.ANGLE in roles:
            turn = self._since_before(self._in_degrees_if_fast(Role.ANGLE, "rad"))
        elif Role.TURN_RATE in roles or Role.YAW_RATE in roles:
            role = Role.TURN_RATE if Role.TURN_RATE in roles else Role.YAW_RATE
            turn = self._in_degrees_if_fast(role, "rad/s") * self.lasted
        else:
            heading = self._heading()
            turn = se2.wrap_angle(np.diff(heading, prepend=heading[:1]))
        self.is_speed = Role.SPEED in roles
        if self.is_speed:
            self._say_that_ticks_do_not_matter()
        forward[0] = turn[0] = 0.0
        return forward, turn

    def _since_before(self, column: FloatArray) -> FloatArray:
        """A column of travel or turn (n,) since the row before."""
        if not self.options.accumulated:
            return column.copy()
        return np.diff(column, prepend=column[:1])

    def _poses(self) -> FloatArray:
        position = [self._scaled(role, "m") for role in (Role.X, Role.Y)]
        return np.column_stack((*position, self._heading()))

    def _heading(self) -> FloatArray:
        """The heading of poses (n,), rad."""
        if Role.QW in self.layout.motion:
            heading = _yaw_of([self.values[role] for role in _QUATERNION])
            if not np.isfinite(heading).all():
                row = int(np.argmin(np.isfinite(heading)))
                raise ValueError(f"the quaternion (qx, qy, qz, qw) of row {row} is no rotation")
            return heading
        role = Role.HEADING if Role.HEADING in self.layout.motion else Role.YAW
        return self._in_degrees_if_fast(role, "rad")

    def _in_degrees_if_fast(self, role: Role, usual: str) -> FloatArray:
        """An angle or a turn rate, rad or rad/s, of which degrees are taken if in radians the robot
        would turn faster than any does.
        """
        known = self.options.unit_of(self.layout.column(role))
        raw = self.values[role]
        if role in (Role.TURN_RATE, Role.YAW_RATE):
            rates = np.abs(raw)
        elif role is Role.ANGLE and not self.options.accumulated:
            rates = np.abs(raw[1:]) / np.maximum(self.spacing[1:], 1e-9)
        else:
            rates = np.abs(np.diff(raw)) / np.maximum(self.spacing[1:], 1e-9)
            if np.ptp(raw) < FULL_TURN:
                rates = rates[:0]
        moving = rates[rates > 0.0]
        fast = float(np.quantile(moving, 0.95)) if len(moving) else 0.0
        if known is None and fast > _FASTEST_TURN:
            usual = usual.replace("rad", "deg")
            self.notes.append(
                f"the column {self.layout.column(role).name} is read in {usual}: in radians the "
                f"robot would turn at {fast:.3g} rad/s; --angle-unit says another unit"
            )
        return self._scaled(role, usual)

    def _inertial(self, turns: FloatArray) -> FloatArray | None:
        """The heading of an inertial measurement unit (n,), rad, beside wheels that turn the robot
        by ``turns`` (n,), rad. None without one that follows them.
        """
        roles = self.layout.inertial
        if not roles:
            return None
        if Role.QW in roles:
            name = self.layout.column(Role.QW).name
            choices = {"": _yaw_of([self.values[role] for role in _QUATERNION])}
            role = Role.QW
        else:
            role = next(iter(roles))
            name = self.layout.column(role).name
            known = self.options.unit_of(self.layout.column(role))
            rate = "/s" if role is Role.YAW_RATE else ""
            units = (f"rad{rate}", f"deg{rate}") if known is None else (known,)
            choices = {unit: self._integrated(role, unit) for unit in units}
        remedy = f", which -{role} in --columns says"
        found = heading_beside_wheels(choices, turns, name, remedy)
        self.notes.extend(found.notes)
        if found.unit:
            self.units[role] = found.unit
        return found.yaw

    def _integrated(self, role: Role, unit: str) -> FloatArray:
        """A heading (n,), rad, from a column of headings or of turn rates in a unit."""
        column = self.values[role] * scale(unit)
        if role is not Role.YAW_RATE:
            return column
        # A rate that is missing leaves the heading unknown from there on, so the last one is kept.
        rows = np.maximum.accumulate(np.where(np.isfinite(column), np.arange(len(column)), 0))
        return np.nancumsum(column[rows] * self.spacing)

    def _say_that_ticks_do_not_matter(self) -> None:
        self.is_speed = True
        unused = [
            option
            for option, is_given in (
                ("--metres-per-tick", self.options.metres_per_tick != 1.0),
                ("--accumulated", self.options.accumulated),
            )
            if is_given
        ]
        if unused:
            are = "are" if len(unused) > 1 else "is"
            self.notes.append(f"the columns hold speeds, so {' and '.join(unused)} {are} not used")


def _yaw_of(quaternion: list[FloatArray]) -> FloatArray:
    """Headings (n,), rad, of quaternions x, y, z, w of any length; NaN where they are zero."""
    x, y, z, w = quaternion
    heading = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return np.where(np.any(quaternion, axis=0), heading, np.nan)
