"""Reads CARMEN logs and keeps a few beams of the laser, so that a robot with many beams becomes a
sparse robot.

These lines are used. The odometry is the *second* pose of a scan::

    FLASER n r_1 .. r_n  x y theta  odom_x odom_y odom_theta  ipc_time host logger_time
    ODOM x y theta tv rv accel  ipc_time host logger_time
"""

from array import array
from collections.abc import Sequence

import numpy as np

from limslam_agent.logs.pose_log import (
    BODY_RADIUS,
    MIN_RANGE,
    check_max_range,
    median_spacing,
    nearest_beams,
)
from limslam_agent.logs.recorded_log import (
    FilePath,
    RecordedLog,
    is_number,
    naming,
    parse_number,
    parse_range,
    read_lines,
)
from limslam_env.geometry import FloatArray, se2
from limslam_env.interface import RobotSpec, SensorSpec, side_of
from limslam_env.messages import counted

# Most of these logs come from SICK lasers. Their largest readings, 8183 to 8191 counts of 1 mm or 1
# cm, are codes for "no return" and for errors.
_SICK_TOP_COUNTS = (8183.0, 8191.5)
_SICK_UNITS = (0.001, 0.01)

_FIRST_TIMES, _LONGEST_STEP = 10, 60.0  # s between the first times of a clock that begins below 0

_SCAN, _ODOMETRY = _KINDS = b"FLASER", b"ODOM"
_SCAN_TAIL = 9
_ODOM_FIELDS = 10
# If the laser's pose relative to the odometry varies by more than this (m, rad), it is not the
# mount of the laser but the result of a mapping program.
_STEADY = np.array([0.05, 0.05, 0.035])


def read_carmen(path: FilePath, beams_deg: Sequence[float], max_range: float) -> RecordedLog:
    """Read a CARMEN log, plain or gzip, and keep the beams nearest to the given angles.

    The parameters are those of `limslam_agent.logs.log_reader.read_log`. Lines other than ODOM and
    FLASER are skipped. Scans have 180, 181, 360 or 361 beams over 180 degrees.

    There is one event for each line, in the order of the file, at the line's ``ipc_time``. The
    frame of the estimate is the robot's first pose, because the origin of odometry is arbitrary and
    may be far away. Times that begin below 0 and go on from there are moved so that the first one
    is 0. Other lines with a negative time are left out. Raises a LogError if the file cannot be
    read, is cut short, has something other than a number where one is needed, has no scan or no
    odometry, or has no beam within 1 degree of a given angle.
    """
    with naming(path):
        check_max_range(max_range)
        if not len(beams_deg):
            raise ValueError("at least one beam must be chosen")
        events = _Events(beams_deg)
        read_lines(path, events.add)
        if not events.time:
            # Any text that is no table is read here, so the message names both.
            table = "nor, as a table, a header that begins with t,x,y,theta or t,left,right"
            raise ValueError(f"has no odometry: no ODOM or FLASER line of CARMEN, {table}")
        if not events.ranges:
            raise ValueError("has no scan: there is no FLASER line")
        return _as_log(events, max_range)


def beam_angles_deg(count: int) -> FloatArray:
    """Directions of a scan's beams (count,), deg, from -90 on the right to the left.

    A scan with an even count has no beam at +90. Raises a ValueError if the layout of this number
    of beams is unknown.
    """
    if count not in (180, 181, 360, 361):
        raise ValueError(f"a scan of {count} beams: only 180, 181, 360 and 361 beams are known")
    return -90.0 + np.arange(count, dtype=np.float64) * (180.0 / (count - count % 2))


class _Events:
    """The numbers of the lines read so far, in packed arrays, because a log may have millions of
    lines.
    """

    def __init__(self, beams_deg: Sequence[float]) -> None:
        self.beams_deg = beams_deg
        self.beam_count = 0
        self.columns: list[int] = []
        self.time = array("d")
        self.odometry = array("d")
        self.laser = array("d")
        self.ranges = array("d")
        self.has_scan = bytearray()

    def add(self, line: bytes) -> None:
        """Process one line. The file ends within a line without a newline."""
        fields = line.split()
        kind = fields[0] if fields else b""
        if kind == _SCAN:
            self._add_scan(fields)
        elif kind == _ODOMETRY:
            self._add_odometry(fields)
        elif (
            not line.endswith(b"\n")
            and len(fields) == 1
            and any(each.startswith(kind) for each in _KINDS)
        ):
            raise ValueError("the line stops within its first word")

    def _add_scan(self, fields: list[bytes]) -> None:
        count = self._beams_in(fields)
        tail = fields[2 + count :]
        if len(tail) != _SCAN_TAIL:
            self._refuse_scan(fields, count)
        values = [parse_range(fields[column], f"range {column - 1}") for column in self.columns]
        laser = [parse_number(field, "the laser's pose") for field in tail[:3]]
        self._add_event(tail[3:6], tail[6], has_scan=True)
        self.ranges.extend(values)
        self.laser.extend(laser)

    def _add_odometry(self, fields: list[bytes]) -> None:
        if len(fields) != _ODOM_FIELDS:
            raise ValueError(f"ODOM has {len(fields)} fields where {_ODOM_FIELDS} are needed")
        self._add_event(fields[1:4], fields[7], has_scan=False)

    def _add_event(self, pose: list[bytes], time: bytes, *, has_scan: bool) -> None:
        odometry = [parse_number(field, "the odometry") for field in pose]
        seconds = parse_number(time, "the time")
        self.odometry.extend(odometry)
        self.time.append(seconds)
        self.has_scan.append(has_scan)

    def _beams_in(self, fields: list[bytes]) -> int:
        """Number of beams in a line. The first scan decides which beams are used."""
        text = fields[1] if len(fields) > 1 else b""
        if not text.isdigit():
            raise ValueError("FLASER is not followed by the number of beams")
        count = int(text[:9])
        if not self.columns:
            self.columns = [
                2 + beam for beam in nearest_beams(beam_angles_deg(count), self.beams_deg)
            ]
            self.beam_count = count
        elif count != self.beam_count:
            raise ValueError(f"a scan of {count} beams after scans of {self.beam_count}")
        return count

    def _refuse_scan(self, fields: list[bytes], count: int) -> None:
        """Raise an error that says what is wrong with a scan whose number of fields is wrong."""
        tail = fields[2 + count :]
        stamped = len(tail) in (3, 6) and not is_number(tail[-2])
        bare = len(fields) >= 2 + count and not tail
        if not self.time and (stamped or bare):
            raise ValueError("has no odometry: the scan comes without its poses")
        raise ValueError(
            f"FLASER has {len(fields)} fields where {2 + count + _SCAN_TAIL} are needed"
        )


def _as_log(events: _Events, max_range: float) -> RecordedLog:
    time, has_scan = np.array(events.time), np.frombuffer(events.has_scan, dtype=np.bool_)
    shifted = -float(time[0]) if _begins_below_zero(time) else 0.0
    kept = time + shifted >= 0.0
    if not has_scan[kept].any():
        raise ValueError("has no scan whose time is not negative")
    scans = kept[has_scan]
    time, odometry, has_scan = (
        time[kept] + shifted,
        np.array(events.odometry).reshape(-1, 3)[kept],
        has_scan[kept],
    )
    odometry[:, 2] = se2.wrap_angle(odometry[:, 2])
    angles = np.radians(beam_angles_deg(events.beam_count)[np.array(events.columns) - 2])
    mount = _laser_mount(odometry[has_scan], np.array(events.laser).reshape(-1, 3)[scans])
    ranges = np.full((len(time), len(angles)), np.nan)
    ranges[has_scan] = _without_codes(np.array(events.ranges).reshape(-1, len(angles))[scans])
    robot = _robot(angles, mount, max_range, time)
    notes = _notes_of_times(shifted, int((~kept).sum()))
    return RecordedLog(robot, time, ranges, has_scan, odometry=odometry, notes=notes)


def _notes_of_times(shifted: float, untimed: int) -> tuple[str, ...]:
    """What was added to all times, s, and how many lines have impossible times, in words."""
    notes = []
    if shifted:
        notes.append(f"the times begin at {-shifted:g} s; {shifted:g} s were added to all of them")
    if untimed:
        were = "were" if untimed > 1 else "was"
        notes.append(f"{counted(untimed, 'line')} with a negative time {were} left out")
    return tuple(notes)


def _begins_below_zero(time: FloatArray) -> bool:
    """Whether a clock (n,), s, begins below 0 and goes on from there. A single wrong time does not
    go on.
    """
    steps = np.diff(time[:_FIRST_TIMES])
    return bool(time[0] < 0.0 and len(steps) and (np.abs(steps) < _LONGEST_STEP).all())


def _without_codes(ranges: FloatArray) -> FloatArray:
    """Ranges (k, n_beams), m, with infinity in place of the laser's codes for "no return"."""
    seen, largest = ranges.copy(), float(ranges.max(where=np.isfinite(ranges), initial=0.0))
    for unit in _SICK_UNITS:
        lowest, highest = _SICK_TOP_COUNTS[0] * unit, _SICK_TOP_COUNTS[1] * unit
        if lowest <= largest <= highest:
            seen[ranges >= lowest] = np.inf
    return seen


def _laser_mount(odometry: FloatArray, laser: FloatArray) -> FloatArray:
    """Pose (3,) of the laser on the robot, from both poses (k, 3) of every scan. Zero if it is not
    fixed.
    """
    offsets = se2.between(odometry, laser)
    # A median of angles needs angles that are near to each other, so they are counted from the
    # first angle.
    offsets[:, 2] = offsets[0, 2] + se2.wrap_angle(offsets[:, 2] - offsets[0, 2])
    mount = np.median(offsets, axis=0)
    if np.any(np.percentile(np.abs(offsets - mount), 90, axis=0) > _STEADY):
        return np.zeros(3)
    # The log has six decimals, so further digits are rounding errors. Adding zero turns -0.0 into
    # 0.0.
    return np.array([*np.round(mount[:2], 6), se2.wrap_angle(float(np.round(mount[2], 6)))]) + 0.0


def _robot(angles: FloatArray, mount: FloatArray, max_range: float, time: FloatArray) -> RobotSpec:
    x, y = float(mount[0]), float(mount[1])
    turned = [float(se2.wrap_angle(angle + mount[2])) for angle in angles]
    beams = tuple(SensorSpec(x, y, a, MIN_RANGE, max_range, side_of(a)) for a in turned)
    return RobotSpec(radius=BODY_RADIUS, control_period=median_spacing(time), beams=beams)
