"""Shared parts of the readers of text files and bags: poses and readings become the log of a sparse
robot.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from limslam_agent.logs.directions import apart
from limslam_agent.logs.odometry_breaks import without_excursions
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_env.geometry import FloatArray, se2
from limslam_env.interface import LARGEST_RANGE, RobotSpec, SensorSpec

MIN_RANGE = 0.02
"""Shorter readings (m) mean "no reading" or dirt on the window of a laser."""

BODY_RADIUS = 0.2
"""Radius (m) of a robot whose log does not hold it."""

WORST_BEAM_MISMATCH_DEG = 1.0

DEFAULT_BEAMS_DEG = (-90.0, -45.0, -15.0, 15.0, 45.0, 90.0)
"""Beams that are chosen from a sensor with many beams by default."""

DEFAULT_MAX_RANGE = 3.0
"""Longest reading (m) that is used by default."""

SPARSE_BEAMS = 16
"""A robot with at most this many beams is already sparse. All of its beams are used."""

FARTHEST = 1e9
"""Largest coordinate (m) of an odometry pose. Maps of the whole Earth have coordinates of about 1e7
m.
"""

LARGEST_STEP_BACK = 1.0
"""Times may step back by this much (s), for example if two threads write one log. A larger step
means another run, a clock that was set, or a bag that begins again.
"""


def beam(
    angle: float, max_range: float, *, x: float = 0.0, y: float = 0.0, min_range: float = 0.0
) -> SensorSpec:
    """A beam of a log from (x, y), m, in the direction ``angle``, rad. It measures nothing below
    ``MIN_RANGE``.
    """
    return SensorSpec(x, y, float(se2.wrap_angle(angle)), max(min_range, MIN_RANGE), max_range)


def choose_beams(angles: FloatArray, beams_deg: Sequence[float] | None) -> list[int]:
    """Indices of the beams of a log, at the angles (n,), deg, that are used.

    These are the beams in the wanted directions, deg, as :func:`nearest_beams` chooses them. None
    takes all beams of a sparse robot, and of another robot those that are nearest to
    ``DEFAULT_BEAMS_DEG``, however far apart its beams are.
    """
    if beams_deg is not None:
        return nearest_beams(angles, beams_deg)
    if len(angles) <= SPARSE_BEAMS:
        return list(range(len(angles)))
    nearest = [int(np.argmin(apart(angles, wanted))) for wanted in DEFAULT_BEAMS_DEG]
    return list(dict.fromkeys(nearest))


def nearest_beams(
    angles: FloatArray, beams_deg: Sequence[float], beams: str = "the log's beams"
) -> list[int]:
    """Indices of the angles (n,), deg, nearest to the given directions, deg. Raises a ValueError if
    no direction is given, no beam lies within 1 degree of a direction, or one beam is nearest to
    two directions.
    """
    if not len(beams_deg):
        raise ValueError("at least one beam must be chosen")
    chosen: dict[int, float] = {}
    for wanted in beams_deg:
        if not math.isfinite(wanted):
            raise ValueError(f"a beam angle must be a finite number, not {wanted}")
        off = apart(angles, wanted)
        index = int(np.argmin(off))
        if off[index] > WORST_BEAM_MISMATCH_DEG + 1e-9:
            known = ", ".join(f"{angle:g}" for angle in np.sort(np.round(angles, 1)))
            few = len(angles) <= SPARSE_BEAMS
            there = f"at {known}" if few else f"from {angles.min():g} to {angles.max():g}"
            raise ValueError(
                f"no beam within {WORST_BEAM_MISMATCH_DEG:g} deg of {wanted:g} deg: {beams} "
                f"are {there} deg"
            )
        if index in chosen:
            # A reading that is used twice would count as two measurements.
            raise ValueError(
                f"{chosen[index]:g} deg and {wanted:g} deg are the same beam, at "
                f"{angles[index]:g} deg"
            )
        chosen[index] = wanted
    return list(chosen)


def pose_log(
    beams: Sequence[SensorSpec],
    time: FloatArray,
    odometry: FloatArray,
    robot: RobotSpec | None = None,
    notes: Sequence[str] = (),
    **fields: Any,
) -> RecordedLog:
    """The log of a robot that recorded poses. Its arrays, the notes and all other fields are as in
    a :class:`RecordedLog`.

    The headings of ``odometry`` may include full turns. Single poses that are off the path are
    replaced. Of a robot that is not described only a radius of 0.2 m is assumed. The frame of the
    estimate is the robot's first pose, because the origin of odometry is arbitrary. Raises a
    ValueError if a number is not finite, or the odometry jumps or has impossible coordinates.
    """
    is_far = np.any(np.abs(odometry) > FARTHEST, axis=1)
    if is_far.any():
        row = int(np.argmax(is_far))
        raise ValueError(
            f"the odometry in row {row} is not a pose: {', '.join(f'{v:g}' for v in odometry[row])}"
        )
    body = robot or RobotSpec(radius=BODY_RADIUS)
    robot = replace(body, control_period=median_spacing(time), beams=tuple(beams))
    odometry = np.column_stack((odometry[:, :2], se2.wrap_angle(odometry[:, 2])))
    odometry, replaced = without_excursions(time, odometry)
    return RecordedLog(robot, time, odometry=odometry, notes=(*notes, *replaced), **fields)


def check_max_range(max_range: float) -> None:
    """Raise a ValueError if a largest range is not a length above ``MIN_RANGE`` and up to
    ``LARGEST_RANGE``.
    """
    if not (math.isfinite(max_range) and max_range > MIN_RANGE):
        raise ValueError(f"the largest range must be above {MIN_RANGE} m, not {max_range}")
    if max_range > LARGEST_RANGE:
        raise ValueError(
            f"the largest range is at most {LARGEST_RANGE:g} m, not {max_range:g}: is it in metres?"
        )


def median_spacing(time: FloatArray) -> float:
    """Median time between two events, s. The default control period for a log that is too short."""
    steps = np.diff(time)
    steps = steps[steps > 0.0]
    return float(np.median(steps)) if len(steps) else RobotSpec().control_period
