"""Groups of result rows: the rows of one setting form a group, and each seed is one run of the group."""

import math
import re
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from benchmarks.suite.jobs import FAULTS, LAPS_POLICY, LOG_POLICY, RANDOM
from benchmarks.suite.store import Row
from limslam_env.geometry import FloatArray

PUBLISHED = "paper"
"""The preset of the published method."""

FRONTIER, TOUR, ORACLE = "frontier", "tour", "oracle"
"""Policies that the tables refer to by name, in addition to the policies named in :mod:`benchmarks.suite.jobs`."""

Value: TypeAlias = Callable[[Row], float | None]
"""The value of a row in a column; None if the row has no value."""


@dataclass(frozen=True)
class Setting:
    """The setting that the runs of a group have in common.

    Attributes
    ----------
    world
        Name of the world; all random floor plans form one world, ``random plans``.
    noise, robots, preset, policy, ablation, laps
        As in a job.
    """

    world: str
    noise: float
    robots: int
    preset: str
    policy: str
    ablation: str | None
    laps: int

    @property
    def method(self) -> str:
        """The estimator as text."""
        return self.preset if self.ablation is None else f"{self.preset}, {self.ablation}"

    @property
    def is_published(self) -> bool:
        """Whether the setting is the unchanged published method."""
        return self.preset == PUBLISHED and self.ablation is None

    @property
    def order(self) -> tuple[object, ...]:
        """Key for sorting tables: worlds first, the published method before other methods."""
        name = tuple((not part.isdigit(), int(part) if part.isdigit() else part) for part in _parts(self.world))
        method = (not self.is_published, self.preset != PUBLISHED, self.preset, self.ablation or "")
        return (self.world.startswith("random"), name, self.laps, self.robots, self.policy, method, self.noise)


@dataclass(frozen=True, eq=False)
class Group:
    """The runs of one setting.

    Attributes
    ----------
    setting
        The setting that the runs have in common.
    rows
        All rows, including failed runs.
    """

    setting: Setting
    rows: Sequence[Row]

    @property
    def failed(self) -> int:
        """Number of failed runs."""
        return sum(row.error is not None for row in self.rows)

    def values(self, of: Value) -> FloatArray:
        """The values (k,) of the runs. Runs without a value are left out, and the caller reports their number."""
        found = (of(row) for row in self.rows)
        return np.array([value for value in found if value is not None], dtype=float)

    def by_job(self, of: Value) -> dict[Hashable, float | None]:
        """The value of each run by world, noise and seed, for paired comparisons; None for a run without a value."""
        return {(row.world, row.noise, row.laps, row.seed): of(row) for row in self.rows}


def metric(name: str) -> Value:
    """The metric with this name in ``docs/metrics.md``."""

    def value(row: Row) -> float | None:
        found = row.metrics.get(name)
        if isinstance(found, str | bool) or found is None or not math.isfinite(found):
            return None
        return float(found)

    return value


def cost(name: str) -> Value:
    """The cost of a run with this name in ``docs/metrics.md``."""

    def value(row: Row) -> float | None:
        found = row.cost.get(name)
        return None if found is None or not math.isfinite(found) else float(found)

    return value


def ratio(above: str, below: str) -> Value:
    """Ratio of two metrics of the same run; None if a metric is missing or the denominator is 0."""
    upper, lower = metric(above), metric(below)

    def value(row: Row) -> float | None:
        one, other = upper(row), lower(row)
        return None if one is None or other is None or other == 0.0 else one / other

    return value


def setting_of(row: Row) -> Setting:
    """The setting of a row."""
    world = "random plans" if row.world.startswith(RANDOM) else row.world
    return Setting(world, row.noise, row.robots, row.preset, row.policy, row.ablation, row.laps)


def groups(rows: Iterable[Row]) -> list[Group]:
    """Group rows by setting, in the order of tables."""
    found: dict[Setting, list[Row]] = {}
    for row in rows:
        found.setdefault(setting_of(row), []).append(row)
    return [Group(setting, found[setting]) for setting in sorted(found, key=lambda each: each.order)]


def merged(parts: Iterable[Group], key: Callable[[Setting], Setting]) -> list[Group]:
    """Merge groups whose settings have the same ``key``, in order of appearance."""
    found: dict[Setting, list[Row]] = {}
    for part in parts:
        found.setdefault(key(part.setting), []).extend(part.rows)
    return [Group(setting, rows) for setting, rows in found.items()]


def centimetres(noise: float) -> str:
    """A noise in centimetres, as text."""
    return f"{100.0 * noise:g} cm"


def is_exploration(setting: Setting) -> bool:
    """Whether healthy robots explored, with any policy."""
    return setting.policy not in {LAPS_POLICY, TOUR, LOG_POLICY, *FAULTS}


def is_drive(setting: Setting) -> bool:
    """Whether robots drove a known path, without exploration."""
    return setting.policy in {LAPS_POLICY, TOUR}


def is_faulty(setting: Setting) -> bool:
    """Whether a fault began in the middle of an exploration."""
    return setting.policy in FAULTS


def is_log(setting: Setting) -> bool:
    """Whether the setting is a recorded log."""
    return setting.policy == LOG_POLICY


def _parts(name: str) -> list[str]:
    return [part for part in re.split(r"(\d+)", name) if part]
