"""Reads logs in plain text: a header that names the columns, and a row for each event.

::

    t,x,y,theta,r_-90,r_0,r_90
    0.0,0.000,0.000,0.00,1.20,,1.19
    0.1,0.031,0.000,0.01,1.21,nan,1.18

``t`` is in s, the pose by odometry is in m and rad, and ranges are in m from the position of that
pose. A table of wheel travel has ``left`` and ``right`` instead of ``x``, ``y`` and ``theta``.
Other units, and the robot on which the beams sit, are `limslam_agent.logs.table_options`. An empty
field and ``nan`` mean that there is no reading, and ``inf`` means that the beam saw nothing
(`limslam_agent.readings`). Columns may also be separated by semicolons or spaces, and a comma is
then the decimal mark. Quotation marks, and a separator at the end of a line, do not matter. The
header may be a comment with a remark in brackets. A header that is repeated is skipped: some
loggers write it again when they start again.
"""

import math
import re
from array import array
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from limslam_agent.logs.directions import degrees_of
from limslam_agent.logs.pose_log import (
    DEFAULT_MAX_RANGE,
    LARGEST_STEP_BACK,
    WORST_BEAM_MISMATCH_DEG,
    beam,
    check_max_range,
    choose_beams,
    median_spacing,
    pose_log,
)
from limslam_agent.logs.recorded_log import (
    MOST_BEAMS,
    FilePath,
    RecordedLog,
    check_beams,
    is_number,
    naming,
    numbered_lines,
    parse_number,
    parse_range,
    read_lines,
)
from limslam_agent.logs.table_options import CLOCK_COUNTS, LONGEST_PAUSE, TableOptions, check_travel
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec, SensorSpec

NO_SCAN = b"-"
"""Marks an event with odometry only. It stands in all range columns, or once instead of all of
them.
"""

NOT_USED = "-"
"""Name of a column that is not used."""

_TIME = {"t", "time", "stamp"}
_POSE = (_TIME, {"x", "odom_x"}, {"y", "odom_y"}, {"theta", "yaw", "odom_theta", "odom_yaw"})
_WHEELS = tuple(
    _TIME
    if side is None
    else {side, f"{side}_wheel", f"wheel_{side}", f"{side}_ticks", f"ticks_{side}"}
    for side in (None, "left", "right")
)
_FORMS = "t,x,y,theta,r_<deg>,... or t,left,right,r_<deg>,..."
_RANGE = re.compile(r"r(?:_|\[)([^\[\]]+)\]?")
_HEADER_WITHIN = 1000  # lines

NO_ROW = "delete the line if it is no row of the table, or begin it with #"
"""What helps against a line that was cut short, or that is a message of the robot."""


def is_csv(path: FilePath) -> bool:
    """Whether a text file, plain or gzip, begins with such a header. Raises a LogError if the file
    cannot be read or is not a text file.
    """
    for number, line in numbered_lines(path):
        if number > _HEADER_WITHIN:
            break
        names = _names(line)[0]
        if names and not _is_remark(line, names):
            return _leading(names) > 0
    return False


def read_csv(
    path: FilePath,
    beams_deg: Sequence[float] | None,
    max_range: float | None,
    options: TableOptions | None = None,
) -> RecordedLog:
    """Read a text file with the header ``t,x,y,theta,r_<deg>,...`` or ``t,left,right,r_<deg>,...``,
    plain or gzip.

    The parameters are those of `limslam_agent.logs.log_reader.read_log`. There is one event for
    each row. Raises a LogError if the file cannot be read, is cut short, has another header, has a
    row whose columns do not match the header or that holds something other than numbers, or has no
    row with ranges; if a table of wheel travel comes without a robot, the robot has no beam in a
    direction of the header, or a wheel travels farther than the robot can drive.
    """
    rows = _Rows(beams_deg, max_range, options or TableOptions())
    read_lines(path, rows.add)
    with naming(path):
        return rows.log()


class _Rows:
    """The header, and the numbers of the rows read so far, in packed arrays."""

    def __init__(
        self, beams_deg: Sequence[float] | None, max_range: float | None, options: TableOptions
    ) -> None:
        self.beams_deg, self.max_range, self.options = beams_deg, max_range, options
        self.leading = len(_POSE)
        self.beams: list[SensorSpec] = []
        self.columns: list[int] = []
        self.metres: list[float] = []
        self.header = b""
        self.separator: bytes | None = None
        self.used: list[int] = []
        self.directions: list[float] = []
        self.moves = array("d")
        self.ranges = array("d")
        self.has_scan = bytearray()
        self.time_before = 0.0

    def add(self, line: bytes) -> None:
        """Process one line. The first line that is neither blank nor a remark is the header."""
        text = line.strip().replace(b'"', b"")
        if not self.directions:
            names, self.separator = _names(line)
            columns = list(self.options.columns)
            if names and not (line.startswith(b"#") if columns else _is_remark(line, names)):
                self._add_header(columns or names)
                if columns and is_number(names[0].replace(",", ".")):
                    self._add_row(text)
                else:
                    self.header = text
        elif not line.startswith(b"#") and text and text != self.header:
            self._add_row(text)

    def _add_header(self, names: list[str]) -> None:
        # Only the chosen columns are stored: a header may name thousands.
        self.used = [place for place, name in enumerate(names) if name != NOT_USED]
        if self.options.columns:
            self.used = _in_order(self.used, names)
        names = [names[place] for place in self.used]
        self.leading, self.directions = _leading(names), _directions(names, self.options.columns)
        check_beams(len(names) - self.leading)
        if self.max_range is not None:
            check_max_range(self.max_range)
        if self.options.robot is not None:
            source = _source(self.options.columns)
            beams = [
                _mounted(self.options.robot, degrees, self.max_range, source)
                for degrees in self.directions
            ]
        elif self.leading == len(_WHEELS):
            raise ValueError(
                "a table of wheel travel needs --robot FILE, with the robot's axle, radius and "
                "beams"
            )
        else:
            reach = DEFAULT_MAX_RANGE if self.max_range is None else self.max_range
            beams = [beam(math.radians(degrees), reach) for degrees in self.directions]
        self.columns = choose_beams(beams, self.beams_deg)
        self.beams = [beams[index] for index in self.columns]
        self.metres = [self.options.along_beam(self.directions[index]) for index in self.columns]

    def _add_row(self, text: bytes) -> None:
        fields = self._fields_of(text)
        readings = fields[self.leading :]
        is_silent = bool(readings) and all(field == NO_SCAN for field in readings)
        count = self.leading + len(self.directions)
        if len(fields) != count and not (is_silent and len(readings) == 1):
            # 0,1,0,031 has twice as many fields as numbers, or nearly so if some of them are whole.
            is_doubled = self.separator == b"," and 1.3 * count < len(fields) <= 2 * count
            hint = (
                "if commas are decimal marks here, separate the columns by ; or tabs"
                if is_doubled
                else NO_ROW
            )
            if not (self.has_scan or is_doubled):
                hint += ", or correct the header: --columns can name all columns in its place"
            raise ValueError(f"{len(fields)} columns where the header names {count}: {hint}")
        names = ("t", "left", "right") if self.leading == len(_WHEELS) else ("t", "x", "y", "theta")
        move = [parse_number(field, name) for field, name in zip(fields, names, strict=False)]
        move[0] = self._take_time(move[0])
        values = (
            [math.nan] * len(self.directions)
            if is_silent
            else [_reading(field) for field in readings]
        )
        self.ranges.extend(
            metres * values[column]
            for metres, column in zip(self.metres, self.columns, strict=True)
        )
        self.moves.extend(move)
        self.has_scan.append(not is_silent)

    def _fields_of(self, text: bytes) -> list[bytes]:
        """The fields of a row that are used, in the order of the header, without empty ones after
        its end.
        """
        fields = [field.strip() for field in text.split(self.separator)]
        if self.separator != b",":
            fields = [field.replace(b",", b".") for field in fields]
        named = len(self.options.columns)
        most = named or self.leading + len(self.directions)
        while not fields[-1] and (len(fields) > most or fields[-2:-1] == [NO_SCAN]):
            fields.pop()
        if not named:
            return fields
        # A mark that stands once instead of the ranges comes after all other columns that are used.
        is_short = fields[-1] == NO_SCAN and max(self.used[: self.leading]) < len(fields) - 1
        if is_short and len(fields) <= min(self.used[self.leading :]) + 1:
            return [*(fields[place] for place in self.used[: self.leading]), fields[-1]]
        if len(fields) != named:
            raise ValueError(f"{len(fields)} columns where --columns names {named}: {NO_ROW}")
        return [fields[place] for place in self.used]

    def _take_time(self, time: float) -> float:
        """The time of a row, s, on the clock of the log.

        A clock that is full begins again. A late row after that is still from before. Raises a
        ValueError if the time steps back for another reason.
        """
        time *= self.options.seconds
        before = self.moves[-self.leading] - self.time_before if self.moves else time
        turn = CLOCK_COUNTS * self.options.seconds
        if time < before - LARGEST_STEP_BACK:
            if (
                not 0.0 <= time - before + turn < LONGEST_PAUSE
            ):  # a clock that was full begins again at 0
                back = f"the time steps back by {before - time:.1f} s"
                raise ValueError(
                    f"{back}: if the robot was switched on again, replay the parts as logs of "
                    "their own"
                )
            self.time_before += turn
        elif time < turn and abs(time - turn - before) <= LARGEST_STEP_BACK:
            return time + self.time_before - turn
        return time + self.time_before

    def log(self) -> RecordedLog:
        """The rows as a log."""
        if not self.directions:
            raise ValueError(f"is empty: it has no header {_FORMS}")
        if not any(self.has_scan):
            raise ValueError("has no row with ranges")
        moves = np.array(self.moves).reshape(-1, self.leading)
        ranges = np.array(self.ranges).reshape(len(moves), -1)
        has_scan = np.frombuffer(self.has_scan, dtype=np.bool_)
        robot = self.options.robot
        if robot is None or self.leading == len(_POSE):
            return pose_log(self.beams, moves[:, 0], moves[:, 1:], ranges, has_scan, robot)
        robot = replace(robot, beams=tuple(self.beams), control_period=median_spacing(moves[:, 0]))
        wheels = self.options.wheel_travel(moves[:, 1:], robot)
        check_travel(wheels, moves[:, 0], robot, self.options)
        return RecordedLog(robot, moves[:, 0], ranges, has_scan, wheels=wheels)


def _mounted(robot: RobotSpec, degrees: float, max_range: float | None, source: str) -> SensorSpec:
    """The robot's beam in a direction that ``source`` names. A reading of a table is a new
    measurement in each row. Raises a ValueError if the robot has no such beam.
    """
    apart = np.abs(np.degrees(wrap_angle(robot.beam_angles - math.radians(degrees))))
    nearest = int(np.argmin(apart))
    if apart[nearest] > WORST_BEAM_MISMATCH_DEG + 1e-9:
        known = ", ".join(f"{angle:g}" for angle in np.round(np.degrees(robot.beam_angles), 1))
        raise ValueError(
            f"{source} names a beam at {degrees:g} deg, but the robot's beams are at {known} deg"
        )
    found = robot.beams[nearest]
    reach = found.max_range if max_range is None else min(found.max_range, max_range)
    if reach <= found.min_range:
        raise ValueError(
            f"the largest range must be above the beam's shortest of {found.min_range:g} m, not "
            f"{reach:g}"
        )
    return replace(found, max_range=reach, period=1, phase=0)


def _names(line: bytes) -> tuple[list[str], bytes | None]:
    """Column names of a header in lower case, and the separator (None for spaces)."""
    text = (
        line.decode("utf-8", "replace")
        .replace('"', "")
        .strip()
        .lstrip("#")
        .partition("(")[0]
        .strip()
        .lower()
    )
    # A semicolon goes first: a comma beside it is a decimal mark.
    separator = next((mark for mark in (";", ",") if mark in text), None)
    text = text.rstrip(separator)
    names = [name.strip() for name in text.split(separator)]
    return (names if text else []), separator.encode() if separator else None


def _is_remark(line: bytes, names: list[str]) -> bool:
    return line.startswith(b"#") and not _leading(names)


def _leading(names: list[str]) -> int:
    """How many columns stand before the ranges: 4 of a table of poses, 3 of wheel travel, 0 of
    another header.
    """
    known = (
        form
        for form in (_POSE, _WHEELS)
        if len(names) >= len(form) and all(map(set.__contains__, form, names))
    )
    return len(next(known, ()))


def _in_order(used: list[int], names: list[str]) -> list[int]:
    """Places of the columns that are used, with those first that stand before the ranges of a
    header.
    """
    for form in (_POSE, _WHEELS):
        leading = [next((place for place in used if names[place] in known), None) for known in form]
        if None not in leading:
            return sorted(
                used, key=lambda place: leading.index(place) if place in leading else len(leading)
            )
    return used


def _source(chosen: Sequence[str]) -> str:
    """What names the columns, in messages. ``chosen`` are those that stand in place of the header,
    if any.
    """
    return "--columns" if chosen else "the header"


def _directions(names: list[str], chosen: Sequence[str]) -> list[float]:
    """Directions of the range columns, deg. ``chosen`` are the columns that stand in place of the
    header, if any.
    """
    leading = _leading(names)
    source = _source(chosen)
    if not leading:
        found = ",".join(chosen or names)[:60]
        if chosen:
            raise ValueError(f"--columns must name {_FORMS}, not {found!r}")
        raise ValueError(
            f"the header must be {_FORMS}, not {found!r}; --columns names the columns of another "
            "header"
        )
    directions: list[float] = []
    columns = names[leading:]
    for place, name in enumerate(columns):
        if name == "...":
            directions += _between(directions, columns[place + 1 :])
        else:
            directions.append(_direction(name))
    if not directions:
        raise ValueError(f"{source} names no ranges: r_<deg>,... must follow {names[leading - 1]}")
    turns = [degrees % 360.0 for degrees in directions]
    if len(set(turns)) < len(turns):
        twice = next(
            degrees
            for degrees, turn in zip(directions, turns, strict=True)
            if turns.count(turn) > 1
        )
        raise ValueError(f"{source} names the beam at {twice:g} deg twice")
    return directions


def _direction(name: str) -> float:
    """Direction in a column's name, deg: ``r_-45``, ``r[-45]`` or ``r_left``."""
    inner = _RANGE.fullmatch(name)
    if inner is None:
        raise ValueError(f"the column {name[:40]!r} is not a range: r_<deg>")
    try:
        return degrees_of(inner[1])
    except ValueError as error:
        raise ValueError(f"the column {name[:40]!r}: {error}") from None


def _between(before: list[float], after: list[str]) -> list[float]:
    """The directions that ``...`` stands for, in the step of the two directions before, up to the
    direction after.
    """
    if len(before) < 2 or len(after) != 1:
        raise ValueError("'...' must stand between two ranges and the last one")
    step, last = before[-1] - before[-2], _direction(after[0])
    count = (last - before[-1]) / step if step else 0.0
    if not (1.0 <= count <= MOST_BEAMS and math.isclose(count, round(count), abs_tol=1e-6)):
        raise ValueError(
            f"'...' cannot go from {before[-1]:g} to {last:g} deg in steps of {step:g}"
        )
    return [before[-1] + step * number for number in range(1, round(count))]


def _reading(field: bytes) -> float:
    """A range, m. NaN where the field is empty: there is no reading."""
    try:
        return parse_range(field, "a range") if field else math.nan
    except ValueError as error:
        raise ValueError(f"{error}; an empty field or nan is no reading") from None
