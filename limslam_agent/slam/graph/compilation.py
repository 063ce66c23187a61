"""How the kernels of this package are compiled; in here numba is imported, and nowhere else in the package.

A kernel may call only kernels of its own file. What numba keeps on disk is used until that file changes, so it is never
stale.
"""

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def kernel(function: Kernel) -> Kernel:
    """Compile a function when it is first called, and keep it on disk."""
    return cast(Kernel, njit(cache=True, nogil=True, error_model="numpy")(function))
