"""A folder of results: a stamp says what all results have in common, and ``results.jsonl`` has a
line for each job.

A run can be killed at any moment. A line is valid only if it is complete, and the next run goes on
after the last one.
"""

import json
import types
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Generic, TypeVar, Union, get_args, get_origin, get_type_hints

from limslam_agent.output.atomic_write import append_line, mend_lines, replace_content
from limslam_agent.output.claims import clear_up, locked
from limslam_agent.safe_files import read_limited
from limslam_env.messages import one_line

RESULTS = "results.jsonl"
_LOCK = ".lock"
_MAX_BYTES = 256_000_000
_LARGEST = 1e100


@dataclass(frozen=True)
class BaseStamp:
    """What all results of a folder have in common: versions of packages, and the commit of the
    checkout.
    """

    versions: dict[str, str]
    commit: str

    @property
    def identity(self) -> Mapping[str, Hashable]:
        """What must be equal for results to go on, by the words that say what a folder with another
        one holds.
        """
        return {}

    def changes(self, now: "BaseStamp") -> str:
        """How versions and commit differ from those of now, in words. Empty if they do not."""
        changed = [
            f"{name} {self.versions.get(name, 'missing')}, now {now.versions.get(name, 'missing')}"
            for name in sorted(self.versions.keys() | now.versions.keys())
            if self.versions.get(name) != now.versions.get(name)
        ]
        return "; ".join(
            [
                *changed,
                *([f"commit {self.commit}, now {now.commit}"] if self.commit != now.commit else []),
            ]
        )


R = TypeVar("R")
S = TypeVar("S", bound=BaseStamp)


@dataclass(frozen=True)
class Format(Generic[S, R]):
    """A kind of results: what a folder holds, for messages, its stamp with the name of its file,
    and its rows.

    Fields of a row with ``compare=False`` may differ when a job is repeated. ``key`` tells the job
    of a row from others.
    """

    name: str
    stamp_file: str
    stamp: type[S]
    row: type[R]
    key: Callable[[R], Hashable]


class Store(Generic[R]):
    """A folder of results that only this process writes to (:func:`open_store`), and its rows by
    their keys.
    """

    def __init__(self, form: Format[Any, R], folder: Path, rows: Iterable[R]) -> None:
        self.folder = folder
        self._key = form.key
        self.rows: dict[Hashable, R] = {form.key(row): row for row in rows}

    def append(self, row: R) -> None:
        """Store a row durably: once this method has returned, a kill cannot lose it."""
        append_line(self.folder / RESULTS, _line(row))
        self.rows[self._key(row)] = row


@contextmanager
def open_store(
    form: Format[S, R], folder: Path, stamp: S, keep: Callable[[R], bool] = lambda _: True
) -> Iterator[Store[R]]:
    """Open a folder of results: create it if needed, repair it after a kill, and lock it.

    ``keep`` says whether an earlier row stays. The jobs of others are missing again.

    Raises
    ------
    ValueError
        If another process writes to the folder, or it holds something else, or results of another
        version or commit.
    """
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: is not a folder")
    is_new = not (folder / form.stamp_file).is_file()
    if is_new and folder.is_dir() and any(path.name[0] != "." for path in folder.iterdir()):
        raise ValueError(f"{folder}: is not empty and holds no {form.name}")
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder / _LOCK, f"{folder}: another run is writing there"):
        if (folder / form.stamp_file).is_file():
            before = read_stamp(form, folder)
            for what, value in stamp.identity.items():
                if before.identity[what] != value:
                    raise ValueError(f"{folder}: holds results of {what}: choose another folder")
            if changed := before.changes(stamp):
                raise ValueError(
                    f"{folder}: holds results of other versions ({changed}): choose another folder"
                )
        else:
            replace_content(
                folder / form.stamp_file, json.dumps(asdict(stamp), indent=2).encode() + b"\n"
            )
        mend_lines(folder / RESULTS)
        clear_up(folder)
        rows = read_rows(form, folder)
        kept = [row for row in rows_once(form, rows) if keep(row)]
        if len(kept) < len(rows):
            replace_content(folder / RESULTS, b"".join(map(_line, kept)))
        yield Store(form, folder, kept)


def read_stamp(form: Format[S, R], folder: Path) -> S:
    """The stamp of a folder of results.

    Raises
    ------
    ValueError
        If the folder holds no such results.
    """
    path = folder / form.stamp_file
    try:
        return _built(form.stamp, json.loads(read_limited(path)))
    except OSError as error:
        raise ValueError(f"{folder}: holds no {form.name}: {error.strerror or error}") from error
    except (ValueError, TypeError, RecursionError) as error:
        raise ValueError(one_line(f"{path}: is damaged: {error}")) from error


def read_rows(form: Format[Any, R], path: Path) -> list[R]:
    """The rows of a folder of results, or of a file of rows.

    An incomplete last line is left out. Such a line is still being written, or its process was
    killed.

    Raises
    ------
    ValueError
        If the file does not exist, or a line is no row; the message names file and line.
    """
    path = path / RESULTS if path.is_dir() else path
    try:
        lines = read_limited(path, _MAX_BYTES).split(b"\n")[:-1]
    except OSError as error:
        raise ValueError(f"{path}: no results there: {error.strerror or error}") from error
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            table = json.loads(line, parse_float=_number, parse_int=_number, parse_constant=_number)
            rows.append(_built(form.row, table))
        except (ValueError, TypeError, RecursionError) as error:
            raise ValueError(
                one_line(f"{path}, line {number}: is no row of results: {error}")
            ) from error
    return rows


def rows_once(form: Format[Any, R], rows: Iterable[R]) -> list[R]:
    """Each job's row once.

    Raises
    ------
    ValueError
        If two different rows have the same job.
    """
    found: dict[Hashable, R] = {}
    for row in rows:
        first = found.setdefault(form.key(row), row)
        if first != row:
            names = [each.name for each in fields(row) if each.compare]  # type: ignore[arg-type] # it is a dataclass
            different = next(name for name in names if getattr(first, name) != getattr(row, name))
            raise ValueError(
                f"two different rows claim the same job ({form.key(row)}): their {different} differ"
            )
    return list(found.values())


def _line(row: Any) -> bytes:
    return json.dumps(asdict(row), allow_nan=False).encode() + b"\n"


def _built(kind: type[R], table: Any) -> R:
    """A dataclass from a table of JSON, whose values have the types of its fields."""
    hints = get_type_hints(kind)
    if not isinstance(table, dict) or not table.keys() <= hints.keys():
        raise ValueError(f"it has not the fields {', '.join(hints)}")
    if wrong := [name for name, value in table.items() if not _fits(value, hints[name])]:
        raise ValueError(f"{wrong[0]} is {str(table[wrong[0]])[:60]!r}")
    return kind(**table)


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value of JSON has a type. A whole number, and true or false, are numbers, too."""
    if get_origin(hint) in {Union, types.UnionType}:
        return any(_fits(value, each) for each in get_args(hint))
    if get_origin(hint) is dict:
        return isinstance(value, dict) and all(
            _fits(each, get_args(hint)[1]) for each in value.values()
        )
    if get_origin(hint) is list:
        return isinstance(value, list) and all(_fits(each, get_args(hint)[0]) for each in value)
    if hint is Any:
        return True
    return isinstance(value, int | float) if hint is float else type(value) is hint


def _number(text: str) -> int | float:
    """A number of a row. Numbers that no result can be are refused: means and pages could not hold
    them.
    """
    value = int(text) if text.lstrip("-").isdecimal() else float(text)
    if not abs(value) < _LARGEST:  # NaN is not smaller either
        raise ValueError(f"{text[:20]} is no number of a result")
    return value
