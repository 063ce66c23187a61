"""Checks of claims about the course of laps."""

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from benchmarks.analysis.claim_checks import (
    CONFIRMED,
    PARTLY,
    UNDECIDED,
    UNTRIED,
    Check,
    Finding,
    Measured,
    Results,
    sign,
    signed,
)
from benchmarks.analysis.groups import centimetres
from benchmarks.analysis.statistics import Estimate, median
from limslam_env.geometry import FloatArray

Run: TypeAlias = tuple[FloatArray, FloatArray]
"""Errors (laps, 3) of a run in each lap: by odometry alone, and with the filter."""


def error_is_stable(component: int) -> Check:
    """Growth of an error from the first lap to the last, without the filter and with it."""
    scale, unit = ((1.0, "m"), (1.0, "m"), (math.degrees(1.0), "deg"))[component]

    def at(runs: list[Run]) -> Measured:
        without, with_it = (
            median([scale * float(run[which][-1, component] - run[which][0, component]) for run in runs])
            for which in (0, 1)
        )
        if without is None or with_it is None or without.low is None or with_it.low is None:
            return UNTRIED, ""
        outcome = sign(_less(runs, component), falls=True)
        if outcome == CONFIRMED and without.low <= 0.0:
            outcome = UNDECIDED
        elif outcome == CONFIRMED and with_it.low > 0.0:
            outcome = PARTLY
        return outcome, f"without {signed(without)}, with {signed(with_it)}"

    def check(results: Results) -> Finding:
        words = f"growth from the first lap to the last, {unit} (asked: some without, none to be seen with the EKF)"
        return _over_noises(results, at, words)

    return check


def gain_grows(results: Results) -> Finding:
    """Odometry's position error minus the filter's position error: the last lap compared with the first lap."""

    def at(runs: list[Run]) -> Measured:
        gains = [np.hypot(*odometry[:, :2].T) - np.hypot(*filtered[:, :2].T) for odometry, filtered in runs]
        found = median([float(gain[-1] - gain[0]) for gain in gains])
        return (UNTRIED, "") if found is None else (sign(found), signed(found))

    return _over_noises(results, at, "gain in position in the last lap minus that in the first, m")


def _over_noises(results: Results, at: Callable[[list[Run]], Measured], words: str) -> Finding:
    """Combine one check at each noise of the laps: confirmed if confirmed at all noises, partly if at some."""
    found = {noise: (len(runs), *at(runs)) for noise, runs in results.lap_errors.items()}
    tried = {noise: each for noise, each in found.items() if each[1] != UNTRIED}
    if not tried:
        return Finding(UNTRIED, "needs the series of six runs of two laps or more")
    outcomes = {outcome for _, outcome, _ in tried.values()}
    outcome = outcomes.pop() if len(outcomes) == 1 else PARTLY
    parts = (f"{centimetres(noise)} (n = {count}): {evidence}" for noise, (count, _, evidence) in tried.items())
    return Finding(outcome, f"{words}: {'; '.join(parts)}")


def _less(runs: list[Run], component: int) -> Estimate:
    """Difference between the error growth without the filter and with the filter, run by run."""
    growth = [filtered[-1] - filtered[0] - (odometry[-1] - odometry[0]) for odometry, filtered in runs]
    found = median([float(each[component]) for each in growth])
    assert found is not None  # noqa: S101 - the caller has runs
    return found
