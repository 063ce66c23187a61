"""Runs plans of a folder of results again, and compares the metrics."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from limslam_agent.arena.entry import Entry, manifest_table, read_entry
from limslam_agent.arena.results import FORMAT, Row, Stamp, digest_of, plans_digest, read_results
from limslam_agent.arena.running import Job, results_of
from limslam_agent.arena.tracks import PUBLIC_SEED, Plan, plans_of
from limslam_agent.measurements.store import BaseStamp, read_stamp
from limslam_agent.output.provenance import commit, versions

BOUNDS = {
    "plan_time_to_80_s": 30.0,
    "plan_time_to_95_s": 30.0,
    "correct_coverage": 0.05,
    "ate_final_m": 0.05,
    "wall_f1_5cm": 0.1,
}
"""Largest differences of an entry that runs in a process of its own, whose answers may depend on
time. Metrics of all other entries are equal to the bit.
"""


def opened(
    folder: Path, entry_folder: Path | None, seed: int | None
) -> tuple[Entry, Stamp, list[Plan]]:
    """The entry, the stamp and the plans of a folder of results.

    Raises
    ------
    ValueError
        If the entry is not the one of the results, the plans are not those of the seed, or the
        stamp says something about them that is not true.
    """
    stamp = read_stamp(FORMAT, folder)
    if stamp.is_secret and seed is None:
        raise ValueError(f"{folder}: its plans come from a secret seed: --secret-seed is needed")
    entry = read_entry(entry_folder or Path(stamp.folder))
    if entry.digest != stamp.digest:
        raise ValueError(f"{entry.folder}: is not the entry of {folder}, or was changed since")
    if stamp.entry != manifest_table(entry.manifest):
        raise ValueError(f"{folder}: its manifest is not that of {entry.folder}")
    seed = PUBLIC_SEED if seed is None else seed
    if plans_digest(seed) != stamp.plans:
        raise ValueError(f"{folder}: its plans are not those of this seed")
    if stamp.is_secret == (stamp.plans == plans_digest(PUBLIC_SEED)):
        raise ValueError(f"{folder}: is_secret is {stamp.is_secret}, and its plans say otherwise")
    return entry, stamp, plans_of(seed)


def verify(
    folder: Path, entry: Entry, plans: Sequence[Plan], count: int | None, jobs: int
) -> Iterator[tuple[int, list[str]]]:
    """Run ``count`` rows again, spread evenly over a folder of results; all if it is None.

    Yields number and differences of each plan. ``plans`` are all plans, and ``jobs`` is the number
    of processes.

    Raises
    ------
    ValueError
        If there are no rows, or a row does not belong to its plan or to the entry.
    """
    _, rows = read_results(folder)
    for row in rows.values():
        _check_origin(folder, row, entry, plans)
    spread = np.linspace(0, len(rows) - 1, min(count or len(rows), len(rows))).round().astype(int)
    wanted = [list(rows)[place] for place in spread]
    jobs_again = [Job(entry, plans[number], versions(), commit()) for number in wanted]
    for row in results_of(jobs_again, jobs):
        yield row.plan, differences(rows[row.plan], row, is_process=entry.manifest.is_process)


def differences(before: Row, now: Row, *, is_process: bool) -> list[str]:
    """What differs between two rows of a plan, in words. Cost, provenance and newer metrics are not
    compared.
    """
    if before.error != now.error:
        return [f"error: {before.error}, now {now.error}"]
    bounds = BOUNDS if is_process else {}
    values = {
        name: (before.metrics.get(name), now.metrics.get(name))
        for name in bounds or sorted(before.metrics)
    }
    return [
        f"{name} {first}, now {second}"
        for name, (first, second) in values.items()
        if not _equal(first, second, bounds.get(name))
    ]


def other_versions(stamp: Stamp) -> str:
    """What is another version here than in a folder of results, in words. Empty if nothing is."""
    return stamp.changes(BaseStamp(versions(), commit()))


def _equal(first: object, second: object, bound: float | None) -> bool:
    if isinstance(first, int | float) and isinstance(second, int | float) and bound is not None:
        return abs(first - second) <= bound
    return type(first) is type(second) and first == second


def _check_origin(folder: Path, row: Row, entry: Entry, plans: Sequence[Plan]) -> None:
    if not 0 <= row.plan < len(plans) or row.setting != plans[row.plan].setting:
        raise ValueError(f"{folder}: the row of plan {row.plan} has another setting than the plan")
    if row.settings != digest_of({"plan": row.setting, "entry": entry.digest}):
        raise ValueError(f"{folder}: the row of plan {row.plan} is not of this entry")
