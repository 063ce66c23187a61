"""The origin of results: the commit of the checkout, and the versions of libraries."""

import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[2]


def commit() -> str:
    """The commit of the checkout, with ``-dirty`` if a file has been changed; ``unknown`` without a
    repository.
    """
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


def versions() -> dict[str, str]:
    """Versions of everything that a result depends on."""
    packages = (
        "limslam",
        "gymnasium",
        "pymunk",
        "numpy",
        "scipy",
        "numba",
        "filterpy",
        "opencv-python-headless",
    )
    return {"python": sys.version.split()[0], **{name: _version(name) for name in packages}}


def _version(package: str) -> str:
    """``unknown`` for a package that is used without having been installed, such as a checkout."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(CHECKOUT), *arguments]
    # The arguments are fixed, and contain no user input.
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()  # noqa: S603
