"""What processes of workers and entries have in common: their end, and the messages of their failures."""

import multiprocessing
import os
import re
import signal
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import IO

_LAST_BYTES = 4096


def begin_group() -> None:
    """Make this process the first of a new process group, so that commands which it starts can be ended with it."""
    if sys.platform != "win32":
        os.setpgid(0, 0)


def kill_group(number: int) -> None:
    """Kill a process that has called :func:`begin_group`, and all processes of its group.

    Windows has no process groups of this kind: there, only the process itself is killed.
    """
    if sys.platform == "win32":
        os.kill(number, signal.SIGTERM)
    else:
        os.killpg(number, signal.SIGKILL)


def end_with_parent(end: Callable[[int], object] = os._exit) -> None:
    """Wait until the parent of this process has died, and end this process. To be called in a thread of its own.

    ``end`` ends the process with an exit code. A job may take minutes. A run that was killed and is started again
    should have those processors to itself.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        end(1)


def last_line(errors: IO[bytes]) -> str:
    """The last line that a process has written to a file of errors. Of a long file only the end is read."""
    errors.seek(max(errors.seek(0, os.SEEK_END) - _LAST_BYTES, 0))
    return errors.read(_LAST_BYTES).decode(errors="replace").strip().rpartition("\n")[2]


def without_folders(text: str, folders: Iterable[Path]) -> str:
    """A message without the folders of its paths, so that the same failure has the same message in every run."""
    names = {str(each) for folder in folders for each in (folder, folder.resolve())}
    for name in sorted(names, key=len, reverse=True):
        text = re.sub(rf"{re.escape(name)}(?![\w-])", ".", text.replace(name + os.sep, ""))
    return text.replace(sys.executable, "{python}")
