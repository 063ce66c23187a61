"""Kernels are compiled by a second process, where there are two processors.

If the second process fails, even by a crash of the compiler, the first one finds nothing on disk and compiles the
kernels itself.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_LONGEST_WAIT = 120.0
"""How long the first process waits for the second process, s, before it compiles the kernels itself."""


@contextmanager
def beside(statements: str | None) -> Iterator[Callable[[], None]]:
    """Execute statements in a second process; yield a function that waits for it. The process ends with the block.

    Nothing depends on the process: if it cannot begin, or fails, or takes very long, nothing is said.
    """
    child = None if statements is None else _start(statements)
    try:
        yield lambda: None if child is None else _wait(child)
    finally:
        if child is not None and child.poll() is None:
            child.terminate()
            child.wait()


def processors() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _start(statements: str) -> "subprocess.Popen[bytes] | None":
    try:
        return subprocess.Popen(  # noqa: S603 (this interpreter, and statements of this package)
            [sys.executable, "-P", "-c", statements],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    except OSError:
        return None


def _wait(child: "subprocess.Popen[bytes]") -> None:
    try:
        child.wait(_LONGEST_WAIT)
    except subprocess.TimeoutExpired:
        child.terminate()
