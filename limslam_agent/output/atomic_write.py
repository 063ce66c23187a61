"""Atomic file writing: a file is either complete or does not exist."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from limslam_agent.output.claims import claimed, hidden, sync_file, sync_folder


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Write a file beside its final place, and move it to ``path`` when the context ends without an error.

    Missing folders are made. After an error nothing is left; what a killed process leaves is removed by the next one
    that writes to the same folder.

    Yields
    ------
    Path
        An empty file with the same suffix, beside ``path``.

    Raises
    ------
    OutputError
        If another process is writing this file.
    OSError
        If the file cannot be written there.
    """
    path = path.absolute()
    beside = hidden(path, "new", path.suffix.lower())
    with claimed(path):
        beside.write_bytes(b"")
        try:
            yield beside
            sync_file(beside)
            beside.replace(path)
            sync_folder(path.parent)
        finally:
            beside.unlink(missing_ok=True)
