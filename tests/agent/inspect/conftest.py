"""One short run, and its page, for all tests of the inspector."""

import pytest
from support.inspection import inspected, short_run


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory):
    return short_run(tmp_path_factory.mktemp("inspect") / "run")


@pytest.fixture(scope="session")
def page(run_folder):
    path = run_folder.parent / "page.html"
    done = inspected(run_folder, path)
    assert done.returncode == 0, done.stderr
    assert "The poses equal those in the folder of the run." in done.stdout
    return path
