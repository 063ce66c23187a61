"""Warnings about a replayed log whose numbers are possible but unlikely, such as ranges in another
unit.
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
# m/s: a robot that is faster on average has odometry in another unit, or times in another unit
_FASTEST = 20.0
# If a robot turns by more than this on each metre, rad/m, its heading is probably in degrees. Both
# benchmark logs have 0.4 to 0.7 rad/m.
_MOST_TURNS = 4.0
# a robot with wheels drives along its heading: 1. It is 0 where the heading is in another unit
_LEAST_ALIGNED = 0.5
_MOST_NAMED = 5  # times in a warning
# a wheel with this many times its largest speed on average may have travel in another unit
_CLEARLY_FASTER = 1.2
# share of readings of the other beams that saw nothing, above which a beam may never see a wall
_MANY_NOTHING = 0.3
# m: if the middle half of the readings of a beam has a wider range, the robot has moved
_LEAST_SPREAD = 0.5


def log_warnings(log: RecordedLog, misreading: Misreading | None = None) -> list[str]:
    """What is unlikely about the times, the ranges and the odometry of a log, one sentence for each
    finding.

    ``misreading`` is what `limslam_agent.replay.misreading.misread` has found.
    """
    about_clock = _about_clock(log)
    about_odometry = [] if about_clock else _about_odometry(log)
    if misreading is not None and not (about_clock or about_odometry):
        about_odometry = [misreading.words]
    about_ranges = [*log.readings_notes, *_about_ranges(log), *_about_beams(log)]
    about_breaks = [*_about_breaks(log), *_about_gaps(log)]
    return [*log.notes, *about_clock, *about_breaks, *about_ranges, *about_odometry]


def map_warnings(replay: Replay) -> list[str]:
    """Why the map of a replay has no walls, in one sentence. Empty if the map has walls."""
    if len(replay.segments):
        return []
    return [f"the map has 0 walls: {_why_no_walls(replay)}"]


def _about_clock(log: RecordedLog) -> list[str]:
    steps = np.diff(log.time)
    if len(steps) > 1 and not (steps > 0.0).any():
        return [
            (
                "the times never rise: does the clock stand still, or does the log begin with its "
                "newest row?"
            )
        ]
    steps = steps[steps > 0.0]
    if not len(steps) or _SHORTEST_PERIOD <= (period := float(np.median(steps))) <= _LONGEST_PERIOD:
        return []
    return [
        (
            f"the median time between two events is {period:.3g} s: are the times in seconds? "
            "--time-unit converts"
        )
    ]


def _about_breaks(log: RecordedLog) -> list[str]:
    return [breaks_in_words(log.breaks)] if log.breaks else []


def _about_gaps(log: RecordedLog) -> list[str]:
    if log.wheels is None:
        return []
    start = np.zeros(3)
    path = np.vstack((start, se2.driven(log.wheels[1:], log.robot.axle, start)))
    lost = [each for each in odometry_breaks(log.time, path) if not each.is_jump]
    remedy = "counters, with --accumulated, count on while rows are missing"
    found = [f"{breaks_in_words(lost)}; {remedy}"] if lost else []
    travel = np.abs(log.wheels[1:]).max(axis=1, initial=0.0)
    (rows,) = np.nonzero(travel > _LARGEST_STEP)
    gaps = [
        f"{travel[row]:.1f} m between {log.time[row]:.1f} s and {log.time[row + 1]:.1f} s"
        for row in rows
    ]
    more = ", ..." if len(gaps) > _MOST_NAMED else ""
    consequence = "what the robot did between these rows is not known, so the map may break there"
    if gaps:
        found.append(f"a wheel travels {', '.join(gaps[:_MOST_NAMED])}{more}: {consequence}")
    return found


def _about_ranges(log: RecordedLog) -> list[str]:
    near, share = _seen(log)
    if math.isnan(share):
        return []
    reach = float(log.robot.max_ranges.max())
    if share > _MOSTLY_NOTHING:
        text = (
            f"{share:.1%} of the readings saw nothing up to {reach:g} m: are the ranges in metres?"
        )
        return [f"{text} --range-unit converts"]
    farthest = float(near.max(initial=0.0))
    if share > _BY_CHANCE and farthest < _CLEARLY_BELOW * reach:
        numbers = (
            f"the longest range is {reach:g} m, but the largest reading of a wall is "
            f"{farthest:.2f} m"
        )
        effect = f"the {share:.0%} of the readings that saw nothing clear space that was not seen"
        option = f"--max-range {math.ceil(10.0 * farthest) / 10.0:g} sets another longest range"
        return [f"{numbers}: if the sensors see no farther, {effect}; {option}"]
    return []


def _about_beams(log: RecordedLog) -> list[str]:
    """Beams that always say the same or nothing, although the readings of another one show that the
    robot has moved.
    """
    if _spread(log) < _LEAST_SPREAD:
        return []
    readings = np.minimum(log.ranges[log.has_scan], log.robot.max_ranges)
    # nan where a beam has no reading
    lowest = np.fmin.reduce(readings)
    highest = np.fmax.reduce(readings)
    counts = (~np.isnan(readings)).sum(axis=0)
    is_dead = highest == lowest
    saw_nothing = lowest >= log.robot.too_far
    others = readings[:, ~saw_nothing]
    if (
        np.count_nonzero(others >= log.robot.too_far[~saw_nothing])
        > _MANY_NOTHING * np.isfinite(others).sum()
    ):
        is_dead &= ~saw_nothing
    is_dead |= counts == 0
    if not is_dead.any():
        return []
    angles = [f"{angle:g}" for angle in np.round(np.degrees(log.robot.beam_angles), 1)]
    said = [
        f"says {'nothing was seen' if nothing else f'{low:.3g}'} in all of its {count} readings"
        if count
        else "has no reading"
        for nothing, low, count in zip(saw_nothing, lowest, counts, strict=True)
    ]
    which = ", ".join(
        f"the beam at {angles[beam]} deg {said[beam]}" for beam in np.nonzero(is_dead)[0]
    )
    kept = ",".join(angle for angle, dead in zip(angles, is_dead, strict=True) if not dead)
    return [f"{which}: is its sensor connected? --beams={kept} leaves it out"]


def _about_odometry(log: RecordedLog) -> list[str]:
    odometry = log.continuous_odometry
    if odometry is None:
        return [] if log.wheels is None else _about_wheels(log, log.wheels)
    reach = float(np.hypot(*np.ptp(odometry[:, :2], axis=0)))
    if reach < _LEAST_DRIVEN:
        spread = _spread(log)
        if spread < _LEAST_SPREAD:
            return []
        text = (
            f"by odometry the robot stays within {reach:.2f} m, but its readings change by "
            f"{spread:.2f} m"
        )
        return [f"{text}: is odometry missing, or not in metres?"]
    driven = float(np.hypot(*np.diff(odometry[:, :2], axis=0).T).sum())
    speed = driven / max(float(np.ptp(log.time)), 1e-9)
    if speed > _FASTEST:
        return [
            f"by odometry the robot drives at {speed:.0f} m/s on average: is odometry in metres?"
        ]
    per_metre = float(np.abs(se2.wrap_angle(np.diff(odometry[:, 2]))).sum()) / driven
    if per_metre > _MOST_TURNS and _alignment(odometry) < _LEAST_ALIGNED:
        turns = f"by odometry the robot turns by {per_metre:.1f} rad on each metre"
        return [f"{turns}: is its heading in radians?"]
    return []


def _alignment(odometry: FloatArray) -> float:
    """How well the direction of driving follows the heading of poses (n, 3), ahead or back, from 0
    to 1.
    """
    moves = np.diff(odometry[:, :2], axis=0)
    turned = np.arctan2(moves[:, 1], moves[:, 0]) - odometry[1:, 2]
    return float(
        abs(np.sum(np.hypot(*moves.T) * np.exp(2j * turned)))
        / max(float(np.hypot(*moves.T).sum()), 1e-9)
    )


def _about_wheels(log: RecordedLog, wheels: FloatArray) -> list[str]:
    """What is unlikely about the travel (n, 2) of both wheels, m: whether they move, how fast, and
    which way.
    """
    left, right = np.abs(wheels[1:]).sum(axis=0).tolist()
    if left == right == 0.0:
        return [
            (
                "the wheels never move: are the encoders connected, and are left and right their "
                "columns?"
            )
        ]
    speed = max(left, right) / max(float(np.ptp(log.time)), 1e-9)
    most = log.robot.max_wheel_speed
    if speed > _CLEARLY_FASTER * most:
        text = (
            f"a wheel travels at {speed:.2g} m/s on average, but the robot's max_wheel_speed is "
            f"{most:g} m/s"
        )
        question = "are left and right travel, not speeds, and are the metres for each tick right?"
        return [f"{text}: {question} If the robot is so fast, set max_wheel_speed in its file"]
    if min(left, right) == 0.0 and max(left, right) >= _LEAST_DRIVEN:
        still, moving = ("left", "right") if left == 0.0 else ("right", "left")
        travel = f"while the {moving} wheel travels {max(left, right):.1f} m"
        question = f"is its encoder connected, and is {still} its column?"
        return [f"the {still} wheel never moves, {travel}: {question}"]
    return []


def _spread(log: RecordedLog) -> float:
    """The range of the middle half of a beam's readings of walls, m: the largest of all beams."""
    readings = log.ranges[log.has_scan].astype(np.float64)
    seen = np.where(np.isfinite(readings) & (readings < log.robot.too_far), readings, np.nan)
    seen = seen[:, np.isfinite(seen).any(axis=0)] if seen.size else seen
    if not seen.size:
        return 0.0
    low, high = np.nanquantile(seen, (0.25, 0.75), axis=0)
    return float((high - low).max())


def _seen(log: RecordedLog) -> tuple[FloatArray, float]:
    """Readings of walls (k,), m, and the share of readings that saw nothing. NaN where there are no
    readings.
    """
    readings = log.ranges[log.has_scan].astype(np.float64)
    nothing = readings >= log.robot.too_far
    valid = np.isfinite(readings)
    share = float(nothing[valid].mean()) if valid.any() else math.nan
    return readings[valid & ~nothing], share


def _why_no_walls(replay: Replay) -> str:
    log = replay.log
    share = _seen(log)[1]
    driven = float(np.hypot(*np.diff(replay.odometry[:, :2], axis=0).T).sum())
    if math.isnan(share):
        return "the log has no readings"
    if share > _MOSTLY_NOTHING:
        return "almost no reading saw anything"
    if not (log.ranges[log.has_scan] > log.robot.too_near).any():
        return (
            "all readings are the shortest ones: are the sensors connected, and what does 0 mean?"
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
