"""How fast candidates are beside each other: in short bursts that take turns.

A shared machine changes its speed from second to second. A burst of each candidate makes a round, ratios are taken
within a round, and the median of the rounds counts.
"""

import time
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from limslam_env.geometry import FloatArray

Loop: TypeAlias = Callable[[], int]
"""Does some steps, and returns how many."""

SECONDS = 0.02
"""Length of a burst."""

Clock: TypeAlias = Callable[[], float]


def rates_in_turn(candidates: dict[str, Loop], rounds: int, clock: Clock = time.perf_counter) -> dict[str, FloatArray]:
    """Steps a second of each candidate in each round (rounds,)."""
    found: dict[str, list[float]] = {name: [] for name in candidates}
    for loop in candidates.values():
        loop()
    for _ in range(rounds):
        for name, loop in candidates.items():
            begin, done = clock(), 0
            while clock() - begin < SECONDS:
                done += loop()
            found[name].append(done / (clock() - begin))
    return {name: np.array(rates) for name, rates in found.items()}


def ratio(rates: dict[str, FloatArray], one: str, other: str) -> float:
    """How many times as fast one candidate is as another: the median over the rounds."""
    return float(np.median(rates[one] / rates[other]))


def print_rates(rates: dict[str, FloatArray], references: dict[str, str]) -> None:
    """Print a table of the rates, and of their ratios to some candidates, which have short names in the heading."""
    print("| candidate | steps/s |" + "".join(f" x {short} |" for short in references.values()))
    print("|---" * (2 + len(references)) + "|")
    for name, each in rates.items():
        ratios = "".join(f" {ratio(rates, name, reference):.3g} |" for reference in references)
        print(f"| {name} | {np.median(each):,.0f} |{ratios}")
