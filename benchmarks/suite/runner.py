"""Execution of a job, with its world and its scores, and of a suite: each result is stored as soon
as there is one.
"""

import functools
import os
import time
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TypeAlias
from unittest.mock import patch

from benchmarks.suite.faults import Fault, fault_begins, fault_scores
from benchmarks.suite.jobs import KIDNAPPED, PLAN, RANDOM, Job, Outcome, Suite, digest
from benchmarks.suite.store import FORMAT, Row, Stamp, row_of
from limslam_agent.measurements.processes import Processes
from limslam_agent.measurements.store import open_store
from limslam_agent.output.export import plain
from limslam_agent.output.provenance import commit, versions
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.record import Episode
from limslam_agent.runs.results import cost, score
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.terminal import progress_bar
from limslam_env.worlds.formats.loading import WorldSource, load_world

Work: TypeAlias = Callable[[Job], Outcome]

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
"""Environment of a worker. Sums that are split over threads differ in their last bits, and all
cores are in use.
"""


@dataclass(frozen=True)
class Summary:
    """The summary of an execution of a suite, which took so many seconds.

    Numbers of all jobs, of jobs with rows now, and before; and title and reason of all that ever
    failed.
    """

    jobs: int
    done: int
    before: int
    failures: tuple[tuple[str, str], ...]
    seconds: float

    @property
    def words(self) -> str:
        """The summary as text for the terminal."""
        earlier = f", {self.before} of them before" if self.before else ""
        return (
            f"{self.done} of {self.jobs} jobs done{earlier}, {len(self.failures)} failed, "
            f"{self.seconds:.1f} s"
        )


def data_folder() -> Path:
    """The folder of recorded data: ``LIMSLAM_DATA``, or ``shared/data`` beside the checkout."""
    return Path(
        os.environ.get("LIMSLAM_DATA", Path(__file__).resolve().parents[3] / "shared" / "data")
    )


def data_file(name: str) -> Path:
    """A file or a folder of recorded data."""
    folder = data_folder()
    if not (folder / name).exists():
        raise ValueError(
            f"recorded data not found in {folder}: set LIMSLAM_DATA to the folder that holds {name}"
        )
    return folder / name


# The plan and its free space are computed once for all seeds of the plan.
@functools.lru_cache(maxsize=8)
def world_source(world: str) -> WorldSource:
    """The argument of ``load_world`` for a job's world."""
    if world.startswith(RANDOM):
        return load_world(world)
    if world.startswith(PLAN):
        return data_file(f"kth/{world.removeprefix(PLAN)}.json")
    return world


def contents(jobs: Iterable[Job]) -> dict[str, str]:
    """Digests of the worlds that jobs use, by their names."""
    return {world: load_world(world_source(world)).digest for world in {job.world for job in jobs}}


def run_config(job: Job) -> RunConfig:
    """The run configuration of a job."""
    begin = fault_begins(job)
    changed = {
        "world": world_source(job.world),
        "max_time": job.max_time if begin is None else begin + job.after_fault,
        "kidnap_at": begin if job.fault == KIDNAPPED else None,
    }
    return RunConfig(**job.spec | changed)


def run_job(job: Job) -> Outcome:
    """Run a job and score it. All random numbers depend on the job's seed only."""
    begin = fault_begins(job)
    if job.fault is None or begin is None:
        return _scored(run_episode(run_config(job)))
    episode = run_episode(run_config(job), alter=Fault(job.fault, begin, job.seed).altered)
    scores = fault_scores(episode, begin)
    outcome = _scored(episode)
    return replace(outcome, metrics={**outcome.metrics, **scores})


def _scored(episode: Episode) -> Outcome:
    config = episode.config
    made_from = {
        "agent": asdict(config.agent),
        "robot": asdict(config.robot),
        "world": episode.world.digest,
    }
    return Outcome(plain(score(episode)), cost(episode), digest(made_from))


def run_suite(
    suite: Suite,
    folder: Path,
    processes: Processes,
    *,
    work: Work = run_job,
    retry_failed: bool = False,
) -> Summary:
    """Run the jobs of a suite that have no row in a folder yet, which may contain earlier results.

    ``work`` computes the outcome of a job. Jobs that have failed are run again on demand.
    """
    begin = time.monotonic()
    stamp = Stamp(versions(), commit(), suite.name, suite.digest, len(suite.jobs))

    def keep(row: Row) -> bool:
        return not (retry_failed and row.error)

    with open_store(FORMAT, folder, stamp, keep) as store, patch.dict(os.environ, ONE_THREAD):
        missing = [job for job in suite.jobs if job.key not in store.rows]
        failed = sum(row.error is not None for row in store.rows.values())
        running = closing(processes.run(missing, functools.partial(timed, work)))
        with progress_bar(suite.name, len(suite.jobs)) as advance, running as results:
            for job, result in results:
                row = row_of(stamp, job, result)
                store.append(row)
                failed += row.error is not None
                advance(len(store.rows), f"{failed} failed")
        rows = {job.title: store.rows[job.key] for job in suite.jobs if job.key in store.rows}
        failures = tuple((title, row.error) for title, row in rows.items() if row.error is not None)
        before = len(suite.jobs) - len(missing)
        return Summary(len(suite.jobs), len(store.rows), before, failures, time.monotonic() - begin)


def timed(work: Work, job: Job) -> Outcome:
    """Do a job, and add its time by the clock and of the processor to its cost, s."""
    begin = time.perf_counter()
    begin_cpu = time.process_time()
    outcome = work(job)
    spent = {"job_s": time.perf_counter() - begin, "job_cpu_s": time.process_time() - begin_cpu}
    return replace(outcome, cost={**outcome.cost, **spent})
