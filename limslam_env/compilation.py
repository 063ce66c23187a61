"""Decorators that compile kernels with numba, for the simulator and the agent.

Only this module and two that it needs import numba: ``limslam_env.linking`` compiles faster, and
``limslam_env.kept_code`` keeps compiled code on disk. Those two use parts of numba that are not
public, and only a numba that was tried is handed to them.

numba can keep compiled code on disk. It discards that code when the file of the compiled function
changes, but the code also contains every function and every constant that the function uses from
other files. Here the code is discarded whenever the text of any file changes in the packages that
the decorator names.
"""

import contextlib
import functools
import gc
import hashlib
import importlib.util
import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from limslam_env.messages import announce_once

Kernel = TypeVar("Kernel", bound=Callable[..., object])

ENV_SOURCES = (
    "limslam_env.compilation",
    "limslam_env.kept_code",
    "limslam_env.linking",
    "limslam_env.geometry",
    "limslam_env.kernels",
)
"""The modules and the packages that the kernels of ``limslam_env`` are made of."""

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}

_TRIED = ("0.61.", "0.62.", "0.63.", "0.64.", "0.65.", "0.66.", "0.67.", "0.68.")
"""Versions of numba whose parts that are not public were tried: how their names begin."""

_USES_INTERNALS = (
    numba.__version__.startswith(_TRIED)
    and not getattr(numba.config, "DISABLE_JIT", False)
    and not os.environ.get("LIMSLAM_PUBLIC_NUMBA")
)
"""Whether kernels are kept on disk and linked by ``limslam_env.linking``. Both use parts of numba
that are not public. Otherwise each start compiles anew, by the public interface.
"""

# The added option leaves out the counting of references to arrays. It is not public.
_LEAN: dict[str, Any] = {**_OPTIONS, "_nrt": False} if _USES_INTERNALS else _OPTIONS


def _njit(kernel: Kernel, *, is_kernel: bool = False, **options: Any) -> Any:
    """Compile by way of ``limslam_env.linking``, if this version of numba was tried."""
    function = njit(**options)(kernel)
    if _USES_INTERNALS:
        _link(function, is_kernel)
    return function


@contextlib.contextmanager
def _without_collection() -> Iterator[None]:
    """Leave the search for unused objects until later: it takes a tenth of the time and finds next
    to nothing.
    """
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def _link(function: Any, is_kernel: bool) -> None:
    """Leave a function to ``limslam_env.linking``, which is loaded when something is compiled: most
    starts need none.

    Calls with constants share the code of calls with variables. numba compiles a function for each
    constant.
    """
    part = function._compiler  # noqa: SLF001
    compile_core = part._compile_core  # noqa: SLF001
    of_types = function.get_call_template

    def compile_by_linking(*arguments: Any) -> Any:
        with _without_collection():
            try:
                from limslam_env.linking import compile_or_retry
            except (ImportError, AttributeError):
                return compile_core(*arguments)
            return compile_or_retry(part, compile_core, arguments, is_kernel=is_kernel)

    def of_plain_types(arguments: Any, named: Any) -> Any:
        plain = tuple(types.unliteral(argument) for argument in arguments)
        return of_types(
            plain, {name: types.unliteral(argument) for name, argument in named.items()}
        )

    part._compile_core = compile_by_linking  # noqa: SLF001
    function.get_call_template = of_plain_types


def compiled(kernel: Kernel) -> Kernel:
    """Compile a function that other kernels call."""
    return cast(Kernel, _njit(kernel, **_OPTIONS))


def inlined(kernel: Kernel) -> Kernel:
    """Compile a short function, which makes no arrays, as part of its callers: numba copies it."""
    return cast(Kernel, njit(inline="always", **_LEAN)(kernel))


def merged(kernel: Kernel) -> Kernel:
    """Compile a function with loops or several returns, which makes no arrays, for LLVM to copy
    into its callers.
    """
    return cast(Kernel, _njit(kernel, forceinline=True, **_LEAN))


def _prefetch(typing_context: Any, array: Any, row: Any, column: Any) -> Any:
    """The code of ``prefetch``, as numba asks for it."""
    del typing_context

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        struct = context.make_array(signature.args[0])(context, builder, values[0])
        places = [
            context.cast(builder, value, kind, types.intp)
            for value, kind in zip(values[1:], signature.args[1:], strict=True)
        ]
        strides = cgutils.unpack_tuple(builder, struct.strides)
        terms = [builder.mul(place, stride) for place, stride in zip(places, strides, strict=True)]
        address = builder.ptrtoint(struct.data, places[0].type)
        pointer = builder.inttoptr(
            builder.add(address, builder.add(*terms)), ir.IntType(8).as_pointer()
        )
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [pointer.type, number, number, number])
        function = builder.module.declare_intrinsic("llvm.prefetch", (pointer.type,), kind)
        # The arguments say that the memory will be read (0), stays in all caches (3), and holds
        # data and no code (1).
        builder.call(function, [pointer, *(ir.Constant(number, value) for value in (0, 3, 1))])
        return context.get_dummy_value()

    return types.none(array, row, column), generate


prefetch: Callable[[Any, Any, Any], None] = cast(Any, intrinsic(_prefetch))
"""Asks the processor for ``array[row, column]``, which is used soon. The place may lie outside of
the array.
"""


def _next_of(typing_context: Any, counter: Any) -> Any:
    """The code of ``next_of``, as numba asks for it."""
    del typing_context

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        struct = context.make_array(signature.args[0])(context, builder, values[0])
        return builder.atomic_rmw("add", struct.data, ir.Constant(ir.IntType(64), 1), "monotonic")

    return types.int64(counter), generate


next_of: Callable[[Any], int] = cast(Any, intrinsic(_next_of))
"""The first number of an array of int64, which is then one larger: threads that share the array get
different ones.
"""


@inlined
def floored(number: float) -> int:
    """The largest whole number that is not above a number. On a GPU, ``math.floor`` alone gives
    another float.
    """
    return int(math.floor(number))  # noqa: RUF046


def entry_of(*sources: str, allocates: bool = True) -> Callable[[Kernel], Kernel]:
    """A decorator for kernels that Python calls: they are compiled at the first call, and kept on
    disk.

    ``sources`` are the modules and packages (without the packages inside of them) whose functions
    and constants the kernels use, besides ``ENV_SOURCES``. Kernels that make no arrays, nor call
    functions that make some, run without counting references to arrays, so that arrays can be
    handed from function to function at no cost.
    """
    options = _OPTIONS if allocates else _LEAN

    def entry(kernel: Kernel) -> Kernel:
        if _USES_INTERNALS:
            try:
                kept = _njit(kernel, is_kernel=True, cache=True, **options)
            except RuntimeError:  # numba found no folder that it may write to
                announce_once(
                    "no folder for compiled code can be written, so each start compiles anew; "
                    "set NUMBA_CACHE_DIR to a folder"
                )
            else:
                from limslam_env.kept_code import keep

                keep(kept, kernel.__name__, source_stamp(*ENV_SOURCES, *sources))
                return cast(Kernel, kept)
        return cast(Kernel, _njit(kernel, is_kernel=True, **options))

    return entry


@functools.cache
def source_stamp(*sources: str) -> str:
    """A digest of the text of modules and packages, given by their dotted names."""
    digest = hashlib.sha256()
    for source in sources:
        for path in _files_of(source):
            digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _files_of(source: str) -> list[Path]:
    spec = importlib.util.find_spec(source)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(f"no module named {source!r}", name=source)
    origin = Path(spec.origin)
    return sorted(origin.parent.glob("*.py")) if spec.submodule_search_locations else [origin]


entry = entry_of()
"""The decorator for kernels of ``limslam_env`` that Python calls."""

lean_entry = entry_of(allocates=False)
"""The same for kernels that make no arrays."""
