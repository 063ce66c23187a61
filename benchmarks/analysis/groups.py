"""Groups of result rows: the rows of one setting form a group, and each seed is one run of the
group.
"""

import math
import re
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from benchmarks.suite.faults import FAULTS
from benchmarks.suite.jobs import LAPS_POLICY, RANDOM
from benchmarks.suite.store import Row
from limslam_agent.measurements.statistics import MISSING
from limslam_env.geometry import FloatArray

PUBLISHED = "paper"
"""The preset of the published method."""

FRONTIER = "frontier"
TOUR = "tour"
"""Policies that the tables refer to by name, in addition to the policies named in
:mod:`benchmarks.suite.jobs`.
"""

Value: TypeAlias = Callable[[Row], float | None]
"""The value of a row in a column; None if the row has no value."""


@dataclass(frozen=True)
class Setting:
    """The setting that the runs of a group have in common, by the fields of a job.

    All random floor plans form one world, ``random plans``. Sums have the world ``all``, and the
    noise None.
    """

    world: str
    noise: float | None
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
    def words(self) -> dict[str, str]:
        """The fields as text, with the noise in centimetres."""
        return {
            "world": self.world,
            "laps": str(self.laps or MISSING),
            "noise": "all" if self.noise is None else f"{100.0 * self.noise:g} cm",
            "robots": str(self.robots),
            "policy": self.policy,
            "method": self.method,
        }

    @property
    def pooled(self) -> "Setting":
        """The setting of a sum over all worlds and noises."""
        return replace(self, world="all", noise=None)

    @property
    def kind(self) -> str:
        """``drive`` along a known path, ``faulty`` if a fault began in an exploration, or
        ``exploration``.
        """
        if self.policy in {LAPS_POLICY, TOUR}:
            return "drive"
        return "faulty" if self.policy in FAULTS else "exploration"

    @property
    def order(self) -> tuple[object, ...]:
        """Key for sorting tables: worlds first, the published method before other methods."""
        parts = [part for part in re.split(r"(\d+)", self.world) if part]
        name = tuple((not part.isdigit(), int(part) if part.isdigit() else part) for part in parts)
        method = (self.preset != PUBLISHED, self.preset, self.ablation or "")
        return (
            self.world.startswith("random"),
            name,
            self.laps,
            self.robots,
            self.policy,
            method,
            self.noise,
        )


@dataclass(frozen=True, eq=False)
class Group:
    """The runs of one setting, also those that failed."""

    setting: Setting
    rows: Sequence[Row]

    @property
    def ended(self) -> int:
        """Number of runs that did not fail."""
        return sum(row.error is None for row in self.rows)

    def values(self, of: Value) -> FloatArray:
        """The values (k,) of the runs. Runs without a value are left out, and the caller reports
        their number.
        """
        found = (of(row) for row in self.rows)
        return np.array([value for value in found if value is not None], dtype=float)

    def by_job(self, of: Value) -> dict[Hashable, float | None]:
        """The value of each run by world, noise and seed, for paired comparisons; None for a run
        without a value.
        """
        return {(row.world, row.noise, row.laps, row.seed): of(row) for row in self.rows}


def metric(name: str) -> Value:
    """The metric with this name in ``docs/metrics.md``."""

    def value(row: Row) -> float | None:
        found = row.metrics.get(name)
        if isinstance(found, str | bool) or found is None or not math.isfinite(found):
            return None
        return float(found)

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
    return [
        Group(setting, found[setting]) for setting in sorted(found, key=lambda each: each.order)
    ]


def with_sums(parts: Sequence[Group]) -> list[Group]:
    """Groups, followed by the sums over all worlds and noises of those that have several."""
    pooled: dict[Setting, list[Group]] = {}
    for part in parts:
        pooled.setdefault(part.setting.pooled, []).append(part)
    sums = [
        Group(setting, [row for part in several for row in part.rows])
        for setting, several in pooled.items()
        if len(several) > 1
    ]
    return [*parts, *sums]
