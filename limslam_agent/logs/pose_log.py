"""What the readers of texts and bags share: poses and readings become a log of a sparse robot."""

import math
from collections.abc import Sequence

import numpy as np

from limslam_agent.logs.recorded_log import RecordedLog
from limslam_env.geometry import BoolArray, FloatArray, se2
from limslam_env.interface import RobotSpec, SensorSpec

MIN_RANGE = 0.02
"""Shorter readings (m) are how lasers say "no reading", or dirt on the window."""

BODY_RADIUS = 0.2
"""Radius (m) given to a robot whose log does not tell it."""

WORST_BEAM_MISMATCH_DEG = 1.0

DEFAULT_BEAMS_DEG = (-90.0, -45.0, -15.0, 15.0, 45.0, 90.0)
"""Chosen out of a rich sensor's beams when nobody says which."""

DEFAULT_MAX_RANGE = 3.0
"""Longest reading (m) that is used when nobody says otherwise."""

SPARSE_BEAMS = 16
"""A robot of no more beams than this is sparse already: all of them are used."""

FARTHEST = 1e9
"""Odometry farther out than this (m) is no odometry; maps of the whole Earth have coordinates of some 1e7 m."""

LARGEST_STEP_BACK = 1.0
"""Times may step back by this much (s), as when two threads write one log; more is another run, or a set clock."""


def beam(angle: float, max_range: float, *, x: float = 0.0, y: float = 0.0, min_range: float = 0.0) -> SensorSpec:
    """A log's beam: from (x, y) m towards ``angle`` rad; what is nearer than ``MIN_RANGE`` is never measured."""
    return SensorSpec(x, y, float(se2.wrap_angle(angle)), max(min_range, MIN_RANGE), max_range)


def choose_beams(beams: Sequence[SensorSpec], beams_deg: Sequence[float] | None) -> list[int]:
    """Indices of the beams nearest to the given directions.

    Parameters
    ----------
    beams
        All that the log has.
    beams_deg
        Directions wanted, in degrees. None takes all beams of a sparse robot, and six of any other.

    Raises
    ------
    ValueError
        If none is wanted, no beam lies within 1 degree of a direction, or one beam is nearest to two of them.
    """
    if beams_deg is None:
        if len(beams) <= SPARSE_BEAMS:
            return list(range(len(beams)))
        beams_deg = DEFAULT_BEAMS_DEG
    return nearest_beams(np.degrees([beam.angle for beam in beams]), beams_deg)


def nearest_beams(angles: FloatArray, beams_deg: Sequence[float]) -> list[int]:
    """Indices of the angles (n,), deg, nearest to the given directions, deg.

    Raises
    ------
    ValueError
        As :func:`choose_beams` does.
    """
    if not len(beams_deg):
        raise ValueError("at least one beam must be chosen")
    chosen: list[int] = []
    for wanted in beams_deg:
        index = _nearest(angles, wanted)
        if index in chosen:
            # The same reading twice would count as two measurements.
            other = beams_deg[chosen.index(index)]
            raise ValueError(f"{other:g} deg and {wanted:g} deg are the same beam, at {angles[index]:g} deg")
        chosen.append(index)
    return chosen


def pose_log(
    beams: Sequence[SensorSpec], time: FloatArray, odometry: FloatArray, ranges: FloatArray, has_scan: BoolArray
) -> RecordedLog:
    """The log of a robot that recorded poses.

    Parameters
    ----------
    beams
        The robot's.
    time
        (n,) s.
    odometry
        (n, 3) m, m, rad, any number of whole turns.
    ranges
        (n, n_beams) m; what is not a number or past a beam's maximum is "nothing seen", what is nearer than its
        minimum (or negative, as some drivers say it) is "something may be near".
    has_scan
        (n,) whether ranges were measured.

    Returns
    -------
    RecordedLog
        The frame of the estimate is the robot's first pose, since where odometry began counting means nothing.

    Raises
    ------
    ValueError
        If a number is not finite, or the odometry jumps or is nowhere on Earth.
    """
    if np.any(np.abs(odometry) > FARTHEST):
        row = int(np.argmax(np.any(np.abs(odometry) > FARTHEST, axis=1)))
        raise ValueError(f"the odometry in row {row} is no pose: {', '.join(f'{v:g}' for v in odometry[row])}")
    largest, least = np.array([b.max_range for b in beams]), np.array([b.min_range for b in beams])
    seen = np.where(np.isnan(ranges), largest, np.clip(ranges, least, largest))
    seen[~has_scan] = largest
    return RecordedLog(
        robot=RobotSpec(radius=BODY_RADIUS, control_period=median_spacing(time), beams=tuple(beams)),
        time=time,
        ranges=seen.astype(np.float32),
        has_scan=has_scan,
        start_pose=np.zeros(3),
        odometry=np.column_stack((odometry[:, :2], se2.wrap_angle(odometry[:, 2]))),
    )


def check_max_range(max_range: float) -> None:
    """Refuse a largest range that makes no sense.

    Raises
    ------
    ValueError
        If it is not a length above ``MIN_RANGE``.
    """
    if not (math.isfinite(max_range) and max_range > MIN_RANGE):
        raise ValueError(f"the largest range must be above {MIN_RANGE} m, not {max_range}")


def _nearest(angles: FloatArray, wanted: float) -> int:
    if not math.isfinite(wanted):
        raise ValueError(f"a beam angle must be a finite number, not {wanted}")
    mismatch = np.abs((angles - wanted + 180.0) % 360.0 - 180.0)
    index = int(np.argmin(mismatch))
    if mismatch[index] > WORST_BEAM_MISMATCH_DEG + 1e-9:
        known = ", ".join(f"{angle:g}" for angle in np.sort(np.round(angles, 1)))
        few = len(angles) <= SPARSE_BEAMS
        there = f"at {known}" if few else f"from {angles.min():g} to {angles.max():g}"
        raise ValueError(
            f"no beam within {WORST_BEAM_MISMATCH_DEG:g} deg of {wanted:g} deg: the log's beams are {there} deg"
        )
    return index


def median_spacing(time: FloatArray) -> float:
    """Median time (s) between two events; the default period where the log is too short to tell."""
    steps = np.diff(time)
    steps = steps[steps > 0.0]
    return float(np.median(steps)) if len(steps) else RobotSpec().control_period
