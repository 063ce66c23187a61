"""What makes results: versions of packages, and the checkout's commit."""

import subprocess
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

from benchmarks.suite.jobs import Job, Outcome

CHECKOUT = Path(__file__).resolve().parents[2]


def package_versions() -> dict[str, str]:
    """Versions of all that a metric depends on."""
    from limslam_agent.runs.results import versions

    try:
        return {**versions(), "gtsam": metadata.version("gtsam")}
    except metadata.PackageNotFoundError:  # only limits need it
        return versions()


def work_alike(work: Callable[[Job], Outcome], expected: dict[str, str], job: Job) -> Outcome:
    """Do a job where the versions are the expected ones, which the results will bear: on a cluster they may differ.

    Raises
    ------
    ValueError
        If they differ.
    """
    here = package_versions()
    if here != expected:
        raise ValueError(f"this worker has other versions: {version_changes(expected, here)}")
    return work(job)


def version_changes(before: dict[str, str], now: dict[str, str]) -> str:
    """What differs between two sets of versions, in words."""
    return ", ".join(
        f"{name} {before.get(name, 'missing')}, now {now.get(name, 'missing')}"
        for name in sorted(before.keys() | now.keys())
        if before.get(name) != now.get(name)
    )


def commit() -> str:
    """The checkout's commit, with ``-dirty`` when a file of it has been changed; ``unknown`` where there is none."""
    try:
        top = _git("rev-parse", "--show-toplevel")
        # An unpacked archive may lie in somebody else's repository.
        return (
            _git("describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
            if Path(top) == CHECKOUT
            else "unknown"
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(CHECKOUT), *arguments]
    # Fixed arguments, and none of them a user's.
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()  # noqa: S603
