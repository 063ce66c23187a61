"""What all tests share: one thread for each process, the marker ``quick``, the order of the files,
and the list of the skips that are allowed.
"""

import os
from pathlib import Path

import pytest

# Before numpy is imported: for small matrices a second thread takes longer to wake than it saves.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Tests look at stderr, which must not depend on what was compiled before.
os.environ.setdefault("LIMSLAM_QUIET", "1")

FOLDER = Path(__file__).parent


def _lines(path: Path) -> list[str]:
    """The lines of a list without their comments and without empty ones."""
    lines = [line.split("#")[0].strip() for line in path.read_text(encoding="utf-8").splitlines()]
    return [line for line in lines if line]


NOT_QUICK = _lines(FOLDER / "not_quick.txt")
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


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option by which a skip that nobody has agreed to counts as a failure."""
    parser.addoption(
        "--allowed-skips",
        type=Path,
        metavar="FILE",
        help="fail on a skip whose reason does not begin with a line of this file",
    )


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail if a test was skipped for a reason that is not allowed."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if session.exitstatus == pytest.ExitCode.OK and reporter and _unlisted_skips(reporter):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the skips that are not allowed."""
    if unlisted := _unlisted_skips(terminalreporter):
        terminalreporter.section("skips that are not allowed", red=True)
        for line in unlisted:
            terminalreporter.write_line(line)


def _unlisted_skips(reporter: pytest.TerminalReporter) -> list[str]:
    """The skipped tests whose reason is not allowed; none without the option.

    Workers report to the process that started them, and only that one has all skips.
    """
    path = reporter.config.getoption("allowed_skips")
    if path is None:
        return []
    allowed = tuple(_lines(path))
    skips = [(each.nodeid, each.longrepr[2]) for each in reporter.stats.get("skipped", [])]
    reasons = [(test, reason.removeprefix("Skipped: ")) for test, reason in skips]
    return [f"{test}: {reason}" for test, reason in reasons if not reason.startswith(allowed)]


def _names(item: pytest.Item) -> tuple[str, str]:
    """The file of a test, and the test without its parameters, as in the list."""
    file = item.path.relative_to(FOLDER).as_posix()
    return file, f"{file}::{getattr(item, 'originalname', item.name)}"


@pytest.fixture(scope="module")
def chromium():
    """A headless browser for the pages of one file of tests."""
    from support.browser import browser

    with browser() as opened:
        yield opened


@pytest.fixture
def pygame(monkeypatch):
    """Pygame with a display that nobody sees."""
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    import pygame

    pygame.display.quit()
    yield pygame
    pygame.display.quit()
