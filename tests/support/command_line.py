"""Calls of the command lines in this process, which spares the start of an interpreter and the
imports in it.
"""

import signal
import sys
from collections.abc import Callable
from contextlib import chdir, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

from limslam_agent.cli.main import app, main

__all__ = ["Finished", "app", "benchmarks", "limslam", "refused", "told"]


class Finished(NamedTuple):
    """A call that has ended: its exit code, and what it wrote to standard output and standard
    error.
    """

    returncode: int
    stdout: str
    stderr: str


def limslam(*arguments: object, cwd: Path | None = None) -> Finished:
    """Call ``limslam`` with arguments, in a folder (None: where the tests run)."""
    return _called(main, arguments, cwd)


def benchmarks(*arguments: object, cwd: Path | None = None) -> Finished:
    """Call ``python -m benchmarks``, which isn't there where only the package is installed."""
    from benchmarks.__main__ import main as benchmarks_main

    return _called(benchmarks_main, arguments, cwd)


def told(*arguments: object, cwd: Path | None = None) -> str:
    """What ``limslam`` writes to standard output when all goes well."""
    finished = limslam(*arguments, cwd=cwd)
    assert finished.returncode == 0, finished.stderr
    return finished.stdout


def refused(*arguments: object, cwd: Path | None = None) -> str:
    """The one line with which ``limslam`` refuses what a user has asked for."""
    return refusal_of(limslam(*arguments, cwd=cwd))


def refusal_of(finished: Finished) -> str:
    """The one line of a call that was refused."""
    assert finished.returncode == 2, finished
    assert finished.stderr.startswith("limslam: ")
    assert finished.stderr.count("\n") == 1, finished.stderr
    return finished.stderr.removeprefix("limslam: ")[:-1]


def _called(main: Callable[[], None], arguments: tuple[object, ...], cwd: Path | None) -> Finished:
    out = StringIO()
    err = StringIO()
    code = None
    # The handlers of signals stay those of pytest.
    with (
        patch.object(sys, "argv", ["command", *map(str, arguments)]),
        patch.object(signal, "signal"),
        chdir(cwd or Path.cwd()),
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as ended:
            code = ended.code
    assert isinstance(code, int), f"the command ended with {code!r} instead of an exit code"
    return Finished(code, out.getvalue(), err.getvalue())
