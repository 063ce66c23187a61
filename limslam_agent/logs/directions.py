"""Finds the direction of a sensor from its name."""

import math
import re

import numpy as np
from numpy.typing import ArrayLike

from limslam_env.geometry import FloatArray


def words_in(text: str) -> frozenset[str]:
    """The words of a text between its spaces."""
    return frozenset(text.split())


_WAYS = {
    0.0: "front ahead forward fwd f",
    90.0: "left l",
    180.0: "back rear behind backward b",
    -90.0: "right r",
    45.0: "fl lf",
    -45.0: "fr rf",
    135.0: "bl rl",
    -135.0: "br rr",
}
_TOWARDS = {word: degrees for degrees, words in _WAYS.items() for word in words_in(words)}
_VERTICAL = words_in("up down top bottom ground floor ceiling cliff height altitude zrange")
# A single letter is a direction only as the last word of a name: in "r_l", but not in "l_laser".
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+|\d+(?:\.\d+)?")
# In "beam30deg", "m30deg" does not say which sign was meant.
_SIGN = r"(?:([-+])|(?<![a-z0-9.])(m|minus_?|neg_?)|(?<![mgs0-9.]))"
_DEGREES = re.compile(_SIGN + r"(\d{1,3}(?:\.\d+)?)_?deg(?![a-z])", re.IGNORECASE)


def words_of(name: str) -> list[str]:
    """The words of a name such as ``/range/front_left`` or ``tofFrontLeft``, in lower case."""
    return [word.lower() for word in _WORD.findall(name)]


def direction_of(name: str) -> float | None:
    """Direction in a name, deg, left positive: ``front_left`` is 45, ``range_m30deg`` is -30. None
    if there is none.
    """
    number = _DEGREES.search(name)
    if number is not None:
        return -float(number[3]) if number[1] == "-" or number[2] else float(number[3])
    words = words_of(name)
    are_ways = [len(word) > 1 for word in words[:-1]] + [True]
    ways = {_TOWARDS.get(word) for word, is_way in zip(words, are_ways, strict=False) if is_way}
    angles = [math.radians(degrees) for degrees in ways if degrees is not None]
    x = sum(map(math.cos, angles))
    y = sum(map(math.sin, angles))
    # Opposite words cancel each other out.
    return round(math.degrees(math.atan2(y, x)), 6) if math.hypot(x, y) > 0.5 else None


def apart(angles: ArrayLike, wanted: float) -> FloatArray:
    """How far angles (n,) are from a wanted one, deg, from 0 to 180."""
    return np.asarray(np.abs((np.asarray(angles) - wanted + 180.0) % 360.0 - 180.0))


def degrees_of(text: str) -> float:
    """Direction that a text gives, deg, left positive: a number of degrees, or a word like
    ``left``. Raises a ValueError if it gives none, or is not within 360 deg.
    """
    try:
        degrees = float(text)
    except ValueError:
        named = direction_of(text)
        if named is None:
            raise ValueError(
                f"{text[:40]!r} is no direction: degrees, or a word like left"
            ) from None
        return named
    if not -360.0 <= degrees <= 360.0:
        raise ValueError(f"{text[:40]} is not within 360 deg")
    return degrees


def is_vertical(name: str) -> bool:
    """Whether a name describes a sensor that looks up or down, which is useless for a map of
    walls.
    """
    return bool(_VERTICAL & set(words_of(name)))
