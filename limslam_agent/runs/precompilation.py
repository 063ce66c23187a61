"""Kernels are compiled by a second process, where there are two processors: the line smoother while a robot drives.

A run needs the smoother at its end only, so nobody waits for it. If the second process fails, even by a crash of the
compiler, the first one finds nothing on disk and compiles the kernels itself.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_SECONDS = 10
"""About how long the kernels take to compile on a usual processor, s."""
_LONGEST_WAIT = 120.0
"""How long a run waits for the second process, s, before it compiles the kernels itself."""


def kernels_of_smoother() -> list[tuple[Any, str]]:
    """The kernels that each smoothing calls, with their arguments in the letters of ``compile_for``."""
    from limslam_agent.slam.least_squares.selected_inverse import selected_inverse
    from limslam_agent.slam.line_graph import line_kernels

    return [
        (selected_inverse, "i1 i1 f1 f1 f1"),
        (line_kernels.fit_lines, "f2 i1 f f2 f2"),
        (line_kernels.best_lines, "f2 i1 f2 f1 f2 f2 f3 f f i1 f2"),
        (line_kernels.one_sided_runs, "f1 i1 f i b1"),
        (line_kernels.count_crossings, "f2 i1 f2 f1 f2 f2 i1 i2 f i2"),
    ]


@contextmanager
def smoother_beside() -> Iterator[Callable[[], None]]:
    """Let a second process compile the smoother if it is not on disk; yield a function that waits for the process."""
    from limslam_env.compilation import is_kept
    from limslam_env.messages import announce

    is_needed = processors() > 1 and not all(is_kept(kernel) for kernel, _ in kernels_of_smoother())
    if is_needed:
        announce(f"a second process compiles the smoother, once, about {_SECONDS} s, while the robot drives")
    with beside(f"from {__name__} import main; main()" if is_needed else None) as wait:
        yield wait


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


def main() -> None:
    """Compile the kernels of the smoother, and keep them on disk."""
    from limslam_env.compilation import compile_for

    for kernel, arguments in kernels_of_smoother():
        compile_for(kernel, arguments)
