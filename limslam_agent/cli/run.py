"""``limslam run``: a simulated run, and its folder."""

import re
import shutil
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from limslam_agent.cli import options as take
from limslam_agent.cli.options import Overwrite, RunOptions
from limslam_agent.cli.settings import Given, run_config, run_options, write_run_settings
from limslam_agent.command_options import takes
from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.endings import code_of, exit_code, noted_endings
from limslam_agent.terminal import Advance, progress_bar, say, warn

if TYPE_CHECKING:
    from limslam_agent.mapping.team import LimSlamTeam
    from limslam_agent.runs.record import Episode
    from limslam_agent.runs.run_config import RunConfig
    from limslam_env.envs.parallel_env import LimSlamParallelEnv

_SHOWN = 10  # steps between two states of the progress bar


@takes(RunOptions)
def run(
    robot: take.Robot = None,
    odometry_noise: take.TrueOdometryNoise = None,
    wheel_mismatch: take.WheelMismatch = None,
    sharp: take.Sharp = False,
    config: take.Config = None,
    **options: Any,
) -> None:
    """Explore an unknown building and draw its map."""
    faults = {"odometry_noise": odometry_noise, "wheel_mismatch": wheel_mismatch, "sharp": sharp}
    given = Given.read(config, {**options, **faults, "robot": robot})
    carry_out(given, run_options(given))


def play(
    world: Annotated[str, typer.Option(help="Name of a shipped world, or a world file.")] = "env1",
    noise: Annotated[float, typer.Option(help="Standard deviation of the ranges, m.")] = 0.02,
    preset: Annotated[str, typer.Option(help="Settings of the agent.")] = DEFAULT_PRESET,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results.", show_default="runs/...")
    ] = None,
    *,
    force: Overwrite = False,
) -> None:
    """Drive a robot with the keyboard, beside what it maps, and keep the run."""
    told = {"world": world, "noise": noise, "preset": preset, "seed": seed}
    given = Given.read(None, {**told, "policy": "keyboard", "out": out, "force": force})
    carry_out(given, run_options(given))


def carry_out(given: Given, options: RunOptions) -> None:
    """Run what was asked for, write its folder, and print its summary."""
    from limslam_agent.output.run_folder import new_folder
    from limslam_agent.output.summary import record_summary, run_summary

    config = run_config(given, options)
    warn([*given.warnings(options.preset), *config.warnings])
    target = options.out or Path("runs") / _folder_name(config)
    task, total = ("driving", config.max_time) if config.laps else ("exploring", 1.0)
    with (
        new_folder(target, force=options.force, numbered=options.out is None) as folder,
        progress_bar(task, total) as advance,
    ):
        with noted_endings() as noted:
            episode = _shown_run(config, advance, options, lambda: bool(noted))
        if config.agent.run_smoothing is not None and not noted:
            advance(total, "smoothing, and writing the map")
        result, code = _written(folder.beside, episode, noted)
        write_run_settings(folder.beside, config, options.world)
    say(*record_summary(result), *run_summary(result["metrics"], result["cost"]))
    if options.video is not None:
        say(f"video       {options.video}")
    say(f"results     {folder.target}")
    raise typer.Exit(code)


def _written(folder: Path, episode: "Episode", noted: list[int]) -> tuple[dict[str, Any], int]:
    """Write the results of a run. The content of ``result.json``, and the exit code.

    What takes long is left out if a signal to end was noted, and broken off if one comes.
    """
    from limslam_agent.runs.results import write_episode

    if not noted:
        try:
            return write_episode(folder, episode), 0
        except (KeyboardInterrupt, SystemExit) as ending:
            code = code_of(ending)
        shutil.rmtree(folder)
        folder.mkdir()
    else:
        code = exit_code(noted[0])
    say("limslam: interrupted: writing what there is; Ctrl-C again ends at once", err=True)
    return write_episode(folder, episode.interrupted()), code


def file_name(world: str) -> str:
    """The name of a world as any system can have it as the name of a file."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", world).strip(".") or "world"


def _folder_name(config: "RunConfig") -> str:
    from limslam_env.worlds.formats.loading import load_world

    world = file_name(load_world(config.world).name)
    return (
        f"{world}-{100 * config.noise:g}cm-{config.preset}-seed{config.seed}"
        + (f"-{config.policy.rpartition(':')[2]}" if config.policy != "frontier" else "")
        + (f"-{config.laps}laps" if config.laps else "")
        + (f"-{config.robots}robots" if config.robots > 1 else "")
        + (f"-{config.ablation}" if config.ablation else "")
    )


def _shown_run(
    config: "RunConfig", advance: Advance, options: RunOptions, is_interrupted: Callable[[], bool]
) -> "Episode":
    """Run, and show the run in a film and in a browser where that was asked for. Both show the same
    recording.
    """
    from limslam_agent.inspect.live_page import Follower, live_page
    from limslam_agent.runs.driving import Driver, driving
    from limslam_agent.runs.episode import run_episode
    from limslam_agent.runs.policies import KEYBOARD
    from limslam_agent.runs.recording import FilmedRun, filming
    from limslam_agent.runs.results import title_of
    from limslam_env.worlds.formats.loading import load_world

    title = title_of(config)
    steps = round(config.max_time / config.robot.control_period) + 1
    with ExitStack() as opened:
        page = follower = driver = None
        pictures: list[FilmedRun | Driver] = []
        if options.video is not None:
            film = filming(options.video, config, title, force=options.force)
            pictures.append(opened.enter_context(film))
        if options.watch:
            page = opened.enter_context(live_page(title, load_world(config.world).edges))
            typer.echo(f"watch       {page.address}", err=True)
        if config.policy == KEYBOARD:
            driver = opened.enter_context(driving(config))
            pictures.append(driver)
        if page is not None or pictures:
            follower = Follower(page, steps)

        def show(
            team: "LimSlamTeam", env: "LimSlamParallelEnv", time: float, coverage: float
        ) -> None:
            if round(time / config.robot.control_period) % _SHOWN == 0:
                # An exploration is over when all is seen, and laps have no such end.
                advance(
                    time if config.laps else coverage,
                    f"{time:6.1f} s  {coverage:6.1%} covered  {team.status}",
                )
            if follower is not None:
                recorder = follower.note(team.mapper, team.policies, time, env.true_poses)
                for picture in pictures:
                    picture.watch(recorder, team, env, time, coverage)

        episode = run_episode(
            config,
            show,
            render_mode="rgb_array" if pictures else None,
            policies=None if driver is None else [driver],
            is_interrupted=is_interrupted,
        )
        if follower is not None:
            follower.end()
        return episode
