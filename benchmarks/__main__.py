"""``python -m benchmarks``: suites of runs (``run``), their tables, the scoreboard, training and
speed.

What takes long to import is imported inside the commands, so that help comes at once.
"""

import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from limslam_agent.command_options import takes, with_told
from limslam_agent.config.help import Help
from limslam_agent.endings import end_cleanly
from limslam_agent.terminal import run_command

if TYPE_CHECKING:
    from benchmarks.suite.runner import Summary
    from limslam_agent.measurements.processes import Processes

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Suites of runs, and what came of them.",
)

# The commands that keep what is done, and go on with it.
_GO_ON = "run", "scoreboard"

Folders = Annotated[list[Path], typer.Argument(help="Folders of results that `run` has made.")]
Workers = Annotated[
    int | None, typer.Option(min=1, help="Jobs at once.", show_default="one a core")
]
Retry = Annotated[bool, typer.Option("--retry-failed", help="Do again what has failed.")]


def _processes(workers: int | None, timeout: float = 3600.0) -> "Processes":
    from limslam_agent.measurements.processes import Processes

    return Processes(workers or os.cpu_count() or 1, timeout)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _end(summary: "Summary", lines: Iterable[str]) -> int:
    """Print what has failed, and lines; the exit code."""
    for title, reason in summary.failures:
        typer.echo(f"failed: {title}: {reason}", err=True)
    for line in lines:
        typer.echo(line)
    return 1 if summary.failures else 0


@app.command()
def run(
    suite: Annotated[str, typer.Option(help="Name of a suite, or a FILE.toml.")],
    workers: Workers = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results.", show_default="runs/suite-NAME")
    ] = None,
    timeout: Annotated[
        float, typer.Option(help="Wall-clock time after which a job has failed, s.")
    ] = 3600.0,
    first_seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Lowest seed of each grid: of noise and start, and of the world random:seed.",
            show_default="the suite's",
        ),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="List the jobs, run none.")] = False,
    retry_failed: Retry = False,
) -> int:
    """Do what is missing of a suite. The same command goes on after a kill."""
    from benchmarks.suite.runner import run_suite
    from benchmarks.suite.suite import load_suite

    if not timeout > 0.0:
        raise ValueError(f"--timeout: a time above 0 s is needed, not {timeout:g}")
    chosen = load_suite(suite, first_seed)
    if dry_run:
        for job in chosen.jobs:
            typer.echo(job.title)
        typer.echo(f"{chosen.name}: {len(chosen.jobs)} jobs")
        return 0
    folder = out or Path("runs") / f"suite-{chosen.name}"
    summary = run_suite(chosen, folder, _processes(workers, timeout), retry_failed=retry_failed)
    return _end(summary, [f"{chosen.name}: {summary.words}; {folder}"])


@app.command()
def train(
    out: Annotated[Path, typer.Option(help="Folder of the training.")] = Path("runs/train-explore"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of the training.")] = 0,
) -> None:
    """Train an explorer by PPO, for a fixed budget (extra rl)."""
    try:
        from benchmarks.training.train import TrainConfig
        from benchmarks.training.train import train as learn
    except ModuleNotFoundError as error:
        raise ValueError(f'training needs {error.name}: pip install -e ".[rl]"') from error
    typer.echo(f"weights     {learn(TrainConfig(seed=seed), out)}")


@dataclass(frozen=True)
class ScoreboardOptions:
    """The options of the scoreboard."""

    rows: Annotated[
        str,
        Help(None, 'Names of rows, with commas; "drive*" for all that begin so.', default=False),
    ] = ""
    against: Annotated[
        Path | None,
        Help(None, "Compare with this scoreboard.json, or the folder of one.", "none"),
    ] = None
    unused: Annotated[bool, Help(None, "The seeds of figures that are published.")] = False
    rows_file: Annotated[
        Path | None, Help(None, "Rows of your own, a TOML file.", "the shipped ones")
    ] = None


@app.command()
@takes(ScoreboardOptions)
def scoreboard(
    out: Annotated[Path, typer.Argument(help="Folder of the results.")],
    workers: Workers = None,
    *,
    retry_failed: Retry = False,
    **told: Any,
) -> int:
    """Measure whether a change of the estimator is kept. The same command goes on after a kill."""
    from benchmarks.scoreboard.board import FILE, read_board, run_scoreboard, table
    from benchmarks.scoreboard.compare import compared, comparison_table
    from benchmarks.scoreboard.rows import SHIPPED, read_rows

    options = with_told(ScoreboardOptions(), told)
    before = None if options.against is None else read_board(options.against)
    board, summary, skipped = run_scoreboard(
        read_rows(options.rows_file or SHIPPED),
        _names(options.rows),
        out,
        _processes(workers),
        unused=options.unused,
        retry_failed=retry_failed,
    )
    for name in skipped:
        typer.echo(
            f"left out: {name}: it needs the folder of recorded data: set LIMSLAM_DATA", err=True
        )
    lines = table(board)
    if before is not None:
        lines += ["", *comparison_table(compared(before["cells"], board["cells"]))]
    counts = f"{len(board['cells'])} cells, {len(summary.failures)} failed, {summary.seconds:.0f} s"
    return _end(summary, [*lines, "", f"scoreboard: {counts}; {out / FILE}"])


@dataclass(frozen=True)
class PeersOptions:
    """The options of the maps of exploration papers."""

    maps: Annotated[
        str,
        Help(
            None,
            'Patterns of the names of maps, with commas: "*-img_[1-7]" are those of the table, "*" '
            "are all.",
        ),
    ] = "*-img_1"
    beams: Annotated[str, Help(None, "Numbers of beams, with commas. Six are the robot's own.")] = (
        "360,6"
    )
    policies: Annotated[str, Help(None, "Policies, with commas: names, or FILE.py:CLASS.")] = (
        "frontier"
    )
    noise: Annotated[
        float, Help(None, "Standard deviation of the ranges, m. Poses are known without it.")
    ] = 0.0
    robots: Annotated[int, Help(None, "Number of robots that explore together.")] = 1


@app.command()
@takes(PeersOptions)
def peers(
    data: Annotated[Path, typer.Option(help="Folder of the maps of exploration papers.")],
    workers: Workers = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/peers"),
    **told: Any,
) -> int:
    """Explore the maps of exploration papers, in the measure of these papers. The same command goes
    on after a kill.
    """
    from benchmarks.peers import Entrant, maps_in, run_peers

    options = with_told(PeersOptions(), told)
    counts = _names(options.beams)
    if not all(count.isdecimal() for count in counts):
        raise ValueError(f"--beams: whole numbers are needed, not {options.beams!r}")
    lines, summary = run_peers(
        maps_in(data, _names(options.maps)),
        [Entrant(policy, int(count)) for policy in _names(options.policies) for count in counts],
        out,
        _processes(workers),
        noise=options.noise,
        robots=options.robots,
    )
    runs = f"{summary.done} runs, {summary.before} of them before, {len(summary.failures)} failed"
    return _end(summary, [*lines, "", f"peers: {runs}; {out}"])


@app.command()
def table(folders: Folders) -> None:
    """Print medians with intervals, as the paper's grid."""
    from benchmarks.analysis.tables import table as tabulate
    from benchmarks.suite.store import read_rows

    typer.echo(tabulate(read_rows(*folders)).rstrip("\n"))


@app.command()
def speed(
    device: Annotated[
        Literal["cpu", "cuda"], typer.Option(help="cuda: only batches, on a GPU.")
    ] = "cpu",
    processor_time: Annotated[
        bool,
        typer.Option("--processor-time", help="Count processor time, for a machine that is busy."),
    ] = False,
    with_long: Annotated[
        bool, typer.Option("--long", help="Also an hour of driving and a recorded building.")
    ] = False,
) -> None:
    """Measure the speed of environments, batches, beliefs, runs and starts."""
    import time

    from benchmarks.speed import print_device_rates, print_rates

    if device == "cuda":
        print_device_rates()
    else:
        clock = time.process_time if processor_time else time.perf_counter
        print_rates(clock, with_long=with_long)


@app.command()
def growth(
    cases: Annotated[
        str, typer.Option(help="Names of cases, with commas.", show_default="all")
    ] = "",
    hours: Annotated[int, typer.Option(min=1, help="Simulated hours of each case.")] = 10,
) -> None:
    """Measure memory and time of a step over simulated hours."""
    from benchmarks.growth import CASES, print_growth

    unknown = set(_names(cases)) - set(CASES)
    if unknown:
        raise ValueError(f"no case is called {min(unknown)!r}; there are {', '.join(CASES)}")
    print_growth(_names(cases) or tuple(CASES), hours)


def main() -> None:
    """Entry point: 0 well, 1 a job failed, 2 and one line for what the user can mend, 130
    stopped.
    """
    end_cleanly()
    goes_on = next(iter(sys.argv[1:]), "") in _GO_ON
    run_command(
        app,
        "benchmarks",
        interrupted="stopped; what is done is kept, and the same command goes on"
        if goes_on
        else "stopped",
    )


if __name__ == "__main__":
    main()
