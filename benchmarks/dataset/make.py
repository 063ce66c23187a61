"""The making of a dataset: drives are recorded one by one, and Minari's files, the card and the checksums follow.

A folder without checksums is not complete. The same command goes on with it.
"""

import json
import shutil
from dataclasses import asdict
from functools import partial
from pathlib import Path

from benchmarks.dataset.card import card
from benchmarks.dataset.check import SUMS, sums_of
from benchmarks.dataset.drives import DatasetConfig, record_drive
from benchmarks.dataset.minari_files import NAMESPACE, dataset_id, write_dataset
from benchmarks.suite.runner import Summary, run_suite
from benchmarks.suite.store import STAMP, Row, read_rows
from limslam_agent.measurements.processes import Processes
from limslam_agent.measurements.store import RESULTS
from limslam_agent.output.atomic_write import replace_content

DRIVES, CARD, SETTINGS = "drives", "README.md", "dataset.json"


def make_dataset(
    config: DatasetConfig, folder: Path, processes: Processes, *, retry_failed: bool = False
) -> Summary | None:
    """Make what is missing of a dataset; None if it is complete.

    Parameters
    ----------
    config
        Settings of the dataset.
    folder
        Root of the datasets. It may hold a dataset with the same settings, whole or in part.
    processes
        Run the drives.
    retry_failed
        Record the drives again that have failed.

    Raises
    ------
    ValueError
        If the folder holds something else.
    """
    settings, path = (json.dumps(asdict(config), indent=2) + "\n").encode(), folder / SETTINGS
    if not path.is_file() and folder.exists() and any(each.name[0] != "." for each in folder.iterdir()):
        raise ValueError(f"{folder}: is not empty and holds no dataset")
    if path.is_file() and path.read_bytes() != settings:
        raise ValueError(f"{folder}: holds a dataset with other settings (see {SETTINGS}): choose another folder")
    if (folder / SUMS).is_file():
        return None
    replace_content(path, settings)
    summary = run_suite(
        config.suite, folder / DRIVES, processes, work=partial(record_drive, config), retry_failed=retry_failed
    )
    if not summary.failures:
        _write_files(config, folder)
        shutil.rmtree(folder / DRIVES)
    return summary


def _write_files(config: DatasetConfig, folder: Path) -> None:
    """Write Minari's files, the card, and at last the checksums."""
    by_key = {row.key: row for row in read_rows(folder / DRIVES)}
    rows: dict[str, list[Row]] = {policy: [] for policy in config.policies}
    for job in config.suite.jobs:  # in the order of the plans; in the folder they are in the order of their ends
        rows[job.policy].append(by_key[job.key])
    for policy, driven in rows.items():
        # What an earlier process has left unfinished.
        shutil.rmtree(folder / dataset_id(policy), ignore_errors=True)
        write_dataset(folder, folder / DRIVES, policy, driven, config)
    for name in (RESULTS, STAMP):
        shutil.copyfile(folder / DRIVES / name, folder / name)
    sizes = {policy: sum(map(_size, (folder / dataset_id(policy)).rglob("*"))) for policy in rows}
    replace_content(folder / CARD, card(config, rows, sizes).encode())
    above = [folder / name for name in (CARD, SETTINGS, RESULTS, STAMP)]
    files = [*above, *(path for path in (folder / NAMESPACE).rglob("*") if path.is_file())]
    replace_content(folder / SUMS, sums_of(folder, files).encode())


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0
