"""Atomic file writing: a file is either complete or does not exist.

Results of many runs are lines of a file that is only appended to: a kill at any moment loses at
most the last line.
"""

import os
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from limslam_agent.output.claims import OutputError, claimed, hidden


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Write a file beside its final place, and move it to ``path`` when the context ends without an
    error.

    The context gets an empty file with the same suffix. Missing folders are made. After an error
    nothing is left; what a killed process leaves is removed by the next one that writes to the same
    folder. Raises an OutputError if another process is writing this file, and an OSError if it
    cannot be written there.
    """
    path = path.absolute()
    beside = hidden(path, "new", path.suffix.lower())
    with claimed(path):
        beside.write_bytes(b"")
        try:
            yield beside
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)


def check_target(
    path: Path, kind: str = "a file", endings: Collection[str] = (), *, force: bool
) -> None:
    """Refuse a file of another kind than its ending says, and one that would be replaced by
    accident. Raises an OutputError if the path ends in none of the endings, is a folder, or is a
    file that only ``force`` may replace.
    """
    if endings and path.suffix.lower() not in endings:
        raise OutputError(f"{path}: {kind} ends in {', '.join(endings)}")
    if path.is_dir():
        raise OutputError(f"{path}: is a folder")
    if path.exists() and not force:
        raise OutputError(f"{path}: already exists; --force replaces it")


def append_line(path: Path, line: bytes) -> None:
    """Append a line durably: once this function has returned, a kill cannot lose the line. Raises
    an OSError if the line cannot be written as a whole.
    """
    with path.open("ab", buffering=0) as file:
        written = file.write(line)
        if written != len(
            line
        ):  # the disk is full: the incomplete line is removed at the next start
            raise OSError(None, "the disk takes no more", str(path))
        os.fsync(file.fileno())


def mend_lines(path: Path) -> None:
    """Remove an incomplete last line, which remains after a kill. A file that does not exist is
    made.
    """
    content = path.read_bytes() if path.is_file() else b""
    whole = content[: content.rfind(b"\n") + 1]
    if whole != content or not path.is_file():
        replace_content(path, whole)


def replace_content(path: Path, content: bytes) -> None:
    """Give a file another content, as a whole or not at all."""
    with atomic_write(path) as beside:
        beside.write_bytes(content)
