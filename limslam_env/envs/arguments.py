"""The arguments of environments and batches, and their checks, which name what is wrong."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, TypeAlias, TypeVar

import numpy as np

from limslam_env.config import NoiseConfig, RewardConfig
from limslam_env.geometry.numbers import check_count, index_of, plain
from limslam_env.interface import RobotSpec
from limslam_env.messages import described, one_line
from limslam_env.worlds.formats.loading import WorldSource, load_world
from limslam_env.worlds.formats.tables import keyed_world
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig
from limslam_env.worlds.world import World

PlaceSource: TypeAlias = WorldSource | FloorPlanConfig | Mapping[str, Any]
"""A world, its name, its file or its table; or settings of random floor plans or their table, or
``"random"`` for the default settings.
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

Kind = TypeVar("Kind", RobotSpec, NoiseConfig, RewardConfig, FloorPlanConfig)


def given(name: str, value: Any, kind: type[Kind]) -> Kind:
    """An argument or a table of its settings, or what ``kind`` is by default for None; a ValueError
    where it is of another kind.
    """
    if value is None:
        return kind()
    if isinstance(value, Mapping):
        known = [part.name for part in fields(kind)]
        for key in value:
            if key not in known:
                raise ValueError(
                    f"{name} has no setting {described(key)}; there are {', '.join(known)}"
                )
        try:
            return kind(**value)
        except TypeError as error:
            raise ValueError(one_line(f"{name}: {error}")) from error
    if isinstance(value, kind):
        return value
    example = f"{kind.__name__}({fields(kind)[0].name}=...)"
    raise ValueError(
        one_line(f"{name} must be a {kind.__name__}, such as {example}, not {described(value)}")
    )


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


def place_of(source: PlaceSource | None) -> World | FloorPlanConfig:
    """The world, or what floor plans are drawn by; a ValueError where there is neither."""
    if source is None:
        raise ValueError(
            "a world is needed: world= takes a name ('env1', 'random:17', 'random'), a file, a "
            "World or a FloorPlanConfig"
        )
    if isinstance(source, FloorPlanConfig):
        return source
    if isinstance(source, Mapping):
        if "walls" not in source:
            return given("world", source, FloorPlanConfig)
        # What the reader of a file has noted is no part of a world.
        return keyed_world(plain({key: source[key] for key in source if key != "notes"}))
    return FloorPlanConfig() if source == "random" else load_world(source)


def worlds_of(source: BatchSource, num_envs: int) -> World | list[World] | FloorPlanConfig:
    """The world of all environments or of each, or what floor plans are drawn by; a ValueError if
    they do not fit.
    """
    if isinstance(source, Sequence) and not isinstance(source, str):
        if len(source) != num_envs:
            raise ValueError(
                f"{len(source)} worlds for {num_envs} environments; give one for each, or one for "
                "all"
            )
        places = [place_of(place) if isinstance(place, Mapping) else place for place in source]
        # A file that stands for many environments is read once.
        loaded = {place: place_of(place) for place in dict.fromkeys(places)}
        worlds = [world for place in places if isinstance(world := loaded[place], World)]
        if len(worlds) < num_envs:
            raise ValueError("floor plans are drawn for all environments or for none")
        return worlds
    return place_of(source)


def seeds_of(plans: Plans, source: World | list[World] | FloorPlanConfig) -> Sequence[int] | None:
    """The seeds of the floor plans that are made beforehand; a ValueError where there can be
    none.
    """
    if plans is None:
        return None
    if not isinstance(source, FloorPlanConfig):
        raise ValueError("plans are for worlds that are drawn")  # noqa: TRY004 (all are ValueErrors)
    if not isinstance(plans, Sequence):
        return range(check_count("plans", plans, MOST_PLANS))
    found = [seed for seed in map(index_of, plans[: MOST_PLANS + 1]) if seed is not None]
    if not 1 <= len(found) == len(plans) <= MOST_PLANS or min(found) < 0:
        raise ValueError(
            f"plans must be up to {MOST_PLANS} seeds of 0 and more, not {described(plans)}"
        )
    return found


def listed_seeds(seeds: Any, num_envs: int) -> list[int | None]:
    """The seed of each environment, None where any will do; a ValueError where they are none."""
    listed = list(seeds) if isinstance(seeds, Sequence | np.ndarray) else [seeds]
    found = [index_of(seed) for seed in listed]
    is_wrong = any(
        seed is not None and (number is None or number < 0)
        for seed, number in zip(listed, found, strict=True)
    )
    if is_wrong or len(found) != num_envs:
        raise ValueError(
            f"a seed is a whole number, 0 or more, or a list of {num_envs} of them, not "
            f"{described(seeds)}"
        )
    return found
