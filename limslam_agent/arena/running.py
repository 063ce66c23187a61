"""Runs an entry on plans, in several processes, and stores each result as soon as its plan has ended."""

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from limslam_agent.arena.entry import Entry
from limslam_agent.arena.exploration import Keep, explore
from limslam_agent.arena.mapping import map_drive
from limslam_agent.arena.processes import begin_group, end_with_parent, kill_group, without_folders
from limslam_agent.arena.results import RUNS, Row, digest_of, open_store, stamp_of
from limslam_agent.arena.scoring import lost_scores
from limslam_agent.arena.tracks import MAPPING, Plan
from limslam_agent.output.export import plain
from limslam_agent.output.provenance import commit
from limslam_agent.runs.results import versions
from limslam_env.messages import one_line

Report = Callable[[Row, int], None]
"""Called with each new row and the number of rows that exist."""

_TERMINATED = 143  # exit code of a command of this project that was asked to end (SIGTERM)


@dataclass(frozen=True)
class Job:
    """A plan that an entry has to run.

    Attributes
    ----------
    entry, plan
        Who runs what.
    folder
        Where the folder of the run is kept. None keeps nothing.
    versions, commit
        Provenance of the row.
    keep
        Writes the folder of an exploration.
    """

    entry: Entry
    plan: Plan
    folder: Path | None
    versions: dict[str, str]
    commit: str
    keep: Keep | None = None


def run_entry(
    entry: Entry,
    plans: Sequence[Plan],
    folder: Path,
    *,
    seed: int,
    is_secret: bool,
    jobs: int,
    keep: Keep | None = None,
    retry_failed: bool = False,
    report: Report = lambda _row, _count: None,
) -> list[Row]:
    """Run the plans that have no row in a folder yet. Returns all rows of these plans.

    Parameters
    ----------
    entry, plans
        Who runs what.
    folder
        Folder for the results. It may contain earlier results of the same entry.
    seed, is_secret
        The seed of the plans, and whether it is secret.
    jobs
        Number of processes.
    keep
        Writes the folders of explorations. None keeps no folders, of the mapping track neither.
    retry_failed
        Run the plans again in which the entry failed.
    report
        Called with each new row.

    Raises
    ------
    ValueError
        If the folder cannot be used, or a process of the arena has died.
    """
    place, inside = folder.absolute(), entry.folder.resolve()
    if folder.resolve() == inside or inside in folder.resolve().parents:
        raise ValueError(f"{folder}: lies in the folder of the entry, which must not change while it runs")
    stamp = stamp_of(entry, seed, is_secret=is_secret, versions=versions(), commit=commit())
    with open_store(folder, stamp) as store:
        if retry_failed:
            store.forget_failed({plan.number for plan in plans})
        todo = [
            Job(entry, plan, place / RUNS / f"{plan.number:03d}" if keep else None, stamp.versions, stamp.commit, keep)
            for plan in plans
            if plan.number not in store.rows
        ]
        for row in results_of(todo, jobs):
            store.append(row)
            report(row, sum(plan.number in store.rows for plan in plans))
        return [store.rows[plan.number] for plan in plans]


def results_of(todo: Sequence[Job], jobs: int) -> Iterator[Row]:
    """The rows of jobs as they end, in any order.

    Raises
    ------
    ValueError
        If a process has died.
    """
    if jobs == 1:
        yield from map(run_job, todo)
        return
    context = multiprocessing.get_context("spawn")
    before = set(multiprocessing.active_children())
    with ProcessPoolExecutor(min(jobs, max(len(todo), 1)), mp_context=context, initializer=_prepare) as pool:
        submitted = {pool.submit(run_job, job): job.plan.number for job in todo}
        try:
            for done in as_completed(submitted):
                yield done.result()
        except BrokenProcessPool as error:
            suspects = " or ".join(f"plan {number}" for number in _unfinished(submitted)[:jobs])
            raise ValueError(
                f"a process of the arena has died while it ran {suspects}; the same command goes on, and --plans can "
                "leave this plan out"
            ) from error
        except BaseException:
            # Nobody waits for plans that are being run when the user stops the command.
            pool.shutdown(wait=False, cancel_futures=True)
            for child in set(multiprocessing.active_children()) - before:
                _kill(child)
            raise


def _kill(child: BaseProcess) -> None:
    """Kill a process of the pool, and the commands of entries that it has started."""
    if child.pid is not None:
        with suppress(OSError):  # it has ended, or has no group yet
            kill_group(child.pid)
    child.kill()


def _unfinished(submitted: dict["Future[Row]", int]) -> list[int]:
    """The plans without a row, in the order in which the processes take them."""
    return [plan for each, plan in submitted.items() if not each.done() or each.exception() is not None]


def _prepare() -> None:
    """Begin a worker, which ignores Ctrl-C and ends with its parent, as the commands that it starts do."""
    # The commands of entries would inherit an ignored signal, but they do not inherit a handler.
    signal.signal(signal.SIGINT, lambda *_: None)
    begin_group()
    signal.signal(signal.SIGTERM, lambda *_: kill_group(os.getpid()))
    threading.Thread(target=end_with_parent, args=(lambda _code: kill_group(os.getpid()),), daemon=True).start()
    import cv2

    cv2.setNumThreads(1)


def run_job(job: Job) -> Row:
    """Run a plan. Whatever the entry's code raises becomes the error of the row, and the plan is lost."""
    plan, manifest = job.plan, job.entry.manifest
    provenance: dict[str, Any] = {
        "versions": job.versions, "commit": job.commit,
        "settings": digest_of({"plan": plan.setting, "entry": job.entry.digest}),
    }  # fmt: skip
    begin, cpu, error = time.perf_counter(), _cpu_s(), None
    try:
        if plan.robots > manifest.robots:
            raise ValueError(f"the entry drives one robot, and the plan has {plan.robots}")  # noqa: TRY301
        if manifest.track == MAPPING:
            metrics, cost = map_drive(job.entry, plan, job.folder)
        else:
            metrics, cost = explore(job.entry, plan, job.folder, job.keep)
    except OSError:  # no space, or no permission: not the entry's failure
        raise
    except (Exception, SystemExit) as failure:
        if isinstance(failure, SystemExit) and failure.code == _TERMINATED:
            raise
        error = f"{failure}" if isinstance(failure, ValueError) else f"{type(failure).__name__}: {failure}"
        error = one_line(without_folders(error, (job.entry.folder,)))
        metrics, cost = lost_scores(plan, manifest.track, f"failed: {error}"), {}
    cost = {**cost, "cpu_s": _cpu_s() - cpu, "wall_clock_s": time.perf_counter() - begin}
    return Row(plan.number, plan.setting, plain(metrics), plain(cost), **provenance, error=error)


def _cpu_s() -> float:
    """Processor time of this process and of its children that have ended, s. Windows tells nothing of children."""
    if sys.platform == "win32":
        return time.process_time()
    import resource

    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime
