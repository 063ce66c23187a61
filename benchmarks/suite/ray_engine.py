"""The engine that runs jobs on Ray: on this machine, or on a cluster."""

import os
import socket
import time
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from benchmarks.suite.engines import ONE_THREAD, JobClock, Result, Work, one_thread, stages
from benchmarks.suite.jobs import Failure, Job

OBJECT_STORE = 100_000_000
"""Memory of the object store of a local Ray, bytes. Results are small; Ray would reserve a third of the machine."""

PATIENCE = 10.0
"""Longest time in which a cluster must accept a connection, s."""


@dataclass(frozen=True)
class RayEngine:
    """Tasks of Ray core, one job each.

    Attributes
    ----------
    workers
        Number of jobs that run at once; None for as many as Ray has CPUs.
    timeout
        Wall-clock time, s, after which a job has failed and its worker is killed. The clock of a job starts when a
        worker starts the job: the time that Ray takes to start workers does not count.
    address
        Address of a running cluster, as in ``ray.init``; None starts Ray on this machine for this run only.
    """

    workers: int | None
    timeout: float
    address: str | None = None

    def run(self, jobs: Sequence[Job], work: Work) -> Generator[tuple[Job, Result]]:
        """Yield each job with its result. When the caller closes the generator, running tasks are cancelled.

        Raises
        ------
        ValueError
            If Ray is not installed, or there is no cluster at the address.
        """
        with _ray(self.workers, self.address) as ray:
            # A task that Ray repeats would have a wrong time-out, and it would hide why its worker died.
            task = ray.remote(num_cpus=1, max_retries=0, num_returns="streaming")(stages)
            slots = self.workers or max(int(ray.cluster_resources()["CPU"]), 1)
            waiting, busy = deque(jobs), dict[Any, JobClock]()
            try:
                while waiting or busy:
                    while waiting and len(busy) < slots:
                        job = waiting.popleft()
                        busy[task.remote(work, job)] = JobClock(job, self.timeout)
                    for stream, result in _heard(ray, busy):
                        if result is not None:
                            yield busy.pop(stream).job, result
            finally:
                for stream in busy:
                    ray.cancel(stream, force=True)


def _heard(ray: Any, busy: dict[Any, JobClock]) -> list[tuple[Any, Result | None]]:
    """Wait for tasks that have sent something: None when a job starts, then its result. Late tasks are cancelled."""
    patience = min(clock.deadline for clock in busy.values()) - time.monotonic()
    ready, _ = ray.wait(list(busy), timeout=max(patience, 0.0))
    if ready:
        return [(stream, _next(ray, stream, busy[stream])) for stream in ready]
    late = [stream for stream, clock in busy.items() if clock.deadline <= time.monotonic()]
    for stream in late:
        ray.cancel(stream, force=True)
    return [(stream, busy[stream].failure) for stream in late]


def _next(ray: Any, stream: Any, clock: JobClock) -> Result | None:
    try:
        result: Result | None = ray.get(next(stream))
    except ray.exceptions.RayError as error:
        # Only the first line of Ray's long messages is kept.
        first = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
        return Failure(f"{type(error).__name__}: {first}")
    if result is None:
        clock.start()
    return result


@contextmanager
def _ray(workers: int | None, address: str | None) -> Iterator[Any]:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # With Ray's default niceness of 15 its workers get no processor time while other programs are busy.
    os.environ.setdefault("RAY_worker_niceness", "0")
    try:
        import ray
    except ImportError as error:
        raise ValueError("--engine ray needs Ray: pip install 'limslam[ray]'") from error
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if address is not None:
        _check_answers(address)
        options |= {"runtime_env": {"env_vars": ONE_THREAD}}
    else:
        # The workers of a Ray on this machine inherit the environment, so that Ray can start them beforehand.
        options |= {"num_cpus": workers, "include_dashboard": False, "object_store_memory": OBJECT_STORE}
    try:
        with one_thread():
            ray.init(address=address or "local", **options)
    except (ConnectionError, ValueError) as error:
        raise ValueError(f"--address {address}: no Ray cluster answers there: {str(error).splitlines()[0]}") from error
    try:
        yield ray
    finally:
        ray.shutdown()


def _check_answers(address: str) -> None:
    """Refuse an address ``host:port`` where no program listens. Ray itself would try to connect for ten minutes."""
    host, _, port = address.rpartition(":")
    if not (host and port.isdigit()) or "//" in address:
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), PATIENCE).close()
    except (OSError, OverflowError) as error:
        raise ValueError(f"--address {address}: no Ray cluster answers there: {error}") from error
