"""Checks of a log whose numbers are possible but unlikely, such as ranges in another unit.

A check is a function that gives one line about a log, or an empty text if it finds nothing.
"""

import math

import numpy as np

from limslam_agent.logs.odometry_breaks import breaks_in_words, odometry_breaks
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.replay.misreading import Misreading
from limslam_agent.replay.record import Replay
from limslam_env.geometry import FloatArray, se2

# Share of readings that saw nothing, above which the ranges are probably not in metres
_MOSTLY_NOTHING = 0.95
# s: median times between events beyond them are probably not in seconds
_SHORTEST_PERIOD = 1e-3
_LONGEST_PERIOD = 10.0
# of the longest range: a smaller largest reading was probably cut off by the sensor itself
_CLEARLY_BELOW = 0.85
# Up to this share of readings may see nothing without a reason that all of them have.
_BY_CHANCE = 0.01
# Between two rows no wheel travels farther than this, m: otherwise the path between the rows is not
# known.
_LARGEST_STEP = 0.5
_LEAST_DRIVEN = 1.0  # m of driving, below which walls cannot be expected
# If a robot turns by more than this on each metre, rad/m, its heading is probably in degrees. Both
# benchmark logs have 0.4 to 0.7 rad/m.
_MOST_TURNS = 4.0
# a robot with wheels drives along its heading: 1. It is 0 where the heading is in another unit
_LEAST_ALIGNED = 0.5
_MOST_NAMED = 5  # times in a warning
# a wheel with this many times its largest speed on average may have travel in another unit
_CLEARLY_FASTER = 1.2
# A wheel that gets no farther than this share of its travel has counts that are no counters.
_GOES_NOWHERE = 0.05
# share of readings of the other beams that saw nothing, above which a beam may never see a wall
_MANY_NOTHING = 0.3
# Of the longest range, and m: if the middle half of the readings of a beam has a wider range, the
# robot has moved.
_LEAST_SPREAD = 0.25
_ENOUGH_SPREAD = 0.5


def log_warnings(log: RecordedLog, misreading: Misreading | None = None) -> list[str]:
    """What is unlikely about the times, the ranges and the odometry of a log, one sentence for each
    finding.

    ``misreading`` is what `limslam_agent.replay.misreading.misread` has found.
    """
    clock = _clock(log)
    found = "" if misreading is None else misreading.words
    moves = _wheels(log) or found or _poses(log) or _counts(log) or _stays(log)
    odometry = "" if clock else moves
    breaks = [breaks_in_words(log.breaks) if log.breaks else "", _uncounted(log), _long_steps(log)]
    ranges = [*log.readings_notes, _ranges(log), _beams(log)]
    return [line for line in (*log.notes, clock, *breaks, *ranges, odometry) if line]


def map_warnings(replay: Replay) -> list[str]:
    """Why the map of a replay has no walls, in one sentence. Empty if the map has walls."""
    if len(replay.segments):
        return []
    return [f"the map has 0 walls: {_why_no_walls(replay)}"]


def _clock(log: RecordedLog) -> str:
    steps = np.diff(log.time)
    rising = steps[steps > 0.0]
    if len(steps) > 1 and not len(rising):
        return (
            "the times never rise: does the clock stand still, or does the log begin with its "
            "newest row?"
        )
    period = float(np.median(rising)) if len(rising) else _SHORTEST_PERIOD
    if _SHORTEST_PERIOD <= period <= _LONGEST_PERIOD:
        return ""
    return (
        f"the median time between two events is {period:.3g} s: are the times in seconds? "
        "--time-unit converts"
    )


def _uncounted(log: RecordedLog) -> str:
    """Gaps in which the wheels of a log did not count."""
    if log.wheels is None:
        return ""
    start = np.zeros(3)
    path = np.vstack((start, se2.driven(log.wheels[1:], log.robot.axle, start)))
    gaps = [each for each in odometry_breaks(log.time, path) if not each.is_jump]
    remedy = "counters, with --accumulated, count on while rows are missing"
    return f"{breaks_in_words(gaps)}; {remedy}" if gaps else ""


def _long_steps(log: RecordedLog) -> str:
    """Steps in which a wheel travels so far that the way is not known."""
    if log.wheels is None:
        return ""
    travel = np.abs(log.wheels[1:]).max(axis=1, initial=0.0)
    steps = [
        f"{travel[row]:.1f} m between {log.time[row]:.1f} s and {log.time[row + 1]:.1f} s"
        for row in np.flatnonzero(travel > _LARGEST_STEP)
    ]
    if not steps:
        return ""
    more = ", ..." if len(steps) > _MOST_NAMED else ""
    consequence = "what the robot did between these rows is not known, so the map may break there"
    return f"a wheel travels {', '.join(steps[:_MOST_NAMED])}{more}: {consequence}"


def _ranges(log: RecordedLog) -> str:
    walls, share = _seen(log)
    reach = float(log.robot.max_ranges.max())
    if share > _MOSTLY_NOTHING:
        return (
            f"{share:.1%} of the readings saw nothing up to {reach:g} m: are the ranges in metres? "
            "--range-unit converts"
        )
    farthest = float(walls.max(initial=0.0))
    if not share > _BY_CHANCE or farthest >= _CLEARLY_BELOW * reach:
        return ""
    return (
        f"the longest range is {reach:g} m, but the largest reading of a wall is {farthest:.2f} m: "
        f"if the sensors see no farther, the {share:.0%} of the readings that saw nothing clear "
        f"space that was not seen; --max-range {math.ceil(10.0 * farthest) / 10.0:g} sets another "
        "longest range"
    )


def _beams(log: RecordedLog) -> str:
    """Beams that always say the same or nothing, although the readings of another one show that the
    robot has moved.
    """
    if not _has_moved(log):
        return ""
    too_far = log.robot.too_far
    readings = np.minimum(log.ranges[log.has_scan], log.robot.max_ranges)
    # nan where a beam has no reading
    lowest = np.fmin.reduce(readings)
    counts = (~np.isnan(readings)).sum(axis=0)
    is_dead = np.fmax.reduce(readings) == lowest
    saw_nothing = lowest >= too_far
    others = readings[:, ~saw_nothing]
    nothing_of_others = np.count_nonzero(others >= too_far[~saw_nothing])
    if nothing_of_others > _MANY_NOTHING * np.isfinite(others).sum():
        is_dead &= ~saw_nothing
    is_dead |= counts == 0
    if not is_dead.any():
        return ""
    angles = [f"{angle:g}" for angle in np.round(np.degrees(log.robot.beam_angles), 1)]
    findings = []
    for beam in np.flatnonzero(is_dead):
        value = "nothing was seen" if saw_nothing[beam] else f"{lowest[beam]:.3g}"
        always = f"says {value} in all of its {counts[beam]} readings"
        which = always if counts[beam] else "has no reading"
        findings.append(f"the beam at {angles[beam]} deg {which}")
    kept = ",".join(angle for angle, dead in zip(angles, is_dead, strict=True) if not dead)
    return f"{', '.join(findings)}: is its sensor connected? --beams={kept} leaves it out"


def _stays(log: RecordedLog) -> str:
    """Whether the robot stays where it is by its odometry, although its readings change."""
    poses = log.continuous_odometry
    if poses is None and log.wheels is not None:
        poses = se2.driven(log.wheels[1:], log.robot.axle, np.zeros(3))
    reach = 0.0 if poses is None else float(np.hypot(*np.ptp(poses[:, :2], axis=0)))
    if not (0.0 < reach < _LEAST_DRIVEN and _has_moved(log)):
        return ""
    remedy = "--position-unit converts" if log.wheels is None else "--metres-per-tick converts"
    return (
        f"by odometry the robot stays within {reach:.2f} m, but its readings change by "
        f"{_spread(log):.2f} m: is odometry missing, or not in metres? {remedy}"
    )


def _poses(log: RecordedLog) -> str:
    """What is unlikely about odometry poses: which way they move."""
    odometry = log.continuous_odometry
    if odometry is None:
        return ""
    moves = np.diff(odometry[:, :2], axis=0)
    lengths = np.hypot(*moves.T)
    driven = float(lengths.sum())
    if driven < _LEAST_DRIVEN:
        return ""
    per_metre = float(np.abs(se2.wrap_angle(np.diff(odometry[:, 2]))).sum()) / driven
    # How well the direction of driving follows the heading, ahead or back, from 0 to 1
    aside = np.arctan2(moves[:, 1], moves[:, 0]) - odometry[1:, 2]
    aligned = float(abs(np.sum(lengths * np.exp(2j * aside)))) / driven
    if per_metre > _MOST_TURNS and aligned < _LEAST_ALIGNED:
        turns = f"by odometry the robot turns by {per_metre:.1f} rad on each metre"
        return f"{turns}: is its heading in radians?"
    return ""


def _wheels(log: RecordedLog) -> str:
    """What is unlikely about the travel of the wheels: whether they move, and how fast."""
    if log.wheels is None:
        return ""
    left, right = np.abs(log.wheels[1:]).sum(axis=0).tolist()
    most = max(left, right)
    if most == 0.0:
        return (
            "the wheels never move: are the encoders connected, and are left and right their "
            "columns?"
        )
    speed = most / max(float(np.ptp(log.time)), 1e-9)
    limit = log.robot.max_wheel_speed
    if speed > _CLEARLY_FASTER * limit:
        return (
            f"a wheel travels at {speed:.2g} m/s on average, but the robot's max_wheel_speed is "
            f"{limit:g} m/s: are left and right travel, not speeds, and are the metres for each "
            "tick right? If the robot is so fast, set max_wheel_speed in its file"
        )
    if min(left, right) == 0.0 and most >= _LEAST_DRIVEN:
        still, moving = ("left", "right") if left == 0.0 else ("right", "left")
        return (
            f"the {still} wheel never moves, while the {moving} wheel travels {most:.1f} m: is its "
            f"encoder connected, and is {still} its column?"
        )
    return ""


def _counts(log: RecordedLog) -> str:
    """What is unlikely about the signs of the travel of the wheels."""
    if log.wheels is None:
        return ""
    wheels = log.wheels[1:]
    most = float(np.abs(wheels).sum(axis=0).max(initial=0.0))
    if most < _LEAST_DRIVEN:
        return ""
    if (wheels >= 0.0).all():
        return (
            "no wheel ever turns backwards: if the robot has turned on the spot or driven back, "
            "the direction of its wheels is not measured, and the map is wrong"
        )
    reach = float(np.ptp(np.cumsum(wheels, axis=0), axis=0).max())
    if reach > _GOES_NOWHERE * most:
        return ""
    return (
        f"the wheels travel {most:.1f} m and get no farther than {reach:.2f} m: are left and right "
        "the travel since the row before? Then leave out --accumulated"
    )


def _has_moved(log: RecordedLog) -> bool:
    """Whether the readings show that the robot has moved."""
    reach = float(log.robot.max_ranges.max())
    return _spread(log) >= min(_LEAST_SPREAD * reach, _ENOUGH_SPREAD)


def _spread(log: RecordedLog) -> float:
    """The range of the middle half of a beam's readings of walls, m: the largest of all beams."""
    readings = log.ranges[log.has_scan].astype(np.float64)
    walls = np.where(np.isfinite(readings) & (readings < log.robot.too_far), readings, np.nan)
    walls = walls[:, np.isfinite(walls).any(axis=0)]
    if not walls.size:
        return 0.0
    return float(np.ptp(np.nanquantile(walls, (0.25, 0.75), axis=0), axis=0).max())


def _seen(log: RecordedLog) -> tuple[FloatArray, float]:
    """Readings of walls (k,), m, and the share of readings that saw nothing; NaN without
    readings.
    """
    readings = log.ranges[log.has_scan].astype(np.float64)
    nothing = readings >= log.robot.too_far
    valid = np.isfinite(readings)
    share = float(nothing[valid].mean()) if valid.any() else math.nan
    return readings[valid & ~nothing], share


def _why_no_walls(replay: Replay) -> str:
    log = replay.log
    seen, share = _seen(log)
    driven = float(np.hypot(*np.diff(replay.odometry[:, :2], axis=0).T).sum())
    if math.isnan(share):
        return "the log has no readings"
    if share > _MOSTLY_NOTHING:
        return "almost no reading saw anything"
    if not (log.ranges[log.has_scan] > log.robot.too_near).any():
        return (
            f"no reading is longer than {seen.max():.2g} m, which is too near: are the sensors "
            "connected, what does 0 mean, and are the ranges in metres? --range-unit converts"
        )
    if all(beam.side == "none" for beam in log.robot.beams):
        return "no beam looks to the left or the right of the robot, and only such beams draw walls"
    if driven < _LEAST_DRIVEN:
        little = f"the robot drove only {driven:.2f} m by odometry. Is the odometry in metres?"
        return little if driven else "by odometry the robot never moves"
    return (
        f"the {1.0 - share:.0%} of the readings that saw something do not lie on lines. Are "
        "odometry and ranges in "
        "metres, and the beams' directions right? A larger --noise accepts more scatter"
    )
