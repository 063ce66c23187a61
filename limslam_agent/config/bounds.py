"""Bounds of settings: the annotation of a field says which numbers it may hold, and a base class
checks them.
"""

import functools
import math
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Annotated, Any, Self, get_type_hints


@dataclass(frozen=True)
class Bounds:
    """The least and the greatest number that a setting may be.

    Attributes
    ----------
    low, high
        Both are allowed themselves.
    is_whole
        Whether the number must be a whole one.
    """

    low: float
    high: float
    is_whole: bool = False

    def check(self, name: str, value: Any) -> None:
        """Raise a ValueError, which begins with the setting's name, if a number is out of bounds or
        not a number.
        """
        is_number = isinstance(value, Integral if self.is_whole else Real)
        if isinstance(value, bool) or not is_number or not self.low <= value <= self.high:
            # The command line imports this module, but not the simulator.
            from limslam_env.messages import described

            kind = "whole number" if self.is_whole else "number"
            limits = f"{self.low:g} to {self.high:g}"
            raise ValueError(f"{name} must be a {kind} from {limits}, not {described(value)}")


Number = Annotated[float, Bounds(-1e6, 1e6)]
"""Any number of a sensible size."""
NonNegative = Annotated[float, Bounds(0.0, 1e6)]
"""A length (m), a speed (m/s), a gate or a number of standard deviations: 0 or more."""
Positive = Annotated[float, Bounds(1e-6, 1e6)]
"""The same, but above 0: a bin or a cell of no size cannot be computed with."""
Angle = Annotated[float, Bounds(0.0, 2.0 * math.pi)]
"""An angle without a sign, rad."""
Count = Annotated[int, Bounds(1, 10**6, is_whole=True)]
"""How many: 1 or more."""
CountOrNone = Annotated[int, Bounds(0, 10**6, is_whole=True)]
"""How many: 0 or more."""


class Bounded:
    """Base of frozen dataclasses whose annotations say the bounds of their numbers."""

    def __post_init__(self) -> None:
        for name, bounds in bounds_of(type(self)):  # type: ignore[arg-type] # mypy takes a class for its object
            bounds.check(name, getattr(self, name))

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # Settings never change, so that copies can share them.
        return self


@functools.cache
def bounds_of(kind: type[Any]) -> tuple[tuple[str, Bounds], ...]:
    """The fields of a class that have bounds, and their bounds."""
    hints = get_type_hints(kind, include_extras=True)
    found = (
        (name, extra) for name, hint in hints.items() for extra in getattr(hint, "__metadata__", ())
    )
    return tuple((name, extra) for name, extra in found if isinstance(extra, Bounds))
