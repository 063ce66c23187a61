"""Processes that run jobs. A job that dies ends no other job, and has a reason."""

import math
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, Generic, TypeVar

from limslam_agent.measurements.linux import adopt_orphans, kill_descendants

J = TypeVar("J")
R = TypeVar("R")


@dataclass(frozen=True)
class Failure:
    """The reason why a job failed: an exception, a killed worker, or a time-out."""

    reason: str


@dataclass(frozen=True)
class Processes:
    """Processes on this machine.

    A ``ProcessPoolExecutor`` would not do: it fails as a whole when one of its processes dies, it
    does not say which job that process had, and it has no time-out. Here each worker has its own
    pipe and at most one job.

    A job that takes longer than ``timeout``, s, has failed, and its worker is killed. The clock of
    a job starts when a worker starts the job: the time that a new process takes to import its
    modules does not count.
    """

    workers: int
    timeout: float = math.inf

    def run(self, jobs: Sequence[J], work: Callable[[J], R]) -> Generator[tuple[J, R | Failure]]:
        """Yield each job with its result as soon as the job has ended. A worker must be able to
        import ``work``.

        When the caller closes the generator, the workers are killed.
        """
        waiting = deque(jobs)
        busy = list[_Worker[J, R]]()
        idle = list[_Worker[J, R]]()
        try:
            while waiting or busy:
                while waiting and len(busy) < self.workers:
                    worker = idle.pop() if idle else _Worker(work, self.timeout)
                    if worker.process.is_alive():
                        worker.give(waiting.popleft())
                        busy.append(worker)
                    else:  # it has died between two jobs, so no job is to blame
                        worker.kill()
                for worker in _ready(busy):
                    result = worker.take()
                    if result is not None:
                        busy.remove(worker)
                        if worker.process.is_alive():
                            idle.append(worker)
                        else:
                            worker.kill()
                        yield worker.job, result
        finally:
            for worker in (*idle, *busy):
                worker.kill()


class _Worker(Generic[J, R]):
    """A process that runs one job after another: ``job``, which fails at the time ``deadline``.

    Its pipe can be read when the job has started, when it has ended, and when the process has died.
    """

    job: J
    deadline: float

    def __init__(self, work: Callable[[J], R], timeout: float) -> None:
        self._timeout = timeout
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, work), daemon=True)
        with _ctrl_c_ignored():
            self.process.start()
        # While this process holds a copy of the worker's end, the death of the worker does not
        # close the pipe.
        theirs.close()

    def give(self, job: J) -> None:
        """Hand a job to the process."""
        self.job = job
        self.deadline = math.inf
        with suppress(OSError):  # it has just died, as its end of the pipe will say
            self.connection.send(job)

    def take(self) -> R | Failure | None:
        """The result of the job; None if the job has only started. A worker whose time is over is
        killed.
        """
        try:
            if self.connection.poll():
                result: R | Failure | None = self.connection.recv()
                if result is None:
                    self.deadline = time.monotonic() + self._timeout
                return result
            failure = Failure(f"time-out: not done after {self._timeout:g} s")
        except (EOFError, OSError):
            self.process.join()
            failure = Failure(_death(self.process.exitcode or 0))
        self.kill()
        return failure

    def kill(self) -> None:
        """End the process and what it has started. A second call does nothing."""
        if self.connection.closed:
            return
        if self.process.pid is not None:
            with suppress(OSError):  # it has ended, or has no group yet
                _kill_group(self.process.pid)
        self.process.kill()
        self.process.join()
        self.connection.close()


def _ready(busy: Sequence[_Worker[J, R]]) -> list[_Worker[J, R]]:
    """Wait for workers that have sent something or died, or for the first worker whose time is
    over.
    """
    patience = min(worker.deadline for worker in busy) - time.monotonic()
    ready = wait(
        [worker.connection for worker in busy], None if math.isinf(patience) else max(patience, 0.0)
    )
    if ready:
        return [worker for worker in busy if worker.connection in ready]
    return [worker for worker in busy if worker.deadline <= time.monotonic()]


def _death(exit_code: int) -> str:
    if exit_code >= 0:
        return f"its worker ended with exit code {exit_code}"
    name = signal.Signals(-exit_code).name
    return f"its worker was killed by {name}" + (" (out of memory?)" if name == "SIGKILL" else "")


def _serve(connection: Connection, work: Callable[[Any], Any]) -> None:
    """Run jobs in a process of their own, on one thread, until the pipe is closed. What a job has
    started ends with it.
    """
    # What a job starts would inherit an ignored signal, but it does not inherit a handler.
    signal.signal(signal.SIGINT, lambda *_: None)
    if sys.platform != "win32":
        os.setpgid(0, 0)
    signal.signal(signal.SIGTERM, lambda *_: _kill_group(os.getpid()))
    threading.Thread(target=_end_with_parent, daemon=True).start()
    adopt_orphans()
    import cv2

    cv2.setNumThreads(1)
    while True:
        try:
            job = connection.recv()
        except EOFError:
            return
        connection.send(None)
        try:
            result = work(job)
        except Exception as error:  # noqa: BLE001 - any exception concerns this job alone
            result = Failure(" ".join(f"{type(error).__name__}: {error}".split()))
        kill_descendants(os.getpid())
        connection.send(result)


def _end_with_parent() -> None:
    """End this process and what it has started when its parent has died, so that a run that goes on
    is alone.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        _kill_group(os.getpid())


def _kill_group(number: int) -> None:
    """Kill a worker and the processes that it has started. Windows has no such groups: there, only
    the worker.
    """
    kill_descendants(number)
    if sys.platform == "win32":
        os.kill(number, signal.SIGTERM)
    else:
        os.killpg(number, signal.SIGKILL)


@contextmanager
def _ctrl_c_ignored() -> Iterator[None]:
    """Start processes that ignore Ctrl-C: it reaches all processes of a terminal, and their parent
    ends the workers.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
