"""The results of an entry in a folder: ``arena.json`` says whose, and ``results.jsonl`` has one
line for each plan.
"""

import hashlib
import json
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from limslam_agent.arena.entry import Entry, Manifest, manifest_table
from limslam_agent.arena.scoring import check_scores
from limslam_agent.arena.tracks import MAX_TIME, PUBLIC_SEED, VERSION, plans_of
from limslam_agent.config.tables import built
from limslam_agent.measurements import store
from limslam_env.messages import one_line

STAMP = "arena.json"
RUNS = "runs"


@dataclass(frozen=True)
class Row:
    """The result of a plan, which is ``setting`` as a table.

    Metrics have the names of ``docs/metrics.md`` and ``docs/arena.md``. Time and memory, which are
    the cost, differ from run to run. ``settings`` is a digest of plan and entry. ``error`` says why
    the entry failed, which has lost the plan.

    Raises
    ------
    ValueError
        If the metrics are not those of a run (:func:`limslam_agent.arena.scoring.check_scores`), or
        a cost is negative.
    """

    plan: int
    setting: dict[str, Any]
    metrics: dict[str, float | int | str | None]
    cost: dict[str, float] = field(default_factory=dict, compare=False)
    versions: dict[str, str] = field(default_factory=dict)
    commit: str = "unknown"
    settings: str = ""
    error: str | None = None

    def __post_init__(self) -> None:
        longest = self.setting.get("max_time")
        if not isinstance(longest, int | float) or not 0.0 < longest <= MAX_TIME:
            raise ValueError(f"the longest time of a plan is 0 to {MAX_TIME:g} s, not {longest!r}")
        check_scores(self.metrics, longest, self.error)
        if any(value < 0.0 for value in self.cost.values()):
            raise ValueError("a cost is negative")


@dataclass(frozen=True)
class Stamp(store.BaseStamp):
    """What all results of a folder have in common: the version of the arena, the entry, and the
    plans.

    ``entry`` is its manifest, ``folder`` its folder, and ``digest`` that of its files. The digest
    ``plans`` says whether two folders have the same plans, and nothing about a secret seed.
    """

    arena: int
    entry: dict[str, Any]
    folder: str
    digest: str
    plans: str
    is_secret: bool

    def __post_init__(self) -> None:
        if self.arena != VERSION:
            raise ValueError(f"results of version {self.arena} of the arena, not of {VERSION}")
        built(Manifest, self.entry, "entry")

    @property
    def identity(self) -> Mapping[str, Hashable]:
        """What must be equal for results to go on."""
        return {
            "other plans": self.plans,
            "another entry, or of this one before it was changed": self.digest,
        }


FORMAT = store.Format("results of the arena", STAMP, Stamp, Row, lambda row: row.plan)


def stamp_of(entry: Entry, seed: int, *, versions: dict[str, str], commit: str) -> Stamp:
    """The stamp of an entry's results on the plans of a seed."""
    return Stamp(
        versions,
        commit,
        VERSION,
        manifest_table(entry.manifest),
        str(entry.folder),
        entry.digest,
        plans_digest(seed),
        seed != PUBLIC_SEED,
    )


def plans_digest(seed: int) -> str:
    """Digest of the plans of a seed."""
    return digest_of([plan.setting for plan in plans_of(seed)])


def digest_of(content: Any) -> str:
    """Digest of what JSON can hold."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def read_results(folder: Path) -> tuple[Stamp, dict[int, Row]]:
    """The stamp of a folder of results, and its rows by the numbers of their plans, in their
    order.
    """
    stamp = store.read_stamp(FORMAT, folder)
    rows = store.rows_once(FORMAT, store.read_rows(FORMAT, folder))
    if not rows:
        raise ValueError(one_line(f"{folder}: has no results yet"))
    return stamp, {row.plan: row for row in sorted(rows, key=lambda row: row.plan)}
