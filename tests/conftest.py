"""What all tests share: one thread for each process, the marker ``quick``, and the order of the
files.
"""

import os
from pathlib import Path

import pytest

# Before numpy is imported: for small matrices a second thread takes longer to wake than it saves.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Tests look at stderr, which must not depend on what was compiled before.
os.environ.setdefault("LIMSLAM_QUIET", "1")

FOLDER = Path(__file__).parent
NOT_QUICK = [
    line.split("#")[0].strip()
    for line in (FOLDER / "not_quick.txt").read_text(encoding="utf-8").splitlines()
    if line.split("#")[0].strip()
]
"""Files and tests that take long, the longest files first, relative to this folder."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as ``quick`` the first case of each test that is not listed as taking long; put the
    longest files first.

    Workers get whole files in this order, so that no worker begins a long file while the others
    have nothing left.
    """
    order = {name: number for number, name in reversed([*enumerate(NOT_QUICK)])}
    seen = set()
    for item in items:
        file, test = _names(item)
        is_listed = file in order or test in order or item.get_closest_marker("slow") is not None
        if not is_listed and test not in seen:
            item.add_marker(pytest.mark.quick)
        seen.add(test)
    files = {name.partition("::")[0]: number for name, number in reversed(order.items())}
    items.sort(key=lambda item: files.get(_names(item)[0], len(NOT_QUICK)))


def _names(item: pytest.Item) -> tuple[str, str]:
    """The file of a test, and the test without its parameters, as in the list."""
    file = item.path.relative_to(FOLDER).as_posix()
    return file, f"{file}::{getattr(item, 'originalname', item.name)}"
