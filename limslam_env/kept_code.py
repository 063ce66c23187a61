"""Compiled code on disk: when it is used, what is done about damaged files, and what the user is
told.

This uses parts of numba that are not public. ``limslam_env.compilation`` uses it for the versions
of numba that it was tried with.
"""

import contextlib
import pickle
import zlib
from typing import Any

from numba.core import caching, environment
from numba.core.runtime.nrt import rtsys

from limslam_env.messages import announce, announce_once

_SECONDS = {"advance": 7, "step_some": 25}
"""Kernels that take long to compile, and about how long on a usual processor, s."""


def _environment(module: str, constants: list[Any], name: str) -> Any:
    """What compiled code knows of its function: its constants, and the globals, which no code of
    ours reads.

    numba imports the modules of its own functions for the latter, which takes longer than to load
    all kernels.
    """
    known = environment.lookup_environment(name)
    if known is None:
        known = environment.Environment({"__name__": module})
        known.consts[:] = constants
        known.env_name = name
        environment.Environment._memo[name] = known  # noqa: SLF001
    return known


class _CheckedFile(caching.IndexDataCacheFile):
    """The files of a kernel's compiled code, with a checksum: damaged machine code that is run can
    do anything.
    """

    def _save_data(self, name: str, data: Any) -> None:
        content = self._dump(data)
        super()._save_data(name, (zlib.crc32(content), content))

    def _load_data(self, name: str) -> Any:
        checksum, content = super()._load_data(name)
        if zlib.crc32(content) != checksum:
            raise ValueError(f"{name} is damaged")
        return pickle.loads(content)  # noqa: S301 # what numba itself has written


def keep(kept: Any, name: str, stamp: str) -> None:
    """Keep a kernel on disk until the stamp of its sources changes. Files that cannot be used are
    as good as absent, whatever is wrong with them.

    A kernel that is not on disk and has to be compiled is announced: those that take long, and the
    first.

    numba loads all that it could need to compile something before it looks at the disk, which takes
    longer than to load an agent. Its compiler loads the same, so here code from the disk does
    without it.
    """
    # numba asks its cache for the code before it compiles.
    cache = kept._cache  # noqa: SLF001
    cache._cache_file = _CheckedFile(  # noqa: SLF001
        cache.cache_path,
        cache._impl.filename_base,  # noqa: SLF001
        stamp,
    )
    save_overload = cache.save_overload

    def load_or_announce(signature: Any, target: Any) -> Any:
        # A kernel that makes no arrays may hold functions that were compiled for one that does, and
        # they count references.
        rtsys.initialize(target)
        usual = environment._rebuild_env  # noqa: SLF001
        environment._rebuild_env = _environment  # noqa: SLF001
        try:
            found = cache._load_overload(signature, target)  # noqa: SLF001
        except Exception:  # noqa: BLE001 # damaged files can raise anything
            found = None
            with contextlib.suppress(OSError):
                cache.flush()
        finally:
            environment._rebuild_env = usual  # noqa: SLF001
        if found is None and name in _SECONDS:
            announce(f"compiling {name!r}, once, about {_SECONDS[name]} s")
        elif found is None:
            announce_once(
                "compiling small kernels, once, a few seconds; `limslam warmup` compiles all of "
                "them beforehand"
            )
        return found

    def save_or_announce(signature: Any, made: Any) -> None:
        try:
            save_overload(signature, made)
        except Exception as error:  # noqa: BLE001 # the disk is full, or files cannot be replaced
            announce_once(f"compiled code cannot be kept in {cache.cache_path}: {error}")

    cache.load_overload = load_or_announce
    cache.save_overload = save_or_announce
