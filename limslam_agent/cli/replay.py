"""``limslam replay``: a map from a recorded log, or from two logs of one building, and its
folder.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from limslam_agent.cli import options as take
from limslam_agent.cli.options import ReplayOptions
from limslam_agent.cli.settings import Given, replay_agent, write_replay_settings
from limslam_agent.command_options import takes
from limslam_agent.terminal import progress_bar, say, warn

if TYPE_CHECKING:
    from limslam_agent.config.presets import AgentConfig
    from limslam_agent.logs.recorded_log import RecordedLog
    from limslam_agent.logs.relations import Relations
    from limslam_agent.logs.table_options import TableOptions
    from limslam_agent.output.run_folder import NewFolder
    from limslam_agent.replay.calibration import OdometryBias
    from limslam_agent.replay.record import Replay
    from limslam_agent.two_logs.joint import JointReplay
    from limslam_env.interface import RobotSpec
    from limslam_env.worlds.world import World


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
    options = given.merged(ReplayOptions())
    agent = replay_agent(given, options)
    warn(given.warnings(options.preset))
    robot_of_table = _with_axle(given.replay_robot(), options.axle)
    if options.other_log is not None:
        _carry_out_both(options, agent, robot_of_table)
        return
    if options.other_relations is not None:
        raise ValueError("--relations is given twice, which is for two logs")
    _carry_out(options, agent, robot_of_table)


def _with_axle(robot: "RobotSpec | None", axle: float | None) -> "RobotSpec | None":
    """The robot with another axle, m, if one is given."""
    if axle is None:
        return robot
    if robot is None:
        raise ValueError("--axle changes the robot of a table, which --robot names")
    try:
        return replace(robot, axle=axle)
    except ValueError as error:
        raise ValueError(f"--axle: {error}") from None


def _pair(name: str, paths: list[Path] | None, shown: str) -> dict[str, Path | None]:
    """One or two paths by the names of their options."""
    if paths and len(paths) > 2:
        raise ValueError(
            f"{shown}: {len(paths)} were given; one log is replayed, or two logs are joined"
        )
    first, second = [*(paths or []), None, None][:2]
    return {name: first, f"other_{name}": second}


@dataclass(frozen=True, eq=False)
class Job:
    """A log with all that is known about it; None stands for what is not known or was not asked
    for.

    The agent's settings have the estimated bias of the odometry. ``source`` has names of files, for
    ``result.json``.
    """

    log: "RecordedLog"
    config: "AgentConfig"
    relations: "Relations | None"
    calibration: "OdometryBias | None"
    source: dict[str, str | None]


def _carry_out(options: ReplayOptions, agent: "AgentConfig", robot: "RobotSpec | None") -> None:
    """Replay a log, write its folder, and print its summary. ``robot`` is the robot that recorded a
    table.
    """
    from limslam_agent.places.saved_map import read_saved_map
    from limslam_agent.replay.checks import map_warnings
    from limslam_agent.replay.replay import replay_log, write_replay
    from limslam_agent.runs.results import write_world

    if options.log is None:
        raise ValueError("a log is needed: limslam replay LOG")
    job = job_of(options.log, options, agent, robot)
    if options.dry_run:
        _describe(options.log, job.log, options)
        return
    _check_reading(options.log, job.log, options)
    with _folder(options, f"{_stem(options.log)}-{options.preset}", len(job.log)) as (
        folder,
        advance,
        report,
    ):
        prior_map = None if options.map is None else read_saved_map(options.map)
        result = replay_log(job.log, job.config, advance, report, prior_map)
        world = _world_beside(options.log, job.log)
        scores = _scores_of(job, result, options.relations, world)
        figures = job.calibration.figures if job.calibration else {}
        source = job.source
        if world is not None:
            source = {**source, "world": world.name, "world_digest": world.digest}
            write_world(folder.beside, world)
        edges = None if world is None else world.edges
        content = write_replay(folder.beside, result, source, {**scores, **figures}, edges)
        write_replay_settings(folder.beside, options, agent, robot)
    calibrated = [
        f"calibrated  {found.words}"
        for found in (job.calibration, result.self_calibration)
        if found
    ]
    _tell(content, calibrated, folder.target, map_warnings(result))


def _carry_out_both(
    options: ReplayOptions, agent: "AgentConfig", robot: "RobotSpec | None"
) -> None:
    """Replay two logs, join them if they fit, write their folder, and print its summary."""
    from limslam_agent.two_logs.joining import check_logs, replay_logs
    from limslam_agent.two_logs.output import write_joint_replay

    for name in ("map", "calibrate"):
        if getattr(options, name) is not None:
            raise ValueError(f"--{name} is for one log, not for two")
    if options.log is None or options.other_log is None:
        raise ValueError("two logs are needed: limslam replay LOG LOG")
    paths = (options.log, options.other_log)
    files = (options.relations, options.other_relations or options.relations)
    jobs = [
        job_of(path, replace(options, relations=file), agent, robot)
        for path, file in zip(paths, files, strict=True)
    ]
    logs = [job.log for job in jobs]
    if options.dry_run:
        for path, log in zip(paths, logs, strict=True):
            _describe(path, log, options)
        return
    check_logs(logs, agent)
    for path, log in zip(paths, logs, strict=True):
        _check_reading(path, log, options)
    name = "-".join(map(_stem, paths))
    with _folder(options, name, sum(map(len, logs))) as (folder, advance, report):
        joint = replay_logs(logs, agent, advance, report)
        # Relations that both logs share may all lie in one of them, or between them.
        asked = (None, None) if options.other_relations is None else files
        own = [_scores_of(*each) for each in zip(jobs, joint.replays, asked, strict=True)]
        relations = jobs[0].relations, jobs[0 if options.other_relations is None else 1].relations
        scores = own[0], own[1], _scores_of_both(joint, relations)
        content = write_joint_replay(folder.beside, joint, (jobs[0].source, jobs[1].source), scores)
        write_replay_settings(folder.beside, options, agent, robot)
    _tell(content, [], folder.target, [])


def _describe(path: Path, log: "RecordedLog", options: ReplayOptions) -> None:
    """Print how a log was read, its first rows, and the warnings about it."""
    from limslam_agent.logs.description import description
    from limslam_agent.replay.checks import log_warnings
    from limslam_agent.replay.misreading import misread

    say(f"log         {path}", *description(log))
    warn(log_warnings(log, misread(log, options.metres_per_tick, options.wheel_radius)))


def _check_reading(path: Path, log: "RecordedLog", options: ReplayOptions) -> None:
    """Warn of what is unlikely about a log. Refuse it if it was certainly read in a wrong way."""
    from limslam_agent.replay.checks import log_warnings
    from limslam_agent.replay.misreading import misread

    misreading = misread(log, options.metres_per_tick, options.wheel_radius)
    if misreading is not None and misreading.is_certain and not options.as_read:
        raise ValueError(f"{path}: {misreading.words}; --as-read replays the log as it is")
    warn(log_warnings(log, misreading))


@contextmanager
def _folder(
    options: ReplayOptions, name: str, events: int
) -> "Iterator[tuple[NewFolder, Callable[[int], None], Callable[[str], None]]]":
    """The folder of the results, and what shows the number of events that are done and the stage of
    the smoothing.
    """
    from limslam_agent.output.run_folder import new_folder

    target = options.out or Path("runs") / f"replay-{name}"
    with (
        new_folder(target, force=options.force, numbered=options.out is None) as folder,
        progress_bar("replaying", events) as show,
    ):
        yield (
            folder,
            lambda done: show(done, f"{done} of {events} events"),
            lambda stage: show(events, f"smoothing: {stage}"),
        )


def _tell(
    content: dict[str, Any], calibrated: list[str], target: Path, warnings: list[str]
) -> None:
    """Print what ``result.json`` says, and where it is."""
    from limslam_agent.output.summary import record_summary, replay_summary

    say(*record_summary(content), *calibrated, *replay_summary(content["metrics"]))
    warn(warnings)
    say(f"results     {target}")


def _stem(path: Path) -> str:
    return path.name.split(".")[0]


def job_of(
    log: Path, options: ReplayOptions, agent: "AgentConfig", robot: "RobotSpec | None"
) -> Job:
    """Read a log and all that is known about it."""
    from limslam_agent.logs.log_reader import read_log
    from limslam_agent.logs.relations import read_relations
    from limslam_agent.replay.calibration import calibrated
    from limslam_agent.replay.options import chosen_topics, numbers

    if options.calibrate and options.odometry_bias:
        raise ValueError("--odometry-bias and --calibrate both set the bias: use only one of them")
    if options.calibrate and options.calibrate == options.relations:
        raise ValueError(
            "--calibrate and --relations name one file: relations that calibrate do not score"
        )
    known = read_relations(options.relations) if options.relations else None
    angles = None if options.beams is None else numbers("--beams", options.beams)
    table = _table_options(options, robot)

    topics = chosen_topics(options.topics)
    recorded = read_log(log, angles, options.max_range, topics, table, options.missing)
    _check_options(log, options, recorded)
    # Relations of two logs lie in one of them, or between them.
    if (
        known is not None
        and options.other_log is None
        and (share := float(known.within(recorded.time).mean())) < 0.5
    ):
        count = f"only {share:.0%}" if share else "none"
        raise ValueError(
            f"{options.relations}: {count} of its relations lie in the log's time: are they of "
            "another log?"
        )
    calibration = None
    if options.calibrate is not None:
        calibration = calibrated(options.calibrate, recorded, agent.odometry)
        agent = replace(agent, odometry=calibration.applied_to(agent.odometry))
    files = {"log": log, "relations": options.relations, "calibration": options.calibrate}
    source = {name: path.name if path else None for name, path in files.items()}
    return Job(recorded, agent, known, calibration, source)


def _table_options(options: ReplayOptions, robot: "RobotSpec | None") -> "TableOptions":
    """How a log that is a table is read."""
    from limslam_agent.logs.table_options import TableOptions
    from limslam_agent.replay.options import numbers

    axes = () if options.zone_axes is None else tuple(numbers("--zone-axes", options.zone_axes))
    columns = () if options.columns is None else tuple(options.columns.split(","))
    return TableOptions(
        robot,
        metres_per_tick=options.metres_per_tick,
        accumulated=options.accumulated,
        range_unit=options.range_unit,
        time_unit=options.time_unit,
        zone_axes=axes,
        columns=tuple(name.strip() for name in columns),
        angle_unit=options.angle_unit,
        position_unit=options.position_unit,
        wheel_radius=options.wheel_radius,
        rate=options.rate,
    )


def _check_options(log: Path, options: ReplayOptions, recorded: "RecordedLog") -> None:
    """Refuse options that do not fit the log."""
    if options.noise > (reach := float(recorded.robot.max_ranges.max())):
        raise ValueError(
            f"--noise {options.noise:g} m is more than the longest range of {reach:g} m: is it in "
            "metres?"
        )
    if options.map is not None and recorded.wheels is None:
        raise ValueError(f"{log}: has odometry poses; --map is for logs of wheel travel")
    if recorded.odometry is None and (options.odometry_noise or options.odometry_bias):
        raise ValueError(
            f"{log}: has wheel travel; --odometry-noise and --odometry-bias are for logs with poses"
        )


def _scores_of(
    job: Job, result: "Replay", relations: Path | None, world: "World | None" = None
) -> dict[str, Any]:
    """Metrics of a replay against the truth and against known relative poses."""
    from limslam_agent.replay.replay import relation_scores
    from limslam_agent.runs.results import path_scores, trajectory_scores, wall_scores

    scores: dict[str, Any] = {}
    if job.log.true_pose is not None:
        scores |= trajectory_scores(
            job.log.true_pose, result.estimated, result.odometry, result.covariances
        )
        if result.smoothed is not None:
            scores |= path_scores(
                job.log.true_pose, result.smoothed.poses, result.smoothed.covariances
            )
        if world is not None:
            drawn_from = result.estimated if result.smoothed is None else result.smoothed.poses
            scores |= wall_scores(
                world, job.log.robot, result.segments, job.log.true_pose, drawn_from
            )
    if job.relations is not None:
        scores |= relation_scores(result, job.relations)
        if not scores["relations"] and relations is not None:
            raise ValueError(f"{relations}: none of its relations is in the log's time")
    return scores


def _world_beside(path: Path, log: "RecordedLog") -> "World | None":
    """The world in which a log was driven, of the file that a simulated run writes beside it."""
    from limslam_agent.output.finished_run import WORLD
    from limslam_env.worlds.formats.loading import load_world

    file = path.parent / WORLD
    return load_world(file) if log.true_pose is not None and file.is_file() else None


def _scores_of_both(
    joint: "JointReplay", relations: "tuple[Relations | None, Relations | None]"
) -> dict[str, Any]:
    """Metrics of both logs together. Relations that both logs share may lie between the logs."""
    from limslam_agent.runs.results import mean_scores
    from limslam_agent.two_logs.output import relation_scores
    from limslam_env.metrics import trajectory_metrics

    scores = relation_scores(joint, relations)
    true = [each.log.true_pose for each in joint.replays if each.log.true_pose is not None]
    if len(true) < 2 or not joint.is_joined:
        return scores
    names = {"est": "ate_m", "odometry": "odometry_ate_m", "smoothed": "ate_smoothed_m"}
    for kind, paths in joint.paths().items():
        found = mean_scores([trajectory_metrics(*each) for each in zip(true, paths, strict=True)])
        scores[names[kind]] = found["ate_m"]
    return scores
