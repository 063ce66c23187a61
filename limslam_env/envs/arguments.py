"""The arguments of batches, resolved to one value per environment, and their checks."""

import operator
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from limslam_env.config import NoiseConfig, Setting
from limslam_env.envs.adapter import PlaceSource, is_random
from limslam_env.envs.argument_types import check_noise
from limslam_env.geometry import FloatArray
from limslam_env.messages import described
from limslam_env.worlds.formats.loading import load_world
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig
from limslam_env.worlds.world import World

BatchSource: TypeAlias = PlaceSource | Sequence[PlaceSource]
"""What a single environment takes, or a sequence of worlds, one for each environment."""

Plans: TypeAlias = int | Sequence[int] | None
"""The number or the seeds of floor plans that are generated once; None for new floor plans at each reset."""

NoiseSource: TypeAlias = NoiseConfig | Sequence[NoiseConfig] | None
"""The noise of all environments, or of each of them."""

SensorNoise: TypeAlias = Setting | Sequence[Setting] | FloatArray | None
"""A number or a range for all environments, or for each of them; None for what the noise says."""


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
        loaded: dict[Any, World] = {}
        for place in source:
            if place not in loaded:
                loaded[place] = load_world(place)  # type: ignore[arg-type]
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
    number = _index(plans)
    seeds: list[int | None] = []
    if number is not None:
        seeds = list(range(number))
    elif _is_several(plans):
        seeds = [_index(seed) for seed in plans]  # type: ignore[union-attr]
    found = [seed for seed in seeds if seed is not None and seed >= 0]
    if not found or len(found) < len(seeds):
        raise ValueError(f"plans must be 1 or more, or seeds of 0 and more, whole numbers, not {described(plans)}")
    return found


def noise_of_each(noise: NoiseSource, sensor_noise: SensorNoise, num_envs: int) -> list[NoiseConfig]:
    """The noise of each environment, or of all.

    Raises
    ------
    ValueError
        If there is not one for each, or it is no noise.
    """
    each: list[Any] = [NoiseConfig()] if noise is None else [noise]
    if _is_several(noise):
        each = list(noise)  # type: ignore[arg-type]
    for one in each:
        check_noise(one, ", or one for each environment")
    if len(each) not in {1, num_envs}:
        raise ValueError(f"{len(each)} noise settings for {num_envs} environments")
    if sensor_noise is None:
        return each
    is_range = isinstance(sensor_noise, tuple) and len(sensor_noise) == 2 and not any(map(_is_several, sensor_noise))
    if is_range or not _is_several(sensor_noise):
        setting = _setting(sensor_noise)
        return [replace(one, sensor_noise=setting) for one in each]
    settings = [_setting(value) for value in sensor_noise]  # type: ignore[union-attr]
    if len(settings) != num_envs:
        raise ValueError(
            f"{len(settings)} values of sensor_noise for {num_envs} environments; "
            "give a number or a range (low, high) for all, or one for each"
        )
    each = each * num_envs if len(each) == 1 else each
    return [replace(one, sensor_noise=setting) for one, setting in zip(each, settings, strict=True)]


def _index(value: Any) -> int | None:
    """A whole number; None for anything else, truth values among it."""
    if isinstance(value, bool | np.bool_):
        return None
    try:
        return operator.index(value)
    except TypeError:
        return None


def _is_several(value: Any) -> bool:
    """Whether it is a sequence or an array of things."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def _setting(value: Any) -> Setting:
    try:
        numbers = np.asarray(value)
    except ValueError:
        numbers = np.zeros(0)
    if numbers.shape not in {(), (2,)} or numbers.dtype.kind not in "iuf":
        raise ValueError(f"sensor_noise must be a number or a range (low, high), not {described(value)}")
    return float(numbers) if numbers.ndim == 0 else (float(numbers[0]), float(numbers[1]))
