"""Short runs and their pages for the tests of the inspector."""

from pathlib import Path

from support.command_line import Finished, call

from limslam_agent.cli import main as cli

SHORT = ("--world", "square", "--noise", 0.02, "--until", "seen", "--max-time", 25)


def short_run(folder: Path, *options: object) -> Path:
    """The folder of a short run."""
    done = call(cli.main, "run", *SHORT, *options, "--out", folder)
    assert done.returncode == 0, done.stderr
    return folder


def inspected(source: Path, out: Path, *options: object) -> Finished:
    """``limslam inspect`` of a folder or a log."""
    return call(cli.main, "inspect", source, "--out", out, *options)


def data_in(page: Path) -> str:
    """The recording in a page, as it was packed."""
    return page.read_text(encoding="utf-8").split('id="data">', 1)[1].split("</script>", 1)[0]
