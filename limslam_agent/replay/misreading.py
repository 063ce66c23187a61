"""Whether the ranges of a log fit its odometry better if the log is read in another way.

A wheel that counts backwards, exchanged wheels, a wrong size of wheels or axle, a wrong order of
the beams, a laser that is mounted backwards, or a heading that counts clockwise makes a map that is
wrong everywhere, and nothing in the log says so. But what is seen next then does not fit what was
seen just before, and it does if the log is read rightly. There are few ways to read a log, and each
of them is another path of the robot. All of them are compared by one score: the share of the
readings that end at a surface of the other part of a short stretch, of all readings that end at
such a surface or pass through it. The score is symmetric in both parts, so that a path which is too
short has no advantage over one which is too long.

Only stretches in which two readings differ say which of them is right: a wrong axle shows in turns.
On 106 simulated drives of a minute, with slips, kidnapping, wheels and axles that are wrong by up
to 5 %, wide and noisy beams, missing readings and coarse encoders, no other reading is certain, and
one is warned of. Of 30 drives each, every fault of the wiring is found, 59 of 60 wrong sizes of
ticks, and 55 of 60 wrong axles.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from limslam_agent.logs.columns import Dimension, Role, column_of
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.logs.table_layout import WHEELS
from limslam_env.geometry import BoolArray, FloatArray, IntArray, se2

# m of driving on either side of an event that are compared, and the least between two events, so
# that stretches overlap; the most events; and the fewest that say something
_STRETCH = 0.8
_APART = 0.4
_MOST_EVENTS = 60
_FEWEST_EVENTS = 6
_MOST_RAYS = 150  # of each side
# m: a ray meets a point that lies within this beside it, and ends there if its length differs by
# less than the tolerance
_BESIDE = 0.05
_TOLERANCE = 0.12
_USUAL_RANGE = 1.0  # m, of a reading, whose end a turn moves
# Another reading is better if its mean score leads by this, and by so many standard errors of the
# difference. It is certain with the larger numbers.
_LEAST_LEAD = 0.08
_LEAST_SIGMAS = 2.2
_CERTAIN_LEAD = 0.15
_CERTAIN_SIGMAS = 5.0

_BEAM = re.compile(r"^(-?r_)(-?)(?=[\d.]*[1-9])")
_SAME_ANGLE = 0.02  # rad
_OF_TICKS = {None, Dimension.TICKS, Dimension.TICK_RATE}
# A robot whose odometry goes on average by more than so many of its longest ranges in a second has
# odometry in another unit.
_MOST_REACHES = 2.0
_FORWARD = {Role.SPEED, Role.DISTANCE}
_MOTIONS = {Role.TURN_RATE, Role.YAW_RATE, Role.ANGLE, Role.YAW, Role.HEADING}
# Distance, and turn times the axle, by the travel of both wheels.
_MOTION = np.array(((0.5, 0.5), (-1.0, 1.0)))


@dataclass(frozen=True)
class Misreading:
    """Another way to read a log, which its ranges fit better.

    Attributes
    ----------
    words
        What it is, and the option that mends it or a question to the owner of the log.
    is_certain
        Whether a replay of the log as it was read is of no use.
    """

    words: str
    is_certain: bool


class _Reading(NamedTuple):
    """Another way to read the wheels of a log.

    ``wheels`` has the true travel of the left and of the right wheel, by factors of the columns
    left and right; ``tick`` and ``axle`` are factors of the size of a tick and of the axle.
    """

    words: str = ""
    wheels: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.0), (0.0, 1.0))
    tick: float = 1.0
    axle: float = 1.0

    def path(self, log: RecordedLog, wheels: FloatArray) -> FloatArray:
        """The path (n, 3) by the travel of both wheels (n, 2), m. The turn comes from ``yaw`` where
        the log has it, which its reader has turned as the wheels turn. What was travelled before
        the first row says nothing.
        """
        left, right = self.tick * np.array(self.wheels) @ wheels.T
        distance = 0.5 * (left + right)
        turn = (right - left) / (self.axle * log.robot.axle)
        if log.yaw is not None:
            measured = se2.wrap_angle(np.diff(log.yaw, prepend=log.yaw[:1]))
            follows = float(np.nansum(measured * turn)) >= 0.0
            turn = np.where(np.isfinite(measured), measured if follows else -measured, turn)
        half = 0.5 * log.robot.axle * turn
        travel = np.column_stack((distance - half, distance + half))
        start = np.zeros(3)
        return np.vstack((start, se2.driven(travel[1:], log.robot.axle, start)))

    def columns(self, header: Sequence[str]) -> list[str]:
        """The names of the columns of a table that is read so. A table of distance and turn stays
        as it is if no signs of these mend it.
        """
        matrix = np.array(self.wheels)
        signs = dict(zip((Role.LEFT, Role.RIGHT), matrix.sum(axis=0).tolist(), strict=True))
        if not any(column_of(name).role in signs for name in header):
            by_motion = _MOTION @ matrix @ np.linalg.inv(_MOTION)
            ahead, turn = np.diag(by_motion)
            signs = dict.fromkeys(_MOTIONS, turn) | dict.fromkeys(_FORWARD, ahead)
            return list(header) if by_motion[0, 1] or by_motion[1, 0] else _signed(header, signs)
        others = {Role.LEFT: Role.RIGHT, Role.RIGHT: Role.LEFT} if matrix[0, 0] == 0.0 else {}
        return _signed(header, signs, others)


_EXCHANGED = ((0.0, 1.0), (1.0, 0.0))
_READINGS = (
    _Reading(),
    _Reading("the right wheel counts the other way", ((1.0, 0.0), (0.0, -1.0))),
    _Reading("the left wheel counts the other way", ((-1.0, 0.0), (0.0, 1.0))),
    _Reading("both wheels count the other way", ((-1.0, 0.0), (0.0, -1.0))),
    _Reading("left and right are exchanged, of the wheels or of the beams", _EXCHANGED),
    _Reading(
        "the robot looks the other way: its beams look back, or its wheels are exchanged and both "
        "count the other way",
        ((0.0, -1.0), (-1.0, 0.0)),
    ),
    _Reading(
        "the wheels are exchanged, and the true right one counts the other way",
        ((0.0, 1.0), (-1.0, 0.0)),
    ),
    _Reading(
        "the wheels are exchanged, and the true left one counts the other way",
        ((0.0, -1.0), (1.0, 0.0)),
    ),
    _Reading("the left wheel travels 2 times as far", ((2.0, 0.0), (0.0, 1.0))),
    _Reading("the right wheel travels 2 times as far", ((1.0, 0.0), (0.0, 2.0))),
    *(_Reading(tick=size) for size in (0.25, 0.5, 2.0, 4.0)),
    *(_Reading(axle=size) for size in (2.0 / 3.0, 0.75, 4.0 / 3.0, 1.5)),
)
# Factors around the best size, by which it is refined. A size that is so near to the best one is
# left as it is.
_NEAR_SIZES = np.arange(0.86, 1.141, 0.02)
_NEARLY_SAME = 0.07

# Signs of x, y and heading, and a turn of the heading, rad, of another way to read poses, with the
# question to the owner of the log.
_READINGS_OF_POSES = (
    (
        "with left and right exchanged: are the beams in the wrong order, or is odometry mirrored?",
        (1.0, -1.0, -1.0),
        0.0,
    ),
    (
        "if the beams look the other way: is the sensor mounted backwards, or ahead negative?",
        (1.0, 1.0, 1.0),
        math.pi,
    ),
    (
        "with a heading of the other sign: does the heading of odometry count clockwise?",
        (1.0, 1.0, -1.0),
        0.0,
    ),
    ("with y of the other sign: does y of odometry point to the right?", (1.0, -1.0, 1.0), 0.0),
)


def misread(
    log: RecordedLog, metres_per_tick: float = 1.0, wheel_radius: float | None = None
) -> Misreading | None:
    """Another way to read a log that its ranges fit better. None if nothing is clearly better, or
    too little was driven.

    Only a log of wheel travel, or of poses in another unit, is misread for certain. A live robot
    could be asked after each metre: the score needs the last two stretches alone.

    Parameters
    ----------
    log
        A log with poses or wheel travel.
    metres_per_tick
        By which a table of wheel travel was read, m.
    wheel_radius
        By which turns of wheels were read, m; None where none was needed.
    """
    if log.wheels is not None:
        return _misread_wheels(log, log.wheels, (metres_per_tick, wheel_radius))
    odometry = log.continuous_odometry
    if odometry is None:
        return None
    travel = np.hypot(*np.diff(odometry[:, :2], axis=0, prepend=odometry[:1, :2]).T)
    speed = float(travel.sum()) / max(float(np.ptp(log.time)), 1e-9)
    reach = float(log.robot.max_ranges.max())
    if speed > _MOST_REACHES * reach:
        remedy = " --position-unit and --time-unit convert" if log.header else ""
        words = (
            f"by odometry the robot drives at {speed:.3g} m/s on average, with ranges of up to "
            f"{reach:g} m: is odometry in metres, and are the times in seconds?{remedy}"
        )
        return Misreading(words, is_certain=True)
    others = [odometry * signs + (0.0, 0.0, turn) for _, signs, turn in _READINGS_OF_POSES]
    better = _better([odometry, *others], log, _stretches(travel))
    if better is None:
        return None
    question, (_, y, heading), _ = _READINGS_OF_POSES[better[0] - 1]
    signs = {Role.Y: y, Role.HEADING: heading, Role.YAW: heading}
    has_heading = any(column_of(name).role in {Role.HEADING, Role.YAW} for name in log.header)
    columns = _signed(log.header, signs if has_heading else {})
    remedy = _remedy("", log.header, columns)
    return Misreading(f"the ranges fit odometry better {question}{remedy}", is_certain=False)


def _signed(
    header: Sequence[str],
    signs: Mapping[Role, float],
    others: Mapping[Role, Role] = MappingProxyType({}),
) -> list[str]:
    """The names of columns with the signs and with the other names of their roles."""
    names = []
    for name in header:
        role = column_of(name).role
        own = name if role is None else name.replace(role, others.get(role, role))
        is_turned = role is not None and signs.get(role, 1.0) < 0.0
        turned = own[1:] if own.startswith("-") else f"-{own}"
        names.append(turned if is_turned else own)
    return names


def _remedy(mark: str, header: Sequence[str], names: Sequence[str]) -> str:
    """What reads a table with other names of its columns, after a mark."""
    if names == list(header):
        return ""
    return f"{mark} --columns {','.join(names)} reads the table so"


def _remedy_of_beams(log: RecordedLog) -> str:
    """What reads a table if its beams are exchanged, which the ranges cannot tell from exchanged
    wheels: one map is the mirror image of the other.
    """
    names = [_BEAM.sub(lambda found: found[1] + "-" * (not found[2]), name) for name in log.header]
    angles = log.robot.beam_angles
    apart = np.abs(se2.wrap_angle(angles[:, None] + angles))
    is_even = bool((apart <= _SAME_ANGLE).any(axis=1).all())
    if not is_even or not any(column_of(name).role in WHEELS for name in names):
        return ""
    columns = ",".join(names)
    return f", and --columns {columns} if it is the beams; the other map is a mirror image"


def _misread_wheels(
    log: RecordedLog, wheels: FloatArray, sizes: tuple[float, float | None]
) -> Misreading | None:
    stretches = _stretches(np.abs(wheels).mean(axis=1))
    better = _better([each.path(log, wheels) for each in _READINGS], log, stretches)
    if better is None:
        return None
    number, is_certain = better
    reading = _READINGS[number]
    if reading.words:
        words = reading.words + _remedy(":", log.header, reading.columns(log.header))
        if reading.wheels == _EXCHANGED:
            words += _remedy_of_beams(log)
    else:
        name = "axle" if reading.tick == 1.0 else "tick"
        size = getattr(reading, name)
        shares = []
        for factor in _NEAR_SIZES:
            near = reading._replace(**{name: size * factor})
            ending, met = _counts(near.path(log, wheels), log, stretches).sum(axis=0)
            shares.append(ending / max(met, 1.0))
        best = float(_NEAR_SIZES[int(np.argmax(np.convolve(shares, np.ones(3), "same")))])
        if name == "axle":
            words = _of_axle(log, size * best)
        else:
            size *= 1.0 if abs(best - 1.0) < _NEARLY_SAME else best
            words = _of_size(log, size, *sizes)
    return Misreading(f"the ranges fit the wheels far better if {words}", is_certain)


def _of_size(
    log: RecordedLog, size: float, metres_per_tick: float, wheel_radius: float | None
) -> str:
    """That the wheels travel ``size`` times as far, and what mends it."""
    fact = f"the wheels travel {size:.3g} times as far as the log was read"
    if not log.header:
        return fact
    columns = [column_of(name) for name in log.header]
    if any(each.role is Role.LEFT and each.dimension in _OF_TICKS for each in columns):
        return (
            f"{fact}: --metres-per-tick {size * metres_per_tick:.3g} reads the table so, if unit "
            "and directions of the ranges are right"
        )
    if wheel_radius is not None:
        return f"{fact}: --wheel-radius {size * wheel_radius:.3g} reads the table so"
    return f"{fact}: are the columns of the travel or of the speed in another unit?"


def _of_axle(log: RecordedLog, size: float) -> str:
    """That the axle is ``size`` times as long, and what mends it."""
    if log.header and not any(column_of(name).role is Role.LEFT for name in log.header):
        fact = f"the robot turns {1.0 / size:.3g} times as far as the log was read"
        return f"{fact}: is the column of the turn in another unit?"
    fact = f"the wheels are {size:.3g} times as far apart as the robot's axle says"
    if not log.header:
        return fact
    return f"{fact}: --axle {size * log.robot.axle:.3g} reads the table so"


def _better(
    paths: Sequence[FloatArray], log: RecordedLog, stretches: IntArray
) -> tuple[int, bool] | None:
    """The number of the path (n, 3) that the ranges fit clearly better than the first one, in the
    stretches in which both differ, and whether that is certain.
    """
    first, *others = paths
    counts_of_first = _counts(first, log, stretches)
    leads = []
    for path in others:
        counts = _counts(path, log, stretches)
        is_met = (counts[:, 1] > 0.0) & (counts_of_first[:, 1] > 0.0)
        rows = is_met & _differ(first, path, stretches)
        shares, of_first = (each[rows, 0] / each[rows, 1] for each in (counts, counts_of_first))
        leads.append(shares - of_first)
    number = int(np.argmax([each.sum() for each in leads]))
    best = leads[number]
    if len(best) < _FEWEST_EVENTS:
        return None
    lead = float(best.mean())
    error = float(best.std()) / math.sqrt(len(best))
    if lead <= max(_LEAST_LEAD, _LEAST_SIGMAS * error):
        return None
    return number + 1, lead > max(_CERTAIN_LEAD, _CERTAIN_SIGMAS * error)


class _Rays(NamedTuple):
    """Readings as rays: poses (k, 3) of their starts, with their directions; lengths (k,), m; and
    whether each ends at a surface (k,).
    """

    starts: FloatArray
    lengths: FloatArray
    is_hit: BoolArray

    @property
    def ends(self) -> FloatArray:
        """Where surfaces were met (h, 2), m."""
        starts = self.starts[self.is_hit]
        directions = np.column_stack((np.cos(starts[:, 2]), np.sin(starts[:, 2])))
        return np.asarray(starts[:, :2] + self.lengths[self.is_hit, None] * directions)


def _stretches(travel: FloatArray) -> IntArray:
    """Stretches (s, 3) of a log: the first event, the middle one and the last one, by the travel
    (n,) to each event, m, which all readings have alike.
    """
    driven = np.cumsum(travel)
    apart = max(_APART, driven[-1] / _MOST_EVENTS)
    middles = np.arange(_STRETCH, driven[-1] - _STRETCH, apart)
    around = middles[:, None] + np.array((-_STRETCH, 0.0, _STRETCH))
    return np.asarray(np.searchsorted(driven, around), dtype=np.int64)


def _differ(first: FloatArray, path: FloatArray, stretches: IntArray) -> BoolArray:
    """In which stretches (s,) the readings show which of two paths (n, 3) the robot has driven."""
    is_apart: BoolArray = np.zeros(len(stretches), dtype=np.bool_)
    for ends in (stretches[:, 0], stretches[:, 2]):
        one, other = (se2.between(each[stretches[:, 1]], each[ends]) for each in (first, path))
        apart = np.hypot(*(one - other)[:, :2].T)
        turned = np.abs(se2.wrap_angle(one[:, 2] - other[:, 2]))
        is_apart |= apart + _USUAL_RANGE * turned > _TOLERANCE
    return is_apart


def _counts(path: FloatArray, log: RecordedLog, stretches: IntArray) -> FloatArray:
    """How many readings end at a surface of the other side, and how many meet one (s, 2), at each
    stretch.
    """
    counts = np.zeros((len(stretches), 2))
    for stretch, (first, middle, last) in enumerate(stretches.tolist()):
        before = _rays(path, log, np.arange(first, middle + 1))
        after = _rays(path, log, np.arange(middle + 1, last + 1))
        counts[stretch] = np.add(_met(before, after.ends), _met(after, before.ends))
    return counts


def _rays(path: FloatArray, log: RecordedLog, events: IntArray) -> _Rays:
    """The readings of some events, thinned evenly, along a path (n, 3)."""
    robot = log.robot
    ranges = log.ranges[events].astype(np.float64)
    is_usable = log.has_scan[events, None] & (ranges > robot.too_near)
    row, beam = np.nonzero(is_usable)
    chosen = np.linspace(0, len(row) - 1, min(len(row), _MOST_RAYS)).astype(np.int64)
    row = row[chosen]
    beam = beam[chosen]
    mounted = np.column_stack((robot.beam_origins, robot.beam_angles))
    lengths = ranges[row, beam]
    return _Rays(
        se2.compose(path[events[row]], mounted[beam]), lengths, lengths < robot.too_far[beam]
    )


def _met(rays: _Rays, points: FloatArray) -> tuple[int, int]:
    """How many rays end at the first of the points (p, 2) that they meet, and how many of them end
    there or pass through it. A ray that ends before it says nothing, since another place may hide
    the point.
    """
    if not len(points) or not len(rays.lengths):
        return 0, 0
    x, y = np.moveaxis(points - rays.starts[:, None, :2], -1, 0)
    cos = np.cos(rays.starts[:, 2:])
    sin = np.sin(rays.starts[:, 2:])
    along = cos * x + sin * y
    is_met = (np.abs(cos * y - sin * x) < _BESIDE) & (along > 0.0)
    beyond = rays.lengths - np.where(is_met, along, np.inf).min(axis=1)
    ending = int(np.count_nonzero(rays.is_hit & (np.abs(beyond) < _TOLERANCE)))
    return ending, ending + int(np.count_nonzero(beyond > _TOLERANCE))
