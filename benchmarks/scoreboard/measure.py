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
from limslam_env.geometry import se2
from limslam_env.interface import NominalNoise, RobotSpec
from limslam_env.worlds.world import World

_FOUND = "found in the saved map"
_OTHER_DRIVE = 500  # seeds from a drive to another one through the same world


def measure(rows: Mapping[str, Row], jitter: float, job: Job) -> Outcome:
    """Measure a cell. ``rows`` has the row of the job, and ``jitter`` is further noise of recorded
    ranges, m.
    """
    row = rows[job.policy]
    warm_up()
    scores = _KINDS[row.kind](row, job, jitter)
    cost: dict[str, float] = {name: scores.pop(name) for name in CPU if name in scores}
    return Outcome(plain(scores), cost, "")


@functools.cache
def warm_up() -> None:
    """Load or compile what each cell needs, so that no cell's time contains it."""
    row = Row("warm-up", "drive", ("env1",), seconds=20.0)
    _drive(row, Job("env1", row.noise, policy=row.name), 0.0)


@functools.cache
def warm_up_batch() -> None:
    """Load or compile what a batch needs."""
    BatchSlam(RobotSpec(), size=0).step(np.ones((1, 6)), np.zeros((1, 2)))


def _drive(row: Row, job: Job, jitter: float) -> Scores:
    """A recorded drive, replayed as ``limslam replay`` does."""
    world = world_of(job.world)
    log = recorded_drive(row, world, job.seed, jitter)
    found, spent = _replayed(log, row, job)
    return {**replay_scores(found), **_wall_scores(world, found), **_times(found, spent)}


def _replayed(
    log: RecordedLog, row: Row, job: Job, prior_map: SavedMap | None = None
) -> tuple[Replay, float]:
    """The replay of a log, and the processor time that it took, s."""
    begin = time.process_time()
    found = replay_log(log, preset(job.preset, NominalNoise(row.noise)), prior_map=prior_map)
    return found, time.process_time() - begin


def replay_scores(found: Replay) -> Scores:
    """The figures of a replay with the truth, without those of its map."""
    log = found.log
    smoothed = found.smoothed
    assert log.true_pose is not None  # noqa: S101 (the logs of rows with the truth have it)
    true = log.true_pose[:, None]
    poses = None if smoothed is None else smoothed.poses[:, None]
    covariances = (
        None if smoothed is None or smoothed.covariances is None else smoothed.covariances[:, None]
    )
    return {
        **path_scores(true, found.estimated[:, None], found.covariances[:, None], ""),
        **({} if poses is None else path_scores(true, poses, covariances, "_smoothed")),
        **path_scores(true, found.odometry[:, None], None, "_odometry"),
        **while_driving(log.time, true, found.estimated[:, None], found.levels[:, None]),
        **at_the_end(
            _final_level(found), true, found.estimated[:, None] if poses is None else poses
        ),
    }


def _times(found: Replay, spent: float) -> Scores:
    smoothing = 0.0 if found.smoothed is None else found.smoothed.seconds
    return {"drive_cpu_s": spent - smoothing, "smoothing_cpu_s": smoothing}


def _final_level(found: Replay) -> str:
    """The status of the smoothed path, or of the filter where nothing was smoothed."""
    smoothed = found.smoothed
    filtered = (
        found.status.level if smoothed is None or smoothed.status is None else smoothed.status.level
    )
    return str(filtered if smoothed is None else smoothed.figures.get("smoothed_status", filtered))


def _wall_scores(world: World, found: Replay) -> Scores:
    log = found.log
    smoothed = found.smoothed
    assert log.true_pose is not None  # noqa: S101 (drives are recorded with the truth)
    drawn_from = log.true_pose if smoothed is None else smoothed.poses
    visible = metrics.visible_samples(world, log.robot.radius, log.robot.reach)
    alignment = metrics.rigid_alignment(log.true_pose[:, :2], drawn_from[:, :2])
    walls = metrics.wall_metrics(visible, world.edges, found.segments, alignment)
    seen = faces(world, log.robot, found.segments, alignment)
    return {"f1_5cm": walls["wall_f1_5cm"], "f1_aligned_5cm": walls["wall_f1_aligned_5cm"], **seen}


def _exploration(row: Row, job: Job, jitter: float) -> Scores:
    """An exploration as ``limslam run`` does it. Jitter does not apply: it would lead to another
    drive.
    """
    del jitter
    kidnap_at = None
    longest = row.seconds
    if row.kidnapped is not None:
        kidnap_at = round(float(np.random.default_rng(job.seed).uniform(*row.kidnapped)), 1)
        longest += kidnap_at
    config = RunConfig(
        world_of(job.world),
        row.noise,
        job.preset,
        job.seed,
        longest,
        robots=row.robots,
        until=row.until,
        unknown_starts=row.unknown_starts,
        kidnap_at=kidnap_at,
        true_noise=row.true_noise,
    )
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
    seen = faces(episode.world, config.robot, episode.final_map.segments, alignment)
    walls = {
        "f1_5cm": found["wall_f1_5cm"],
        "f1_aligned_5cm": found["wall_f1_aligned_5cm"],
        **seen,
    }
    if kidnap_at is None:
        paths = path_scores(true, estimated, episode.covariances[:, placed], "")
        if smoothed is not None:
            paths |= path_scores(true, smoothed.poses, smoothed.covariances, "_smoothed")
        paths |= path_scores(true, episode.odometry[:, placed], None, "_odometry")
        paths |= {"placed": int(episode.placed_robots == row.robots)} if row.unknown_starts else {}
    else:
        # Of a lost robot, the filter's path is in another frame, and covariances say nothing.
        paths = {} if smoothed is None else path_scores(true, smoothed.poses, None, "_smoothed")
        found_again = fault_scores(episode, kidnap_at)
        paths |= {"placed": int(found_again["fault_placed_s"] is not None)}
        paths |= {name: found_again[f"fault_{name}"] for name in ("placed_s", "wrong_place_s")}
    return {
        **paths,
        **while_driving(episode.time, true, estimated, episode.levels[:, placed]),
        **walls,
        **at_the_end(found["status"], true, estimated if smoothed is None else smoothed.poses),
        "association_right_share": found["association_right_share"],
        "explored": int(episode.is_finished),
        "driven_s": float(episode.time[-1]),
        "drive_cpu_s": driven - begin,
        "smoothing_cpu_s": spent,
    }


def _log(row: Row, job: Job, jitter: float) -> Scores:
    """A recorded log, replayed as ``limslam replay`` does. The errors are those of relations, in
    place of an ATE.
    """
    from limslam_agent.logs.log_reader import read_log
    from limslam_agent.logs.relations import read_relations

    log = read_log(data_file(row.file), row.beams, row.max_range)
    ranges = shaken(log.ranges.astype(np.float64), log.robot, jitter, job.seed)
    log = replace(log, ranges=ranges.astype(np.float32))
    found, spent = _replayed(log, row, job)
    errors = relation_scores(found, read_relations(data_file(row.relations)))
    scores = {
        f"ate{suffix}{kind}_m": errors.get(f"{prefix}{name}")
        for prefix, suffix in (("", ""), ("smoothed_", "_smoothed"), ("odometry_", "_odometry"))
        for kind, name in (("", "relation_error_m"), ("_aligned", "loop_relation_error_m"))
    }
    level = _final_level(found)
    loops = scores["ate_smoothed_aligned_m"]
    end = {
        "status": level,
        "wrong_ok_end": int(level == "ok" and loops is not None and loops > WRONG_PATH),
    }
    return {**scores, **end, **_times(found, spent)}


def _made_up_log(row: Row, job: Job, jitter: float) -> Scores:
    """A log of few points, smoothed without the filter in front of it."""
    from benchmarks.scoreboard.made_up_logs import made_up_log, smoothing_scores, sparse_sensor

    log = made_up_log(job.seed, revisits=job.seed // 4 % 2 == 0)
    found = smoothing_scores(log, sparse_sensor(job.seed, *row.points), jitter)
    return {
        **found,
        "wrong_ok_end": int(
            found["status"] == "ok" and found["ate_smoothed_aligned_m"] > WRONG_PATH
        ),
    }


def _long_log(row: Row, job: Job, jitter: float) -> Scores:
    """A log of a long drive through a campus, replayed as ``limslam replay`` does."""
    from benchmarks.scoreboard.campus import campus_beams, campus_log
    from benchmarks.scoreboard.made_up_logs import as_recorded

    recorded = as_recorded(campus_log(job.seed), campus_beams(job.seed), row.max_range)
    return _log_with_truth(recorded, row, job, jitter)


def _flight(row: Row, job: Job, jitter: float) -> Scores:
    """A log of a short flight, replayed as ``limslam replay`` does."""
    from benchmarks.scoreboard.made_up_logs import as_recorded, flight_log

    recorded = as_recorded(flight_log(job.seed, np.radians(row.beams)), row.beams, row.max_range)
    return _log_with_truth(recorded, row, job, jitter)


def _log_with_truth(log: RecordedLog, row: Row, job: Job, jitter: float) -> Scores:
    """``nees_smoothed`` compares the square of the error with that of the stated one."""
    ranges = shaken(log.ranges.astype(np.float64), log.robot, jitter, job.seed)
    found, spent = _replayed(replace(log, ranges=ranges.astype(np.float32)), row, job)
    scores = replay_scores(found)
    figures = {} if found.smoothed is None else found.smoothed.figures
    stated = figures.get("smoothed_position_std_m")
    error = scores.get("ate_smoothed_aligned_m")
    # Nothing is stated of a path of one key pose.
    compared = (
        {"stated_m": stated, "nees_smoothed": (error / stated) ** 2} if stated and error else {}
    )
    return {**scores, **compared, **_times(found, spent)}


def _second_drive(row: Row, job: Job, jitter: float) -> Scores:
    """A drive that begins at an unknown place of the map of another drive through the same
    world.
    """
    world = world_of(job.world)
    drive = replace(row, kind="drive")
    first, _ = _replayed(recorded_drive(drive, world, job.seed, jitter), row, job)
    log = recorded_drive(drive, world, job.seed + _OTHER_DRIVE, jitter)
    known = SavedMap(first.segments, first.landmarks, first.grid)
    found, spent = _replayed(replace(log, start_pose=np.zeros(3)), row, job, known)
    placed = int(any(each["event"] == _FOUND for each in found.places.records))
    return {**replay_scores(found), "placed": placed, **_times(found, spent)}


def _two_logs(row: Row, job: Job, jitter: float) -> Scores:
    """Two drives through one world, with ranges that are too long by ``biases``, joined."""
    world = world_of(job.world)
    logs = [
        recorded_drive(
            replace(row, kind="drive", fault="offset", fault_size=bias),
            world,
            job.seed + number * _OTHER_DRIVE,
            jitter,
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


def _batch(row: Row, job: Job, jitter: float) -> Scores:
    """A recorded drive, estimated by a batch, in which no status is kept.

    ``batch_apart_m`` is how far its positions are from those of the single estimator at most,
    which calibrates.
    """
    log = recorded_drive(row, world_of(job.world), job.seed, jitter)
    assert log.wheels is not None and log.true_pose is not None  # noqa: PT018, S101 (of a drive)
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
    poses, covariances = (
        np.array([getattr(each, name)[0] for each in beliefs]) for name in ("pose", "covariance")
    )
    single = replay_log(log, settings).estimated
    true = log.true_pose[:, None]
    return {
        **path_scores(true, poses[:, None], covariances[:, None], ""),
        "batch_apart_m": float(np.hypot(*(poses - single)[:, :2].T).max()),
        "drive_cpu_s": spent,
    }


_KINDS: dict[str, Callable[[Row, Job, float], Scores]] = {
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
