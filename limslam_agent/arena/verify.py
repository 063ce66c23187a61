"""Runs plans of a folder of results again, and compares the metrics."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from limslam_agent.arena.entry import Entry, manifest_table, read_entry
from limslam_agent.arena.results import FORMAT, Row, Stamp, digest_of, plans_digest, read_results
from limslam_agent.arena.running import Execution, Job, results_of
from limslam_agent.arena.scoring import BOUNDS
from limslam_agent.arena.tracks import PUBLIC_SEED, Plan, plans_of
from limslam_agent.measurements.store import BaseStamp, read_stamp
from limslam_agent.output.provenance import commit, versions
from limslam_env.messages import counted

_FEWEST_PAIRS = 10
# standard errors of a mean, and a share of the bound
_SURE_OF_SHIFT = 5.0
_LEAST_SHIFT = 0.02


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
    folder: Path,
    entry: Entry,
    plans: Sequence[Plan],
    execution: Execution,
    generator: np.random.Generator,
    count: int | None = None,
) -> Iterator[tuple[Row, Row]]:
    """Run ``count`` rows of a folder of results again; all if it is None.

    The rows are drawn by the generator, so that nobody knows them beforehand. ``plans`` are all
    plans.

    Yields
    ------
    tuple
        The row of each plan in the folder, and that of the new run.

    Raises
    ------
    ValueError
        If a plan has no row, or a row does not belong to its plan or to the entry.
    """
    _, rows = read_results(folder)
    for row in rows.values():
        _check_origin(folder, row, entry, plans)
    if missing := [plan.number for plan in plans if plan.number not in rows]:
        raise ValueError(
            f"{folder}: {counted(len(missing), 'plan')} of {len(plans)} "
            f"{'has' if len(missing) == 1 else 'have'} no results, such as plan {missing[0]}: "
            "limslam arena run goes on with them"
        )
    drawn = generator.choice(len(plans), min(count or len(plans), len(plans)), replace=False)
    jobs_again = [
        Job(entry, plans[number], versions(), commit(), user=execution.user)
        for number in sorted(drawn)
    ]
    for row in results_of(jobs_again, execution.jobs):
        yield rows[row.plan], row


def differences(before: Row, now: Row, *, is_process: bool) -> list[str]:
    """What differs between two rows of a plan, in words. Cost and provenance are not compared."""
    if before.error != now.error:
        return [f"error: {before.error}, now {now.error}"]
    return [
        f"{name} {before.metrics.get(name, 'missing')}, now {now.metrics.get(name, 'missing')}"
        for name in sorted(before.metrics.keys() | now.metrics.keys())
        if name not in before.metrics
        or name not in now.metrics
        or not _equal(before.metrics[name], now.metrics[name], BOUNDS[name] if is_process else 0.0)
    ]


def shifts(pairs: Sequence[tuple[Row, Row]]) -> list[str]:
    """Metrics of a process that differ in one direction, in words.

    Each difference may lie within its bound. The mean of the differences of two honest runs is
    zero, so results in which all times are a little shorter were changed.
    """
    found = []
    for name, bound in BOUNDS.items():
        both = [(before.metrics.get(name), now.metrics.get(name)) for before, now in pairs]
        changes = np.array(
            [
                now - before
                for before, now in both
                if isinstance(before, int | float) and isinstance(now, int | float)
            ]
        )
        if len(changes) < _FEWEST_PAIRS:
            continue
        mean = float(changes.mean())
        error = float(changes.std(ddof=1)) / len(changes) ** 0.5
        if abs(mean) > max(_SURE_OF_SHIFT * error, _LEAST_SHIFT * bound):
            found.append(f"{name} is now {mean:+.3g} in the mean of {len(changes)} plans")
    return found


def other_versions(stamp: Stamp) -> str:
    """What is another version here than in a folder of results, in words. Empty if nothing is."""
    return stamp.changes(BaseStamp(versions(), commit()))


def _equal(first: object, second: object, bound: float) -> bool:
    if bound and isinstance(first, int | float) and isinstance(second, int | float):
        return abs(first - second) <= bound
    return type(first) is type(second) and first == second


def _check_origin(folder: Path, row: Row, entry: Entry, plans: Sequence[Plan]) -> None:
    if not 0 <= row.plan < len(plans) or row.setting != plans[row.plan].setting:
        raise ValueError(f"{folder}: the row of plan {row.plan} has another setting than the plan")
    if row.settings != digest_of({"plan": row.setting, "entry": entry.digest}):
        raise ValueError(f"{folder}: the row of plan {row.plan} is not of this entry")
