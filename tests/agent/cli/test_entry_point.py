"""The installed command: its entry point, its exit code and its one line, in a process of its own."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(sys.executable).with_name("limslam")


@pytest.mark.parametrize("command", [[SCRIPT], [sys.executable, "-m", "limslam_agent"]], ids=["script", "module"])
def test_a_bad_argument_ends_the_command_with_2_and_one_line(command, tmp_path):
    result = subprocess.run(
        [*command, "run", "--noise", "-1"], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert (result.returncode, result.stdout, result.stderr.count("\n")) == (2, "", 1)
    assert result.stderr.startswith("limslam: ")
    assert list(tmp_path.iterdir()) == []
