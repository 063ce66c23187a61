"""Work on many things in threads."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Thing = TypeVar("Thing")
Result = TypeVar("Result")


def cores() -> int:
    """Number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def work_through(work: Callable[[Thing], Result], things: Sequence[Thing], threads: int) -> Iterator[Result]:
    """The results of ``work`` on many things, in their order, from several threads.

    An error of ``work`` is raised in the place of its result; things that have not begun then are left out.
    """
    with ThreadPoolExecutor(threads) as pool:
        yield from pool.map(work, things)
