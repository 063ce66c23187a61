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

A table is read in stages: its lines become a header and rows of numbers (`table_text`), the columns
of the header get their uses (`columns`, `table_layout`), the numbers of the odometry become wheel
travel or poses (`table_motion`), and those with the ranges a log (here).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limslam_agent.logs.columns import SCALE_OF, Role, column_of
from limslam_agent.logs.labelled_lines import unlabelled, unpacked
from limslam_agent.logs.pose_log import (
    DEFAULT_MAX_RANGE,
    LARGEST_STEP_BACK,
    beam,
    check_max_range,
    choose_beams,
    median_spacing,
    nearest_beams,
    pose_log,
)
from limslam_agent.logs.recorded_log import FilePath, RecordedLog, naming, numbered_lines
from limslam_agent.logs.table_layout import WHEELS, Header, Layout, layout_of, range_directions
from limslam_agent.logs.table_motion import Odometry
from limslam_agent.logs.table_options import TableOptions
from limslam_agent.logs.table_text import (
    MOST_DAMAGED,
    Rows,
    has_rows_of_numbers,
    split_header,
    with_units_of_cells,
)
from limslam_agent.logs.wording import listed, was
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import RobotSpec, SensorSpec
from limslam_env.messages import counted

# Median spacings of the rows of a control loop, by which the unit of its times is found.
_SPACINGS = {"ms": (10.0, 2e3), "us": (2e3, 2e6), "ns": (2e6, 1e10)}
_MOST_IGNORED = 12  # columns in a note
# A clock in ms or us begins again after so many counts: that in us every 72 minutes. A clock of the
# day begins again after so many s. The longest time between two rows in which one does, s
_CLOCK_COUNTS = 2.0**32
_DAY = 86400.0
_LONGEST_PAUSE = 10.0
# The clock is slower than the rows if so many rows have one time, of so many times.
_ROWS_A_TICK = 3
_FEWEST_TICKS = 3
# Robots whose rows may follow each other in turn, and the share of the motion between two rows that
# is left between two rows of one robot
_MOST_ROBOTS = 4
_ALTERNATING = 0.3
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
    return has_rows_of_numbers(unlabelled(numbered_lines(path)))


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
    robot = options.robot
    with naming(path):
        beams = [] if robot is None else np.degrees(robot.beam_angles).tolist()
        lines = unpacked(unlabelled(numbered_lines(path)))
        header, lines = split_header(lines, options.columns, beams)
        header, lines = with_units_of_cells(header, lines)
        if options.rate is not None:
            header = replace(header, columns=(column_of("t"), *header.columns))
        layout = layout_of(header, has_robot=robot is not None)
        if max_range is not None:
            check_max_range(max_range)
        ranges = _Ranges.of(header, layout, options, beams_deg, max_range)
        rows = Rows(header, layout, ranges.places, options.rate)
        for number, line in lines:
            rows.add(number, line)
        rows.check()
        # What overflows on the way is refused as too large.
        with np.errstate(over="ignore", invalid="ignore"):
            return _log(rows, ranges, options)


@dataclass(frozen=True, eq=False)
class _Ranges:
    """The columns of ranges that are used."""

    places: list[int]
    beams: tuple[SensorSpec, ...]
    metres: FloatArray  # (n_beams,), for each 1 in the columns
    words: list[str]  # how each column is read
    notes: tuple[str, ...]
    header: tuple[str, ...]  # of all columns of the table

    @classmethod
    def of(
        cls,
        header: Header,
        layout: Layout,
        options: TableOptions,
        beams_deg: Sequence[float] | None,
        max_range: float | None,
    ) -> "_Ranges":
        """The ranges in the wanted directions, deg. Raises a ValueError if there are none."""
        robot = options.robot
        directions, notes = range_directions(layout, robot, header.source)
        reach = DEFAULT_MAX_RANGE if max_range is None else max_range
        if robot is None:
            beams = [beam(math.radians(degrees), reach) for degrees in directions]
        else:
            beams = _mounted(robot, directions, max_range)
        used = choose_beams(np.degrees([each.angle for each in beams]), beams_deg)
        places = [layout.ranges[index] for index in used]
        metres = []
        words = []
        for place, index in zip(places, used, strict=True):
            column = layout.columns[place]
            unit = options.unit_of(column) or "m"
            metres.append(options.along_beam(directions[index], unit))
            words.append(f"{column.name} -> range at {directions[index]:g} deg, {unit}")
        chosen = tuple(beams[index] for index in used)
        names = layout.header(directions)[options.rate is not None :]
        return cls(places, chosen, np.array(metres), words, notes, names)


def _mounted(
    robot: RobotSpec, directions: Sequence[float], max_range: float | None
) -> list[SensorSpec]:
    """The robot's beams in the directions of columns, deg. A reading of a table is a new
    measurement in each row. Raises a ValueError if the robot has no such beam.
    """
    beams = []
    for index in nearest_beams(np.degrees(robot.beam_angles), directions, "the robot's beams"):
        found = robot.beams[index]
        reach = found.max_range if max_range is None else min(found.max_range, max_range)
        if reach <= found.min_range:
            raise ValueError(
                f"the largest range must be above the beam's shortest of {found.min_range:g} m, "
                f"not {reach:g}"
            )
        beams.append(replace(found, max_range=reach, period=1, phase=0))
    return beams


def _log(rows: Rows, ranges: _Ranges, options: TableOptions) -> RecordedLog:
    """The rows as a log."""
    layout = rows.layout
    numbers, has_scan, lines = rows.arrays()
    if not has_scan.any():
        raise ValueError("has no row with ranges")
    unit, time_notes = _time_unit(rows, median_spacing(numbers[:, 0]), options)
    numbers[:, 0] = _continued_clock(numbers[:, 0] * SCALE_OF[unit], SCALE_OF[unit])
    order = _order(numbers[:, 0])
    numbers = numbers[order]
    has_scan = has_scan[order]
    lines = lines[order]
    numbers[:, 0], spread_notes = _evenly_apart(numbers[:, 0])
    _check_alternating(layout, numbers, options)
    for impossible_rows in (
        _impossible_times,
        lambda left: Odometry(layout, left, options).impossible_rows(),
    ):
        is_impossible = impossible_rows(numbers)
        count = int(is_impossible.sum())
        if count and rows.allows(count):
            first = lines[int(np.argmax(is_impossible))]
            rows.add_damage(f"line {first}: its time or its motion is impossible", count)
            numbers = numbers[~is_impossible]
            has_scan = has_scan[~is_impossible]
            lines = lines[~is_impossible]
    begins = _begin_again(numbers, lines)
    time = numbers[:, 0]
    odometry = Odometry(layout, numbers, options, begins)
    notes = (*_notes_of_text(rows), *ranges.notes, *time_notes, *spread_notes, *odometry.notes)
    fields: dict[str, Any] = {
        "ranges": numbers[:, len(layout.places) :] * ranges.metres,
        "has_scan": has_scan,
        "columns": _columns_in_words(layout, ranges, {Role.TIME: unit, **odometry.units}),
        "header": ranges.header,
    }
    if odometry.poses is not None:
        return pose_log(ranges.beams, time, odometry.poses, options.robot, notes, **fields)
    robot = replace(
        options.robot or RobotSpec(), beams=ranges.beams, control_period=median_spacing(time)
    )
    odometry.check_wheels(robot)
    return RecordedLog(
        robot,
        time,
        wheels=odometry.wheels,
        yaw=odometry.yaw,
        gaps=tuple(odometry.gaps),
        notes=notes,
        **fields,
    )


def _time_unit(rows: Rows, spacing: float, options: TableOptions) -> tuple[str, list[str]]:
    """The unit of the times, and a note where their usual spacing has shown it."""
    unit = options.unit_of(rows.layout.column(Role.TIME))
    if rows.has_calendar or rows.rate:
        return "s", []
    if unit:
        return unit, []
    for unit, (low, high) in _SPACINGS.items():
        if low <= spacing < high:
            note = (
                f"the times are read in {unit}, since the rows are {spacing:g} apart; "
                "--time-unit says another unit"
            )
            return unit, [note]
    return "s", []


def _notes_of_text(rows: Rows) -> list[str]:
    """What was left out of the text."""
    notes = []
    if skipped := rows.header.skipped:
        lines = counted(skipped, "line")
        notes.append(f"{lines} of text before the table {was(skipped)} skipped")
    if rows.damaged:
        lines = counted(rows.damaged, "damaged line")
        first = "the first is " if rows.damaged > 1 else ""
        notes.append(f"{lines} {was(rows.damaged)} left out: {first}{rows.first_damage}")
    if rows.repeated:
        lines = counted(rows.repeated, "line")
        notes.append(f"{lines} repeated the line before, and count once")
    if unused := rows.layout.unused:
        are = "columns are" if len(unused) > 1 else "column is"
        notes.append(f"{len(unused)} {are} not used: {listed(unused, _MOST_IGNORED)}")
    return notes


def _columns_in_words(layout: Layout, ranges: _Ranges, units: dict[Role, str]) -> tuple[str, ...]:
    """How each column was read, a line each."""
    moves = []
    for role in layout.places:
        column = layout.column(role)
        turned = ", counted the other way" if column.sign < 0.0 else ""
        unit = f", {units[role]}" if role in units else ""
        moves.append(f"{column.name} -> {_WORDS.get(role, role)}{unit}{turned}")
    return (*moves, *ranges.words, *(f"{name} -> not used" for name in layout.unused))


def _impossible_times(numbers: FloatArray) -> BoolArray:
    """Rows (n,) of numbers (n, k) whose time, s, lies outside of those before and after, although
    these follow each other.
    """
    time = numbers[:, 0]
    is_impossible = np.zeros(len(time), dtype=np.bool_)
    before = time[:-2]
    here = time[1:-1]
    after = time[2:]
    follow = (after >= before) & (after - before <= _LONGEST_PAUSE)
    is_outside = (here < before - LARGEST_STEP_BACK) | (here > after + LARGEST_STEP_BACK)
    is_impossible[1:-1] = follow & is_outside
    return is_impossible


def _continued_clock(time: FloatArray, unit: float) -> FloatArray:
    """Times (n,), s, of a clock that counts in ``unit``, s, and begins again when it is full, or at
    midnight. A late row after that is still from before.
    """
    for turn in (_CLOCK_COUNTS * unit, _DAY):
        steps = np.diff(time, prepend=time[:1])
        since = steps + turn
        begins = (steps < -LARGEST_STEP_BACK) & (since >= 0.0) & (since < _LONGEST_PAUSE)
        is_late = (np.abs(steps - turn) <= LARGEST_STEP_BACK) & (np.cumsum(begins) > 0)
        time = time + turn * (np.cumsum(begins) - np.cumsum(is_late))
    return time


def _order(time: FloatArray) -> IntArray:
    """The order (n,) of rows at times (n,), s, in which a row that was written just before an
    earlier one stands behind it.
    """
    order = np.arange(len(time))
    before, early, late, after = (time[first : len(time) - 3 + first] for first in range(4))
    is_late = (late < early) & (early - late <= LARGEST_STEP_BACK)
    rows = np.flatnonzero(is_late & (before <= late) & (early <= after)) + 1
    order[rows] = rows + 1
    order[rows + 1] = rows
    return order


def _evenly_apart(time: FloatArray) -> tuple[FloatArray, list[str]]:
    """Times (n,), s, of a clock that is slower than the rows, such as one of whole seconds, with
    the rows of one time evenly apart, and that in words.
    """
    firsts = np.flatnonzero(np.diff(time, prepend=-math.inf))
    ticks = time[firsts]
    if len(firsts) < _FEWEST_TICKS or len(time) < _ROWS_A_TICK * len(firsts):
        return time, []
    if (np.diff(ticks) < 0.0).any():
        return time, []
    rows = np.arange(len(time))
    period = (ticks[-1] - ticks[1]) / (firsts[-1] - firsts[1])
    spread = np.interp(rows, firsts, ticks)
    for here, ends in ((rows < firsts[1], 1), (rows > firsts[-1], -1)):
        spread[here] = ticks[ends] + period * (rows[here] - firsts[ends])
    share = len(time) / len(firsts)
    return spread, [f"{share:.2g} rows on average have the same time: they are taken evenly apart"]


def _check_alternating(layout: Layout, numbers: FloatArray, options: TableOptions) -> None:
    """Raise a ValueError if rows (n, k) of several robots follow each other in turn: the odometry
    goes on from a row some rows before.
    """
    kind = next((pair for pair in ((Role.X, Role.Y), WHEELS) if pair[0] in layout.motion), None)
    if kind is None or (kind == WHEELS and (layout.is_speed or not options.accumulated)):
        return
    roles = list(layout.places)
    counted_so_far = numbers[:, [roles.index(role) for role in kind]]
    moved = [
        float(np.abs(counted_so_far[lag:] - counted_so_far[:-lag]).mean())
        for lag in range(1, _MOST_ROBOTS + 1)
        if lag < len(numbers)
    ]
    robots = int(np.argmin(moved)) + 1 if moved else 1
    if robots > 1 and moved[robots - 1] < _ALTERNATING * moved[0] < math.inf:
        raise ValueError(
            f"the odometry of each row goes on from that {robots} rows before, as if the rows were "
            f"those of {robots} robots: write a log for each robot"
        )


def _begin_again(numbers: FloatArray, lines: NDArray[np.int64]) -> BoolArray:
    """Rows (n,) before which the board was switched on again: the time steps back. The times in
    ``numbers`` (n, k) go on from there. Raises a ValueError if they are many.
    """
    steps = np.diff(numbers[:, 0], prepend=numbers[:1, 0])
    begins = np.asarray(steps < -LARGEST_STEP_BACK)
    if begins.any():
        row = int(np.argmax(begins))
        if begins.sum() > MOST_DAMAGED * len(begins):
            raise ValueError(
                f"line {lines[row]}: the time steps back by {-steps[row]:.1f} s, as in "
                f"{counted(int(begins.sum()), 'row')} of {len(begins)}: sort them by time, or name "
                "another column as t in --columns"
            )
        period = median_spacing(numbers[:, 0])
        numbers[:, 0] += np.cumsum(np.where(begins, period - steps, 0.0))
    return begins
