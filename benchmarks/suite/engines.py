"""Engines run the jobs of a suite: processes of this machine, or Ray. A job that dies ends no other job."""

import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Protocol, TypeAlias

from benchmarks.suite.jobs import Failure, Job, Outcome
from limslam_agent.arena.processes import end_with_parent

Result: TypeAlias = Outcome | Failure
Work: TypeAlias = Callable[[Job], Outcome]

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
"""Environment of a worker. Sums that are split over threads differ in their last bits, and all cores are in use."""

STARTING = 600.0
"""Longest time until a worker starts a job, s, unless the time-out is longer. It only prevents waiting forever."""


class Engine(Protocol):
    """Runs jobs, in any order."""

    def run(self, jobs: Sequence[Job], work: Work) -> Generator[tuple[Job, Result]]:
        """Yield each job with its result as soon as the job has ended. A worker must be able to import ``work``."""


@dataclass(frozen=True)
class ProcessEngine:
    """Processes on this machine.

    A ``ProcessPoolExecutor`` would not do: it fails as a whole when one of its processes dies, it does not say which
    job that process had, and it has no time-out. Here each worker has its own pipe and at most one job.

    Attributes
    ----------
    workers
        Number of processes.
    timeout
        Wall-clock time, s, after which a job has failed and its worker is killed. The clock of a job starts when a
        worker starts the job: the time that a new process takes to import its modules does not count.
    """

    workers: int
    timeout: float

    def run(self, jobs: Sequence[Job], work: Work) -> Generator[tuple[Job, Result]]:
        """Yield each job with its result. When the caller closes the generator, the workers are killed."""
        waiting, busy = deque(jobs), list[_Worker]()
        idle = [_Worker(work, self.timeout) for _ in range(min(self.workers, len(jobs)))]
        try:
            while waiting or busy:
                while waiting and idle:
                    busy.append(idle.pop())
                    busy[-1].give(waiting.popleft())
                for worker in _ready(busy):
                    result = worker.take()
                    if result is not None:
                        busy.remove(worker)
                        idle.append(worker)
                        yield worker.clock.job, result
        finally:
            for worker in (*idle, *busy):
                worker.kill()


class JobClock:
    """The time limit of one job, on the monotonic clock.

    Parameters
    ----------
    job
        The job.
    timeout
        Longest time from the start of the job to its end, s.

    Attributes
    ----------
    job
        The job.
    deadline
        The time at which the job fails, unless something is heard of it before.
    """

    def __init__(self, job: Job, timeout: float) -> None:
        self.job, self._timeout = job, timeout
        self._limit, self._missing = max(timeout, STARTING), "started"
        self.deadline = time.monotonic() + self._limit

    def start(self) -> None:
        """Begin the time of the job itself."""
        self._limit, self._missing = self._timeout, "done"
        self.deadline = time.monotonic() + self._limit

    @property
    def failure(self) -> Failure:
        """The result of a job whose time is over."""
        return Failure(f"time-out: not {self._missing} after {self._limit:g} s")


class _Worker:
    """A process that runs one job after another. A new process replaces one that has died."""

    clock: JobClock

    def __init__(self, work: Work, timeout: float) -> None:
        self._work, self._timeout = work, timeout
        self._running: tuple[SpawnProcess, Connection] | None = None

    @property
    def connection(self) -> Connection:
        """The pipe. It can be read when the job has started, when it has ended, and when the process has died."""
        return self._process()[1]

    def give(self, job: Job) -> None:
        """Hand a job to the process."""
        try:
            self.connection.send(job)
        except OSError:  # the process has died between two jobs, so no job is to blame
            self.kill()
            self.connection.send(job)
        self.clock = JobClock(job, self._timeout)

    def take(self) -> Result | None:
        """The result of the job; None if the job has only started. A worker whose time is over is killed."""
        process, connection = self._process()
        try:
            if connection.poll():
                result: Result | None = connection.recv()
                if result is None:
                    self.clock.start()
                return result
            failure = self.clock.failure
        except (EOFError, OSError):
            process.join()
            failure = Failure(_death(process.exitcode or 0))
        self.kill()
        return failure

    def kill(self) -> None:
        """End the process, if there is one."""
        if self._running is not None:
            process, connection = self._running
            self._running = None
            process.kill()
            process.join()
            connection.close()

    def _process(self) -> tuple[SpawnProcess, Connection]:
        if self._running is None:
            context = multiprocessing.get_context("spawn")
            ours, theirs = context.Pipe()
            process = context.Process(target=_serve, args=(theirs, self._work), daemon=True)
            with one_thread(), _ctrl_c_ignored():
                process.start()
            # While this process holds a copy of the worker's end, the death of the worker does not close the pipe.
            theirs.close()
            self._running = process, ours
        return self._running


def _ready(busy: Sequence[_Worker]) -> list[_Worker]:
    """Wait for workers that have sent something or died, or for the first worker whose time is over."""
    patience = min(worker.clock.deadline for worker in busy) - time.monotonic()
    ready = wait([worker.connection for worker in busy], max(patience, 0.0))
    if ready:
        return [worker for worker in busy if worker.connection in ready]
    return [worker for worker in busy if worker.clock.deadline <= time.monotonic()]


def _death(exit_code: int) -> str:
    if exit_code >= 0:
        return f"its worker ended with exit code {exit_code}"
    name = signal.Signals(-exit_code).name
    return f"its worker was killed by {name}" + (" (out of memory?)" if name == "SIGKILL" else "")


def _serve(connection: Connection, work: Work) -> None:
    """Run jobs in a process of their own until the pipe is closed."""
    threading.Thread(target=end_with_parent, daemon=True).start()
    while True:
        try:
            job = connection.recv()
        except EOFError:
            return
        for stage in stages(work, job):
            connection.send(stage)


def stages(work: Work, job: Job) -> Iterator[Result | None]:
    """Run a job in a worker, on one thread: None when the job starts, then its result. An exception is a failure."""
    import cv2

    cv2.setNumThreads(1)
    yield None
    try:
        result: Result = work(job)
    except Exception as error:  # noqa: BLE001 - any exception concerns this job alone
        result = Failure(" ".join(f"{type(error).__name__}: {error}".split()))
    yield result


@contextmanager
def one_thread() -> Iterator[None]:
    """Give new processes the environment of workers; afterwards this process has its own environment again."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _ctrl_c_ignored() -> Iterator[None]:
    """Start processes that ignore Ctrl-C: it reaches all processes of a terminal, and their parent ends the workers."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
