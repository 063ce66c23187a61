"""The origin of results: versions of packages, and the commit of the checkout."""

import subprocess
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

from benchmarks.suite.jobs import Job, Outcome

CHECKOUT = Path(__file__).resolve().parents[2]


def package_versions() -> dict[str, str]:
    """Versions of all packages that a metric depends on."""
    from limslam_agent.runs.results import versions

    try:
        return {**versions(), "gtsam": metadata.version("gtsam")}
    except metadata.PackageNotFoundError:  # only the offline optimum needs this package
        return versions()


def work_alike(work: Callable[[Job], Outcome], expected: dict[str, str], job: Job) -> Outcome:
    """Run a job if the versions equal the expected versions, which the results will contain.

    On a cluster the versions may differ between machines.

    Raises
    ------
    ValueError
        If the versions differ.
    """
    here = package_versions()
    if here != expected:
        raise ValueError(f"this worker has other versions: {version_changes(expected, here)}")
    return work(job)


def version_changes(before: dict[str, str], now: dict[str, str]) -> str:
    """The differences between two sets of versions, as text."""
    return ", ".join(
        f"{name} {before.get(name, 'missing')}, now {now.get(name, 'missing')}"
        for name in sorted(before.keys() | now.keys())
        if before.get(name) != now.get(name)
    )


def commit() -> str:
    """The commit of the checkout, with ``-dirty`` if a file has been changed; ``unknown`` without a repository."""
    try:
        top = _git("rev-parse", "--show-toplevel")
        # An unpacked archive may lie inside another project's repository.
        return (
            _git("describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
            if Path(top) == CHECKOUT
            else "unknown"
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(CHECKOUT), *arguments]
    # The arguments are fixed, and contain no user input.
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()  # noqa: S603
