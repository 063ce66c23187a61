"""The installed command: its entry point, its exit code and its one line, in a process of its own."""

import subprocess
import sys
from pathlib import Path

import pytest
import typer

from limslam_agent.cli.terminal import run_command

SCRIPT = Path(sys.executable).with_name("limslam")


@pytest.mark.parametrize(
    "command", [[SCRIPT], [sys.executable, "-m", "limslam_agent.cli.main"]], ids=["script", "module"]
)
def test_a_bad_argument_ends_the_command_with_2_and_one_line(command, tmp_path):
    result = subprocess.run(
        [*command, "run", "--noise", "-1"], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert (result.returncode, result.stdout, result.stderr.count("\n")) == (2, "", 1)
    assert result.stderr.startswith("limslam: ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (OSError(5, "Input/output error"), "it: port: Input/output error\n"),
        (OverflowError("inf"), "it: a number is too large or too small to compute with: inf\n"),
    ],
)
def test_a_program_says_what_an_error_is_about(capsys, monkeypatch, error, line):
    app = typer.Typer()

    @app.command()
    def _fails():
        raise error

    monkeypatch.setattr(sys, "argv", ["it"])
    with pytest.raises(SystemExit) as ended:
        run_command(app, "it", resource="port", numbers=True)
    assert (ended.value.code, capsys.readouterr().err) == (2, line)
