"""Atomic file writing: a file is either complete or does not exist."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Write a file beside its final place, and move it to ``path`` when the context ends without an error.

    Missing folders are made at the end. After an error nothing is left.

    Yields
    ------
    Path
        An empty file with the same suffix, beside ``path`` or in the nearest existing folder above it.

    Raises
    ------
    OSError
        If the file cannot be written there.
    """
    path = path.absolute()
    folder = next(parent for parent in path.parents if parent.exists())
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix.lower(), dir=folder)
    os.close(handle)
    beside = Path(name)
    try:
        yield beside
        # mkstemp makes private files. Results get the permissions of the user's other files.
        mask = os.umask(0)
        os.umask(mask)
        beside.chmod(0o666 & ~mask)
        path.parent.mkdir(parents=True, exist_ok=True)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
