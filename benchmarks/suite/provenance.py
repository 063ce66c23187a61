"""The origin of results: versions of all packages that a metric depends on."""

from collections.abc import Callable

from benchmarks.suite.jobs import Job, Outcome
from limslam_agent.output.provenance import version_changes


def package_versions() -> dict[str, str]:
    """Versions of all packages that a metric depends on."""
    from limslam_agent.runs.results import versions

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
