"""Turns the odometry of a table into wheel travel or poses: counters, speeds, travelled distances
and turns. A heading or a turn rate of an inertial measurement unit is compared with the wheels.
"""

from collections.abc import Sequence

import numpy as np

from limslam_agent.logs.columns import MEASURED, SCALE_OF, UNITS, Dimension, Role
from limslam_agent.logs.headings import FULL_TURN, heading_beside_wheels
from limslam_agent.logs.lost_reports import gaps_in
from limslam_agent.logs.pose_log import median_spacing
from limslam_agent.logs.table_layout import QUATERNION, WHEELS, Layout
from limslam_agent.logs.table_options import TOO_FAST, TableOptions
from limslam_agent.logs.wording import listed
from limslam_env.geometry import BoolArray, FloatArray, se2
from limslam_env.interface import RobotSpec

# Counters that begin again have at least so many bits, and without the jump a wheel travels at most
# so many times what its largest speed allows.
_FEWEST_COUNTER_BITS = 8
_SPARE = 2.0
# rad/s: a robot that turns faster for more than one row in twenty has its heading in degrees
_FASTEST_TURN = 2.0 * np.pi
# No robot's pose moves by more than this between two rows, m and m/s.
_FARTHEST_STEP = 1.0
_FASTEST = 20.0
_MOST_NAMED = 5  # times in a note


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
    notes
        What was found and assumed, in words.
    gaps
        The rows before which reports of the wheels are missing.
    """

    wheels: FloatArray | None = None
    poses: FloatArray | None = None
    yaw: FloatArray | None = None
    gaps: Sequence[int] = ()
    _moves: FloatArray  # since the row before, of the pose or of both wheels (n, 2), m
    _farthest: FloatArray  # that is possible (n,), m

    def __init__(
        self,
        layout: Layout,
        numbers: FloatArray,
        options: TableOptions,
        begins: BoolArray | None = None,
    ) -> None:
        """Read it from the numbers (n, k) of the columns of ``layout.places``, of which the first
        are the times, s. ``begins`` (n,) are the rows before which the clock says that the board
        was switched on again. Raises a ValueError if the robot or the radius of its wheels is
        needed and not given, or a unit in a name and an option do not agree.
        """
        self.units: dict[Role, str] = {}
        self.notes: list[str] = []
        self._layout = layout
        self._options = options
        self._values = {
            role: numbers[:, place] * layout.column(role).sign
            for place, role in enumerate(layout.places)
        }
        self._time = numbers[:, 0]
        none: BoolArray = np.zeros(len(numbers), dtype=np.bool_)
        self._begins = none if begins is None else begins
        self._period = median_spacing(self._time)
        self._spacing = np.maximum(np.diff(self._time, prepend=self._time[:1]), 0.0)
        longest = np.maximum(self._spacing, self._period)
        robot = options.robot
        # A speed says how far the robot drove until the row, and not in all of a gap before it.
        has_gaps = self._spacing > (1.5 * self._period if robot else np.inf)
        self._lasted = np.where(has_gaps, self._period, self._spacing)
        has_poses = Role.X in layout.motion
        self._is_travel = not has_poses and (layout.is_speed or not options.accumulated)
        if has_poses:
            self.poses = np.column_stack((self._si(Role.X), self._si(Role.Y), self._heading()))
        else:
            axle = 1.0 if robot is None else robot.axle
            has_wheels = Role.LEFT in layout.motion
            wheels = self._wheels(robot) if has_wheels else self._driven(axle)
            self._note_unused_options()
            if layout.inertial:
                self.yaw = self._inertial(np.diff(wheels, axis=1)[:, 0] / axle)
            if robot is None:
                start = np.zeros(3)
                self.poses = np.vstack((start, se2.driven(wheels[1:], axle, start)))
            else:
                self.wheels = wheels
                self._moves = wheels
                self._farthest = TOO_FAST * robot.max_wheel_speed * longest
                if self._is_travel:
                    self.gaps = gaps_in(wheels, self._time, self._period).tolist()
        if self._begins.any():
            when = [f"{seconds:.1f} s" for seconds in self._time[self._begins].tolist()]
            self.notes.append(
                f"the log begins again at {listed(when, _MOST_NAMED)}, as of a board that was "
                "switched on again: how the robot moved there is not known"
            )
        if self.poses is not None:
            self._moves = np.diff(self.poses[:, :2], axis=0, prepend=self.poses[:1, :2])
            self._farthest = _FARTHEST_STEP + _FASTEST * longest

    def impossible_rows(self) -> BoolArray:
        """Rows (n,) with a motion that no robot makes, after which it goes on as before."""
        moves = self._moves
        farthest = self._farthest
        is_far = np.abs(moves).max(axis=1) > farthest
        is_impossible = np.zeros(len(moves), dtype=np.bool_)
        if self._is_travel:
            is_impossible[1:-1] = is_far[1:-1] & ~is_far[:-2] & ~is_far[2:]
            return is_impossible
        after_both = np.abs(moves[:-1] + moves[1:]).max(axis=1) <= farthest[:-1] + farthest[1:]
        is_impossible[:-1] = is_far[:-1] & is_far[1:] & after_both
        return is_impossible

    def check_wheels(self, robot: RobotSpec) -> None:
        """Raise a ValueError if a wheel travels more than ten times as far between two rows as the
        robot's largest wheel speed allows. The message asks about what the options have not said.
        """
        travelled = np.abs(self._moves).max(axis=1)
        is_far = travelled > self._farthest
        if not is_far.any():
            return
        row = int(np.argmax(is_far))
        lasted = max(self._spacing[row], self._period)
        raise ValueError(
            f"a wheel travels {travelled[row]:.3g} m in {lasted:.3g} s at time "
            f"{self._time[row]:g} s, but the robot's max_wheel_speed is "
            f"{robot.max_wheel_speed:g} m/s. {self._question()}"
        )

    def _question(self) -> str:
        """What to ask about wheels that travel too far."""
        if self._layout.is_speed and not self._layout.counts_ticks:
            return "Are the speeds in m/s and rad/s? --columns names others, as in left_mm_s"
        if Role.LEFT not in self._layout.motion:
            return (
                "Is the distance in metres, since the row before? --position-unit and "
                "--accumulated say otherwise"
            )
        if self._options.accumulated:
            return (
                f"Is --metres-per-tick {self._options.metres_per_tick:g} right? Counters may begin "
                "again after a power of two"
            )
        changes = np.abs(np.diff(self._moves, axis=0)).max(axis=1, initial=0.0)
        if (changes[1:] <= self._farthest[2:]).all():
            return "They look like counters: --accumulated says that they count from the start"
        return (
            "Are left and right metres since the row before? --metres-per-tick converts ticks, and "
            "--accumulated says that they count from the start"
        )

    def _si(self, role: Role) -> FloatArray:
        """A column in m, rad, m/s or rad/s."""
        unit = self._options.unit_of(self._layout.column(role)) or self._likely_unit(role)
        self.units[role] = unit
        return self._values[role] * SCALE_OF[unit]

    def _likely_unit(self, role: Role) -> str:
        """The unit of a column where nothing says it: degrees if in radians the robot would turn
        faster than any does.
        """
        column = self._layout.column(role)
        dimension = MEASURED.get(role, Dimension.SPEED)
        usual, second, *_ = UNITS[dimension]
        rates = self._values[role]
        if dimension is Dimension.ANGLE:
            is_total = role is not Role.ANGLE or self._options.accumulated
            is_narrow = is_total and np.ptp(rates) < FULL_TURN
            steps = np.diff(rates) if is_total else rates[1:]
            rates = steps[:0] if is_narrow else steps / np.maximum(self._spacing[1:], 1e-9)
        elif dimension is not Dimension.TURN_RATE:
            return usual
        moving = np.abs(rates[rates != 0.0])
        fast = float(np.quantile(moving, 0.95)) if len(moving) else 0.0
        if fast <= _FASTEST_TURN:
            return usual
        self.notes.append(
            f"the column {column.name} is read in {second}: in radians the robot would turn at "
            f"{fast:.3g} rad/s; --angle-unit says another unit"
        )
        return second

    def _wheels(self, robot: RobotSpec | None) -> FloatArray:
        """Travel of both wheels (n, 2), m, since the row before. What they travelled before the
        first row says nothing. Counters that a board begins again at 0 count from there.
        """
        if robot is None:
            raise ValueError(
                "a table of wheel travel needs --robot FILE, with the robot's axle, radius and "
                "beams"
            )
        options = self._options
        columns = [self._layout.column(role) for role in WHEELS]
        if self._layout.is_speed:
            speeds = np.column_stack([self._si(role) for role in WHEELS])
            if self._layout.counts_ticks:
                speeds *= options.metres_per_tick
            elif columns[0].dimension is Dimension.TURN_RATE:
                speeds *= self._wheel_radius()
            return speeds * self._lasted[:, None]
        per_tick = options.metres_per_tick
        are_angles = columns[0].dimension is Dimension.ANGLE
        has_unit = (Dimension.LENGTH, Dimension.ANGLE)
        units = [each.unit if each.dimension in has_unit else None for each in columns]
        metres: FloatArray = np.array([SCALE_OF[unit] if unit else per_tick for unit in units])
        if are_angles:
            metres = metres * self._wheel_radius()
        for role, unit in zip(WHEELS, units, strict=True):
            self.units[role] = unit or f"{per_tick:g} m for each 1"
        if units[0] and per_tick != 1.0:
            self.notes.append(
                f"--metres-per-tick is not used: by its name {columns[0].name} is in {units[0]}"
            )
        counters = np.column_stack([self._values[role] for role in WHEELS])
        travel = counters.copy()
        if options.accumulated:
            farthest = _SPARE * robot.max_wheel_speed * self._period / float(metres.min())
            travel = _continued(np.diff(counters, axis=0, prepend=counters[:1]), counters, farthest)
            is_far = (np.abs(travel) > farthest).any(axis=1)
            begins_at_0 = is_far & (np.abs(counters) <= farthest).all(axis=1)
            travel[self._begins] = 0.0
            travel[begins_at_0] = counters[begins_at_0]
            self._begins = self._begins | begins_at_0
        travel[0] = 0.0
        return travel * metres

    def _wheel_radius(self) -> float:
        """Radius of the wheels, m. Raises a ValueError that asks for it."""
        if self._options.wheel_radius is None:
            column = self._layout.column(Role.LEFT)
            raise ValueError(
                f"the column {column.name[:40]!r} is the turn of a wheel in "
                f"{column.unit or column.usual}: --wheel-radius says the radius of the wheels, m; "
                "or --columns names a speed in m/s, as in left_m_s"
            )
        return self._options.wheel_radius

    def _driven(self, axle: float) -> FloatArray:
        """Travel of both wheels (n, 2), m, since the row before, by a distance and a turn."""
        _, forward_role, turn_role, *_ = self._layout.motion
        if turn_role in (Role.ANGLE, Role.TURN_RATE, Role.YAW_RATE):
            forward = self._since_before(forward_role, self._lasted)
            turn = self._since_before(turn_role, self._lasted)
        else:
            forward = self._since_before(forward_role, self._spacing)
            heading = self._joined(self._heading())
            turn = se2.wrap_angle(np.diff(heading, prepend=heading[:1]))
        forward[0] = turn[0] = 0.0
        return np.column_stack((forward - 0.5 * axle * turn, forward + 0.5 * axle * turn))

    def _since_before(self, role: Role, lasted: FloatArray) -> FloatArray:
        """Travel or turn (n,) since the row before, by a column of it, of its sum, or of a speed
        that has lasted some time (n,), s.
        """
        column = self._si(role)
        if MEASURED[role] in (Dimension.SPEED, Dimension.TURN_RATE):
            return column * lasted
        if not self._options.accumulated:
            return column.copy()
        return np.diff(self._joined(column), prepend=column[:1])

    def _joined(self, column: FloatArray) -> FloatArray:
        """A column (n,), NaN where it is not known, that goes on where the board was switched on
        again.
        """
        column = column.copy()
        known = np.flatnonzero(np.isfinite(column))
        for begin in np.flatnonzero(self._begins):
            after = int(np.searchsorted(known, begin))
            if 0 < after < len(known):
                column[begin:] -= column[known[after]] - column[known[after - 1]]
        return column

    def _heading(self) -> FloatArray:
        """The heading of poses (n,), rad."""
        if Role.QW not in self._layout.motion:
            role = Role.HEADING if Role.HEADING in self._layout.motion else Role.YAW
            return self._si(role)
        heading = self._yaw()
        if not np.isfinite(heading).all():
            row = int(np.argmin(np.isfinite(heading)))
            raise ValueError(f"the quaternion (qx, qy, qz, qw) of row {row} is no rotation")
        return heading

    def _yaw(self) -> FloatArray:
        """Headings (n,), rad, of quaternions of any length; NaN where they are zero."""
        x, y, z, w = (self._values[role] for role in QUATERNION)
        heading = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
        return np.asarray(np.where(np.any((x, y, z, w), axis=0), heading, np.nan))

    def _inertial(self, turns: FloatArray) -> FloatArray | None:
        """The heading of an inertial measurement unit (n,), rad, beside wheels that turn the robot
        by ``turns`` (n,), rad. None if it does not follow them.
        """
        *_, role = self._layout.inertial
        column = self._layout.column(role)
        if role is Role.QW:
            choices = {"": self._yaw()}
        else:
            rate = "/s" if role is Role.YAW_RATE else ""
            unit = self._options.unit_of(column)
            units = (f"rad{rate}", f"deg{rate}") if unit is None else (unit,)
            choices = {unit: self._integrated(role, unit) for unit in units}
        remedy = f", which -{role} in --columns says"
        heading = heading_beside_wheels(choices, turns, column.name, remedy)
        self.notes.extend(heading.notes)
        if heading.unit:
            self.units[role] = heading.unit
        return None if heading.yaw is None else self._joined(heading.yaw)

    def _integrated(self, role: Role, unit: str) -> FloatArray:
        """A heading (n,), rad, from a column of headings or of turn rates in a unit."""
        column = self._values[role] * SCALE_OF[unit]
        if role is not Role.YAW_RATE:
            return column
        # A rate that is missing leaves the heading unknown from there on, so the last one is kept.
        rows = np.maximum.accumulate(np.where(np.isfinite(column), np.arange(len(column)), 0))
        return np.nancumsum(column[rows] * self._spacing)

    def _note_unused_options(self) -> None:
        has_size = self._options.metres_per_tick != 1.0
        unused = ["--metres-per-tick"] * (has_size and not self._layout.counts_ticks)
        unused += ["--accumulated"] * self._options.accumulated
        if self._layout.is_speed and unused:
            are = "are" if len(unused) > 1 else "is"
            self.notes.append(f"the columns hold speeds, so {' and '.join(unused)} {are} not used")


def _continued(travel: FloatArray, counters: FloatArray, farthest: float) -> FloatArray:
    """Travel (n, 2), ticks, without the jumps of counters (n, 2) that begin again after a power of
    two.

    They count as such counters if the jump is right in at least one row: without it, no wheel
    travels more than ``farthest``.
    """
    largest = float(np.ptp(counters, axis=0).max())
    if not largest < 2.0**63:  # no counter has more bits
        return travel
    bits = max(int(largest).bit_length(), _FEWEST_COUNTER_BITS)
    jumps = np.round(travel / 2.0**bits)
    continued = travel - jumps * 2.0**bits
    is_proof = jumps.any(axis=1) & (np.abs(continued) <= farthest).all(axis=1)
    return continued if is_proof.any() and (counters == np.round(counters)).all() else travel
