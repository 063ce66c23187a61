"""What is measured in a cell of the scoreboard. Only the truth, the log and what the estimator says
are used.
"""

import functools
import time
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from benchmarks.scoreboard.compare import CPU
from benchmarks.scoreboard.drives import recorded_drive, shaken
from benchmarks.scoreboard.rows import Row
from benchmarks.scoreboard.scores import (
    WRONG_PATH,
    Scores,
    at_the_end,
    faces,
    path_scores,
    while_driving,
)
from benchmarks.scoreboard.worlds import world_of
from benchmarks.suite.faults import fault_scores
from benchmarks.suite.jobs import Job, Outcome
from benchmarks.suite.runner import data_file
from limslam_agent.config.presets import preset
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.output.export import plain
from limslam_agent.places.saved_map import SavedMap
from limslam_agent.replay.record import Replay
from limslam_agent.replay.replay import relation_scores, replay_log
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.results import score
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.slam.batch.batch_slam import BatchSlam
from limslam_agent.two_logs.joining import replay_logs
from limslam_env import metrics
from limslam_env.geometry import FloatArray, se2
from limslam_env.interface import NominalNoise, RobotSpec
from limslam_env.worlds.world import World

_FOUND = "found in the saved map"
_OTHER_DRIVE = 500  # seeds from a drive to another one through the same world


def measure(rows: Mapping[str, Row], job: Job) -> Outcome:
    """Measure a cell. ``rows`` has the row of the job."""
    row = rows[job.policy]
    warm_up()
    scores = _KINDS[row.kind](row, job)
    cost: dict[str, float] = {name: scores.pop(name) for name in CPU if name in scores}
    return Outcome(plain(scores), cost, "")


@functools.cache
def warm_up() -> None:
    """Load or compile what each cell needs, so that no cell's time contains it."""
    row = Row("warm-up", "drive", ("env1",), seconds=20.0)
    _drive(row, Job("env1", row.noise, policy=row.name))


@functools.cache
def warm_up_batch() -> None:
    """Load or compile what a batch needs."""
    BatchSlam(RobotSpec(), size=0).step(np.ones((1, 6)), np.zeros((1, 2)))


def _drive(row: Row, job: Job) -> Scores:
    """A recorded drive, replayed as ``limslam replay`` does."""
    world = world_of(job.world)
    found, times = _replayed(recorded_drive(row, world, job.seed), row, job)
    return {**replay_scores(found), **_wall_scores(world, found), **times}


def _replayed(
    log: RecordedLog, row: Row, job: Job, prior_map: SavedMap | None = None
) -> tuple[Replay, Scores]:
    """The replay of a log, and the processor time that it took."""
    begin = time.process_time()
    found = replay_log(log, preset(job.preset, NominalNoise(row.noise)), prior_map=prior_map)
    spent = time.process_time() - begin
    smoothing = 0.0 if found.smoothed is None else found.smoothed.seconds
    return found, {"drive_cpu_s": spent - smoothing, "smoothing_cpu_s": smoothing}


def _true_path(found: Replay) -> FloatArray:
    assert found.log.true_pose is not None  # noqa: S101 (the logs of rows with the truth have it)
    return found.log.true_pose


def replay_scores(found: Replay) -> Scores:
    """The figures of a replay with the truth, without those of its map."""
    true = _true_path(found)[:, None]
    estimated = found.estimated[:, None]
    scores = path_scores(true, estimated, found.covariances[:, None], "")
    scores |= path_scores(true, found.odometry[:, None], None, "_odometry")
    best = estimated
    if found.smoothed is not None:
        best = found.smoothed.poses[:, None]
        stated = found.smoothed.covariances
        stated = None if stated is None else stated[:, None]
        scores |= path_scores(true, best, stated, "_smoothed")
    scores |= while_driving(found.log.time, true, estimated, found.levels[:, None])
    return scores | at_the_end(_final_level(found), true, best)


def _final_level(found: Replay) -> str:
    """The status of the smoothed path, or of the filter where nothing was smoothed."""
    smoothed = found.smoothed
    if smoothed is None:
        return str(found.status.level)
    status = smoothed.status or found.status
    return str(smoothed.figures.get("smoothed_status", status.level))


def _wall_scores(world: World, found: Replay) -> Scores:
    robot = found.log.robot
    true = _true_path(found)
    drawn_from = true if found.smoothed is None else found.smoothed.poses
    visible = metrics.visible_samples(world, robot.radius, robot.reach)
    alignment = metrics.rigid_alignment(true[:, :2], drawn_from[:, :2])
    walls = metrics.wall_metrics(visible, world.edges, found.segments, alignment)
    return _f1(walls) | faces(world, robot, found.segments, alignment)


def _f1(walls: Mapping[str, float | None]) -> Scores:
    return {"f1_5cm": walls["wall_f1_5cm"], "f1_aligned_5cm": walls["wall_f1_aligned_5cm"]}


def _exploration(row: Row, job: Job) -> Scores:
    """An exploration as ``limslam run`` does it. Jitter does not apply: it would lead to another
    drive.
    """
    kidnap_at = None
    if row.kidnapped is not None:
        kidnap_at = round(float(np.random.default_rng(job.seed).uniform(*row.kidnapped)), 1)
    of_run = {
        "world": world_of(job.world),
        "policy": "frontier",
        "max_time": row.seconds + (kidnap_at or 0.0),
        "until": row.until,
        "unknown_starts": row.unknown_starts,
        "kidnap_at": kidnap_at,
    }
    config = RunConfig(**job.spec | of_run, true_noise=row.true_noise)
    begin = time.process_time()
    episode = run_episode(config)
    driven = time.process_time()
    smoothed = episode.smoothed
    spent = time.process_time() - driven
    found = score(episode)
    placed = slice(episode.placed_robots)
    true = episode.true[:, placed]
    estimated = episode.estimated[:, placed]
    first = (episode.placed_steps, 0, slice(2))
    alignment = metrics.rigid_alignment(episode.true[first], episode.final_map.poses[first])
    best = estimated if smoothed is None else smoothed.poses
    scores: Scores = {}
    # Of a lost robot, the filter's path is in another frame, and covariances say nothing.
    if smoothed is not None:
        stated = smoothed.covariances if kidnap_at is None else None
        scores |= path_scores(true, smoothed.poses, stated, "_smoothed")
    if kidnap_at is None:
        scores |= path_scores(true, estimated, episode.covariances[:, placed], "")
        scores |= path_scores(true, episode.odometry[:, placed], None, "_odometry")
    else:
        again = fault_scores(episode, kidnap_at)
        scores["placed"] = int(again["fault_placed_s"] is not None)
        scores |= {name: again[f"fault_{name}"] for name in ("placed_s", "wrong_place_s")}
    if row.unknown_starts:
        scores["placed"] = int(episode.placed_robots == row.robots)
    return {
        **scores,
        **while_driving(episode.time, true, estimated, episode.levels[:, placed]),
        **_f1(found),
        **faces(episode.world, config.robot, episode.final_map.segments, alignment),
        **at_the_end(found["status"], true, best),
        "association_right_share": found["association_right_share"],
        "explored": int(episode.is_finished),
        "driven_s": float(episode.time[-1]),
        "drive_cpu_s": driven - begin,
        "smoothing_cpu_s": spent,
    }


def _log(row: Row, job: Job) -> Scores:
    """A recorded log, replayed as ``limslam replay`` does. The errors are those of relations, in
    place of an ATE.
    """
    from limslam_agent.logs.log_reader import read_log
    from limslam_agent.logs.relations import read_relations

    log = read_log(data_file(row.file), row.beams, row.max_range)
    found, times = _replayed(_shaken_log(log, row, job), row, job)
    errors = relation_scores(found, read_relations(data_file(row.relations)))
    scores = {
        f"ate{suffix}{kind}_m": errors.get(f"{prefix}{name}")
        for prefix, suffix in (("", ""), ("smoothed_", "_smoothed"), ("odometry_", "_odometry"))
        for kind, name in (("", "relation_error_m"), ("_aligned", "loop_relation_error_m"))
    }
    level = _final_level(found)
    return {**scores, **_wrong_end(level, scores["ate_smoothed_aligned_m"]), **times}


def _shaken_log(log: RecordedLog, row: Row, job: Job) -> RecordedLog:
    ranges = shaken(log.ranges.astype(np.float64), log.robot, row.jitter, job.seed)
    return replace(log, ranges=ranges.astype(np.float32))


def _wrong_end(level: str, error: float | None) -> Scores:
    """The final status, and whether it is ok although the error, m, is that of a wrong path."""
    is_wrong = level == "ok" and error is not None and error > WRONG_PATH
    return {"status": level, "wrong_ok_end": int(is_wrong)}


def _made_up_log(row: Row, job: Job) -> Scores:
    """A log of few points, smoothed without the filter in front of it."""
    from benchmarks.scoreboard.made_up_logs import made_up_log, smoothing_scores, sparse_sensor

    log = made_up_log(job.seed, revisits=job.seed // 4 % 2 == 0)
    found = smoothing_scores(log, sparse_sensor(job.seed, *row.points), row.jitter)
    return found | _wrong_end(found["status"], found["ate_smoothed_aligned_m"])


def _long_log(row: Row, job: Job) -> Scores:
    """A log of a long drive through a campus, replayed as ``limslam replay`` does."""
    from benchmarks.scoreboard.campus import campus_beams, campus_log
    from benchmarks.scoreboard.made_up_logs import as_recorded

    recorded = as_recorded(campus_log(job.seed), campus_beams(job.seed), row.max_range)
    return _log_with_truth(recorded, row, job)


def _flight(row: Row, job: Job) -> Scores:
    """A log of a short flight, replayed as ``limslam replay`` does."""
    from benchmarks.scoreboard.made_up_logs import as_recorded, flight_log

    recorded = as_recorded(flight_log(job.seed, np.radians(row.beams)), row.beams, row.max_range)
    return _log_with_truth(recorded, row, job)


def _log_with_truth(log: RecordedLog, row: Row, job: Job) -> Scores:
    """``nees_smoothed`` compares the square of the error with that of the stated one."""
    found, times = _replayed(_shaken_log(log, row, job), row, job)
    scores = replay_scores(found)
    figures = {} if found.smoothed is None else found.smoothed.figures
    stated = figures.get("smoothed_position_std_m")
    error = scores.get("ate_smoothed_aligned_m")
    # Nothing is stated of a path of one key pose.
    if stated and error:
        scores |= {"stated_m": stated, "nees_smoothed": (error / stated) ** 2}
    return scores | times


def _second_drive(row: Row, job: Job) -> Scores:
    """A drive that begins at an unknown place of the map of another drive through the same
    world.
    """
    world = world_of(job.world)
    drive = replace(row, kind="drive")
    first, _ = _replayed(recorded_drive(drive, world, job.seed), row, job)
    log = recorded_drive(drive, world, job.seed + _OTHER_DRIVE)
    known = SavedMap(first.segments, first.landmarks, first.grid)
    found, times = _replayed(replace(log, start_pose=np.zeros(3)), row, job, known)
    placed = int(any(each["event"] == _FOUND for each in found.places.records))
    return {**replay_scores(found), "placed": placed, **times}


def _two_logs(row: Row, job: Job) -> Scores:
    """Two drives through one world, with ranges that are too long by ``biases``, joined."""
    world = world_of(job.world)
    logs = [
        recorded_drive(
            replace(row, kind="drive", fault="offset", fault_size=bias),
            world,
            job.seed + number * _OTHER_DRIVE,
        )
        for number, bias in enumerate(row.biases)
    ]
    starts = np.array([log.start_pose for log in logs])
    logs[1] = replace(logs[1], start_pose=np.zeros(3))
    begin = time.process_time()
    found = replay_logs(logs, preset(job.preset, NominalNoise(row.noise)))
    spent = time.process_time() - begin
    # What was not joined is judged by itself, from where it truly began.
    own = np.zeros(3) if found.is_joined else starts[1]
    first, second = found.poses
    poses = np.stack((first, se2.compose(own, second)), axis=1)
    true = np.stack([log.true_pose for log in logs if log.true_pose is not None], axis=1)
    return {
        **path_scores(true, poses, None, "_smoothed"),
        **at_the_end(found.status.level, true, poses),
        "placed": int(found.is_joined),
        "drive_cpu_s": spent - found.seconds,
        "smoothing_cpu_s": found.seconds,
    }


def _batch(row: Row, job: Job) -> Scores:
    """A recorded drive, estimated by a batch, in which no status is kept.

    ``batch_apart_m`` is how far its positions are from those of the single estimator at most,
    which calibrates.
    """
    log = recorded_drive(row, world_of(job.world), job.seed)
    assert log.wheels is not None  # noqa: S101 (it is a drive)
    settings = preset("consistent", NominalNoise(row.noise))
    warm_up_batch()
    begin = time.process_time()
    batch = BatchSlam(log.robot, settings, 1, num_threads=1, size=0)
    batch.reset(log.start_pose[None])
    beliefs = [
        batch.step(ranges[None], wheels[None])
        for ranges, wheels in zip(log.ranges, log.wheels, strict=True)
    ]
    spent = time.process_time() - begin
    poses = np.array([belief.pose for belief in beliefs])
    covariances = np.array([belief.covariance for belief in beliefs])
    single = replay_log(log, settings)
    return {
        **path_scores(_true_path(single)[:, None], poses, covariances, ""),
        "batch_apart_m": float(np.hypot(*(poses[:, 0] - single.estimated)[:, :2].T).max()),
        "drive_cpu_s": spent,
    }


_KINDS: dict[str, Callable[[Row, Job], Scores]] = {
    "batch": _batch,
    "campus log": _long_log,
    "drive": _drive,
    "exploration": _exploration,
    "flight": _flight,
    "log": _log,
    "made-up log": _made_up_log,
    "second drive": _second_drive,
    "two logs": _two_logs,
}
