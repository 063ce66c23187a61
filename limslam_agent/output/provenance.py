"""The origin of results: the commit of the checkout, and differences between versions of packages."""

import subprocess
from pathlib import Path
from typing import Protocol

CHECKOUT = Path(__file__).resolve().parents[2]


class Provenance(Protocol):
    """What a stamp of results says of their origin: versions of packages, and the commit of the checkout."""

    @property
    def versions(self) -> dict[str, str]:
        """Versions of packages by their names."""

    @property
    def commit(self) -> str:
        """The commit of the checkout."""


def changes(before: Provenance, now: Provenance) -> str:
    """The differences between the versions and the commits of two results, as text. Empty if there are none."""
    changed = [version_changes(before.versions, now.versions)] if before.versions != now.versions else []
    if before.commit != now.commit:
        changed.append(f"commit {before.commit}, now {now.commit}")
    return "; ".join(changed)


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
