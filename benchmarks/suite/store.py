"""The results of a suite in a folder: one line of JSON for each job."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.suite.jobs import Job, Metric, Outcome
from limslam_agent.measurements import store
from limslam_agent.measurements.processes import Failure

STAMP = "suite.json"


@dataclass(frozen=True)
class Row:
    """A line of ``results.jsonl``: the fields of a job, and its result.

    The policy is ``laps`` if laps were driven. Metrics have the names of ``docs/metrics.md``. Cost
    is ignored in comparisons for identity. ``config`` is a digest of the agent's settings and
    world, and ``key`` that of the job. A job that failed has no metrics and no cost, and the reason
    as ``error``.
    """

    world: str
    noise: float
    robots: int
    preset: str
    policy: str
    ablation: str | None
    laps: int
    seed: int
    metrics: dict[str, Metric]
    cost: dict[str, float] = field(default_factory=dict, compare=False)
    versions: dict[str, str] = field(default_factory=dict)
    commit: str = "unknown"
    config: str = ""
    key: str = field(kw_only=True)
    error: str | None = None


@dataclass(frozen=True)
class Stamp(store.BaseStamp):
    """What all results of a suite have in common: also its name, its digest, and its number of
    jobs.
    """

    suite: str
    digest: str
    jobs: int

    @property
    def identity(self) -> Mapping[str, Hashable]:
        """What must be equal for results to go on."""
        return {"another suite, or of this one before it was changed": (self.suite, self.digest)}


FORMAT = store.Format("benchmark's results", STAMP, Stamp, Row, lambda row: row.key)


def row_of(stamp: Stamp, job: Job, result: Outcome | Failure) -> Row:
    """The row of a job."""
    made_by = {**job.identity, "versions": stamp.versions, "commit": stamp.commit}
    if isinstance(result, Failure):
        return Row(**made_by, metrics={}, error=result.reason)
    return Row(**made_by, metrics=result.metrics, cost=result.cost, config=result.config)


def read_rows(*paths: Path) -> list[Row]:
    """The rows of folders of results, or of files ``results.jsonl``, each job once."""
    return store.rows_once(FORMAT, [row for path in paths for row in store.read_rows(FORMAT, path)])
