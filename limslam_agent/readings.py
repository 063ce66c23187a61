"""What a range reading means, and which readings are used: one definition for logs, live robots and
``Mapper``.

- ``+inf``, the beam's maximum or more become the maximum: nothing was seen, and the beam is free up
  to its maximum. Examples are the 8190 mm of a time-of-flight chip and the 81.91 m of a CARMEN log.
- Between minimum and maximum a reading stays as it is: a surface at this distance.
- 0 up to the beam's minimum become the minimum: something may be too near to be measured.
- ``NaN`` stays: there is no reading. It is skipped and counted.
- Negative numbers and ``-inf`` become ``NaN``. They are skipped and counted.

A program reports ``NaN``, a negative number, 0, 65535 or another number of its own where nothing
was seen, or where nothing was measured, and no single reading shows which. A log as a whole does:
what is reported in place of "nothing was seen" stands beside readings near the longest range.
:func:`settled` decides it so. An observation of a robot that drives is taken as above, so a program
whose sensor reports something else where nothing was seen replaces it by infinity.

A reading is used once. A loop that is faster than its sensors reports the same reading several
times, at different poses. Noise and resolution seldom make two readings of a moving robot equal, so
the readings show which beams repeat theirs (``limslam_agent.kernels.repeats``).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec

MEANINGS = "auto", "nothing", "not-measured"
"""What missing readings of a log may mean: what the log itself says, that nothing was seen, or that
nothing was measured.
"""

UNSTEADY = 0.2
"""A robot's speed changes by as much as its largest one in the inverse of this time, 1/s."""

TURN_LENGTH = 0.4
"""A turn by one radian counts as this motion, m: it moves the end of a beam by about as much."""

# What missing readings mean is said if they are more than this share.
_NOTED = 0.01
# The largest number of 16 bits, which no sensor measures, in mm, cm and m as metres.
_CODES = (65.535, 655.35, 65535.0)
# The readings of a log end at this quantile of those of walls, and from this share of it on they
# are near their end.
_END = 0.98
_NEAR_END = 0.85
# Missing readings mean that nothing was seen if the odds of the readings beside them to be near the
# end are so many times those of all readings, and that by so many standard deviations.
_ODDS = 2.0
# One number is reported in place of "nothing was seen" if it is so many times as frequent as each
# other one, and more than this share of the readings.
_TIMES_OFTEN = 5.0
_LEAST_CODE = 0.03
_SIGMAS = 3.0
_FEWEST = 10  # readings beside missing ones that say something
# m: no wall comes nearer by more than this between two readings.
_LARGEST_STEP = 0.5


@dataclass(frozen=True, eq=False)
class Settled:
    """The readings of a log, as they are used.

    Attributes
    ----------
    readings
        (n, n_beams), m, from the minimum to the maximum of the beam, or NaN.
    repeated
        Which of them (n, n_beams) repeat the reading before, and are therefore NaN.
    notes
        What was found, in words, a line for each finding.
    """

    readings: FloatArray
    repeated: BoolArray
    notes: tuple[str, ...]


def as_readings(ranges: ArrayLike, min_ranges: ArrayLike, max_ranges: ArrayLike) -> FloatArray:
    """Ranges from a sensor or a log as readings of the table above.

    Parameters
    ----------
    ranges
        Whatever the sensor reports (..., n_beams), m.
    min_ranges, max_ranges
        Shortest and longest reading of each beam (n_beams,), m.

    Returns
    -------
    FloatArray
        Readings (..., n_beams), m, from the minimum to the maximum, or NaN. A reading at the
        maximum means that nothing was seen, a reading at the minimum that something may be nearer,
        and NaN that there is no reading.
    """
    values = np.asarray(ranges, dtype=np.float64)
    # A comparison with NaN is false, and np.clip keeps NaN.
    return np.asarray(np.where(values >= 0.0, np.clip(values, min_ranges, max_ranges), np.nan))


def path_moved(motions: FloatArray) -> FloatArray:
    """How far motions (n, 3), m, m, rad, move the ends of the beams (n,), m."""
    turned = TURN_LENGTH * np.abs(motions[:, 2])
    return np.asarray(np.hypot(motions[:, 0], motions[:, 1]) + turned)


def new_repeats(beams: int) -> FloatArray:
    """What is known of the repeats of a number of beams before the first reading."""
    from limslam_agent.kernels.tables import PREVIOUS, REPEATS

    repeats = np.zeros((beams, REPEATS))
    repeats[:, PREVIOUS] = math.nan
    return repeats


def settled(
    reported: NDArray[np.floating],
    has_scan: BoolArray,
    robot: RobotSpec,
    moved: FloatArray,
    missing: str = "auto",
) -> Settled:
    """The readings of a log, with what is missing and what is repeated settled.

    Parameters
    ----------
    reported
        Whatever the sensors report (n, n_beams), m.
    has_scan
        Which rows (n,) have ranges.
    robot
        The robot with its beams.
    moved
        How far each row moved the beams (n,), m, as :func:`path_moved` says it.
    missing
        What missing readings mean: one of ``MEANINGS``.

    Raises
    ------
    ValueError
        If ``missing`` is unknown.
    """
    if missing not in MEANINGS:
        raise ValueError(f"--missing must be one of {', '.join(MEANINGS)}, not {missing!r}")
    values = np.array(reported, dtype=np.float64)
    notes = []
    # A row without any reading may stand between two scans, and says nothing of missing readings.
    is_empty = has_scan & np.isnan(values).all(axis=1)
    rows = has_scan if missing != "auto" else has_scan & ~is_empty
    for kind in _kinds(values[rows], robot):
        meaning, note = (missing, "") if missing != "auto" else _decided(kind, robot)
        notes.append(note)
        if meaning:
            value = math.inf if meaning == "nothing" else math.nan
            values[rows] = np.where(kind.mask, value, values[rows])
    if missing == "auto" and _saw_nothing(is_empty[has_scan], values[has_scan], robot):
        values[is_empty] = math.inf
    readings = as_readings(values, robot.min_ranges, robot.max_ranges)
    repeated, note = _repeated(readings, has_scan, robot, moved)
    readings[repeated] = math.nan
    return Settled(readings, repeated, tuple(note for note in (*notes, note) if note))


@dataclass(frozen=True, eq=False)
class _Kind:
    """One form of missing readings: in words, where it stands (m, n_beams), all readings."""

    words: str
    mask: BoolArray
    readings: FloatArray
    default: str  # what they mean where the log does not say it; "" as the module says


def _kinds(values: FloatArray, robot: RobotSpec) -> list[_Kind]:
    """The forms of missing readings among the values (m, n_beams), m, of a log."""
    is_code = np.isclose(values[..., None], _CODES, rtol=1e-6, atol=0.0).any(axis=-1)
    masks: dict[str, tuple[BoolArray, str]] = {
        "missing (nan, empty or negative)": (~(values >= 0.0), "not-measured"),
        "0": (values == 0.0, ""),
        "65535": (is_code & (values > robot.max_ranges), "nothing"),
    }
    others = values.copy()
    for mask, _ in masks.values():
        others[mask] = math.nan
    readings = as_readings(others, robot.min_ranges, robot.max_ranges)
    kinds = [
        _Kind(words, mask, readings, default)
        for words, (mask, default) in masks.items()
        if mask.any()
    ]
    code = _code(readings, robot)
    mask = readings == code
    kind = _Kind(f"{code:.3g} m", mask, np.where(mask, math.nan, readings), "not-measured")
    return [*kinds, kind] if mask.any() and _meaning(kind, robot)[0] == "nothing" else kinds


def _code(readings: FloatArray, robot: RobotSpec) -> float:
    """The reading of a wall (m) that stands far more often than any other among readings (m,
    n_beams), m, and is no farthest one. NaN if there is none.
    """
    walls = readings[(readings > robot.too_near) & (readings < robot.too_far)]
    numbers, counts = np.unique(walls, return_counts=True)
    if len(numbers) < _FEWEST:
        return math.nan
    *_, second, most = np.sort(counts)
    code = float(numbers[np.argmax(counts)])
    others = walls[walls != code]
    is_apart = code > others.max() or code < _NEAR_END * float(np.quantile(others, _END))
    is_often = most > max(_TIMES_OFTEN * second, _LEAST_CODE * readings.size)
    return code if is_often and is_apart else math.nan


def _decided(kind: _Kind, robot: RobotSpec) -> tuple[str, str]:
    """What missing readings mean by the readings beside them, and that in words."""
    meaning, reason = _meaning(kind, robot)
    if not meaning or (meaning == kind.default == "nothing") or kind.mask.mean() < _NOTED:
        return meaning, ""
    text = f"{kind.mask.mean():.0%} of the readings are {kind.words}: {reason}, so they count as"
    if meaning == "nothing":
        return meaning, f"{text} 'nothing seen'; --missing not-measured leaves them out"
    return meaning, f"{text} not measured; --missing nothing takes them for 'nothing seen'"


def _saw_nothing(is_empty: BoolArray, values: FloatArray, robot: RobotSpec) -> bool:
    """Whether rows (m,) without any reading among values (m, n_beams), m, saw nothing."""
    mask = np.broadcast_to(is_empty[:, None], values.shape)
    readings = as_readings(values, robot.min_ranges, robot.max_ranges)
    return _meaning(_Kind("", mask, readings, "not-measured"), robot)[0] == "nothing"


def _meaning(kind: _Kind, robot: RobotSpec) -> tuple[str, str]:
    """What missing readings mean by the readings beside them, and why."""
    mask = kind.mask
    readings = kind.readings
    is_known = readings > robot.too_near
    walls = readings[is_known & (readings < robot.too_far)]
    begins = mask[1:] & is_known[:-1]
    ends = mask[:-1] & is_known[1:]
    beside = np.concatenate((readings[:-1][begins], readings[1:][ends]))
    if len(beside) < _FEWEST or not len(walls):
        return kind.default, "no other readings of the same beams stand beside them"
    if not kind.default and np.median(beside) < float(robot.too_near.max()) + _LARGEST_STEP:
        return "", ""  # what was measured last was near
    limit = _NEAR_END * float(np.quantile(walls, _END))
    share = float((readings[is_known] > limit).mean())
    found = float((beside > limit).sum())
    expected = share * len(beside)
    is_odd = found * (1.0 - share) > _ODDS * share * (len(beside) - found)
    if is_odd and found - expected > _SIGMAS * math.sqrt(expected * (1.0 - share)):
        return "nothing", "they begin where the readings end near the longest range"
    return "not-measured", "they stand beside near and far readings alike"


def _repeated(
    readings: FloatArray, has_scan: BoolArray, robot: RobotSpec, moved: FloatArray
) -> tuple[BoolArray, str]:
    """Which readings (n, n_beams) of a log repeat the one before, and that in words.

    The whole log says which beams repeat their readings, and for how many rows.
    """
    from limslam_agent.kernels.repeats import find_holds, mark_repeats
    from limslam_agent.kernels.tables import HOLD, LONG_CHANGES, LONG_ROWS

    due = robot.measures(np.arange(len(readings))[:, None]) & has_scan[:, None]
    walls = (readings > robot.too_near) & (readings < robot.too_far)
    repeated = np.zeros(readings.shape, dtype=np.bool_)
    found, known = (new_repeats(readings.shape[1]) for _ in range(2))
    mark_repeats(readings, walls, due, moved, found, repeated)
    find_holds(found)
    is_repeating = found[:, HOLD] > 0.0
    known[:, HOLD] = np.where(is_repeating, found[:, HOLD], -1.0)
    mark_repeats(readings, walls, due, moved, known, repeated)
    if not is_repeating.any():
        return repeated, ""
    rows = found[is_repeating, LONG_ROWS].sum() / found[is_repeating, LONG_CHANGES].sum()
    angles = ", ".join(f"{angle:.4g}" for angle in np.degrees(robot.beam_angles[is_repeating]))
    which = "" if is_repeating.all() else f" of the beams at {angles} deg"
    return repeated, f"each reading{which} stands in {rows:.2g} rows on average: it is used once"


def unsteadiness(robot: RobotSpec) -> float:
    """Mean square of how much a wheel's travel changes from one step to the next, m^2."""
    return UNSTEADY * robot.max_wheel_speed**2 * robot.control_period**3
