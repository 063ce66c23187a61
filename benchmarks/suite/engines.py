"""Who does the jobs: processes of this machine, or Ray. Whoever it is, a job that dies takes no other one with it."""

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

Result: TypeAlias = Outcome | Failure
Work: TypeAlias = Callable[[Job], Outcome]

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
"""Environment of a worker: sums split over threads differ in their last bits, and the cores are taken as it is."""


class Engine(Protocol):
    """Does jobs, in any order."""

    def run(self, jobs: Sequence[Job], work: Work) -> Generator[tuple[Job, Result]]:
        """Yield each job with what came of it, when it has ended. ``work`` is a function that a worker can import."""


@dataclass(frozen=True)
class ProcessEngine:
    """Processes of this machine.

    They are not a ``ProcessPoolExecutor``: that one breaks as a whole when one of its processes dies, says not whose
    job it was, and has no time-out. Here each worker has a pipe of its own and at most one job.

    Attributes
    ----------
    workers
        How many there are.
    timeout
        Wall-clock time, s, after which a job is given up and its worker killed.
    """

    workers: int
    timeout: float

    def run(self, jobs: Sequence[Job], work: Work) -> Generator[tuple[Job, Result]]:
        """Yield each job with what came of it; when the caller stops listening, the workers are killed."""
        waiting, busy = deque(jobs), dict[_Worker, tuple[Job, float]]()
        idle = [_Worker(work) for _ in range(min(self.workers, len(jobs)))]
        try:
            while waiting or busy:
                while waiting and idle:
                    worker, job = idle.pop(), waiting.popleft()
                    busy[worker] = job, time.monotonic() + self.timeout
                    worker.give(job)
                for worker in _ended(busy):
                    job, _ = busy.pop(worker)
                    idle.append(worker)
                    yield job, worker.take(self.timeout)
        finally:
            for worker in (*idle, *busy):
                worker.kill()


class _Worker:
    """A process that does one job after the other; a new one is started where the last one has died."""

    def __init__(self, work: Work) -> None:
        self._work = work
        self._running: tuple[SpawnProcess, Connection] | None = None

    @property
    def connection(self) -> Connection:
        """Has something to read when the job has ended, one way or the other."""
        return self._process()[1]

    def give(self, job: Job) -> None:
        """Have a job done."""
        try:
            self.connection.send(job)
        except OSError:  # it has died between two jobs, so none is to blame
            self.kill()
            self.connection.send(job)

    def take(self, timeout: float) -> Result:
        """What came of the job. A worker that has neither answered nor died is late, and killed."""
        process, connection = self._process()
        try:
            if connection.poll():
                result: Result = connection.recv()
                return result
            failure = Failure(f"time-out: not done after {timeout:g} s")
        except (EOFError, OSError):
            process.join()
            failure = Failure(_death(process.exitcode or 0))
        self.kill()
        return failure

    def kill(self) -> None:
        """End it, if it is there."""
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
            with _workers_environment():
                process.start()
            # With our copy open, nobody would notice that the worker's is closed.
            theirs.close()
            self._running = process, ours
        return self._running


def _ended(busy: dict[_Worker, tuple[Job, float]]) -> list[_Worker]:
    """Wait for workers that have answered or died, or for the first whose time is over."""
    patience = min(deadline for _, deadline in busy.values()) - time.monotonic()
    ready = wait([worker.connection for worker in busy], max(patience, 0.0))
    if ready:
        return [worker for worker in busy if worker.connection in ready]
    return [worker for worker, (_, deadline) in busy.items() if deadline <= time.monotonic()]


def _death(exit_code: int) -> str:
    if exit_code >= 0:
        return f"its worker ended with exit code {exit_code}"
    name = signal.Signals(-exit_code).name
    return f"its worker was killed by {name}" + (" (out of memory?)" if name == "SIGKILL" else "")


def _serve(connection: Connection, work: Work) -> None:
    """Do jobs until nobody wants any more, in a process of its own."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    while True:
        try:
            job = connection.recv()
        except EOFError:
            return
        connection.send(attempt(work, job))


def _end_with_parent() -> None:
    # A job may take minutes, and a killed run that is started again has those cores to itself.
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def attempt(work: Work, job: Job) -> Result:
    """Do a job in a worker, on one thread; an exception becomes a failure."""
    import cv2

    cv2.setNumThreads(1)
    try:
        return work(job)
    except Exception as error:  # noqa: BLE001 - whatever it is, it is this job's alone
        return Failure(" ".join(f"{type(error).__name__}: {error}".split()))


@contextmanager
def _workers_environment() -> Iterator[None]:
    """What a new process inherits: single threads, and deaf ears for Ctrl-C, which is for us to answer."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    is_main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if is_main else None
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        if is_main:
            signal.signal(signal.SIGINT, handler)
