"""Reads logs in plain text: a header that names the columns, and a row for each event.

::

    t,x,y,theta,r_-90,r_0,r_90
    0.0,0.000,0.000,0.00,1.20,,1.19
    0.1,0.031,0.000,0.01,1.21,nan,1.18

``t`` is in s, the pose by odometry is in m and rad, and ranges are in m from the position of that
pose. A table of wheel travel has ``left`` and ``right`` instead of ``x``, ``y`` and ``theta``.
Columns may have other names and units, in any order (`limslam_agent.logs.columns`), and the
odometry other forms (`limslam_agent.logs.table_motion`). The robot on which the beams sit is in
`limslam_agent.logs.table_options`. An empty field and ``nan`` mean that there is no reading, and
``inf`` means that the beam saw nothing (`limslam_agent.readings`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from limslam_agent.logs.columns import Role
from limslam_agent.logs.pose_log import (
    DEFAULT_MAX_RANGE,
    LARGEST_STEP_BACK,
    beam,
    check_max_range,
    choose_beams,
    median_spacing,
    pose_log,
)
from limslam_agent.logs.recorded_log import (
    FilePath,
    RecordedLog,
    naming,
    numbered_lines,
)
from limslam_agent.logs.table_layout import (
    Form,
    Layout,
    layout_of,
    nearest_beam,
    range_directions,
)
from limslam_agent.logs.table_motion import Odometry, odometry_of
from limslam_agent.logs.table_options import (
    CLOCK_COUNTS,
    LONGEST_PAUSE,
    TOO_FAST,
    TableOptions,
    check_travel,
    scale,
)
from limslam_agent.logs.table_text import Header, Rows, has_rows_of_numbers, split_header
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec, SensorSpec
from limslam_env.messages import counted

# Median spacings of the rows of a control loop, by which the unit of its times is found.
_SPACINGS = {"ms": (10.0, 2e3), "us": (2e3, 2e6), "ns": (2e6, 1e10)}
_MOST_IGNORED = 12  # columns in a note
# No robot's pose moves by more than this between two rows, m and m/s.
_FARTHEST_STEP = 1.0
_FASTEST = 20.0
_WORDS = {
    Role.TIME: "time",
    Role.LEFT: "left wheel",
    Role.RIGHT: "right wheel",
    Role.HEADING: "heading",
    Role.YAW: "heading",
    Role.YAW_RATE: "turn rate of the inertial measurement unit",
    Role.SPEED: "speed",
    Role.TURN_RATE: "turn rate",
    Role.DISTANCE: "distance since the row before",
    Role.ANGLE: "turn since the row before",
}


def is_csv(path: FilePath) -> bool:
    """Whether a text file, plain or gzip, is a table: it has such a header, or rows of numbers.
    Raises a LogError if the file cannot be read or is not a text file.
    """
    return has_rows_of_numbers(numbered_lines(path))


def read_csv(
    path: FilePath,
    beams_deg: Sequence[float] | None,
    max_range: float | None,
    options: TableOptions | None = None,
) -> RecordedLog:
    """Read a table in plain text, plain or gzip.

    The parameters are those of `limslam_agent.logs.log_reader.read_log`. There is one event for
    each row. Up to 5 % of the lines are left out if they cannot be read. Raises a LogError if the
    file cannot be read, is cut short, has no column of the time, of an odometry or of ranges, has
    more lines that cannot be read, or has no row with ranges; if a table of wheel travel comes
    without a robot, the robot has no beam in a direction of the header, or a wheel travels farther
    than the robot can drive.
    """
    options = options or TableOptions()
    with naming(path):
        robot = options.robot
        beams = [] if robot is None else np.degrees(robot.beam_angles).tolist()
        header, lines = split_header(numbered_lines(path), options.columns, beams)
        table = _Table.of(header, beams_deg, max_range, options)
        for number, line in lines:
            table.rows.add(number, line)
        # What overflows on the way is refused as too large.
        with np.errstate(over="ignore", invalid="ignore"):
            return table.log()


@dataclass(frozen=True, eq=False)
class _Table:
    """A table whose columns are known, with its rows."""

    header: Header
    layout: Layout
    options: TableOptions
    beams: tuple[SensorSpec, ...]
    metres: FloatArray
    rows: Rows
    notes: tuple[str, ...]
    readings: tuple[str, ...]
    names: tuple[str, ...]

    @classmethod
    def of(
        cls,
        header: Header,
        beams_deg: Sequence[float] | None,
        max_range: float | None,
        options: TableOptions,
    ) -> "_Table":
        """A table without rows. Raises a ValueError if its columns cannot be used."""
        robot = options.robot
        chosen = header.is_chosen
        layout = layout_of(header.columns, has_robot=robot is not None, is_chosen=chosen)
        if max_range is not None:
            check_max_range(max_range)
        directions, notes = range_directions(layout, robot, is_chosen=chosen)
        reach = DEFAULT_MAX_RANGE if max_range is None else max_range
        beams = [
            beam(math.radians(degrees), reach)
            if robot is None
            else _mounted(robot, degrees, max_range, header.source)
            for degrees in directions
        ]
        used = choose_beams(np.degrees([each.angle for each in beams]), beams_deg)
        ranges = [layout.ranges[index] for index in used]
        columns = [header.columns[place] for place in ranges]
        units = [options.unit_of(column) or "m" for column in columns]
        metres = [
            options.along_beam(directions[index], unit)
            for index, unit in zip(used, units, strict=True)
        ]
        needed = list(layout.motion.values())
        optional = [*layout.inertial.values(), *ranges]
        readings = [
            f"{column.name} -> range at {directions[index]:g} deg, {unit}"
            for column, index, unit in zip(columns, used, units, strict=True)
        ]
        return cls(
            header,
            layout,
            options,
            tuple(beams[index] for index in used),
            np.array(metres),
            Rows(header, needed, optional, layout.ranges),
            tuple(notes),
            tuple(readings),
            layout.header(directions),
        )

    def log(self) -> RecordedLog:
        """The rows as a log."""
        self.rows.check()
        numbers, has_scan, lines = self.rows.arrays()
        if not has_scan.any():
            raise ValueError("has no row with ranges")
        unit, notes = self._time_unit(numbers[:, 0])
        numbers[:, 0] = _continued_clock(numbers[:, 0] * scale(unit), scale(unit))
        for impossible in (_impossible_times, self._impossible_moves):
            kept = self._without(impossible(numbers), lines)
            numbers = numbers[kept]
            has_scan = has_scan[kept]
            lines = lines[kept]
        time = numbers[:, 0]
        _check_clock(time, lines)
        odometry = self._odometry(numbers)
        ranges = numbers[:, len(self.layout.places) :] * self.metres
        found = (*self._notes_of_text(), *self.notes, *notes, *odometry.notes)
        columns = self._readings({Role.TIME: unit, **odometry.units})
        robot = self.options.robot
        if odometry.poses is not None:
            return pose_log(
                self.beams,
                time,
                odometry.poses,
                ranges,
                has_scan,
                robot,
                notes=found,
                columns=columns,
                header=self.names,
            )
        robot = replace(robot or RobotSpec(), beams=self.beams, control_period=median_spacing(time))
        if odometry.wheels is not None:
            check_travel(odometry.wheels, time, robot, self.options, odometry.question)
        return RecordedLog(
            robot,
            time,
            ranges,
            has_scan,
            wheels=odometry.wheels,
            yaw=odometry.yaw,
            gaps=tuple(odometry.gaps),
            notes=found,
            columns=columns,
            header=self.names,
        )

    def _time_unit(self, time: FloatArray) -> tuple[str, list[str]]:
        """The unit of the times (n,), and a note where the spacing of the rows has shown it."""
        column = self.layout.column(Role.TIME)
        if self.rows.has_calendar:
            return "s", []
        known = self.options.unit_of(column)
        if known is not None:
            return known, []
        spacing = median_spacing(time)
        for unit, (low, high) in _SPACINGS.items():
            if low <= spacing < high:
                note = (
                    f"the times are read in {unit}, since the rows are {spacing:g} apart; "
                    "--time-unit says another unit"
                )
                return unit, [note]
        return "s", []

    def _odometry(self, numbers: FloatArray) -> Odometry:
        """The odometry of the numbers (n, k) of the rows, whose first column has the times, s."""
        values = {
            role: numbers[:, place] * self.layout.column(role).sign
            for place, role in enumerate(self.layout.places)
        }
        time = numbers[:, 0]
        return odometry_of(self.layout, values, time, median_spacing(time), self.options)

    def _impossible_moves(self, numbers: FloatArray) -> BoolArray:
        """Rows (n,) of numbers (n, k) with a motion that no robot makes, after which it goes on as
        before.
        """
        odometry = self._odometry(numbers)
        time = numbers[:, 0]
        lasted = np.maximum(np.diff(time, prepend=time[:1]), median_spacing(time))
        if odometry.poses is not None:
            moves = np.diff(odometry.poses[:, :2], axis=0, prepend=odometry.poses[:1, :2])
            farthest = _FARTHEST_STEP + _FASTEST * lasted
        else:
            moves = np.zeros((len(time), 2)) if odometry.wheels is None else odometry.wheels
            robot = self.options.robot or RobotSpec()
            farthest = TOO_FAST * robot.max_wheel_speed * lasted
        is_far = np.abs(moves).max(axis=1) > farthest
        is_impossible = np.zeros(len(time), dtype=np.bool_)
        if self.layout.form is not Form.POSES and (
            odometry.is_speed or not self.options.accumulated
        ):
            is_impossible[1:-1] = is_far[1:-1] & ~is_far[:-2] & ~is_far[2:]
            return is_impossible
        after_both = np.abs(moves[:-1] + moves[1:]).max(axis=1) <= farthest[:-1] + farthest[1:]
        is_impossible[:-1] = is_far[:-1] & is_far[1:] & after_both
        return is_impossible

    def _without(self, is_impossible: BoolArray, lines: NDArray[np.int64]) -> BoolArray:
        """The rows (n,) that are kept: all that are possible, if the others are few enough to be
        damaged lines. ``lines`` (n,) has their numbers.
        """
        count = int(is_impossible.sum())
        if not count or not self.rows.allows(count):
            return np.ones(len(lines), dtype=np.bool_)
        first = lines[int(np.argmax(is_impossible))]
        self.rows.add_damage(f"line {first}: its time or its motion is impossible", count)
        return ~is_impossible

    def _notes_of_text(self) -> list[str]:
        """What was left out of the text."""
        notes = []
        if self.header.skipped:
            were = "were" if self.header.skipped > 1 else "was"
            notes.append(
                f"{counted(self.header.skipped, 'line')} of text before the table {were} skipped"
            )
        if self.rows.damaged:
            were = "were" if self.rows.damaged > 1 else "was"
            first = "the first is " if self.rows.damaged > 1 else ""
            notes.append(
                f"{counted(self.rows.damaged, 'damaged line')} {were} left out: "
                f"{first}{self.rows.first_damage}"
            )
        if self.rows.repeated:
            lines = counted(self.rows.repeated, "line")
            notes.append(f"{lines} repeated the line before, and count once")
        unused = self.layout.unused
        if unused:
            more = f" and {len(unused) - _MOST_IGNORED} more" if len(unused) > _MOST_IGNORED else ""
            are = "columns are" if len(unused) > 1 else "column is"
            notes.append(f"{len(unused)} {are} not used: {', '.join(unused[:_MOST_IGNORED])}{more}")
        return notes

    def _readings(self, units: dict[Role, str]) -> tuple[str, ...]:
        """How each column was read, a line each."""
        moves = []
        for role in self.layout.places:
            column = self.layout.column(role)
            turned = ", counted the other way" if column.sign < 0.0 else ""
            unit = f", {units[role]}" if role in units else ""
            moves.append(f"{column.name} -> {_WORDS.get(role, role)}{unit}{turned}")
        unused = [f"{name} -> not used" for name in self.layout.unused]
        return (*moves, *self.readings, *unused)


def _impossible_times(numbers: FloatArray) -> BoolArray:
    """Rows (n,) of numbers (n, k) whose time, s, lies outside of those before and after, although
    these follow each other.
    """
    time = numbers[:, 0]
    is_impossible = np.zeros(len(time), dtype=np.bool_)
    if len(time) < 3:
        return is_impossible
    before = time[:-2]
    here = time[1:-1]
    after = time[2:]
    follow = (after >= before) & (after - before <= LONGEST_PAUSE)
    is_outside = (here < before - LARGEST_STEP_BACK) | (here > after + LARGEST_STEP_BACK)
    is_impossible[1:-1] = follow & is_outside
    return is_impossible


def _continued_clock(time: FloatArray, unit: float) -> FloatArray:
    """Times (n,), s, of a clock that counts in ``unit``, s, and begins again when it is full. A
    late row after that is still from before.
    """
    turn = CLOCK_COUNTS * unit
    continued = time.copy()
    turns = 0.0
    before = float(time[0])
    for row, seconds in enumerate(time.tolist()):
        late = turns
        if seconds < before - LARGEST_STEP_BACK and 0.0 <= seconds - before + turn < LONGEST_PAUSE:
            turns += turn  # a clock that was full begins again at 0
            late = turns
        elif turns and seconds < turn and abs(seconds - turn - before) <= LARGEST_STEP_BACK:
            late = turns - turn
        before = seconds if late == turns else before
        continued[row] = seconds + late
    return continued


def _check_clock(time: FloatArray, lines: NDArray[np.int64]) -> None:
    """Refuse times (n,), s, that step back, of rows with these numbers of lines (n,)."""
    steps = np.diff(time)
    if not (steps < -LARGEST_STEP_BACK).any():
        return
    row = int(np.argmax(steps < -LARGEST_STEP_BACK))
    raise ValueError(
        f"line {lines[row + 1]}: the time steps back by {-steps[row]:.1f} s: if the robot was "
        "switched on again, replay the parts as logs of their own"
    )


def _mounted(robot: RobotSpec, degrees: float, max_range: float | None, source: str) -> SensorSpec:
    """The robot's beam in a direction that ``source`` names. A reading of a table is a new
    measurement in each row. Raises a ValueError if the robot has no such beam.
    """
    found = robot.beams[nearest_beam(robot, degrees, source)]
    reach = found.max_range if max_range is None else min(found.max_range, max_range)
    if reach <= found.min_range:
        raise ValueError(
            f"the largest range must be above the beam's shortest of {found.min_range:g} m, not "
            f"{reach:g}"
        )
    return replace(found, max_range=reach, period=1, phase=0)
