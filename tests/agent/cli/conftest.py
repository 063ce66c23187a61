"""What tests of the command line share."""

import pytest
from support.command_line import call

from limslam_agent.cli.main import main


@pytest.fixture
def limslam():
    """The command line in this process: its exit code, and what it says."""

    def called(*arguments):
        finished = call(main, *arguments)
        return finished.returncode, finished.stdout, finished.stderr

    return called


@pytest.fixture
def no_display(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
