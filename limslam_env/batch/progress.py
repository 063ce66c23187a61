"""Work on many things in threads, and a bar of its progress."""

import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

from limslam_env.messages import QUIET

_SHOWN_AFTER = 1.0  # s
_WIDTH = 30

Thing = TypeVar("Thing")
Result = TypeVar("Result")


def cores() -> int:
    """Number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def work_through(work: Callable[[Thing], Result], things: Sequence[Thing], threads: int, name: str) -> Iterator[Result]:
    """The results of ``work`` on many things, in their order, from several threads.

    A terminal shows a bar after a second, with ``name`` for what is worked on. ``LIMSLAM_QUIET`` switches the bar off.
    An error of ``work`` is raised in the place of its result; things that have not begun then are left out.
    """
    with _bar(name, len(things)) as advance:
        if threads == 1 or len(things) == 1:
            for thing in things:
                yield work(thing)
                advance()
            return
        with ThreadPoolExecutor(min(threads, len(things))) as pool:
            # A result that has been handed on is not kept: thousands of them are much memory.
            waiting = deque(pool.submit(work, thing) for thing in things)
            try:
                while waiting:
                    yield waiting.popleft().result()
                    advance()
            finally:
                pool.shutdown(wait=False, cancel_futures=True)


@contextmanager
def _bar(name: str, count: int) -> Iterator[Callable[[], None]]:
    """A function that is called once for each thing that is done, and draws the bar."""
    if os.environ.get(QUIET) or sys.stderr is None or not sys.stderr.isatty():
        yield lambda: None
        return
    begin, done, shown = time.monotonic(), 0, 0.0

    def advance() -> None:
        nonlocal done, shown
        done += 1
        now = time.monotonic()
        if now - begin > _SHOWN_AFTER and (now - shown > 0.2 or done == count):
            shown = now
            filled = "#" * (_WIDTH * done // count)
            left = (now - begin) / done * (count - done)
            sys.stderr.write(f"\rlimslam: {name} [{filled:<{_WIDTH}}] {done} of {count}, {left:.0f} s left \x1b[K")
            sys.stderr.flush()

    try:
        yield advance
    finally:
        if shown:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()
