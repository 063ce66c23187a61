"""The arguments of environments and batches, and their checks, which name what is wrong."""

import operator
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, TypeAlias, TypeGuard, TypeVar

from limslam_env.config import NoiseConfig, RewardConfig
from limslam_env.interface import RobotSpec
from limslam_env.messages import described, one_line
from limslam_env.worlds.formats.loading import WorldSource, load_world
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig
from limslam_env.worlds.world import World

PlaceSource: TypeAlias = WorldSource | FloorPlanConfig
"""A world, its name or its file; or settings of random floor plans, or ``"random"`` for the default
settings.
"""

BatchSource: TypeAlias = PlaceSource | Sequence[PlaceSource]
"""What a single environment takes, or a sequence of worlds, one for each environment."""

Plans: TypeAlias = int | Sequence[int] | None
"""The number or the seeds of floor plans that are generated once; None for new floor plans at each
reset.
"""

MAX_ROBOTS = 8

MOST_ENVS = 1 << 22
"""Most environments of a batch."""

MOST_STEPS = 10**9
"""Most steps of an episode that has a limit."""

MOST_THREADS = 1024

MOST_PLANS = 100_000
"""Most floor plans that are made beforehand."""

Kind = TypeVar("Kind", RobotSpec, NoiseConfig, RewardConfig)


def given(name: str, value: Any, kind: type[Kind]) -> Kind:
    """An argument, or what ``kind`` is by default for None; a ValueError where it is of another
    kind.
    """
    if value is None:
        return kind()
    if isinstance(value, kind):
        return value
    example = f"{kind.__name__}({fields(kind)[0].name}=...)"
    raise ValueError(
        one_line(f"{name} must be a {kind.__name__}, such as {example}, not {described(value)}")
    )


def whole(name: str, value: Any, most: int, otherwise: str = "") -> int:
    """A whole number from 1 to ``most``; a ValueError otherwise, which adds the alternatives that
    ``otherwise`` names.
    """
    number = _index(value)
    if number is None or not 1 <= number <= most:
        limit = "1 or more" if number is None or number < 1 else f"{most} or less"
        raise ValueError(
            f"{name} must be a whole number, {limit}{otherwise}, not {described(value)}"
        )
    return number


def check_robots(num_robots: Any) -> None:
    """Refuse a number of robots that is not a whole number from 1 to 8, with a ValueError."""
    if _index(num_robots) not in range(1, MAX_ROBOTS + 1):
        raise ValueError(f"there can be 1 to {MAX_ROBOTS} robots, not {described(num_robots)}")


def reset_options(options: Any, *known: str) -> Mapping[str, Any]:
    """The options of a reset; a ValueError where they are no dictionary, or one of them is not
    ``known``.
    """
    if not (options is None or isinstance(options, Mapping)):
        raise ValueError(f"reset options are a dictionary, not {described(options)}")
    unknown = sorted(map(str, set(options or {}) - set(known)))
    if unknown:
        raise ValueError(
            f"unknown reset option {unknown[0]!r}; there are {' and '.join(map(repr, known))}"
        )
    return options or {}


def is_random(source: object) -> TypeGuard[str]:
    """Whether a world is to be drawn by the default settings."""
    return isinstance(source, str) and source == "random"


def worlds_of(source: BatchSource, num_envs: int) -> World | list[World] | FloorPlanConfig:
    """The world of all environments or of each, or what floor plans are drawn by; a ValueError if
    they do not fit.
    """
    if isinstance(source, FloorPlanConfig):
        return source
    if isinstance(source, Sequence) and not isinstance(source, str):
        if len(source) != num_envs:
            raise ValueError(
                f"{len(source)} worlds for {num_envs} environments; give one for each, or one for "
                "all"
            )
        if any(isinstance(place, FloorPlanConfig) or is_random(place) for place in source):
            raise ValueError("floor plans are drawn for all environments or for none")
        loaded = {place: load_world(place) for place in dict.fromkeys(source)}  # type: ignore[arg-type]
        return [loaded[place] for place in source]
    return FloorPlanConfig() if is_random(source) else load_world(source)


def seeds_of(plans: Plans, source: BatchSource) -> Sequence[int] | None:
    """The seeds of the floor plans that are made beforehand; a ValueError where there can be
    none.
    """
    if plans is None:
        return None
    if not (isinstance(source, FloorPlanConfig) or is_random(source)):
        raise ValueError("plans are for worlds that are drawn")
    seeds = plans if isinstance(plans, Sequence) else range(min(_index(plans) or 0, MOST_PLANS + 1))
    known = map(_index, seeds if len(seeds) <= MOST_PLANS else ())
    found = [seed for seed in known if seed is not None and seed >= 0]
    if not found or len(found) < len(seeds):
        raise ValueError(
            "plans must be 1 or more, or seeds of 0 and more, whole numbers, and at most "
            f"{MOST_PLANS} plans, not {described(plans)}"
        )
    return found


def _index(value: Any) -> int | None:
    """A whole number; None for anything else, truth values among it."""
    try:
        return None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        return None
