"""``limslam inspect``: a finished run or a log as a page that plays it step by step."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from limslam_agent.cli.options import Overwrite, ReplayOptions
from limslam_agent.cli.replay import job_of
from limslam_agent.cli.settings import FILE, Given, replay_agent, run_config, run_options
from limslam_agent.terminal import progress_bar, say

if TYPE_CHECKING:
    from limslam_agent.output.finished_run import FinishedRun
    from limslam_agent.runs.inspection import Inspection


def inspect(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RUN_OR_LOG",
            help="The folder of a finished run, replay or live session, or a log.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Write this file (.html).", show_default="RUN/inspect.html or LOG.html"),
    ] = None,
    *,
    force: Overwrite = False,
) -> None:
    """Write a page that plays a run step by step: open it in any browser."""
    from limslam_agent.inspect.page import write_page
    from limslam_agent.output.atomic_write import check_target
    from limslam_agent.output.finished_run import read_run

    run = read_run(source) if source.is_dir() or not source.exists() else None
    target = out or (
        Path(f"{source.name.split('.')[0]}.html") if run is None else source / "inspect.html"
    )
    check_target(target, "a page", (".html", ".htm"), force=force)
    title = source.name if run is None else run.title
    found = _of_log(source) if run is None else _of_folder(run)
    size = write_page(target, title, found.arrays, found.meta)
    typer.echo(f"recorded    {found.frames} frames and {len(found.meta['events'])} events")
    if found.difference is not None:
        typer.echo(f"check       {found.meta['check']}")
    say(f"page        {target} ({size / 1e6:.1f} MB)")


def _of_folder(run: "FinishedRun") -> "Inspection":
    from limslam_agent.runs.inspection import inspect_run

    settings = run.folder / FILE
    if not settings.is_file():
        raise ValueError(
            f"{run.folder}: there is no {FILE}, without which the run cannot be repeated"
        )
    given = Given.read(settings, {})
    if run.is_replay:
        return _of_replay(given, run)
    config = run_config(given, run_options(given))
    with progress_bar("inspecting", len(run.time)) as advance:
        return inspect_run(
            config, run, lambda done: advance(done, f"{done} of {len(run.time)} steps")
        )


def _of_replay(given: Given, run: "FinishedRun | None") -> "Inspection":
    from limslam_agent.places.saved_map import read_saved_map
    from limslam_agent.runs.inspection import inspect_log

    options = given.merged(ReplayOptions())
    if options.log is None:
        raise ValueError(f"{given.path}: names no log")
    if options.other_log is not None:
        raise ValueError(
            f"{given.path}: is of two logs; inspect one of them: limslam inspect {options.log}"
        )
    job = job_of(options.log, options, replay_agent(given, options), given.replay_robot())
    prior_map = None if options.map is None else read_saved_map(options.map)
    count = len(job.log)
    with progress_bar("inspecting", count) as advance:
        return inspect_log(
            job.log,
            job.config,
            lambda done: advance(done, f"{done} of {count} events"),
            run,
            prior_map,
        )


def _of_log(path: Path) -> "Inspection":
    return _of_replay(Given(None, {}, {"log": path}), None)
