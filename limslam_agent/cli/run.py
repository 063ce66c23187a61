"""``limslam run``: a simulated run, and its folder."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from limslam_agent.cli import options as take
from limslam_agent.cli.settings import Given, RunOptions, run_config, run_options, write_run_settings
from limslam_agent.cli.terminal import Advance, progress_bar, warn

if TYPE_CHECKING:
    from limslam_agent.runs.episode import Episode, Watcher
    from limslam_agent.runs.run_config import RunConfig
    from limslam_agent.team import LimSlamTeam
    from limslam_env.envs.parallel_env import LimSlamParallelEnv


def run(
    world: take.World = None,
    noise: take.Noise = None,
    preset: take.RunPreset = None,
    seed: take.Seed = None,
    max_time: take.MaxTime = None,
    policy: take.Policy = None,
    until: take.Until = None,
    laps: take.Laps = None,
    robots: take.Robots = None,
    robot: take.Robot = None,
    calibration: take.Calibration = None,
    odometry_noise: take.TrueOdometryNoise = None,
    wheel_mismatch: take.WheelMismatch = None,
    axle_mismatch: take.AxleMismatch = None,
    slip_rate: take.SlipRate = None,
    slip_share: take.SlipShare = None,
    dropout: take.Dropout = None,
    sharp: take.Sharp = None,
    kidnap_at: take.KidnapAt = None,
    unknown_starts: take.UnknownStarts = None,
    map: take.PriorMap = None,  # noqa: A002 (the option's name)
    ablation: take.Ablation = None,
    limit: take.Limit = None,
    video: take.Video = None,
    film_speed: take.FilmSpeed = None,
    watch: take.Watch = None,
    out: take.Out = None,
    force: take.Force = None,
    config: take.Config = None,
) -> None:
    """Explore an unknown building and draw its map."""
    arguments = locals()
    given = Given.read(arguments.pop("config"), arguments)
    carry_out(given, run_options(given))


def carry_out(given: Given, options: RunOptions) -> None:
    """Run what was asked for, write its folder, and print its summary.

    Raises
    ------
    ValueError
        If it cannot be run or written.
    """
    from limslam_agent.output.run_folder import new_folder
    from limslam_agent.output.summary import record_summary, run_summary
    from limslam_agent.runs.results import write_episode
    from limslam_env.messages import printable

    config = run_config(given, options)
    options = replace(options, max_time=config.max_time)
    warn([*given.warnings(options.preset), *config.warnings])
    target = options.out or Path("runs") / _folder_name(config)
    task, total = ("driving", options.max_time) if options.laps else ("exploring", 1.0)
    with (
        new_folder(target, force=options.force, numbered=options.out is None) as folder,
        progress_bar(task, total) as advance,
    ):
        episode = _filmed_run(config, advance, options)
        if config.agent.run_smoothing is not None:
            advance(options.max_time if options.laps else 1.0, "smoothing, and writing the map")
        result = write_episode(folder.beside, episode)
        write_run_settings(folder.beside, options, config)
    for line in record_summary(result) + run_summary(result["metrics"], result["cost"]):
        typer.echo(line)
    if options.video is not None:
        typer.echo(printable(f"video       {options.video}"))
    typer.echo(printable(f"results     {folder.target}"))


def _folder_name(config: "RunConfig") -> str:
    from limslam_env.worlds.formats.loading import load_world

    world = re.sub(r"[^A-Za-z0-9_.-]+", "_", load_world(config.world).name).strip(".") or "world"
    return (
        f"{world}-{100 * config.noise:g}cm-{config.preset}-seed{config.seed}"
        + (f"-{config.policy.rpartition(':')[2]}" if config.policy != "frontier" else "")
        + (f"-{config.laps}laps" if config.laps else "")
        + (f"-{config.robots}robots" if config.robots > 1 else "")
        + (f"-{config.ablation}" if config.ablation else "")
    )


def _filmed_run(config: "RunConfig", advance: Advance, options: RunOptions) -> "Episode":
    from limslam_agent.runs.episode import run_episode

    with _watched(config, options) as follow:

        def show(team: "LimSlamTeam", env: "LimSlamParallelEnv", time: float, coverage: float) -> None:
            # An exploration is over when all is seen, and laps have no such end.
            advance(time if config.laps else coverage, f"{time:6.1f} s  {coverage:6.1%} covered  {team.status}")
            follow(team, env, time, coverage)

        if options.video is None:
            return run_episode(config, show)
        from limslam_agent.runs.recording import filming
        from limslam_agent.runs.results import title_of

        title, speed = title_of(config), options.film_speed
        with filming(options.video, config, title, force=options.force, speed=speed) as recorder:

            def watch(team: "LimSlamTeam", env: "LimSlamParallelEnv", time: float, coverage: float) -> None:
                recorder.watch(team, env, time, coverage)
                show(team, env, time, coverage)

            return run_episode(config, watch, render_mode="rgb_array")


@contextmanager
def _watched(config: "RunConfig", options: RunOptions) -> "Iterator[Watcher]":
    """What is called after each step, so that a browser can show the run while it goes on."""
    if not options.watch:
        yield lambda *_: None
        return
    from limslam_agent.inspect.live_page import Follower, live_page
    from limslam_agent.runs.results import title_of
    from limslam_env.worlds.formats.loading import load_world

    steps = round(config.max_time / config.robot.control_period) + 1
    with live_page(title_of(config), load_world(config.world).edges) as page:
        typer.echo(f"watch       {page.address}", err=True)
        follower = Follower(page, steps)
        yield lambda team, env, time, _: follower.note(team.mapper, team.policies, time, env.true_poses)
        follower.end()
