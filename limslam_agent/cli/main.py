"""The command line: ``limslam run``, ``replay``, ``show`` and the other commands.

Modules that take long to import are imported inside the commands, so that help appears at once.
"""

import gc
import os
from typing import Annotated

import typer

from limslam_agent.cli.arena import arena
from limslam_agent.cli.inspect import inspect
from limslam_agent.cli.live import live
from limslam_agent.cli.notebooks import notebooks
from limslam_agent.cli.replay import replay
from limslam_agent.cli.run import play, run
from limslam_agent.cli.score import score
from limslam_agent.cli.show import compare, export, show
from limslam_agent.cli.warmup import warmup
from limslam_agent.cli.worlds import worlds
from limslam_agent.endings import end_cleanly
from limslam_agent.terminal import run_command

THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Numbers of threads of linear algebra. Each is read once, when numpy or scipy is loaded."""

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Exploration and SLAM with almost no sensing.",
)
app.command()(run)
app.command()(play)
app.command()(replay)
app.command()(live)
app.command()(show)
app.command()(inspect)
app.command()(compare)
app.command()(score)
app.command()(export)
app.command()(notebooks)
app.command()(warmup)
app.add_typer(worlds)
app.add_typer(arena)


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"limslam {version('limslam')}")
        raise typer.Exit


@app.callback()
def _limslam(
    _version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_show_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    """Exploration and SLAM with almost no sensing."""


def main() -> None:
    """Entry point. An error that the user can correct gives exit code 2 and one line, not a
    traceback.
    """
    _use_one_thread()
    collect_rarely()
    end_cleanly()  # so that no half-written folder is left, and no robot without a stop
    run_command(app, "limslam", numbers=True)


def _use_one_thread() -> None:
    """Compute linear algebra in one thread, unless the user has set a number; other processes
    inherit it.

    The matrices are small, and threads that wait for each other cost more time than they save.
    """
    for name in THREAD_VARIABLES:
        os.environ.setdefault(name, "1")


def collect_rarely() -> None:
    """Let Python search for unused objects that refer to each other less often.

    A search goes through all objects of numba and numpy, takes 50 ms, and finds next to nothing.
    All other objects are freed when nothing refers to them any more.
    """
    gc.set_threshold(50_000)


if __name__ == "__main__":
    main()
