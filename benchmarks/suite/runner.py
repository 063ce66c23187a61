"""Execution of a suite: the missing jobs are run, and each result is stored as soon as its job has ended."""

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from benchmarks.suite.engines import Engine, Work
from benchmarks.suite.provenance import package_versions, work_alike
from benchmarks.suite.store import Row, Stamp, open_store
from benchmarks.suite.suite import Suite
from benchmarks.suite.work import run_job
from limslam_agent.output.provenance import commit


@dataclass(frozen=True)
class Summary:
    """The summary of an execution of a suite.

    Attributes
    ----------
    jobs, done, before
        Numbers of jobs: all jobs, jobs with rows now, and jobs with rows before this execution.
    failures
        Title and reason of all failed jobs, including earlier failures.
    seconds
        Wall-clock time of this execution, s.
    lost
        Number of jobs that had to be repeated because the files of their series were lost.
    """

    jobs: int
    done: int
    before: int
    failures: tuple[tuple[str, str], ...]
    seconds: float
    lost: int = 0

    @property
    def words(self) -> str:
        """The summary as text for the terminal."""
        earlier = f", {self.before} of them before" if self.before else ""
        again = f", {self.lost} again because their series were lost" if self.lost else ""
        return (
            f"{self.done} of {self.jobs} jobs done{earlier}{again}, {len(self.failures)} failed, {self.seconds:.1f} s"
        )


def run_suite(
    suite: Suite, folder: Path, engine: Engine, *, work: Work = run_job, retry_failed: bool = False
) -> Summary:
    """Run the jobs of a suite that have no row in a folder yet.

    Parameters
    ----------
    suite
        The suite.
    folder
        Folder for the results; it may contain earlier results.
    engine
        The engine that runs the jobs.
    work
        The function that computes the outcome of a job.
    retry_failed
        Run failed jobs again.

    Raises
    ------
    ValueError
        If the folder cannot be used: see :func:`benchmarks.suite.store.open_store`.
    """
    begin = time.monotonic()
    stamp = Stamp(suite.name, suite.digest, len(suite.jobs), package_versions(), commit())
    with open_store(folder, stamp, retry_failed=retry_failed) as store:
        missing = [job for job in suite.jobs if job.key not in store.rows]
        before = len(suite.jobs) - len(missing)
        failed = sum(row.error is not None for row in store.rows.values())
        with _bar(suite.name, before, len(suite.jobs), failed) as advance:
            if missing:
                with closing(engine.run(missing, partial(work_alike, work, stamp.versions))) as results:
                    for job, result in results:
                        advance(store.append(job, result))
        rows = {job.title: store.rows[job.key] for job in suite.jobs if job.key in store.rows}
        failures = tuple((title, row.error) for title, row in rows.items() if row.error is not None)
        return Summary(len(suite.jobs), len(store.rows), before, failures, time.monotonic() - begin, store.lost)


@contextmanager
def _bar(name: str, before: int, jobs: int, failed: int) -> Iterator[Callable[[Row], None]]:
    console = Console(stderr=True, highlight=False)
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[failed]} failed"),
        TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(),
    )  # fmt: skip
    quiet = not console.is_terminal
    with Progress(*columns, console=console, transient=True, refresh_per_second=2, disable=quiet) as progress:
        bar = progress.add_task(name, total=jobs, completed=before, failed=failed)

        def advance(row: Row) -> None:
            nonlocal failed
            failed += row.error is not None
            progress.update(bar, advance=1, failed=failed)

        yield advance
