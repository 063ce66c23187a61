"""Tests that cannot run skip with a reason, and ``--allowed-skips`` fails on a reason that is not
listed.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent
ONE_OF_A_BROWSER = "agent/inspect/test_live_page.py::test_the_page_follows_the_newest_moment"
REASON = "there is no Chromium: none of chromium, "


def without_a_browser(*options):
    """A test of a page where no browser is found."""
    command = [sys.executable, "-m", "pytest", "-rs", "-p", "no:cacheprovider", *options]
    surroundings = {**os.environ, "PATH": "", "PYTEST_ADDOPTS": ""}
    return subprocess.run(
        [*command, str(FOLDER / ONE_OF_A_BROWSER)],
        capture_output=True,
        text=True,
        check=False,
        env=surroundings,
        cwd=FOLDER.parent,
    )


def test_without_a_browser_the_tests_of_pages_skip_and_say_why():
    finished = without_a_browser("-n0")
    assert finished.returncode == 0, finished.stdout + finished.stderr
    assert finished.stdout.count(REASON) == 1


@pytest.mark.parametrize(
    ("listed", "workers", "status"),
    [("there is no Chromium  # why\n", "-n1", 0), ("# none\n", "-n1", 1), ("", "-n0", 1)],
)
def test_a_skip_that_is_not_listed_is_a_failure(tmp_path, listed, workers, status):
    allowed = tmp_path / "allowed.txt"
    allowed.write_text(listed, encoding="utf-8")
    finished = without_a_browser(workers, "--allowed-skips", str(allowed))
    assert finished.returncode == status, finished.stdout + finished.stderr
    assert REASON in finished.stdout
    assert (f"{ONE_OF_A_BROWSER}: {REASON}" in finished.stdout) == (status == 1)


def test_the_list_of_long_tests_names_tests_that_exist():
    for line in (FOLDER / "not_quick.txt").read_text(encoding="utf-8").splitlines():
        file, _, name = line.partition("#")[0].strip().partition("::")
        if file:
            assert f"def {name}" in (FOLDER / file).read_text(encoding="utf-8"), line
