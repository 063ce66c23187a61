"""The arguments of environments and batches, and their checks, which name what is wrong."""

import operator
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, TypeAlias, TypeGuard, TypeVar

from limslam_env.config import NoiseConfig, RewardConfig, Setting, bounds_of
from limslam_env.interface import NominalNoise, RobotSpec
from limslam_env.messages import described, one_line
from limslam_env.worlds.formats.loading import WorldSource, load_world
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig
from limslam_env.worlds.world import World

PlaceSource: TypeAlias = WorldSource | FloorPlanConfig
"""A world, its name or its file; or settings of random floor plans, or ``"random"`` for the default settings."""

BatchSource: TypeAlias = PlaceSource | Sequence[PlaceSource]
"""What a single environment takes, or a sequence of worlds, one for each environment."""

Plans: TypeAlias = int | Sequence[int] | None
"""The number or the seeds of floor plans that are generated once; None for new floor plans at each reset."""

MAX_ROBOTS = 8

Kind = TypeVar("Kind", RobotSpec, NoiseConfig, RewardConfig)


def given(name: str, value: Any, kind: type[Kind]) -> Kind:
    """An argument, or what ``kind`` is by default for None.

    Raises
    ------
    ValueError
        If the argument is of another kind.
    """
    if value is None:
        return kind()
    if isinstance(value, kind):
        return value
    example = f"{kind.__name__}({fields(kind)[0].name}=...)"
    raise ValueError(one_line(f"{name} must be a {kind.__name__}, such as {example}, not {described(value)}"))


def noise_of(noise: NoiseConfig | None, sensor_noise: Setting | None) -> NoiseConfig:
    """The noise of an environment; ``sensor_noise`` comes before that of ``noise``.

    Raises
    ------
    ValueError
        If one of them cannot be used.
    """
    told = given("noise", noise, NoiseConfig)
    return told if sensor_noise is None else replace(told, sensor_noise=sensor_noise)


def nominal_noise(noise: NoiseConfig) -> NominalNoise:
    """The noise that the robot's data sheets give, and that an agent may therefore know.

    Of a range of values it is the upper end. The variance of the wheels is never below that of ``NominalNoise()``,
    because no data sheet promises ideal wheels. Noise that a standard deviation cannot describe (dropouts, slip,
    unequal wheels and so on) is not part of it.
    """
    wheel_variance = max(bounds_of(noise.wheel_variance)[1], NominalNoise().wheel_variance)
    return NominalNoise(bounds_of(noise.sensor_noise)[1], wheel_variance)


def whole(name: str, value: Any, otherwise: str = "") -> int:
    """A whole number of at least 1; the error message adds ``otherwise``, which names the alternatives.

    Raises
    ------
    ValueError
        If it is something else.
    """
    number = _index(value)
    if number is None or number < 1:
        raise ValueError(f"{name} must be a whole number, 1 or more{otherwise}, not {described(value)}")
    return number


def check_robots(num_robots: Any) -> None:
    """Refuse a number of robots that is not a whole number from 1 to 8.

    Raises
    ------
    ValueError
        If it is something else.
    """
    if _index(num_robots) not in range(1, MAX_ROBOTS + 1):
        raise ValueError(f"there can be 1 to {MAX_ROBOTS} robots, not {described(num_robots)}")


def is_random(source: object) -> TypeGuard[str]:
    """Whether a world is to be drawn by the default settings."""
    return isinstance(source, str) and source == "random"


def worlds_of(source: BatchSource, num_envs: int) -> World | list[World] | FloorPlanConfig:
    """The world of all environments or of each, or what floor plans are drawn by.

    Raises
    ------
    ValueError
        If there is not a world for each, or floor plans are to be drawn for some only.
    """
    if isinstance(source, FloorPlanConfig):
        return source
    if isinstance(source, Sequence) and not isinstance(source, str):
        if len(source) != num_envs:
            raise ValueError(f"{len(source)} worlds for {num_envs} environments; give one for each, or one for all")
        if any(isinstance(place, FloorPlanConfig) or is_random(place) for place in source):
            raise ValueError("floor plans are drawn for all environments or for none")
        loaded = {place: load_world(place) for place in dict.fromkeys(source)}  # type: ignore[arg-type]
        return [loaded[place] for place in source]
    return FloorPlanConfig() if is_random(source) else load_world(source)


def seeds_of(plans: Plans, source: BatchSource) -> Sequence[int] | None:
    """The seeds of the floor plans that are made beforehand.

    Raises
    ------
    ValueError
        If worlds are not drawn, or these are no seeds.
    """
    if plans is None:
        return None
    if not (isinstance(source, FloorPlanConfig) or is_random(source)):
        raise ValueError("plans are for worlds that are drawn")
    seeds = plans if isinstance(plans, Sequence) else range(_index(plans) or 0)
    found = [seed for seed in map(_index, seeds) if seed is not None and seed >= 0]
    if not found or len(found) < len(seeds):
        raise ValueError(f"plans must be 1 or more, or seeds of 0 and more, whole numbers, not {described(plans)}")
    return found


def _index(value: Any) -> int | None:
    """A whole number; None for anything else, truth values among it."""
    try:
        return None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        return None
