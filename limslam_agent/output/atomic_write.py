"""Files that are whole or not there at all: written beside their place, and moved there when they are done."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A file to write to, which takes its place at ``path`` when the context ends well, and is gone otherwise.

    Folders that are missing are made at the end.

    Yields
    ------
    Path
        An empty file of the same suffix, beside ``path`` or in the nearest folder above it that is there.

    Raises
    ------
    OSError
        If nothing can be written there.
    """
    path = path.absolute()
    folder = next(parent for parent in path.parents if parent.exists())
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix.lower(), dir=folder)
    os.close(handle)
    beside = Path(name)
    try:
        yield beside
        # mkstemp's files are private; results are as readable as the user's other files.
        mask = os.umask(0)
        os.umask(mask)
        beside.chmod(0o666 & ~mask)
        path.parent.mkdir(parents=True, exist_ok=True)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
