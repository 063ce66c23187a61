"""The results of an entry in a folder: ``arena.json`` says whose, and ``results.jsonl`` has one line for each plan.

A run can be killed at any moment. What was written stays, and the next run goes on from there.
"""

import hashlib
import json
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from limslam_agent.arena.entry import Entry, manifest_of, manifest_table
from limslam_agent.arena.tracks import VERSION, plans_of
from limslam_agent.output.atomic_write import append_line, mend_lines, replace_content
from limslam_agent.output.claims import clear_up, locked
from limslam_agent.output.provenance import changes
from limslam_agent.safe_files import read_limited
from limslam_env.messages import one_line

RESULTS, STAMP, RUNS, LOCK = "results.jsonl", "arena.json", "runs", ".lock"

_LARGEST = 1e15


@dataclass(frozen=True)
class Row:
    """The result of a plan.

    Attributes
    ----------
    plan
        Number of the plan.
    setting
        The plan itself.
    metrics
        Metrics by their names in ``docs/metrics.md`` and ``docs/arena.md``.
    cost
        Time and memory, which differ from run to run.
    versions, commit, settings
        Versions of packages, the commit of the checkout, and a digest of plan and entry.
    error
        Why the entry failed; None if it did not. A plan with an error is lost.
    """

    plan: int
    setting: dict[str, Any]
    metrics: dict[str, Any]
    cost: dict[str, float] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)
    commit: str = "unknown"
    settings: str = ""
    error: str | None = None


@dataclass(frozen=True)
class Stamp:
    """What all results of a folder have in common.

    Attributes
    ----------
    arena
        Version of the tracks and the scores.
    entry
        The manifest of the entry.
    folder
        The folder of the entry.
    digest
        Digest of the entry's files.
    plans
        Digest of the plans. It says whether two folders have the same plans, and nothing about a secret seed.
    is_secret
        Whether the plans come from a secret seed.
    versions, commit
        Versions of packages and commit of the checkout.
    """

    arena: int
    entry: dict[str, Any]
    folder: str
    digest: str
    plans: str
    is_secret: bool
    versions: dict[str, str]
    commit: str

    @property
    def track(self) -> str:
        """The track of the entry."""
        return str(self.entry.get("track", ""))


def stamp_of(entry: Entry, seed: int, *, is_secret: bool, versions: dict[str, str], commit: str) -> Stamp:
    """The stamp of an entry's results on the plans of a seed."""
    return Stamp(
        VERSION, manifest_table(entry.manifest), str(entry.folder), entry.digest,
        plans_digest(entry.manifest.track, seed), is_secret, versions, commit,
    )  # fmt: skip


def plans_digest(track: str, seed: int) -> str:
    """Digest of the plans of a track."""
    return digest_of([plan.setting for plan in plans_of(track, seed)])


def digest_of(content: Any) -> str:
    """Digest of what JSON can hold."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


class Store:
    """A folder of results that only this process writes to; see :func:`open_store`.

    Attributes
    ----------
    folder, stamp
        Path and stamp of the folder.
    rows
        The rows by the numbers of their plans.
    """

    def __init__(self, folder: Path, stamp: Stamp) -> None:
        self.folder, self.stamp = folder, stamp
        self.rows = {row.plan: row for row in read_rows(folder)}

    def append(self, row: Row) -> None:
        """Store a row durably."""
        append_line(self.folder / RESULTS, _line(row))
        self.rows[row.plan] = row

    def forget_failed(self, plans: Collection[int]) -> None:
        """Remove the rows of some plans that have an error, so that these plans are run again."""
        self.rows = {plan: row for plan, row in self.rows.items() if row.error is None or plan not in plans}
        replace_content(self.folder / RESULTS, b"".join(map(_line, self.rows.values())))


def _line(row: Row) -> bytes:
    return json.dumps(asdict(row), allow_nan=False).encode() + b"\n"


@contextmanager
def open_store(folder: Path, stamp: Stamp) -> Iterator[Store]:
    """Open a folder of results: create it if needed, repair it after a kill, and lock it.

    Raises
    ------
    ValueError
        If another process writes to the folder, or it holds something else.
    """
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: is not a folder")
    if folder.is_dir() and not (folder / STAMP).is_file() and any(path.name[0] != "." for path in folder.iterdir()):
        raise ValueError(f"{folder}: is not empty and holds no results of the arena")
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder / LOCK, f"{folder}: another run is writing there"):
        _check_stamp(folder, stamp)
        mend_lines(folder / RESULTS)
        for each in (folder, folder / RUNS):
            clear_up(each)
        yield Store(folder, stamp)


def read_stamp(folder: Path) -> Stamp:
    """The stamp of a folder of results.

    Raises
    ------
    ValueError
        If the folder holds no results of the arena.
    """
    path = folder / STAMP
    try:
        stamp = Stamp(**json.loads(read_limited(path)))
    except OSError as error:
        raise ValueError(f"{folder}: holds no results of the arena: {error.strerror or error}") from error
    except (ValueError, TypeError, RecursionError) as error:
        raise ValueError(one_line(f"{path}: is damaged: {error}")) from error
    for name, kind in Stamp.__annotations__.items():
        _check_type(getattr(stamp, name), kind, f"{path}: {name}")
    if stamp.arena != VERSION:
        raise ValueError(f"{folder}: holds results of version {stamp.arena} of the arena, not of {VERSION}")
    try:
        manifest_of(stamp.entry, f"{path}: entry")
    except ValueError as error:
        raise ValueError(one_line(str(error))) from error
    return stamp


def read_rows(folder: Path) -> list[Row]:
    """The rows of a folder of results, in the order of the plans. An incomplete last line is left out.

    Raises
    ------
    ValueError
        If a line is no row, or two rows have the same plan; the message names file and line.
    """
    path = folder / RESULTS
    try:
        content = read_limited(path)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from error
    rows: dict[int, Row] = {}
    for number, line in enumerate(content.split(b"\n")[:-1], 1):
        row = _row(line, f"{path}, line {number}")
        if row.plan in rows:
            raise ValueError(f"{path}, line {number}: there is a row for the plan {row.plan} already")
        rows[row.plan] = row
    return [rows[plan] for plan in sorted(rows)]


def _check_stamp(folder: Path, stamp: Stamp) -> None:
    if not (folder / STAMP).is_file():
        replace_content(folder / STAMP, json.dumps(asdict(stamp), indent=2).encode() + b"\n")
        return
    before = read_stamp(folder)
    if before.plans != stamp.plans:
        raise ValueError(f"{folder}: holds results of other plans: choose another folder")
    if before.digest != stamp.digest:
        raise ValueError(f"{folder}: holds results of another entry, or of this one before it was changed")
    if changed := changes(before, stamp):
        raise ValueError(f"{folder}: holds results of other versions ({changed}): choose another folder")


def _row(line: bytes, label: str) -> Row:
    try:
        row = Row(**json.loads(line, parse_float=_number, parse_int=_number, parse_constant=_number))
    except (ValueError, TypeError, RecursionError) as error:
        raise ValueError(one_line(f"{label}: is no row of results: {error}")) from error
    for name, kind in Row.__annotations__.items():
        _check_type(getattr(row, name), kind, f"{label}: {name}")
    for name, value in row.metrics.items():
        if not (value is None or isinstance(value, str | int | float)):
            raise ValueError(f"{label}: metrics: {name} is no number")
    return row


def _number(text: str) -> int | float:
    """A number of a row. Numbers that no result can be are refused: means and pages could not hold them."""
    value = int(text) if text.lstrip("-").isdecimal() else float(text)
    if not abs(value) < _LARGEST:  # NaN is not smaller either
        raise ValueError(f"{text[:20]} is no number of a result")
    return value


def _check_type(value: Any, kind: Any, label: str) -> None:
    """Refuse a value of another type than a field has. Of tables, only that they are tables is checked."""
    allowed = getattr(kind, "__origin__", kind)
    if not isinstance(value, allowed) or (kind is int and isinstance(value, bool)):
        raise ValueError(f"{label} is {str(value)[:40]!r}")
