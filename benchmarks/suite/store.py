"""The results of a suite in a folder: one line of JSON for each job, appended when the job has ended.

A run can be killed at any moment. A line is valid only if it is complete. The series of a job are written before its
line.
"""

import json
import sys
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.suite.jobs import Failure, Job, Metric, Outcome
from limslam_agent.output.atomic_write import append_line, atomic_write, mend_lines, replace_content
from limslam_agent.output.claims import clear_up, locked
from limslam_agent.output.provenance import changes
from limslam_agent.safe_files import read_limited
from limslam_env.messages import one_line

RESULTS, STAMP, LOCK, SERIES = "results.jsonl", "suite.json", ".lock", "series"
MAX_RESULTS_BYTES = 256_000_000


@dataclass(frozen=True)
class Row:
    """A line of ``results.jsonl``: a job and its result.

    Attributes
    ----------
    world, noise, robots, preset, policy, ablation, laps, seed
        The fields of the job. ``policy`` is ``laps`` if laps were driven, and ``replay`` for a recorded log, whose
        world is ``log:NAME``.
    metrics
        Metrics by their names in ``docs/metrics.md``; empty if the job failed.
    cost
        Time and memory, which are ignored in comparisons for identity; empty if the job failed.
    versions, commit, config
        Origin of the result: versions of packages, the commit of the checkout, and a digest of the agent's settings and
        world.
    series
        File of the arrays for the plots, relative to the folder; None if the job failed.
    key
        Digest of the job.
    error
        The reason of the failure; None if the job succeeded.
    """

    world: str
    noise: float
    robots: int
    preset: str
    policy: str
    ablation: str | None
    laps: int
    seed: int
    metrics: dict[str, Metric]
    cost: dict[str, float] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)
    commit: str = "unknown"
    config: str = ""
    series: str | None = None
    key: str = ""
    error: str | None = None


@dataclass(frozen=True)
class Stamp:
    """The properties that all results of a folder have in common.

    Attributes
    ----------
    suite, digest, jobs
        The name of the suite, its digest, and its number of jobs.
    versions, commit
        Versions of packages and commit of the checkout.
    """

    suite: str
    digest: str
    jobs: int
    versions: dict[str, str]
    commit: str


class Store:
    """A folder of results that only this process writes to; see :func:`open_store`.

    Attributes
    ----------
    folder
        Path of the folder.
    stamp
        The stamp of the results.
    lost
        Number of jobs that must be repeated because their series do not exist any more.
    rows
        The existing rows, by the keys of the jobs.
    """

    def __init__(self, folder: Path, stamp: Stamp, lost: int = 0) -> None:
        self.folder, self.stamp, self.lost = folder, stamp, lost
        self.rows: dict[str, Row] = {row.key: row for row in read_rows(folder)}

    def append(self, job: Job, result: Outcome | Failure) -> Row:
        """Store the result of a job durably: once this method has returned, a kill cannot lose the result.

        Raises
        ------
        ValueError
            If the job already has a row.
        OSError
            If writing fails.
        """
        if job.key in self.rows:
            raise ValueError(f"{self.folder}: has a row for this job already: {job.title}")
        made_by = {"versions": self.stamp.versions, "commit": self.stamp.commit}
        if isinstance(result, Failure):
            came_of_it: dict[str, Any] = {"metrics": {}, "error": result.reason}
        else:
            series = self._write_series(job.key, result.series)
            came_of_it = {"metrics": result.metrics, "cost": result.cost, "config": result.config, "series": series}
        row = Row(**{**job.identity, **made_by, **came_of_it})
        append_line(self.folder / RESULTS, _line(row))
        self.rows[job.key] = row
        return row

    def _write_series(self, key: str, series: dict[str, Any]) -> str:
        name = f"{SERIES}/{key}.npz"
        with atomic_write(self.folder / name) as beside:
            np.savez_compressed(beside, **series)
        return name


@contextmanager
def open_store(folder: Path, stamp: Stamp, *, retry_failed: bool = False) -> Iterator[Store]:
    """Open the folder of a suite's results: create it if needed, repair it after a kill, and lock it.

    Parameters
    ----------
    folder
        Folder for the results; it may contain earlier results.
    stamp
        The stamp of the new results.
    retry_failed
        Remove the rows of failed jobs, so that these jobs are missing again.

    Raises
    ------
    ValueError
        If another process writes to the folder, or the folder contains other files, or results of another suite,
        version or commit.
    """
    _check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder / LOCK, f"{folder}: another run is writing there"):
        _check_stamp(folder, stamp)
        _mend(folder)
        before, _ = rows_once(read_rows(folder))
        wanted = [row for row in before if not retry_failed or row.error is None]
        kept = [row for row in wanted if _has_series(folder, row)]
        if len(kept) < len(before):
            replace_content(folder / RESULTS, b"".join(_line(row) for row in kept))
        yield Store(folder, stamp, len(wanted) - len(kept))


def _has_series(folder: Path, row: Row) -> bool:
    """Whether the series of a row exists, if the row should have a series."""
    return row.series is None or zipfile.is_zipfile(series_path(folder, row.series))


def series_path(folder: Path, name: str) -> Path:
    """The path of a row's series in a folder of results.

    Raises
    ------
    ValueError
        If the name refers to a path outside the folder.
    """
    path = folder / name
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ValueError(f"{folder}: the series {name!r} lead out of the folder")
    return path


def _check_folder(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: is not a folder")
    if folder.is_dir() and not (folder / STAMP).is_file() and any(path.name[0] != "." for path in folder.iterdir()):
        raise ValueError(f"{folder}: is not empty and holds no benchmark's results")


def _check_stamp(folder: Path, stamp: Stamp) -> None:
    path, now = folder / STAMP, asdict(stamp)
    if not path.is_file():
        replace_content(path, json.dumps(now, indent=2).encode() + b"\n")
        return
    try:
        before = Stamp(**json.loads(path.read_bytes()))
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: not the stamp of a benchmark: {error}") from error
    if (before.suite, before.digest) != (stamp.suite, stamp.digest):
        raise ValueError(
            f"{folder}: holds results of another suite, or of this one before it was changed"
            f" ({before.suite}, {before.jobs} jobs, digest {before.digest}; now {stamp.suite}, {stamp.jobs} jobs,"
            f" digest {stamp.digest}): choose another folder"
        )
    if changed := changes(before, stamp):
        raise ValueError(f"{folder}: holds results of other versions ({changed}): choose another folder")


def _mend(folder: Path) -> None:
    """Remove an incomplete last line and partly written files, which remain after a kill."""
    mend_lines(folder / RESULTS)
    clear_up(folder)
    clear_up(folder / SERIES)


def _line(row: Row) -> bytes:
    return json.dumps(asdict(row), allow_nan=False).encode() + b"\n"


def read_rows(path: Path) -> list[Row]:
    """The rows of a folder of results, or of a file ``results.jsonl``.

    An incomplete last line is left out. Such a line is still being written, or its process was killed.

    Raises
    ------
    ValueError
        If the file does not exist, or a line is not a valid row; the message names file and line.
    """
    below = sorted(each.parent for each in path.glob(f"*/{RESULTS}")) if path.is_dir() else []
    path = path / RESULTS if path.is_dir() else path
    if below and not path.exists():
        raise ValueError(one_line(f"{path}: no results there; there are some in {', '.join(map(str, below))}"))
    try:
        content = read_limited(path, MAX_RESULTS_BYTES)
    except OSError as error:
        raise ValueError(f"{path}: no results there: {error.strerror or error}") from error
    lines = content.split(b"\n")[:-1]
    return [_row(line, f"{path}, line {number}") for number, line in enumerate(lines, 1)]


def rows_once(rows: Iterable[Row]) -> tuple[list[Row], int]:
    """Each job's row once, and the number of rows that were left out because they repeat another row.

    Cost and series are not compared, because they differ between repeated runs of a job.

    Raises
    ------
    ValueError
        If two different rows have the same job.
    """
    found: dict[tuple[Any, ...], Row] = {}
    skipped = 0
    for row in rows:
        job = (row.key,) if row.key else (
            row.world, row.noise, row.robots, row.preset, row.policy, row.ablation, row.laps, row.seed
        )  # fmt: skip
        first = found.setdefault(job, row)
        if first is row:
            continue
        if different := next((name for name in _COMPARED if getattr(first, name) != getattr(row, name)), ""):
            where = f"{row.world}, {row.preset}, {row.policy}, seed {row.seed}"
            raise ValueError(f"two different rows claim the same job ({where}): their {different} differ")
        skipped += 1
    return list(found.values()), skipped


def read_jobs(paths: Sequence[Path]) -> list[Row]:
    """The rows of folders of results, each job once. A line on standard error gives the number of repeated rows.

    Raises
    ------
    ValueError
        If a file is missing, a line is not a valid row, or two different rows have the same job.
    """
    rows, skipped = rows_once(row for path in paths for row in read_rows(path))
    if skipped:
        repeats = "1 row repeats another and is" if skipped == 1 else f"{skipped} rows repeat others and are"
        print(f"benchmarks: {repeats} not counted again", file=sys.stderr)
    return rows


def _row(line: bytes, label: str) -> Row:
    try:
        table = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ValueError(one_line(f"{label}: not JSON: {error}")) from error
    if not isinstance(table, dict) or not table.keys() <= _FIELDS.keys():
        raise ValueError(f"{label}: not a row of results")
    if wrong := [name for name, value in table.items() if not _FIELDS[name](value)]:
        raise ValueError(f"{label}: not a row of results: {wrong[0]} is {str(table[wrong[0]])[:60]!r}")
    try:
        return Row(**table)
    except TypeError as error:
        raise ValueError(f"{label}: not a row of results: {error}") from error


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_text_or_none(value: Any) -> bool:
    return value is None or isinstance(value, str)


def _is_count(value: Any) -> bool:
    return type(value) is int and value >= 0


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float)


def _is_metrics(value: Any) -> bool:
    return isinstance(value, dict) and all(
        each is None or isinstance(each, str | int | float) for each in value.values()
    )


def _is_costs(value: Any) -> bool:
    return isinstance(value, dict) and all(map(_is_number, value.values()))


def _is_versions(value: Any) -> bool:
    return isinstance(value, dict) and all(map(_is_text, value.values()))


_FIELDS: dict[str, Callable[[Any], bool]] = {
    "world": _is_text, "noise": _is_number, "robots": _is_count, "preset": _is_text, "policy": _is_text,
    "ablation": _is_text_or_none, "laps": _is_count, "seed": _is_count, "metrics": _is_metrics, "cost": _is_costs,
    "versions": _is_versions, "commit": _is_text, "config": _is_text, "series": _is_text_or_none, "key": _is_text,
    "error": _is_text_or_none,
}  # fmt: skip
"""The valid values of a row's fields."""

_COMPARED = tuple(name for name in _FIELDS if name not in {"cost", "series"})
