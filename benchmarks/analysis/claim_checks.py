"""Checks of claims: functions that compute an outcome from the results of the published method."""

import math
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

import numpy as np

from benchmarks.analysis.groups import FRONTIER, PUBLISHED, Value, centimetres, metric, ratio
from benchmarks.analysis.series import lap_errors, read_series
from benchmarks.analysis.sheets import written
from benchmarks.analysis.statistics import ENOUGH, Comparison, Estimate, compare, median, share
from benchmarks.suite.jobs import LAPS_POLICY
from benchmarks.suite.store import Row
from limslam_env.geometry import FloatArray
from limslam_env.metrics.metrics import doors_open

CONFIRMED, PARTLY, REFUTED = "confirmed", "partly", "not confirmed"
UNDECIDED = "undecided"
"""The interval contains both answers, and more runs are needed to decide."""

UNTRIED = "not tried in these rows"
FAIR_F1 = 0.9
"""Least aligned F1 at which a map is called fairly correct."""

HALF = 0.6
"""Largest ratio to the time of one robot at which the time counts as halved."""

NARROW_GAP = 0.02
"""Least missing share of the walls at which parts are called missing."""


@dataclass(frozen=True)
class Finding:
    """The result of a check: one of the outcomes, and the numbers that support it."""

    outcome: str
    evidence: str


class Results:
    """The rows of the published method, and the folder of their series.

    Parameters
    ----------
    rows
        Rows of one folder of results.
    folder
        The folder of results; None if there is none.
    """

    def __init__(self, rows: Sequence[Row], folder: Path | None) -> None:
        self.folder = folder
        self._rows = [row for row in rows if row.preset == PUBLISHED]

    def explored(self, world: str | None = None, noise: float | None = None, robots: int | None = None) -> list[Row]:
        """Runs of the whole method with frontier exploration, including failed runs. None matches any value."""
        return [
            row
            for row in self._rows
            if row.policy == FRONTIER and row.ablation is None
            and (world is None or row.world == world)
            and (noise is None or math.isclose(row.noise, noise))
            and (robots is None or row.robots == robots)
        ]  # fmt: skip

    def ablated(self, ablation: str) -> list[Row]:
        """Runs without one part of the method, of any policy."""
        return [row for row in self._rows if row.ablation == ablation]

    @property
    def whole(self) -> list[Row]:
        """Runs of the whole method, of any policy."""
        return [row for row in self._rows if row.ablation is None]

    @cached_property
    def lap_errors(self) -> dict[float, list[tuple[FloatArray, FloatArray]]]:
        """By noise, the errors (laps, 3) in each lap of each run: by odometry alone, and with the filter."""
        found: dict[float, list[tuple[FloatArray, FloatArray]]] = {}
        for row in self._rows:
            if self.folder is None or row.policy != LAPS_POLICY or row.laps < 2 or row.ablation is not None:
                continue
            series = read_series(self.folder, row)
            if series is not None and series.true is not None:
                errors = (lap_errors(series, poses, row.laps) for poses in (series.odometry, series.estimated))
                found.setdefault(row.noise, []).append((next(errors), next(errors)))
        return dict(sorted(found.items()))


Check: TypeAlias = Callable[[Results], Finding]
Measured: TypeAlias = tuple[str, str]
"""An outcome and its evidence at one noise."""


def clean_map(world: str) -> Check:
    """Without noise: F1 is high, there are no spurious walls, and some wall is missing."""

    def check(results: Results) -> Finding:
        rows = results.explored(world, 0.0, 1)
        f1, recall, spurious = (
            _median(rows, metric(name)) for name in ("wall_f1_aligned", "wall_recall", "spurious_walls")
        )
        if f1 is None or recall is None or spurious is None or f1.count < ENOUGH:
            return _untried(rows)
        held = (f1.value >= FAIR_F1, spurious.value == 0.0, recall.value < 1.0 - NARROW_GAP)
        words = (
            f"aligned F1 {_words(f1)} (asked: {FAIR_F1} or more); spurious walls {_words(spurious, 1)} (asked: 0); "
            f"share of the walls found, not aligned, {_words(recall)}{_failed(rows)}"
        )
        return Finding(CONFIRMED if all(held) else PARTLY if any(held[:2]) else REFUTED, words)

    return check


def obstacles_grow(world: str) -> Check:
    """Spurious walls with noise minus spurious walls without noise, paired by seed."""
    return by_noise(world, "spurious_walls", falls=False)


def by_noise(world: str, name: str, *, falls: bool) -> Check:
    """A metric of one robot at each noise minus the metric without noise, paired by seed. The highest noise decides."""

    def check(results: Results) -> Finding:
        rows = results.explored(world, robots=1)
        clean = _by_seed(row for row in rows if row.noise == 0.0)
        found: list[Measured] = []
        for noise in sorted({row.noise for row in rows} - {0.0}):
            noisy = [row for row in rows if row.noise == noise]
            compared = compare(_values(clean, metric(name)), _values(_by_seed(noisy), metric(name)))
            if compared.difference is not None:
                outcome = sign(compared.difference, falls=falls)
                found.append((outcome, f"{centimetres(noise)}: {signed(compared.difference)}"))
        if not found:
            return _untried(rows)
        words = f"{name} minus that at 0 cm, by seed: {'; '.join(words for _, words in found)}{_failed(rows)}"
        return Finding(found[-1][0], words)

    return check


def door_open(world: str, noise: float, robots: int) -> Check:
    """Most runs keep the narrowest door open in the map."""
    return _door(world, noise, robots, is_open=True)


def door_lost(world: str, noise: float, robots: int) -> Check:
    """Most runs close the narrowest door in the map."""
    return _door(world, noise, robots, is_open=False)


def two_robots(name: str, words: str, *, world: str | None = None, only_noisy: bool = False) -> Check:
    """A metric of two robots minus the metric of one robot, paired by world, noise and seed."""

    def check(results: Results) -> Finding:
        rows = [row for row in results.explored(world) if row.noise > 0.0 or not only_noisy]
        one, two = ([row for row in rows if row.robots == number] for number in (1, 2))
        found = compare(_by_job(one, metric(name)), _by_job(two, metric(name)))
        if found.difference is None:
            return _untried(one + two)
        where = " with noise" if only_noisy else ""
        left_out = f", {found.left_out} left out" if found.left_out else ""
        evidence = f"{words} of two robots minus that of one{where}: {signed(found.difference, 3)}{left_out}"
        return Finding(sign(found.difference), evidence)

    return check


def time_is_halved(results: Results) -> Finding:
    """Ratio of the exploration time of two robots to the exploration time of one robot."""
    rows, value = results.explored(), metric("exploration_time_s")
    one, two = (_by_job((row for row in rows if row.robots == number), value) for number in (1, 2))
    found = compare(one, two)
    if found.ratio is None or found.ratio.low is None or found.ratio.high is None or found.ratio.count < ENOUGH:
        return _untried(rows)
    left_out = f", {found.left_out} left out" if found.left_out else ""
    evidence = (
        f"time of two robots over that of one: {_words(found.ratio)}{left_out} "
        f"(asked: the whole interval at {HALF} or less)"
    )
    if found.ratio.low >= 1.0 or found.ratio.high >= 1.0:
        return Finding(REFUTED if found.ratio.low >= 1.0 else UNDECIDED, evidence)
    return Finding(CONFIRMED if found.ratio.high <= HALF else PARTLY, evidence)


def filter_improves_the_pose(results: Results) -> Finding:
    """Ratio of the error of the estimate to the error of odometry in the same run."""
    rows, value = results.whole, ratio("ate_m", "odometry_ate_m")
    found = _median(rows, value)
    if found is None or found.high is None or found.low is None or found.count < ENOUGH:
        return _untried(rows)
    better = share(sum((value(row) or math.inf) < 1.0 for row in rows if value(row) is not None), found.count)
    outcome = CONFIRMED if found.high < 1.0 else REFUTED if found.low >= 1.0 else UNDECIDED
    evidence = f"ATE over odometry's: {_words(found)}; smaller in {written(better, 2)} of the runs{_failed(rows)}"
    return Finding(outcome, evidence)


def worse_without(ablation: str, part: str) -> Check:
    """Aligned F1 and error without a part of the method, compared with the whole method, paired by job."""

    def check(results: Results) -> Finding:
        rows = results.ablated(ablation)
        jobs = {_job(row) for row in rows}
        whole = [row for row in results.whole if _job(row) in jobs]
        f1 = _against(whole, rows, metric("wall_f1_aligned")).difference
        error = _against(whole, rows, metric("ate_m")).ratio
        if f1 is None or error is None or error.low is None or error.high is None or error.count < ENOUGH:
            return _untried(rows)
        worse_pose = CONFIRMED if error.low > 1.0 else REFUTED if error.high <= 1.0 else UNDECIDED
        both = {sign(f1, falls=True), worse_pose}
        outcome = both.pop() if len(both) == 1 else PARTLY if CONFIRMED in both else UNDECIDED
        return Finding(outcome, f"without {part}: aligned F1 {signed(f1)}, ATE times {_words(error)}{_failed(rows)}")

    return check


def _door(world: str, noise: float, robots: int, *, is_open: bool) -> Check:
    def check(results: Results) -> Finding:
        rows = results.explored(world, noise, robots)
        kept = [state for row in rows if (state := _narrowest_open(results.folder, row)) is not None]
        found = share(sum(kept), len(kept))
        if found is None or found.low is None or found.high is None:
            return _untried(rows)
        which = "all doors" if results.folder is None else "narrowest door"
        asked = "most" if is_open else "few"
        words = f"{which} open in {sum(kept)} of {len(kept)} runs: {written(found, 2)} (asked: {asked}){_failed(rows)}"
        mostly = found.low > 0.5 if is_open else found.high < 0.5
        seldom = found.high < 0.5 if is_open else found.low > 0.5
        return Finding(CONFIRMED if mostly else REFUTED if seldom else UNDECIDED, words)

    return check


def _narrowest_open(folder: Path | None, row: Row) -> bool | None:
    """Whether a run's map leaves the narrowest door open. Without its series, whether all doors are open."""
    series = None if folder is None else read_series(folder, row)
    if series is None or series.doors is None or not len(series.doors):
        state = metric("doors_open")(row)
        return None if state is None else state == 1.0
    widths = np.linalg.norm(series.doors[:, 2:] - series.doors[:, :2], axis=1)
    return doors_open(series.doors[[np.argmin(widths)]], series.segments) == 1.0


def sign(estimate: Estimate, *, falls: bool = False) -> str:
    """Outcome of an interval: confirmed if the whole interval is above 0 (or below 0, if the claim is a decrease)."""
    if estimate.low is None or estimate.high is None or estimate.count < ENOUGH:
        return UNTRIED
    low, high = (-estimate.high, -estimate.low) if falls else (estimate.low, estimate.high)
    return CONFIRMED if low > 0.0 else REFUTED if high <= 0.0 else UNDECIDED


def _median(rows: Iterable[Row], value: Value) -> Estimate | None:
    return median([found for row in rows if (found := value(row)) is not None])


def _job(row: Row) -> Hashable:
    return row.world, row.noise, row.robots, row.policy, row.laps, row.seed


def _against(first: Iterable[Row], second: Iterable[Row], value: Value) -> Comparison:
    one, two = ({_job(row): value(row) for row in rows} for rows in (first, second))
    return compare(one, two)


def _by_job(rows: Iterable[Row], value: Value) -> dict[Hashable, float | None]:
    return {(row.world, row.noise, row.seed): value(row) for row in rows}


def _by_seed(rows: Iterable[Row]) -> dict[int, Row]:
    return {row.seed: row for row in rows}


def _values(rows: dict[int, Row], value: Value) -> dict[int, float | None]:
    return {seed: value(row) for seed, row in rows.items()}


def _words(estimate: Estimate, decimals: int = 2) -> str:
    return f"{written(estimate, decimals)} (n = {estimate.count})"


def signed(estimate: Estimate, decimals: int = 2) -> str:
    """A difference as text, with its sign and its number of values."""
    return f"{'+' if estimate.value > 0.0 else ''}{_words(estimate, decimals)}"


def _untried(rows: Sequence[Row]) -> Finding:
    """The finding for too few results."""
    return Finding(UNTRIED, f"{ENOUGH} runs or pairs are needed{_failed(rows)}" if rows else "no such runs")


def _failed(rows: Sequence[Row]) -> str:
    failed = sum(row.error is not None for row in rows)
    return f"; {failed} of {len(rows)} runs failed" if failed else ""


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
