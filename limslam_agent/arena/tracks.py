"""The plans that follow from a seed. Each has one setting of noise, robots and faults."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from limslam_agent.runs.run_spec import RunSpec
from limslam_env.config import NoiseConfig

VERSION = 1
"""Version of the plans and the scores. Results of different versions cannot be compared."""

PUBLIC_SEED = 0
"""Seed of the published plans. Judges choose a secret seed for plans that nobody has seen."""

COUNT = 100
"""Number of plans."""

MAX_TIME = 240.0
"""Longest simulated time of a plan, s."""

_NOISES = (0.0, 0.02, 0.04)
_FAULTS = ("none",) * 11 + ("wheels",) * 3 + ("sharp",) * 3 + ("dropout",) * 3
_ROBOTS = (1,) * 7 + (2,) * 3
_SIDES_DM = (50, 71)  # sides of a building, dm; the upper end is excluded
_FLOOR_PLANS = (10**9, 2 * 10**9)  # seeds that no suite and no training of this project uses
_WHEELS = 0.02
_DROPOUT = 0.1
_LEAST_SHARP_NOISE = 0.02


_SETTING = (
    "number",
    "world",
    "noise",
    "robots",
    "fault",
    "wheel_mismatch",
    "seed",
    "max_time",
)


@dataclass(frozen=True)
class Plan(RunSpec):
    """One task: a run, its place in the list, from 0, and the fault of its robots.

    The entry is told the standard deviation of the ranges, ``noise``, m. It is not told the fault:
    ``none``, ``wheels`` (the left encoder reports too much by the share ``wheel_mismatch``, and the
    right one too little), ``sharp`` (triangulating infrared sensors) or ``dropout`` (beams that see
    nothing now and then). ``seed`` is that of starts and noise.
    """

    max_time: float = MAX_TIME
    until: str = "seen"
    number: int = 0
    fault: str = "none"
    wheel_mismatch: float = 0.0

    @property
    def true_noise(self) -> NoiseConfig:
        """The noise of the simulator besides the standard deviation of the ranges."""
        if self.fault == "sharp":
            return NoiseConfig.sharp()
        dropout = _DROPOUT if self.fault == "dropout" else 0.0
        return NoiseConfig(dropout=dropout, wheel_mismatch=self.wheel_mismatch)

    @property
    def setting(self) -> dict[str, Any]:
        """The plan as a table."""
        return {name: getattr(self, name) for name in _SETTING}


def plans_of(seed: int = PUBLIC_SEED) -> list[Plan]:
    """The plans of a seed of 0 or more. The same seed gives the same plans."""
    generator = np.random.default_rng([VERSION, 0, seed])

    def spread(values: tuple[Any, ...]) -> list[Any]:
        """The values in their shares of the plans, in a random order."""
        return [values[index % len(values)] for index in generator.permutation(COUNT)]

    worlds = generator.integers(*_FLOOR_PLANS, COUNT)
    sides = generator.integers(*_SIDES_DM, (COUNT, 2)) / 10.0
    noises = spread(_NOISES)
    faults = spread(_FAULTS)
    robots = spread(_ROBOTS)
    signs = generator.choice((-1.0, 1.0), COUNT)
    seeds = generator.integers(0, 10**6, COUNT)
    return [
        Plan(
            f"random:{worlds[number]}:{sides[number, 0]:g}x{sides[number, 1]:g}",
            max(noises[number], _LEAST_SHARP_NOISE if faults[number] == "sharp" else 0.0),
            seed=int(seeds[number]),
            robots=robots[number],
            number=number,
            fault=faults[number],
            wheel_mismatch=float(signs[number]) * _WHEELS if faults[number] == "wheels" else 0.0,
        )
        for number in range(COUNT)
    ]
