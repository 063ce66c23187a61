"""Worker processes that end when the process that started them has died."""

import multiprocessing
import os
from collections.abc import Callable


def end_with_parent(end: Callable[[int], object] = os._exit) -> None:
    """Wait until the parent of this process has died, and end this process. To be called in a thread of its own.

    ``end`` ends the process with an exit code. A job may take minutes. A run that was killed and is started again
    should have those processors to itself.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        end(1)
