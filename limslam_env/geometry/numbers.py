"""Which numbers are computed with. Numbers that are merely finite overflow the whole numbers and
the tables of compiled code.
"""

import operator
import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from numbers import Real
from typing import Any

import numpy as np

from limslam_env.geometry.arrays import FloatArray
from limslam_env.messages import described

LARGEST_COORDINATE = 1e7
"""Largest coordinate of a pose, m, and largest heading, rad. The coordinates of map grids fit in,
and a double still divides a millimetre there.
"""


def is_number(value: object) -> bool:
    """Whether a value is one real number. A truth value is none."""
    return isinstance(value, Real) and not isinstance(value, bool)


def floats(values: Any) -> FloatArray:
    """Real numbers as an array of floats of their shape. An empty array where they are none:
    complex numbers, truth values, texts, rows of unequal length, whole numbers of any size.
    """
    try:
        array = np.asarray(values)
    except ValueError:  # rows of unequal length
        return np.zeros(0)
    return array.astype(np.float64) if array.dtype.kind in "fiu" else np.zeros(0)


def plain(value: Any) -> Any:
    """A value as JSON holds it: numbers and arrays of numpy, settings and worlds, paths and
    sequences become plain numbers, tables, texts and lists.
    """
    if is_dataclass(value):
        return {part.name: plain(getattr(value, part.name)) for part in fields(value)}
    if isinstance(value, Mapping):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return [plain(each) for each in value]
    if isinstance(value, Enum):
        return value.value
    return os.fspath(value) if isinstance(value, os.PathLike) else value


def check_number(what: str, value: Any, low: float, high: float, unit: str = "") -> None:
    """Refuse what is not a number from ``low`` to ``high``.

    Raises
    ------
    ValueError
        The message begins with ``what``, and has the limits with their unit.
    """
    if not (is_number(value) and low <= value <= high):
        limits = f"{low:g} to {high:g} {unit}".rstrip()
        asked = f": is it in {unit}?" if unit and is_number(value) else ""
        raise ValueError(f"{what} must be a number from {limits}, not {described(value)}{asked}")


def index_of(value: Any) -> int | None:
    """A whole number; None for anything else, truth values among it."""
    try:
        return None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        return None


def check_count(what: str, value: Any, high: int, *, least: int = 1) -> int:
    """A whole number from ``least`` to ``high``. Raises a ValueError as :func:`check_number`
    does.
    """
    number = index_of(value)
    if number is None or not least <= number <= high:
        raise ValueError(
            f"{what} must be a whole number from {least} to {high}, not {described(value)}"
        )
    return number


def check_poses(what: str, poses: FloatArray) -> None:
    """Refuse poses (..., 3), m, m, rad, or other coordinates, that are not finite or too large.

    Raises
    ------
    ValueError
        The message begins with ``what``, and has the limit and the first such number.
    """
    bad = ~(np.abs(poses) <= LARGEST_COORDINATE)
    if bad.any():
        raise ValueError(
            f"{what} must be finite, and at most {LARGEST_COORDINATE:g} m or rad, not "
            f"{poses[bad].flat[0]:g}"
        )
