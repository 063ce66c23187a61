"""Reads CARMEN logs and keeps a few beams of the laser, so that a robot with many beams becomes a
sparse robot.

These lines are used. The odometry is the *second* pose of a scan::

    FLASER n r_1 .. r_n  x y theta  odom_x odom_y odom_theta  ipc_time host logger_time
    ROBOTLASER1 laser n r_1 .. r_n m i_1 .. i_m  x y theta  odom_x odom_y odom_theta
        tv rv forward side turn  ipc_time host logger_time
    RAWLASER1 laser n r_1 .. r_n m i_1 .. i_m  ipc_time host logger_time
    ODOM x y theta tv rv accel  ipc_time host logger_time

where ``laser`` is ``type start_angle field_of_view angular_resolution maximum_range accuracy
remission_mode`` and ``i`` are remissions. RAWLASER1 is used where no scan has a pose. Its pose is
that of the ODOM lines at its time.
"""

import math
import re
from array import array
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from limslam_agent.logs.odometry_breaks import OdometryStream
from limslam_agent.logs.pose_log import MIN_RANGE, check_max_range, choose_beams, pose_log
from limslam_agent.logs.recorded_log import (
    FilePath,
    RecordedLog,
    check_beams,
    is_number,
    naming,
    parse_number,
    parse_range,
    read_lines,
)
from limslam_agent.logs.wording import listed, was
from limslam_env.geometry import BoolArray, FloatArray, se2
from limslam_env.interface import SensorSpec, side_of
from limslam_env.messages import counted

# Most of these logs come from SICK lasers. Their largest readings, 8183 to 8191 counts of 1 mm or 1
# cm, are codes for "no return" and for errors.
_SICK_TOP_COUNTS = (8183.0, 8191.5)
_SICK_UNITS = (0.001, 0.01)

# s between the first times of a clock that begins below 0
_FIRST_TIMES = 10
_LONGEST_STEP = 60.0

_FLASER = b"FLASER"
_RAWLASER = b"RAWLASER1"
_ODOM = b"ODOM"
_ODOM_FIELDS = 10
_LASER_FIELDS = 7  # between the kind of a line and its number of beams, where the line describes it
# Number of fields after the readings, and which of them is the time
_TAILS = {_FLASER: (9, 6), b"ROBOTLASER1": (14, 11), _RAWLASER: (3, 0)}
_KINDS = (*_TAILS, _ODOM)
# Lines of these kinds say nothing that a map needs.
_HARMLESS = {b"PARAM", b"SYNC", b"TRUEPOS", b"MARKER", b"MESSAGE"}
_KIND = re.compile(rb"[A-Z][A-Z0-9_]{1,30}")
_MOST_KINDS = 100
_MOST_NAMED = 6
_SAME_BEAM_DEG = 0.5
# If the laser's pose relative to the odometry varies by more than this (m, rad), it is not the
# mount of the laser but the result of a mapping program.
_STEADY = np.array([0.05, 0.05, 0.035])


def read_carmen(path: FilePath, beams_deg: Sequence[float] | None, max_range: float) -> RecordedLog:
    """Read a CARMEN log, plain or gzip, and keep the beams in the given directions.

    The parameters are those of `limslam_agent.logs.log_reader.read_log`. Lines of other kinds are
    left out, and those that may have held readings or poses are counted in the notes. A FLASER has
    180, 181, 360 or 361 beams over 180 degrees; the other scans describe their beams.

    There is one event for each line, in the order of the file, at the line's ``ipc_time``. The
    frame of the estimate is the robot's first pose, because the origin of odometry is arbitrary and
    may be far away. Times that begin below 0 and go on from there are moved so that the first one
    is 0. Other lines with a negative time are left out. Raises a LogError if the file cannot be
    read, is cut short, has something other than a number where one is needed, has no scan or no
    odometry, or has no beam within 1 degree of a given angle.
    """
    with naming(path):
        check_max_range(max_range)
        events = _Events(beams_deg)
        read_lines(path, events.add)
        if not events.rows:
            # Any text that is no table is read here, so the message names both.
            table = "nor, as a table, a header that begins with t,x,y,theta or t,left,right"
            raise ValueError(f"has no odometry: no ODOM or FLASER line of CARMEN, {table}")
        if not events.scans:
            none = "has no scan: there is no FLASER, ROBOTLASER1 or RAWLASER1 line"
            raise ValueError("; ".join(filter(None, (none, events.others))))
        return _as_log(events, max_range)


def beam_angles_deg(count: int) -> FloatArray:
    """Directions of a scan's beams (count,), deg, from -90 on the right to the left.

    A scan with an even count has no beam at +90. Raises a ValueError if the layout of this number
    of beams is unknown.
    """
    if count not in (180, 181, 360, 361):
        raise ValueError(
            f"a FLASER of {count} beams: only 180, 181, 360 and 361 beams over 180 deg are known, "
            "and ROBOTLASER1 describes others"
        )
    return -90.0 + np.arange(count, dtype=np.float64) * (180.0 / (count - count % 2))


class _Layout(NamedTuple):
    """Where a kind of scan has the chosen beams."""

    beams: int  # number of all beams
    columns: list[int]  # numbers of the chosen beams
    angles: FloatArray  # their directions (n_beams,), deg
    farthest: float  # readings from here on saw nothing, m


class _Events:
    """The numbers of the lines read so far, in packed arrays, because a log may have millions of
    lines.
    """

    def __init__(self, beams_deg: Sequence[float] | None) -> None:
        self.beams_deg = beams_deg
        self.layouts = dict[tuple[bytes, ...], _Layout]()  # by the fields that describe a scan
        self.left_out = Counter[bytes]()
        self.rows = array("d")  # time and odometry of each event
        self.kinds = bytearray()  # of each event, as an index into ``_KINDS``
        self.scans = array("d")  # pose of the laser and ranges of each scan

    def add(self, line: bytes) -> None:
        """Process one line. The file ends within a line without a newline."""
        fields = line.split()
        kind = fields[0] if fields else b""
        if kind == _ODOM:
            if len(fields) != _ODOM_FIELDS:
                raise ValueError(f"ODOM has {len(fields)} fields where {_ODOM_FIELDS} are needed")
            self._add_event(_ODOM, fields[1:4], fields[7])
        elif kind in _TAILS:
            self._add_scan(kind, fields)
        elif (
            not line.endswith(b"\n")
            and len(fields) == 1
            and any(each.startswith(kind) for each in _KINDS)
        ):
            raise ValueError("the line stops within its first word")
        elif kind not in _HARMLESS and _KIND.fullmatch(kind):
            # A text that is no log may have a kind of its own in each line.
            is_known = kind in self.left_out or len(self.left_out) < _MOST_KINDS
            self.left_out[kind if is_known else b"others"] += 1

    @property
    def others(self) -> str:
        """The kinds of lines that were left out, and how many there are. Empty if there are
        none.
        """
        most = self.left_out.most_common()
        kinds = listed([f"{number} {kind.decode('ascii')}" for kind, number in most], _MOST_NAMED)
        return f"lines of kinds that are not read were left out: {kinds}" if kinds else ""

    def _add_scan(self, kind: bytes, fields: list[bytes]) -> None:
        begin = 1 if kind == _FLASER else 1 + _LASER_FIELDS
        text = fields[begin] if len(fields) > begin else b""
        if not text.isdigit():
            raise ValueError(f"{kind.decode()} is not followed by the number of beams")
        count = int(text[:9])
        check_beams(count)
        layout = self._layout(count, tuple(fields[2:begin]))
        readings = fields[begin + 1 : begin + 1 + count]
        tail = fields[begin + 1 + count :]
        if kind != _FLASER and tail and tail[0].isdigit():
            tail = tail[1 + int(tail[0][:9]) :]
        needed, time = _TAILS[kind]
        if len(tail) != needed:
            self._refuse_scan(kind, fields, count)
        ranges = [parse_range(readings[each], f"range {each + 1}") for each in layout.columns]
        laser = [parse_number(field, "the laser's pose") for field in tail[: min(time, 3)]]
        self._add_event(kind, tail[3:6] if time else [b"0"] * 3, tail[time])
        self.scans.extend(laser or [0.0] * 3)
        self.scans.extend(math.inf if each >= layout.farthest else each for each in ranges)

    def _add_event(self, kind: bytes, pose: list[bytes], time: bytes) -> None:
        odometry = [parse_number(field, "the odometry") for field in pose]
        self.rows.extend((parse_number(time, "the time"), *odometry))
        self.kinds.append(_KINDS.index(kind))

    def _layout(self, count: int, laser: tuple[bytes, ...]) -> _Layout:
        """Where scans of a laser have the chosen beams. ``laser`` has the fields that describe it,
        from the start angle on.
        """
        key = b"%d" % count, *laser
        if key in self.layouts:
            return self.layouts[key]
        angles, farthest = _described(count, laser) if laser else (beam_angles_deg(count), math.inf)
        columns = choose_beams(angles, self.beams_deg)
        layout = _Layout(count, columns, angles[columns], farthest)
        first = next(iter(self.layouts.values()), layout)
        if np.abs(layout.angles - first.angles).max() > _SAME_BEAM_DEG:
            raise ValueError(f"a scan of {count} beams after scans of {first.beams}")
        self.layouts[key] = layout
        return layout

    def _refuse_scan(self, kind: bytes, fields: list[bytes], count: int) -> None:
        """Raise an error that says what is wrong with a scan whose number of fields is wrong."""
        name = kind.decode()
        if kind != _FLASER:
            raise ValueError(
                f"{name} has {len(fields)} fields, which is not as many as it announces"
            )
        tail = fields[2 + count :]
        is_stamped = len(tail) in (3, 6) and not is_number(tail[-2])
        if not self.rows and (is_stamped or len(fields) == 2 + count):
            raise ValueError("has no odometry: the scan comes without its poses")
        needed = 2 + count + _TAILS[_FLASER][0]
        raise ValueError(f"{name} has {len(fields)} fields where {needed} are needed")


def _described(count: int, laser: Sequence[bytes]) -> tuple[FloatArray, float]:
    """Directions (count,), deg, of the beams of a laser, and its longest range, m."""
    names = "the start angle", "the field of view", "the angular resolution", "the maximum range"
    start, view, step, farthest = (
        parse_number(field, name) for field, name in zip(laser, names, strict=False)
    )
    if not step:
        step = view / max(count - 1, 1)
    if not count or (count > 1 and not 0.0 < abs(step) * (count - 1) < 2.0 * math.tau):
        raise ValueError(f"{count} beams in steps of {step:g} rad are no scan")
    angles = np.degrees(start + step * np.arange(count, dtype=np.float64))
    return angles, farthest if farthest > MIN_RANGE else math.inf


def _as_log(events: _Events, max_range: float) -> RecordedLog:
    rows = np.array(events.rows).reshape(-1, 4)
    time = rows[:, 0]
    kinds = np.frombuffer(events.kinds, dtype=np.uint8)
    has_scan = kinds != _KINDS.index(_ODOM)
    is_raw = kinds == _KINDS.index(_RAWLASER)
    angles = np.radians(next(iter(events.layouts.values())).angles)
    odometry = rows[:, 1:]
    odometry[:, 2] = se2.wrap_angle(odometry[:, 2])
    ranges = np.full((len(time), len(angles)), np.nan)
    scans = np.array(events.scans).reshape(-1, 3 + len(angles))
    ranges[has_scan] = _without_codes(scans[:, 3:])
    notes = []
    # A single wrong time does not go on.
    steps = np.diff(time[:_FIRST_TIMES])
    if time[0] < 0.0 and len(steps) and (np.abs(steps) < _LONGEST_STEP).all():
        first = float(time[0])
        time = time - first
        notes.append(f"the times begin at {first:g} s; {-first:g} s were added to all of them")
    kept = time >= 0.0
    if untimed := int((~kept).sum()):
        lines = counted(untimed, "line")
        notes.append(f"{lines} with a negative time {was(untimed)} left out")
    gaps = list[int]()
    mount = np.zeros(3)
    is_posed = has_scan & ~is_raw & kept
    if is_posed.any():
        # They repeat scans with poses, unless there are more of them.
        if (raw := int(is_raw.sum())) > int(is_posed.sum()):
            notes.append(f"{counted(raw, 'RAWLASER1 line')} without a pose left out")
        kept &= ~is_raw
        mount = _laser_mount(odometry[is_posed], scans[is_posed[has_scan], :3])
    else:
        kept, odometry, gaps, found = _posed(time, odometry, ranges, kept & is_raw, kept & ~is_raw)
        notes += found
    if not has_scan[kept].any():
        raise ValueError("has no scan whose time is not negative")
    notes += filter(None, (events.others,))
    turned = se2.wrap_angle(angles + mount[2]).tolist()
    x, y, _ = mount.tolist()
    return pose_log(
        [SensorSpec(x, y, each, MIN_RANGE, max_range, side_of(each)) for each in turned],
        time[kept],
        odometry[kept],
        notes=notes,
        ranges=ranges[kept],
        has_scan=has_scan[kept],
        gaps=tuple(gaps),
    )


def _posed(
    time: FloatArray,
    odometry: FloatArray,
    ranges: FloatArray,
    is_scan: BoolArray,
    is_pose: BoolArray,
) -> tuple[BoolArray, FloatArray, list[int], tuple[str, ...]]:
    """Odometry (n, 3) with poses of the scans without one, by the other lines. Also which lines are
    kept (n,), the first ones after a gap of odometry, and what is to be said of it.
    """
    if not is_pose.any():
        raise ValueError("has no odometry: the scans come without poses, and there is no ODOM line")
    rows = np.flatnonzero(is_pose)
    rows = rows[np.argsort(time[rows], kind="stable")]
    stream = OdometryStream(time[rows], odometry[rows])
    silent = stream.silent_times(time[is_scan], ranges[is_scan])
    odometry = odometry.copy()
    odometry[is_scan] = stream.at(time[is_scan])
    odometry[rows] = stream.poses
    is_heard = is_scan & ~silent.hold(time)
    is_within = is_heard & (time >= stream.times[0]) & (time <= stream.times[-1])
    notes = (*stream.notes, *silent.notes(time[is_scan]))
    if left_out := int(is_heard.sum() - is_within.sum()):
        notes += (f"{counted(left_out, 'scan')} before or after all odometry left out",)
    kept = is_pose | is_within
    return kept, odometry, silent.events_after(time[kept]), notes


def _without_codes(ranges: FloatArray) -> FloatArray:
    """Ranges (k, n_beams), m, with infinity in place of the laser's codes for "no return"."""
    seen = ranges.copy()
    largest = float(ranges.max(where=np.isfinite(ranges), initial=0.0))
    for unit in _SICK_UNITS:
        lowest = _SICK_TOP_COUNTS[0] * unit
        if lowest <= largest <= _SICK_TOP_COUNTS[1] * unit:
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
