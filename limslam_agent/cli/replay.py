"""``limslam replay``: a map from a recorded log, and its folder."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from limslam_agent.cli import options as take
from limslam_agent.cli.options import ReplayOptions, takes
from limslam_agent.cli.settings import Given, replay_agent, write_replay_settings
from limslam_agent.cli.terminal import progress_bar, warn

if TYPE_CHECKING:
    from limslam_agent.config.presets import AgentConfig
    from limslam_agent.logs.recorded_log import RecordedLog
    from limslam_agent.logs.relations import Relations
    from limslam_agent.logs.table_options import TableOptions
    from limslam_agent.replay.calibration import OdometryBias
    from limslam_agent.replay.replay import Replay
    from limslam_env.interface import RobotSpec


@takes(ReplayOptions)
def replay(
    log: take.Log = None,
    robot: take.RecordingRobot = None,
    relations: take.RelationsFile = None,
    config: take.Config = None,
    **told: Any,
) -> None:
    """Draw a map from a recorded log, or from two logs of one building."""
    paths = {**_pair("log", log, "LOG"), **_pair("relations", relations, "--relations")}
    given = Given.read(config, {**told, **paths, "robot": robot})
    options = given.merged(ReplayOptions(), ("agent", "robot"))
    agent = replay_agent(given, options)
    warn(given.warnings(options.preset))
    if options.other_log is not None:
        from limslam_agent.cli.two_logs import carry_out_both

        carry_out_both(options, agent, given.replay_robot())
        return
    if options.other_relations is not None:
        raise ValueError("--relations is given twice, which is for two logs")
    carry_out(options, agent, given.replay_robot())


def _pair(name: str, paths: list[Path] | None, shown: str) -> dict[str, Path | None]:
    """One or two paths by the names of their options.

    Raises
    ------
    ValueError
        If there are more of them.
    """
    if paths and len(paths) > 2:
        raise ValueError(f"{shown}: {len(paths)} were given; one log is replayed, or two logs are joined")
    first, second = [*(paths or []), None, None][:2]
    return {name: first, f"other_{name}": second}


@dataclass(frozen=True, eq=False)
class Job:
    """A log with all that is known about it.

    Attributes
    ----------
    log
        The log's events.
    config
        The agent's settings, with the estimated bias if there is one.
    relations
        Known relative poses to score with; None where there are none.
    calibration
        The estimated bias of the odometry; None where none was asked for.
    source
        Names of the files, for ``result.json``.
    """

    log: "RecordedLog"
    config: "AgentConfig"
    relations: "Relations | None"
    calibration: "OdometryBias | None"
    source: dict[str, str | None]


def carry_out(options: ReplayOptions, agent: "AgentConfig", robot: "RobotSpec | None" = None) -> None:
    """Replay a log, write its folder, and print its summary. ``robot`` is the robot that recorded a table.

    Raises
    ------
    ValueError
        If it cannot be replayed or written.
    """
    from limslam_agent.output.run_folder import new_folder
    from limslam_agent.output.summary import record_summary, replay_summary
    from limslam_agent.places.saved_map import read_saved_map
    from limslam_agent.replay.plausibility import log_warnings, map_warnings
    from limslam_agent.replay.replay import replay_log, write_replay
    from limslam_agent.runs.results import versions
    from limslam_env.messages import printable

    if options.log is None:
        raise ValueError("a log is needed: limslam replay LOG")
    job = job_of(options.log, options, agent, robot)
    target = options.out or Path("runs") / f"replay-{options.log.name.split('.')[0]}-{options.preset}"
    count = len(job.log)
    warn(log_warnings(job.log))
    with new_folder(target, force=options.force, numbered=options.out is None) as folder:
        with progress_bar("replaying", count) as advance:
            result = replay_log(
                job.log, job.config, lambda done: advance(done, f"{done} of {count} events"),
                lambda stage: advance(count, f"smoothing: {stage}"),
                None if options.map is None else read_saved_map(options.map),
            )  # fmt: skip
        scores = scores_of(job, result, options.relations)
        figures = job.calibration.figures if job.calibration else {}
        content = write_replay(folder.beside, result, job.source, {**scores, **figures}, versions())
        write_replay_settings(folder.beside, options, agent, robot)
    calibrated = [f"calibrated  {found.words}" for found in (job.calibration, result.self_calibration) if found]
    for line in record_summary(content) + calibrated + replay_summary(content["metrics"]):
        typer.echo(line)
    warn(map_warnings(result))
    typer.echo(printable(f"results     {folder.target}"))


def job_of(log: Path, options: ReplayOptions, agent: "AgentConfig", robot: "RobotSpec | None") -> Job:
    """Read a log and all that is known about it.

    Raises
    ------
    ValueError
        If the log or another file cannot be used.
    """
    from limslam_agent.logs.limits import Limits
    from limslam_agent.logs.log_reader import read_log
    from limslam_agent.logs.relations import read_relations
    from limslam_agent.replay.calibration import calibrated
    from limslam_agent.replay.options import chosen_topics, numbers

    if options.calibrate and options.odometry_bias:
        raise ValueError("--odometry-bias and --calibrate both set the bias: use only one of them")
    if options.calibrate and options.calibrate == options.relations:
        raise ValueError("--calibrate and --relations name one file: relations that calibrate do not score")
    limits = Limits(round(1e6 * options.max_size), options.max_events, options.max_beams)
    known = read_relations(options.relations, limits) if options.relations else None
    angles = None if options.beams is None else numbers("--beams", options.beams)
    topics = chosen_topics(options.scan_topic, options.range_topics, options.odometry_topic)
    table = _table_options(options, robot)

    recorded = read_log(log, angles, options.max_range, topics, limits, table)
    _check_options(log, options, recorded)
    # Relations of two logs lie in one of them, or between them.
    if known is not None and options.other_log is None and (share := float(known.within(recorded.time).mean())) < 0.5:
        count = f"only {share:.0%}" if share else "none"
        raise ValueError(
            f"{options.relations}: {count} of its relations lie in the log's time: are they of another log?"
        )
    calibration = None
    if options.calibrate is not None:
        calibration = calibrated(options.calibrate, recorded, agent.odometry)
        agent = replace(agent, odometry=calibration.applied_to(agent.odometry))
    return Job(recorded, agent, known, calibration, _source(log, options))


def _table_options(options: ReplayOptions, robot: "RobotSpec | None") -> "TableOptions":
    """How a log that is a table is read."""
    from limslam_agent.logs.table_options import TableOptions
    from limslam_agent.replay.options import numbers

    axes = () if options.zone_axes is None else tuple(numbers("--zone-axes", options.zone_axes))
    columns = () if options.columns is None else tuple(name.strip().lower() for name in options.columns.split(","))
    ticks, units = (options.metres_per_tick, options.accumulated), (options.range_unit, options.time_unit)
    return TableOptions(robot, *ticks, *units, axes, options.zero_is_nothing, columns)


def _check_options(log: Path, options: ReplayOptions, recorded: "RecordedLog") -> None:
    """Refuse options that do not fit the log.

    Raises
    ------
    ValueError
        If one does not; the message names it.
    """
    if options.noise > (reach := float(recorded.robot.max_ranges.max())):
        raise ValueError(f"--noise {options.noise:g} m is more than the longest range of {reach:g} m: is it in metres?")
    if options.map is not None and recorded.wheels is None:
        raise ValueError(f"{log}: has odometry poses; --map is for logs of wheel travel")
    if recorded.odometry is None and (options.odometry_noise or options.odometry_bias):
        raise ValueError(f"{log}: has wheel travel; --odometry-noise and --odometry-bias are for logs with poses")


def _source(log: Path, options: ReplayOptions) -> dict[str, str | None]:
    relations, calibration = (path.name if path else None for path in (options.relations, options.calibrate))
    return {"log": log.name, "relations": relations, "calibration": calibration}


def scores_of(job: Job, result: "Replay", relations: Path | None) -> dict[str, Any]:
    """Metrics of a replay against the truth and against known relative poses.

    Raises
    ------
    ValueError
        If none of the relations is in the log's time.
    """
    from limslam_agent.replay.replay import relation_scores
    from limslam_agent.runs.results import trajectory_scores
    from limslam_agent.runs.smoothing import path_scores

    scores: dict[str, Any] = {}
    if job.log.true_pose is not None:
        scores |= trajectory_scores(job.log.true_pose, result.estimated, result.odometry, result.covariances)
        if result.smoothed is not None:
            scores |= path_scores(job.log.true_pose, result.smoothed.poses, result.smoothed.covariances)
    if job.relations is not None:
        scores |= relation_scores(result, job.relations)
        if not scores["relations"]:
            raise ValueError(f"{relations}: none of its relations is in the log's time")
    return scores
