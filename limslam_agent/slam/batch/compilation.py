"""How the kernels of the batch are compiled; in here numba is imported, and nowhere else in the agent."""

import inspect
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeVar, cast

from numba import njit

Kernel = TypeVar("Kernel", bound=Callable[..., object])


@cache
def _stamp(folder: Path) -> tuple[float, int]:
    """When the last of a folder's files was changed, and how long they are together."""
    files = [path.stat() for path in folder.glob("*.py")]
    return max(each.st_mtime for each in files), sum(each.st_size for each in files)


def compiled(kernel: Kernel) -> Kernel:
    """Compile what other kernels call, when they are."""
    return cast(Kernel, njit(nogil=True, error_model="numpy")(kernel))


def algebra(kernel: Kernel) -> Kernel:
    """The same for sums of products, in which a product and a sum may be rounded once."""
    return cast(Kernel, njit(nogil=True, error_model="numpy", fastmath={"contract"})(kernel))


def entry(kernel: Kernel) -> Kernel:
    """Compile what Python calls when it first does, with all that it calls, keep it on disk, and run without a lock."""
    done = njit(cache=True, nogil=True, error_model="numpy")(kernel)
    # What numba keeps on disk is used until the file of that kernel changes. It holds the code of all that is called,
    # too, so it has to go when any of their files changes. numba has no public way to say so.
    file = getattr(getattr(done, "_cache", None), "_cache_file", None)
    if file is not None:
        file._source_stamp = _stamp(Path(inspect.getfile(kernel)).parent)  # noqa: SLF001
    return cast(Kernel, done)
