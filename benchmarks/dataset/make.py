"""The making of a dataset: drives are recorded one by one, and Minari's files, the card and the checksums follow.

A folder without checksums is not complete. The same command goes on with it.
"""

import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from benchmarks.dataset.card import card
from benchmarks.dataset.check import SUMS, check_dataset, sums_of
from benchmarks.dataset.drives import FORMAT, DatasetConfig, record_drive
from benchmarks.dataset.minari_files import NAMESPACE, dataset_id, require_minari, write_dataset
from benchmarks.suite.engines import Engine
from benchmarks.suite.runner import Summary, run_suite
from benchmarks.suite.store import LOCK, RESULTS, STAMP, Row, read_rows
from limslam_agent.output.atomic_write import replace_content
from limslam_agent.output.claims import locked

DRIVES, CARD, SETTINGS = "drives", "README.md", "dataset.json"


@dataclass(frozen=True)
class Made:
    """What has been made.

    Attributes
    ----------
    words
        What was recorded and checked, in lines.
    failures
        Title and reason of each drive that failed. Without them the dataset is complete.
    """

    words: tuple[str, ...]
    failures: tuple[tuple[str, str], ...] = ()


def make_dataset(config: DatasetConfig, folder: Path, engine: Engine, *, retry_failed: bool = False) -> Made:
    """Make what is missing of a dataset, and check it.

    Parameters
    ----------
    config
        Settings of the dataset.
    folder
        Root of the datasets. It may hold an unfinished dataset with the same settings.
    engine
        Runs the drives.
    retry_failed
        Record the drives again that have failed.

    Raises
    ------
    ValueError
        If the extra ``datasets`` is missing, the folder holds something else, or the dataset does not pass its check.
    """
    require_minari()
    _check_folder(folder, config)
    with locked(folder / LOCK, f"{folder}: another process is writing there"):
        said = ["complete before"]
        if not (folder / SUMS).is_file():
            summary = _record(config, folder, engine, retry_failed=retry_failed)
            said = [f"drives: {summary.words}"]
            if summary.failures:
                return Made((*said,), summary.failures)
            _write_files(config, folder)
        said.append(f"checked: {check_dataset(folder)}")
        shutil.rmtree(folder / DRIVES, ignore_errors=True)
        return Made((*said,))


def _record(config: DatasetConfig, folder: Path, engine: Engine, *, retry_failed: bool) -> Summary:
    """Record the drives that are missing."""
    return run_suite(
        config.suite, folder / DRIVES, engine, work=partial(record_drive, config), retry_failed=retry_failed
    )


def _check_folder(folder: Path, config: DatasetConfig) -> None:
    """Refuse a folder that holds anything but a dataset with these settings; note the settings in a new one."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: is not a folder")
    path = folder / SETTINGS
    if not path.is_file():
        if folder.is_dir() and any(each.name[0] != "." for each in folder.iterdir()):
            raise ValueError(f"{folder}: is not empty and holds no dataset")
        folder.mkdir(parents=True, exist_ok=True)
        replace_content(path, (json.dumps(_settings(config), indent=2) + "\n").encode())
        return
    try:
        before = json.loads(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"{path}: not the settings of a dataset: {error}") from error
    if before != _settings(config):
        raise ValueError(f"{folder}: holds a dataset with other settings (see {SETTINGS}): choose another folder")


def _settings(config: DatasetConfig) -> dict[str, object]:
    return {"format": FORMAT, **asdict(config), "policies": list(config.policies)}


def _write_files(config: DatasetConfig, folder: Path) -> None:
    """Write Minari's files, the card, and at last the checksums."""
    rows = _rows(config, folder / DRIVES)
    for policy, driven in rows.items():
        # What an earlier process has left unfinished.
        shutil.rmtree(folder / dataset_id(policy), ignore_errors=True)
        write_dataset(folder, folder / DRIVES, policy, driven, config)
    for name in (RESULTS, STAMP):
        shutil.copyfile(folder / DRIVES / name, folder / name)
    sizes = {policy: _size(folder / dataset_id(policy)) for policy in rows}
    replace_content(folder / CARD, card(config, rows, sizes).encode())
    replace_content(folder / SUMS, sums_of(folder, _files(folder)).encode())


def _rows(config: DatasetConfig, drives: Path) -> dict[str, list[Row]]:
    """The drives of each policy in the order of the plans. In the folder they are in the order of their ends."""
    by_key = {row.key: row for row in read_rows(drives)}
    jobs = config.suite.jobs
    return {policy: [by_key[job.key] for job in jobs if job.policy == policy] for policy in config.policies}


def _files(folder: Path) -> Sequence[Path]:
    """The files that have a checksum."""
    above = [folder / name for name in (CARD, SETTINGS, RESULTS, STAMP)]
    return [*above, *(path for path in (folder / NAMESPACE).rglob("*") if path.is_file())]


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
