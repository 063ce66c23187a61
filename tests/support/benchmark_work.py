"""Work for the engines of the benchmark that takes no time, and work that fails. Worker processes
import it.
"""

import os
import signal
import sys
import time

from benchmarks.suite.jobs import Job, Outcome
from benchmarks.suite.runner import ONE_THREAD

RAISES = 1
KILLED = 2
EXITS = 3
HANGS = 1000
"""Seeds of jobs that go wrong."""


def outcome(job: Job) -> Outcome:
    return Outcome({"ate_m": job.noise + job.seed, "doors_open": None}, {"job_s": 0.1}, "c0ffee")


def troubled(job: Job) -> Outcome:
    if job.seed == RAISES:
        raise ArithmeticError("two\nlines")
    if job.seed == KILLED:
        os.kill(os.getpid(), signal.SIGKILL)
    if job.seed == EXITS:
        sys.exit(7)
    if job.seed == HANGS:
        time.sleep(1000.0)
    return Outcome({"seed": job.seed, **threads()}, {}, "c0ffee")


def threads() -> dict[str, str | int | None]:
    """How many threads a worker may have."""
    import cv2

    return {**{name: os.environ.get(name) for name in ONE_THREAD}, "cv2": cv2.getNumThreads()}
