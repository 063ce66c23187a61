"""What the tests of the command line share."""

import signal
import sys

import pytest

from limslam_agent.cli import main as cli


@pytest.fixture
def limslam(monkeypatch, capsys):
    """The command line in this process: its exit code, and what it says."""
    monkeypatch.setattr(signal, "signal", lambda *_: None)

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["limslam", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        said = capsys.readouterr()
        return end.value.code, said.out, said.err

    return call
