"""Execution of a suite: the missing jobs are run, and each result is stored as soon as its job has ended."""

import os
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeAlias
from unittest.mock import patch

from benchmarks.suite.jobs import Job, Outcome
from benchmarks.suite.store import FORMAT, Row, Stamp, row_of
from benchmarks.suite.suite import Suite
from benchmarks.suite.work import run_job
from limslam_agent.cli.terminal import progress_bar
from limslam_agent.measurements.processes import Processes
from limslam_agent.measurements.store import open_store
from limslam_agent.output.provenance import commit
from limslam_agent.runs.results import versions

Work: TypeAlias = Callable[[Job], Outcome]

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
"""Environment of a worker. Sums that are split over threads differ in their last bits, and all cores are in use."""


@dataclass(frozen=True)
class Summary:
    """The summary of an execution of a suite, which took so many seconds.

    Numbers of all jobs, of jobs with rows now, and before; and title and reason of all that ever failed.
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
        return f"{self.done} of {self.jobs} jobs done{earlier}, {len(self.failures)} failed, {self.seconds:.1f} s"


def run_suite(
    suite: Suite, folder: Path, processes: Processes, *, work: Work = run_job, retry_failed: bool = False
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
        running = closing(processes.run(missing, partial(timed, work)))
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
    begin, begin_cpu = time.perf_counter(), time.process_time()
    outcome = work(job)
    spent = {"job_s": time.perf_counter() - begin, "job_cpu_s": time.process_time() - begin_cpu}
    return replace(outcome, cost={**outcome.cost, **spent})
