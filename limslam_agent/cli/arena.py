"""``limslam arena``: enter the benchmark, verify results, and write the leaderboard."""

import os
import sys
from contextlib import suppress
from getpass import getpass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from limslam_agent.terminal import print_table, progress_bar, say, warn

if TYPE_CHECKING:
    from limslam_agent.arena.leaderboard import Board
    from limslam_agent.runs.record import Episode

arena = typer.Typer(
    name="arena",
    no_args_is_help=True,
    help="A benchmark that anybody can enter: run, verify, page.",
)

_Secret = Annotated[
    bool,
    typer.Option(
        "--secret-seed",
        help="Read the seed of plans that nobody has seen from standard input, for judging.",
    ),
]
_LONGEST_SEED = 1001  # characters, with the end of the line
_Jobs = Annotated[int, typer.Option(min=1, max=64, help="Number of processes.")]
_EntryUser = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="User whose rights a command has. Only root can choose one.",
        show_default="the present user",
    ),
]


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
def run(
    entry: Annotated[Path, typer.Argument(help="Folder of the entry, with entry.toml.")],
    out: Annotated[
        Path, typer.Option(help="Folder for the results. Results that are there are kept.")
    ],
    plans: Annotated[
        int, typer.Option(min=1, max=100, help="How many plans are run, from the first on.")
    ] = 100,
    jobs: _Jobs = 2,
    *,
    secret_seed: _Secret = False,
    keep: Annotated[
        bool, typer.Option("--keep", help="Keep the folder of each run, for limslam inspect.")
    ] = False,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Run plans again that failed.")
    ] = False,
    entry_user: _EntryUser = None,
) -> None:
    """Run an entry on the plans. A run that was stopped goes on where it was."""
    from limslam_agent.arena.entry import read_entry
    from limslam_agent.arena.leaderboard import board
    from limslam_agent.arena.running import run_entry
    from limslam_agent.arena.tracks import PUBLIC_SEED, plans_of

    found = read_entry(entry)
    seed = _read_seed() if secret_seed else PUBLIC_SEED
    wanted = plans_of(seed)[:plans]
    with progress_bar("arena", len(wanted)) as advance:
        rows = run_entry(
            found,
            wanted,
            out,
            seed=seed,
            jobs=jobs,
            keep=write_kept_run if keep else None,
            retry_failed=retry_failed,
            user=entry_user,
            report=lambda row, done: advance(
                done, f"{done} of {len(wanted)} plans, latest {row.plan}"
            ),
        )
    warn(f"plan {row.plan} failed: {row.error}" for row in rows if row.error is not None)
    _print_board(board([out]))
    say(f"results     {out}")


@arena.command()
def verify(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of results.")],
    plans: Annotated[
        int | None,
        typer.Option(
            min=1, help="How many plans are run again, drawn at random.", show_default="all"
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Seed of the draw.", show_default="of the operating system"),
    ] = None,
    entry: Annotated[
        Path | None,
        typer.Option(help="Folder of the entry.", show_default="where it was when it ran"),
    ] = None,
    jobs: _Jobs = 2,
    *,
    secret_seed: _Secret = False,
    entry_user: _EntryUser = None,
) -> None:
    """Run plans again and compare all metrics. Exit code 1 if something differs."""
    import numpy as np

    from limslam_agent.arena import verify as again
    from limslam_env.messages import counted, one_line

    found, stamp, all_plans = again.opened(folder, entry, _read_seed() if secret_seed else None)
    if changed := again.other_versions(stamp):
        warn([f"the results are of other versions ({changed})"])
    different = 0
    rows = again.verify(
        folder,
        found,
        all_plans,
        jobs,
        np.random.default_rng(seed),
        count=plans,
        user=entry_user,
    )
    pairs = []
    for before, now in rows:
        differences = again.differences(before, now, is_process=found.manifest.is_process)
        typer.echo(one_line(f"plan {now.plan:3}    {'; '.join(differences) or 'equal'}", 500))
        different += bool(differences)
        pairs.append((before, now))
    checked = len(pairs)
    shifts = again.shifts(pairs) if found.manifest.is_process else []
    for shift in shifts:
        typer.echo(f"all plans   {shift}: the differences of honest runs have both signs")
    within = " within the bounds of a process" if found.manifest.is_process else ""
    typer.echo(
        f"verified    {checked} of {counted(len(all_plans), 'plan')}, "
        f"{checked - different} equal{within}"
    )
    if different or shifts:
        raise typer.Exit(1)


@arena.command()
def page(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Folders of results.")],
    out: Annotated[Path, typer.Option(help="Write this file (.html).")],
    *,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
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
