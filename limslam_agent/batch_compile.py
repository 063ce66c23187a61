"""How the kernels of the batch are compiled; in here numba is imported, and nowhere else in the agent."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from numba import njit

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def _stamp() -> tuple[float, int]:
    """When the last of the kernels' files was changed, and how long they are together."""
    files = [path.stat() for path in Path(__file__).parent.glob("batch_*.py")]
    return max(each.st_mtime for each in files), sum(each.st_size for each in files)


_STAMP = _stamp()


def compiled(kernel: Kernel) -> Kernel:
    """Compile when first called, keep the result on disk, and run without Python's lock."""
    return _noticing_others(njit(cache=True, nogil=True, error_model="numpy")(kernel))


def algebra(kernel: Kernel) -> Kernel:
    """The same for sums of products, in which a product and a sum may be rounded once."""
    return _noticing_others(njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})(kernel))


def _noticing_others(kernel: Kernel) -> Kernel:
    # What numba keeps on disk is used until the file of that kernel changes. A kernel holds the code of those that it
    # calls, too, so it has to go when the file of any of them changes. numba has no public way to say so.
    file = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if file is not None:
        file._source_stamp = _STAMP  # noqa: SLF001
    return kernel
