"""Jobs on Ray: on this machine, or on a cluster."""

import os
import socket
import time
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from benchmarks.suite.engines import ONE_THREAD, Result, Work, attempt
from benchmarks.suite.jobs import Failure, Job

OBJECT_STORE = 100_000_000
"""Memory of a local Ray's object store, bytes; results are small, and Ray would take a third of the machine."""

PATIENCE = 10.0
"""How long a cluster may take to take a connection, s."""


@dataclass(frozen=True)
class RayEngine:
    """Tasks of Ray core, one job each.

    Attributes
    ----------
    workers
        How many jobs are under way at once; None for as many as Ray has CPUs.
    timeout
        Wall-clock time, s, after which a job is given up and its worker killed. It begins when the job is handed to
        Ray.
    address
        Of a cluster that is up, as in ``ray.init``; None starts Ray on this machine, and ends it.
    """

    workers: int | None
    timeout: float
    address: str | None = None

    def run(self, jobs: Sequence[Job], work: Work) -> Generator[tuple[Job, Result]]:
        """Yield each job with what came of it; when the caller stops listening, tasks under way are cancelled.

        Raises
        ------
        ValueError
            If Ray is not installed, or there is no cluster at the address.
        """
        with _ray(self.workers, self.address) as ray:
            # A task that is tried again could be blamed for nothing, and its time-out would begin anew.
            task = ray.remote(num_cpus=1, max_retries=0)(attempt)
            slots = self.workers or max(int(ray.cluster_resources()["CPU"]), 1)
            waiting, busy = deque(jobs), dict[Any, tuple[Job, float]]()
            try:
                while waiting or busy:
                    while waiting and len(busy) < slots:
                        job = waiting.popleft()
                        busy[task.remote(work, job)] = job, time.monotonic() + self.timeout
                    patience = min(deadline for _, deadline in busy.values()) - time.monotonic()
                    ready, _ = ray.wait(list(busy), timeout=max(patience, 0.0))
                    for reference in ready or [each for each in busy if busy[each][1] <= time.monotonic()]:
                        job, _ = busy.pop(reference)
                        yield job, self._result(ray, reference) if ready else self._given_up(ray, reference)
            finally:
                for reference in busy:
                    ray.cancel(reference, force=True)

    def _given_up(self, ray: Any, reference: Any) -> Failure:
        ray.cancel(reference, force=True)
        return Failure(f"time-out: not done after {self.timeout:g} s")

    def _result(self, ray: Any, reference: Any) -> Result:
        try:
            result: Result = ray.get(reference)
        except ray.exceptions.RayError as error:
            # Ray's messages go on for paragraphs.
            first = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
            return Failure(f"{type(error).__name__}: {first}")
        return result


@contextmanager
def _ray(workers: int | None, address: str | None) -> Iterator[Any]:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # Ray's own choice of 15 lets its workers starve wherever something else is busy.
    os.environ.setdefault("RAY_worker_niceness", "0")
    try:
        import ray
    except ImportError as error:
        raise ValueError("--engine ray needs Ray: pip install 'limslam[ray]'") from error
    options: dict[str, Any] = {
        "log_to_driver": False,
        "logging_level": "ERROR",
        "runtime_env": {"env_vars": ONE_THREAD},
    }
    if address is not None:
        _check_answers(address)
    else:
        options |= {"num_cpus": workers, "include_dashboard": False, "object_store_memory": OBJECT_STORE}
    try:
        ray.init(address=address or "local", **options)
    except (ConnectionError, ValueError) as error:
        raise ValueError(f"--address {address}: no Ray cluster answers there: {str(error).splitlines()[0]}") from error
    try:
        yield ray
    finally:
        ray.shutdown()


def _check_answers(address: str) -> None:
    """Refuse an address ``host:port`` at which nobody listens; Ray itself would go on asking for ten minutes."""
    host, _, port = address.rpartition(":")
    if not (host and port.isdigit()) or "//" in address:
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), PATIENCE).close()
    except (OSError, OverflowError) as error:
        raise ValueError(f"--address {address}: no Ray cluster answers there: {error}") from error
