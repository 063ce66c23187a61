"""Claims on the places of results: one process at a time writes to a place, and a kill leaves
nothing half-written.

Beside a place ``NAME`` there are hidden files while a process writes there:

- ``.NAME.limslam-lock``: held by the process, and free when the process has died;
- ``.NAME.limslam-new``: what is being written, with the suffix of a file;
- ``.NAME.limslam-old``: the earlier result, until the new one is in its place.

Whoever next gets the lock of the place finds out from them how far a dead process had come.
"""

import errno
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

PATIENCE = 0.5
"""Time, s, to wait for another process that only looks after a dead process's files."""

_HIDDEN = re.compile(r"\.(?P<name>.+)\.limslam-(?:lock|new|old)(?:\.\w+)?")


class OutputError(ValueError):
    """Results cannot be written to a place. The message says where and why."""


class ClaimedError(OutputError):
    """Another process writes to the place."""


def hidden(path: Path, kind: str, suffix: str = "") -> Path:
    """The hidden file of a kind (``lock``, ``new`` or ``old``) beside a place."""
    return path.with_name(f".{path.name}.limslam-{kind}{suffix}")


@contextmanager
def locked(lock_file: Path, refusal: str, patience: float = PATIENCE) -> Iterator[None]:
    """Hold a lock that no other process has, and that ends with the process. Raises a ClaimedError
    with the message ``refusal`` if another process holds it, and an OSError if there can be no
    file.
    """
    lock = FileLock(lock_file)
    try:
        lock.acquire(timeout=patience, poll_interval=0.02)
    except Timeout:
        raise ClaimedError(refusal) from None
    try:
        yield
    finally:
        # While the lock is held, nobody else holds one on this file, and who waits for it will
        # notice that it is gone. Windows removes no open file; there, filelock removes it.
        with suppress(OSError):
            lock_file.unlink()
        lock.release()


@contextmanager
def claimed(path: Path) -> Iterator[None]:
    """Be the only process that writes to a place, after clearing up what dead processes left in its
    folder.

    Missing folders are made, and removed again if they are still empty at the end. Raises a
    ClaimedError if another process writes there, and an OSError if nothing can be written there.
    """
    missing = [parent for parent in path.parents if not parent.exists()]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        clear_up(path.parent)
        with locked(hidden(path, "lock"), f"{path}: another process is writing there"):
            recover(path)
            yield
    except OSError as error:
        if error.errno == errno.ENOSPC:  # such an error names no file
            error.filename = error.filename or str(path)
        raise
    finally:
        for parent in missing:
            with suppress(OSError):  # it is not empty
                parent.rmdir()


def clear_up(folder: Path) -> None:
    """Restore or remove what dead processes left in a folder. Live processes, which hold their
    locks, are left alone.

    What cannot be removed, for lack of permission for instance, stays.
    """
    found = {match["name"] for each in _hidden_names(folder) if (match := _HIDDEN.fullmatch(each))}
    for name in sorted(found):
        with suppress(ClaimedError, OSError):
            repair(folder / name)


def repair(path: Path) -> None:
    """Restore or remove what a dead process left of a place. Raises a ClaimedError if a live
    process writes there, and an OSError if it cannot be done.
    """
    with locked(hidden(path, "lock"), f"{path}: another process is writing there", 0.0):
        recover(path)


def recover(path: Path) -> None:
    """Put the earlier result back if a process died before the new one was in place, and remove the
    rest.

    The process that calls this holds the place's lock.
    """
    old = hidden(path, "old")
    if os.path.lexists(old):
        if os.path.lexists(path):
            _remove(old)
        else:
            old.rename(path)
    for name in _hidden_names(path.parent):
        if name.startswith(hidden(path, "new").name):
            _remove(path.with_name(name))


def _hidden_names(folder: Path) -> list[str]:
    try:
        return [each.name for each in folder.iterdir() if each.name.startswith(".")]
    except OSError:
        return []


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
