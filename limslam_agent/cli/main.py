"""The command line: ``limslam run``, ``replay``, ``show``, ``play`` and ``worlds``.

What takes long to import is imported inside the commands, so that help comes at once.
"""

import re
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from limslam_agent.cli.show import show
from limslam_agent.cli.worlds import worlds

if TYPE_CHECKING:
    from limslam_agent.runs.episode import Episode, RunConfig
    from limslam_agent.team import LimSlamTeam
    from limslam_env.envs.parallel_env import LimSlamParallelEnv

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Exploration and SLAM with almost no sensing.",
)

app.add_typer(worlds)
app.command()(show)

_console = Console(stderr=True, highlight=False)

Out = Annotated[Path | None, typer.Option(help="Folder for the results.", show_default="runs/...")]
Force = Annotated[bool, typer.Option("--force", help="Replace the results of an earlier run in that folder.")]
PresetName = Annotated[
    str,
    typer.Option("--preset", help="The agent's settings: consistent, paper (as published), or odometry (no filter)."),
]


@app.callback()
def _limslam() -> None:
    """Exploration and SLAM with almost no sensing."""


@app.command()
def run(
    world: Annotated[str, typer.Option(help="Name of a shipped world, or a world file.")] = "env1",
    noise: Annotated[float, typer.Option(help="Standard deviation of the ranges, m.")] = 0.02,
    preset: PresetName = "consistent",
    seed: Annotated[int, typer.Option(help="Of all noise.")] = 0,
    max_time: Annotated[float, typer.Option(help="Longest simulated time, s.")] = 1800.0,
    policy: Annotated[
        str,
        typer.Option(
            help="Who drives: frontier, frontier_fast, learned, wall_follower, random; "
            "or by the truth: learned_true_pose, tour, oracle."
        ),
    ] = "frontier",
    laps: Annotated[int, typer.Option(help="Drive round the world's loop this often instead of exploring.")] = 0,
    robots: Annotated[int, typer.Option(help="How many explore together, 1 to 8.")] = 1,
    ablation: Annotated[str | None, typer.Option(help="Part of the method to leave out.", show_default="none")] = None,
    limit: Annotated[bool, typer.Option("--limit", help="Compute the optimum too (needs gtsam).")] = False,
    video: Annotated[Path | None, typer.Option(help="Film it: FILE.mp4 or FILE.gif.", show_default="none")] = None,
    out: Out = None,
    force: Force = False,
) -> None:
    """Explore an unknown building and draw its map."""
    from limslam_agent.output.export import new_folder
    from limslam_agent.output.summary import run_summary
    from limslam_agent.runs.episode import RunConfig
    from limslam_agent.runs.results import write_episode
    from limslam_env.worlds.formats.loading import load_world

    place = load_world(world)
    config = RunConfig(
        place, noise, preset, seed, max_time, laps, robots=robots, ablation=ablation, policy=policy, limit=limit
    )
    name = (
        f"{re.sub(r'[^A-Za-z0-9_.-]+', '_', place.name).strip('.') or 'world'}-{100 * noise:g}cm-{preset}-seed{seed}"
        + (f"-{policy}" if policy != "frontier" else "")
        + (f"-{laps}laps" if laps else "")
        + (f"-{robots}robots" if robots > 1 else "")
        + (f"-{ablation}" if ablation else "")
    )
    target = out or _unused(Path("runs") / name)
    with new_folder(target, force=force) as folder, _bar("driving" if laps else "exploring", max_time) as advance:
        episode = _filmed_run(config, advance, video, force=force)
        result = write_episode(folder, episode)
    for line in run_summary(result["metrics"], result["cost"]):
        typer.echo(line)
    if video is not None:
        typer.echo(f"video       {video}")
    typer.echo(f"results     {target}")


def _filmed_run(
    config: "RunConfig", advance: Callable[[float, str], None], video: Path | None, *, force: bool
) -> "Episode":
    from limslam_agent.runs.episode import run_episode

    def show(time: float, coverage: float) -> None:
        advance(time, f"{time:6.1f} s  {coverage:6.1%} covered")

    if video is None:
        return run_episode(config, lambda _team, _env, time, coverage: show(time, coverage))
    from limslam_agent.runs.recording import filming
    from limslam_agent.runs.results import title_of

    with filming(video, config, title_of(config), force=force) as recorder:

        def watch(team: "LimSlamTeam", env: "LimSlamParallelEnv", time: float, coverage: float) -> None:
            recorder.watch(team, env, time, coverage)
            show(time, coverage)

        return run_episode(config, watch, on_association=recorder.on_association, render_mode="rgb_array")


@app.command()
def replay(
    log: Annotated[Path, typer.Argument(help="A CARMEN log, a table (.csv), a ROS bag, or the log.npz of a run.")],
    beams: Annotated[str | None, typer.Option(help="Beams to use, deg: A,B,...", show_default="all of a few")] = None,
    max_range: Annotated[float | None, typer.Option(help="Longest range used, m.", show_default="3.0")] = None,
    noise: Annotated[float, typer.Option(help="Assumed standard deviation of the ranges, m.")] = 0.02,
    preset: PresetName = "paper",
    odometry_noise: Annotated[
        str | None,
        typer.Option(
            help="Std after 1 m of distance (m) and of heading (deg), and of heading after turning 1 rad (deg).",
            show_default="0.05,0.8,4",
        ),
    ] = None,
    odometry_bias: Annotated[
        str | None,
        typer.Option(
            help="True minus reported heading per metre, deg, and true over reported distance.", show_default="0,1"
        ),
    ] = None,
    self_calibrate: Annotated[
        bool, typer.Option("--self-calibrate", help="Let the filter find what odometry is wrong by (consistent only).")
    ] = False,
    calibrate: Annotated[Path | None, typer.Option(help="Known relative poses to estimate the bias from.")] = None,
    calibrate_until: Annotated[float | None, typer.Option(help="Of the log's first seconds only.")] = None,
    calibrate_log: Annotated[Path | None, typer.Option(help="Of this log, instead of the one replayed.")] = None,
    scan_topic: Annotated[str | None, typer.Option(help="In a bag: LaserScan, several as A,B.")] = None,
    range_topics: Annotated[str | None, typer.Option(help="In a bag: Ranges as TOPIC:DEG,...")] = None,
    odometry_topic: Annotated[str | None, typer.Option(help="In a bag: Odometry or poses.")] = None,
    relations: Annotated[Path | None, typer.Option(help="Known relative poses to score against.")] = None,
    out: Out = None,
    force: Force = False,
) -> None:
    """Map from a recorded log."""
    from limslam_agent.logs.log_reader import read_log
    from limslam_agent.logs.relations import read_relations
    from limslam_agent.output.export import new_folder
    from limslam_agent.output.summary import replay_summary
    from limslam_agent.replay.options import CalibrationRun, chosen_topics, numbers, replay_config
    from limslam_agent.replay.replay import relation_scores, replay_log, write_replay
    from limslam_agent.runs.results import trajectory_scores, versions

    config = replay_config(preset, noise, odometry_noise, odometry_bias, self_calibrate=self_calibrate)
    calibration_run = CalibrationRun(calibrate, calibrate_until, calibrate_log)
    if calibrate and odometry_bias:
        raise ValueError("--odometry-bias and --calibrate both set the bias: one of them is enough")
    known = read_relations(relations) if relations else None
    angles = None if beams is None else numbers("--beams", beams)
    topics = chosen_topics(scan_topic, range_topics, odometry_topic)
    recorded = read_log(log, angles, max_range, topics)
    if recorded.odometry is None and (odometry_noise or odometry_bias):
        raise ValueError(f"{log}: has wheel travel; --odometry-noise and --odometry-bias are for logs with poses")
    calibration = calibration_run.estimate(
        recorded, config.odometry, lambda other: read_log(other, angles, max_range, topics)
    )
    if calibration:
        config = replace(config, odometry=calibration.applied_to(config.odometry))
        known = known and calibration.held_out(known)
    target = out or _unused(Path("runs") / f"replay-{log.name.split('.')[0]}-{preset}")
    with new_folder(target, force=force) as folder:
        with _bar("replaying", len(recorded)) as advance:
            result = replay_log(recorded, config, lambda done: advance(done, f"{done} of {len(recorded)} events"))
        scores: dict[str, Any] = {}
        if recorded.true_pose is not None:
            scores |= trajectory_scores(recorded.true_pose, result.estimated, result.odometry, result.covariances)
        if known is not None:
            scores |= relation_scores(result, known)
            if not scores["relations"]:
                left = "left to score" if calibration else "in the log's time"
                raise ValueError(f"{relations}: none of its relations is {left}")
        source = {"log": log.name, "relations": relations.name if relations else None, **calibration_run.source}
        figures = calibration.figures if calibration else {}
        write_replay(folder, result, source, {**scores, **figures}, versions())
    calibrated = [f"calibrated  {found.words}" for found in (calibration, result.self_calibration) if found]
    for line in calibrated + replay_summary({**scores, "landmarks": len(result.landmarks)}):
        typer.echo(line)
    typer.echo(f"results     {target}")


@app.command()
def play(
    world: Annotated[str, typer.Option(help="Name of a shipped world, or a world file.")] = "env1",
    noise: Annotated[float, typer.Option(help="Standard deviation of the ranges, m.")] = 0.0,
    seed: Annotated[int, typer.Option(help="Of all noise.")] = 0,
) -> None:
    """Drive a robot by keyboard, in a window."""
    from gymnasium.error import Error

    from limslam_env.envs.play import play as drive_by_keyboard

    try:
        drive = drive_by_keyboard(world, sensor_noise=noise, seed=seed)
    except Error as error:  # no pygame, no display, or no such seed
        raise ValueError(str(error)) from error
    typer.echo(f"drove for   {drive.time:.1f} s and covered {drive.coverage:.1%} of what can be seen")


def main() -> None:
    """Entry point: exit code 2 and one line for what the user can mend, no traceback."""
    # A polite end is an end like any other: what was being written is taken back.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        code = app(standalone_mode=False)
    except typer.TyperException as error:
        _fail(error.format_message())
    except (typer.Abort, KeyboardInterrupt):
        typer.echo("limslam: stopped", err=True)
        sys.exit(130)
    except ValueError as error:
        # All of the project's own refusals are ValueErrors: worlds, logs, outputs, settings.
        _fail(str(error))
    except OSError as error:
        _fail(f"{error.filename or 'output'}: {error.strerror or error}")
    except (ArithmeticError, MemoryError) as error:
        _fail(f"the numbers are out of all bounds: {error}")
    sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str) -> None:
    if message:
        typer.echo("limslam: " + " ".join(message.split()), err=True)
    sys.exit(2)


@contextmanager
def _bar(task: str, total: float) -> Iterator[Callable[[float, str], None]]:
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[state]}"), TimeElapsedColumn())
    quiet = not _console.is_terminal
    with Progress(*columns, console=_console, transient=True, refresh_per_second=5, disable=quiet) as progress:
        bar = progress.add_task(task, total=total, state="")
        yield lambda done, state: progress.update(bar, completed=done, state=state)


def _unused(path: Path) -> Path:
    """The path, or the first numbered one that is not taken."""
    candidates = [path, *(path.with_name(f"{path.name}-{number}") for number in range(2, 10_000))]
    return next(candidate for candidate in candidates if not candidate.exists())


if __name__ == "__main__":
    main()
