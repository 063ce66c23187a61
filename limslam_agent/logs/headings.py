"""Headings beside wheels: in which unit and which way they turn as the wheels do."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from limslam_agent.logs.recorded_log import RecordedLog
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import wrap_angle

_LEAST_TURNED = 1.0  # rad by the wheels, below which nothing can be said about another heading
_LARGEST_STEP = 1.0  # rad by the wheels between two headings that are compared
FULL_TURN = 6.6
"""Headings in radians that lie farther apart than this are not wrapped, rad."""

# A heading follows the wheels if it turns by their turn within this factor, and correlates. Slip
# and a wrong axle explain the factor.
_LARGEST_FACTOR = 2.5
_LEAST_CORRELATION = 0.5
# rad: by the wheels, after which a heading that was measured differs from them by more than this,
# which is more than headings are rounded by
_TURNED_TO_DIFFER = 20.0
_NO_DIFFERENCE = 0.03


class Heading(NamedTuple):
    """A heading beside wheels (n,), rad, counter-clockwise as the wheels turn, NaN where it has no
    reading, or None if it does not follow them; the unit in which it was read; and what was found,
    in words.
    """

    yaw: FloatArray | None
    unit: str
    notes: tuple[str, ...]


def heading_beside_wheels(
    choices: Mapping[str, FloatArray], turns: FloatArray, name: str, remedy: str = ""
) -> Heading:
    """The heading that follows the turns (n,) by the wheels, rad, since the row before.

    Parameters
    ----------
    choices
        The heading (n,), rad, by the unit in which it was read.
    turns
        As above.
    name
        What the log calls the heading.
    remedy
        What says that it counts clockwise.
    """
    unit, factor = _best(choices, turns)
    if unit is None:
        note = (
            f"the heading in {name} does not follow the turns by the wheels, and is left out: it "
            "may be in another unit, or not work"
        )
        return Heading(None, "", (note,))
    if _is_sum(choices[unit], turns):
        note = (
            f"the heading in {name} is left out: it never differs from that of the wheels, so it "
            "was calculated from them"
        )
        return Heading(None, unit, (note,))
    notes: tuple[str, ...] = ()
    if factor < 0.0:
        note = f"the heading in {name} counts against the turns by the wheels, and is read the "
        notes = (f"{note}other way: it counts clockwise{remedy}, or left and right are exchanged",)
    yaw = np.copysign(1.0, factor) * choices[unit]
    return Heading(np.where(np.isfinite(yaw), wrap_angle(yaw), np.nan), unit, notes)


def with_heading_beside_wheels(log: RecordedLog) -> RecordedLog:
    """The log with its heading as :func:`heading_beside_wheels` reads it."""
    if log.yaw is None or log.wheels is None:
        return log
    turns = np.diff(log.wheels, axis=1)[:, 0] / log.robot.axle
    found = heading_beside_wheels({"rad": log.yaw}, turns, "yaw")
    return replace(log, ranges=log.reported, yaw=found.yaw, notes=(*log.notes, *found.notes))


def _best(choices: Mapping[str, FloatArray], turns: FloatArray) -> tuple[str | None, float]:
    """The unit in which a heading follows the turns (n,) by the wheels, rad, and by which factor.
    None if there is none.
    """
    if np.abs(turns).sum() < _LEAST_TURNED:
        first, *others = choices
        is_wide = bool(others) and float(np.ptp(np.nan_to_num(choices[first]))) > FULL_TURN
        return (others[0] if is_wide else first), 1.0
    best = None
    factor = 1.0
    correlation = _LEAST_CORRELATION
    by_wheels = np.cumsum(turns)
    for unit, heading in choices.items():
        is_there = np.isfinite(heading)
        expected = np.diff(by_wheels[is_there])
        is_small = np.abs(expected) < _LARGEST_STEP
        expected = expected[is_small]
        turned = wrap_angle(np.diff(heading[is_there]))[is_small]
        together = float(turned @ expected)
        slope = together / max(float(expected @ expected), 1e-12)
        found = abs(together) / max(float(np.linalg.norm(turned) * np.linalg.norm(expected)), 1e-12)
        if found >= correlation and 1.0 / _LARGEST_FACTOR <= abs(slope) <= _LARGEST_FACTOR:
            best = unit
            factor = slope
            correlation = found
    return best, factor


def _is_sum(heading: FloatArray, turns: FloatArray) -> bool:
    """Whether a heading (n,), rad, is the sum of the turns (n,) by the wheels, rad, in either
    direction. A measured one differs from it after some turns, by slip if by nothing else.
    """
    rows = np.flatnonzero(np.isfinite(heading))
    by_wheels = np.cumsum(turns)[rows]
    if not len(rows) or np.abs(np.diff(by_wheels)).sum() < _TURNED_TO_DIFFER:
        return False
    turned = np.cumsum(wrap_angle(np.diff(heading[rows], prepend=heading[rows[:1]])))
    differences = np.array([turned - by_wheels, turned + by_wheels])
    return bool(np.ptp(differences, axis=1).min() < _NO_DIFFERENCE)
