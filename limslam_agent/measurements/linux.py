"""What only Linux offers to keep processes apart. On other systems these functions do nothing."""

import ctypes
import os
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

# numbers of prctl(2)
_SET_DUMPABLE = 4
_SET_CHILD_SUBREAPER = 36
# s, between two rounds of ending processes
_ROUNDS = 100
_PAUSE = 0.02


def hide_memory() -> None:
    """Hide the memory and the environment of this process from other processes of the same user."""
    _prctl(_SET_DUMPABLE, 0)


def adopt_orphans() -> None:
    """Become the parent of what this process has started, once its own parent has ended, so that
    :func:`kill_descendants` finds it.
    """
    _prctl(_SET_CHILD_SUBREAPER, 1)


def kill_descendants(number: int) -> None:
    """Kill all processes that the process ``number`` has started, and what those have started."""
    if sys.platform != "linux":
        return
    for _ in range(_ROUNDS):
        alive = False
        for each, has_ended in _descendants(number):
            with suppress(OSError):  # it has ended, or belongs to somebody else
                os.kill(each, signal.SIGKILL)
            with suppress(ChildProcessError):  # it is a child of another process
                os.waitpid(each, os.WNOHANG)
            alive = alive or not has_ended
        if not alive:
            return
        time.sleep(_PAUSE)


def _descendants(number: int) -> list[tuple[int, bool]]:
    """The processes below a process, and whether each has ended and only awaits its parent."""
    children: dict[int, list[tuple[int, bool]]] = {}
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended meanwhile
            state, parent = (place / "stat").read_text().rpartition(")")[2].split()[:2]
            children.setdefault(int(parent), []).append((int(place.name), state == "Z"))
    found = list(children.get(number, []))
    for each, _ in found:  # which grows meanwhile
        found += children.get(each, [])
    return found


def _prctl(option: int, value: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)
