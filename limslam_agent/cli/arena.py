"""``limslam arena``: enter the benchmark, verify results, and write the leaderboard."""

import os
import sys
from contextlib import suppress
from dataclasses import dataclass
from getpass import getpass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from limslam_agent.cli.options import Overwrite
from limslam_agent.command_options import takes, with_told
from limslam_agent.config.bounds import Bounded, Bounds
from limslam_agent.config.help import Help
from limslam_agent.terminal import print_table, progress_bar, say, warn

if TYPE_CHECKING:
    from limslam_agent.arena.leaderboard import Board
    from limslam_agent.runs.record import Episode

arena = typer.Typer(
    name="arena",
    no_args_is_help=True,
    help="A benchmark that anybody can enter: run, verify, page.",
)

_LONGEST_SEED = 1001  # characters, with the end of the line

_Secret = Annotated[
    bool,
    Help(None, "Read the seed of plans that nobody has seen from standard input, for judging."),
]
_Jobs = Annotated[int, Bounds(1, 64, is_whole=True), Help(None, "Number of processes.")]
_EntryUser = Annotated[
    str | None,
    Help(
        None,
        "User whose rights a command has. Only root can choose one.",
        "the present user",
    ),
]


@dataclass(frozen=True)
class RunOptions(Bounded):
    """The options of ``limslam arena run``."""

    plans: Annotated[
        int,
        Bounds(1, 100, is_whole=True),
        Help(None, "How many plans are run, from the first on."),
    ] = 100
    jobs: _Jobs = 2
    secret_seed: _Secret = False
    keep: Annotated[bool, Help(None, "Keep the folder of each run, for limslam inspect.")] = False
    retry_failed: Annotated[bool, Help(None, "Run plans again that failed.")] = False
    entry_user: _EntryUser = None


@dataclass(frozen=True)
class VerifyOptions(Bounded):
    """The options of ``limslam arena verify``."""

    plans: Annotated[
        int | None, Help(None, "How many plans are run again, drawn at random.", "all")
    ] = None
    seed: Annotated[int | None, Help(None, "Seed of the draw.", "of the operating system")] = None
    entry: Annotated[
        Path | None, Help(None, "Folder of the entry.", "where it was when it ran")
    ] = None
    jobs: _Jobs = 2
    secret_seed: _Secret = False
    entry_user: _EntryUser = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, least in (("plans", 1), ("seed", 0)):
            value = getattr(self, name)
            if value is not None and value < least:
                raise ValueError(f"{name} must be at least {least}, not {value}")


def _read_seed() -> int:
    """The secret seed from standard input, which is closed then.

    An entry can read the command lines of the processes above it, and where it runs as the same
    user, their open files. Their memory is hidden.
    """
    from limslam_agent.measurements.linux import hide_memory

    hide_memory()
    text = getpass("secret seed: ") if sys.stdin.isatty() else sys.stdin.readline(_LONGEST_SEED)
    with open(os.devnull, "rb") as nothing, suppress(OSError):  # noqa: PTH123 (a device)
        os.dup2(nothing.fileno(), sys.stdin.fileno())
    if not text.strip().isdecimal():
        raise ValueError(
            "--secret-seed reads a whole number of 0 or more from standard input, of 1000 digits "
            "at most"
        )
    return int(text)


@arena.command()
@takes(RunOptions)
def run(
    entry: Annotated[Path, typer.Argument(help="Folder of the entry, with entry.toml.")],
    out: Annotated[
        Path, typer.Option(help="Folder for the results. Results that are there are kept.")
    ],
    **told: Any,
) -> None:
    """Run an entry on the plans. A run that was stopped goes on where it was."""
    from limslam_agent.arena.entry import read_entry
    from limslam_agent.arena.leaderboard import board
    from limslam_agent.arena.running import Execution, run_entry
    from limslam_agent.arena.tracks import PUBLIC_SEED, plans_of

    options = with_told(RunOptions(), told)
    found = read_entry(entry)
    seed = _read_seed() if options.secret_seed else PUBLIC_SEED
    wanted = plans_of(seed)[: options.plans]
    execution = Execution(
        options.jobs,
        write_kept_run if options.keep else None,
        retry_failed=options.retry_failed,
        user=options.entry_user,
    )
    with progress_bar("arena", len(wanted)) as advance:
        rows = run_entry(
            found,
            wanted,
            out,
            seed,
            execution,
            lambda row, done: advance(done, f"{done} of {len(wanted)} plans, latest {row.plan}"),
        )
    warn(f"plan {row.plan} failed: {row.error}" for row in rows if row.error is not None)
    _print_board(board([out]))
    say(f"results     {out}")


@arena.command()
@takes(VerifyOptions)
def verify(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of results.")], **told: Any
) -> None:
    """Run plans again and compare all metrics. Exit code 1 if something differs."""
    import numpy as np

    from limslam_agent.arena import verify as again
    from limslam_agent.arena.running import Execution
    from limslam_env.messages import counted, one_line

    options = with_told(VerifyOptions(), told)
    seed = _read_seed() if options.secret_seed else None
    found, stamp, all_plans = again.opened(folder, options.entry, seed)
    if changed := again.other_versions(stamp):
        warn([f"the results are of other versions ({changed})"])
    is_process = found.manifest.is_process
    execution = Execution(options.jobs, user=options.entry_user)
    draws = np.random.default_rng(options.seed)
    pairs = []
    different = 0
    for before, now in again.verify(folder, found, all_plans, execution, draws, options.plans):
        differences = again.differences(before, now, is_process=is_process)
        typer.echo(one_line(f"plan {now.plan:3}    {'; '.join(differences) or 'equal'}", 500))
        different += bool(differences)
        pairs.append((before, now))
    shifts = again.shifts(pairs) if is_process else []
    for shift in shifts:
        typer.echo(f"all plans   {shift}: the differences of honest runs have both signs")
    within = " within the bounds of a process" if is_process else ""
    typer.echo(
        f"verified    {len(pairs)} of {counted(len(all_plans), 'plan')}, "
        f"{len(pairs) - different} equal{within}"
    )
    if different or shifts:
        raise typer.Exit(1)


@arena.command()
def page(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Folders of results.")],
    out: Annotated[Path, typer.Option(help="Write this file (.html).")],
    *,
    force: Overwrite = False,
) -> None:
    """Write the leaderboard as one page: open it in any browser."""
    from limslam_agent.arena.leaderboard import board
    from limslam_agent.arena.page import write_board
    from limslam_agent.output.atomic_write import check_target

    check_target(out, "a page", (".html", ".htm"), force=force)
    found = board(folders)
    size = write_board(out, found)
    _print_board(found)
    say(f"page        {out} ({size / 1e6:.1f} MB)")


def write_kept_run(folder: Path, episode: "Episode") -> dict[str, Any]:
    """Write the folder of a run, as ``limslam run`` does, and return its metrics.

    A command has no name that ``limslam run`` knows, so its folders have no ``run.toml``.
    """
    from limslam_agent.cli.settings import write_run_settings
    from limslam_agent.output.run_folder import new_folder
    from limslam_agent.runs.results import write_episode

    config = episode.config
    with new_folder(folder, force=True) as new:
        metrics: dict[str, Any] = write_episode(new.beside, episode)["metrics"]
        if not config.driver:
            write_run_settings(new.beside, config, str(config.world))
    return metrics


def _print_board(found: "Board") -> None:
    from limslam_agent.arena.page import table_rows
    from limslam_agent.arena.tracks import COUNT
    from limslam_env.messages import counted

    typer.echo(f"compared    {len(found.plans)} of {counted(COUNT, 'plan')}")
    print_table(table_rows(found))
