"""Calls of the command lines in this process, which spares the start of an interpreter and the imports in it."""

import signal
import sys
from collections.abc import Callable
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any
from unittest.mock import patch

import typer
from typer.testing import CliRunner


@dataclass(frozen=True)
class Finished:
    """A call that has ended: its exit code, and what it wrote to standard output and standard error."""

    returncode: int
    stdout: str
    stderr: str


def call(main: Callable[[], None], *arguments: object, cwd: Path | None = None) -> Finished:
    """Call the entry point of a command with arguments, in a folder (None: where the tests run)."""
    out, err, code = StringIO(), StringIO(), None
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


def invoke(command: Callable[..., Any], *arguments: object) -> str:
    """Call one command; what it prints. Its errors are raised."""
    app = typer.Typer()
    app.command()(command)
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.stdout
