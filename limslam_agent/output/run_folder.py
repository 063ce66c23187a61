"""The folder of a run: claimed at the start, and put in place as a whole or not at all."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from limslam_agent.output.claims import ClaimedError, OutputError, claimed, hidden, recover

RESULT_FILE = "result.json"


@dataclass(frozen=True)
class NewFolder:
    """A folder of results in the making."""

    beside: Path  # The hidden folder to write to
    target: Path  # Its final place


@contextmanager
def new_folder(target: Path, *, force: bool = False, numbered: bool = False) -> Iterator[NewFolder]:
    """A folder to write to, which is moved to its final place only when everything has been
    written.

    The place belongs to this process from the start. A process that is killed leaves the earlier
    results there, or the new ones, and hidden files that are removed when the next process writes
    to the same parent folder.

    Parameters
    ----------
    target
        Final place of the results. An empty folder may exist there.
    force
        Replace the results of an earlier run there.
    numbered
        If the place is taken, by results or by another process, choose the first free place of
        ``target-2``, ``target-3`` and so on.

    Raises
    ------
    OutputError
        If something else is there, another process writes there, or the folder cannot be written.
    """
    with ExitStack() as stack:
        place = _claim_numbered(target, stack) if numbered else _claim(target, stack, force=force)
        beside = hidden(place.absolute(), "new")
        try:
            beside.mkdir()
        except OSError as error:
            raise OutputError(f"{target}: cannot be written: {error.strerror or error}") from error
        try:
            yield NewFolder(beside, place)
            _put_in_place(beside, place, force=force)
        finally:
            recover(place.absolute())


def _claim(target: Path, stack: ExitStack, *, force: bool) -> Path:
    """Claim a place for as long as the stack is open, if results may be written there."""
    try:
        stack.enter_context(claimed(target.absolute()))
    except OSError as error:
        raise OutputError(f"{target}: cannot be written: {error.strerror or error}") from error
    _check_target(target, force=force)
    return target


def _claim_numbered(target: Path, stack: ExitStack) -> Path:
    for number in count(1):
        candidate = target if number == 1 else target.with_name(f"{target.name}-{number}")
        if candidate.exists():
            continue
        attempt = ExitStack()
        try:
            _claim(candidate, attempt, force=False)
        except ClaimedError:
            continue
        # Another process may have written the folder and ended since its name was chosen.
        if candidate.exists():
            attempt.close()
            continue
        stack.push(attempt)
        return candidate
    raise AssertionError("numbers never end")


def _check_target(target: Path, *, force: bool) -> None:
    if target.is_dir():
        if not any(target.iterdir()):
            return
        if not (target / RESULT_FILE).is_file():
            raise OutputError(f"{target}: is not empty and does not hold the results of a run")
        if not force:
            raise OutputError(
                f"{target}: already holds the results of a run; --force replaces them"
            )
    elif target.exists() or target.is_symlink():
        raise OutputError(f"{target}: is not a folder")


def _put_in_place(beside: Path, target: Path, *, force: bool) -> None:
    """Move finished results to their place, unless something else has come there that may not be
    replaced.
    """
    place = target.absolute()
    try:
        _check_target(target, force=force)
    except OutputError as error:
        spare = next(
            path for n in count(2) if not (path := place.with_name(f"{place.name}-{n}")).exists()
        )
        beside.rename(spare)
        raise OutputError(
            f"{error}; these results are in {target.with_name(spare.name)}"
        ) from error
    if place.is_dir():
        place.rename(hidden(place, "old"))
    beside.rename(place)
