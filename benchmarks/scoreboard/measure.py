"""What is measured in a cell of the scoreboard. Only the truth, the log and what the estimator says
are used.
"""

import functools
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.scoreboard.compare import CPU
from benchmarks.scoreboard.drives import recorded_drive, shaken
from benchmarks.scoreboard.rows import Row
from benchmarks.scoreboard.worlds import world_of
from benchmarks.suite.faults import fault_scores
from benchmarks.suite.jobs import Job, Outcome
from benchmarks.suite.runner import data_file
from limslam_agent.config.presets import preset
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.output.export import plain
from limslam_agent.replay.record import Replay
from limslam_agent.replay.replay import relation_scores, replay_log
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.results import over_robots, score
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.status.chance import TURNED
from limslam_agent.status.status import LEVELS
from limslam_env import metrics
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import transform_points, wrap_angle
from limslam_env.geometry.segment import distances
from limslam_env.interface import NominalNoise, RobotSpec
from limslam_env.worlds.world import World

WRONG = 0.5
"""A pose is wrong if it is farther off, m. While the status is ok, this is never right."""
WRONG_PATH = 0.6
"""A smoothed path is wrong if the root mean square of its aligned position errors is larger, m."""
RIGHT = 0.2
"""An alarm is false while the pose is not farther off, m."""

Scores = dict[str, Any]


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


def _drive(row: Row, job: Job, jitter: float) -> Scores:
    """A recorded drive, replayed as ``limslam replay`` does."""
    world = world_of(job.world)
    log = recorded_drive(row, world, job.seed, jitter)
    begin = time.process_time()
    found = replay_log(log, preset(job.preset, NominalNoise(row.noise)))
    spent = time.process_time() - begin
    assert log.true_pose is not None  # noqa: S101 (drives are recorded with the truth)
    true, smoothed = log.true_pose[:, None], found.smoothed
    poses = None if smoothed is None else smoothed.poses[:, None]
    covariances = (
        None if smoothed is None or smoothed.covariances is None else smoothed.covariances[:, None]
    )
    return {
        **path_scores(true, found.estimated[:, None], found.covariances[:, None], ""),
        **({} if poses is None else path_scores(true, poses, covariances, "_smoothed")),
        **path_scores(true, found.odometry[:, None], None, "_odometry"),
        **while_driving(log.time, true, found.estimated[:, None], found.levels[:, None]),
        **_wall_scores(world, log, found, true[:, 0] if poses is None else poses[:, 0]),
        **at_the_end(
            _final_level(found), true, found.estimated[:, None] if poses is None else poses
        ),
        **_times(found, spent),
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


def _wall_scores(world: World, log: RecordedLog, found: Replay, drawn_from: FloatArray) -> Scores:
    assert log.true_pose is not None  # noqa: S101 (drives are recorded with the truth)
    visible = metrics.visible_samples(world, log.robot.radius, log.robot.reach)
    alignment = metrics.rigid_alignment(log.true_pose[:, :2], drawn_from[:, :2])
    walls = metrics.wall_metrics(visible, world.edges, found.segments, alignment)
    faces = _faces(world, log.robot, found.segments, alignment)
    return {"f1_5cm": walls["wall_f1_5cm"], "f1_aligned_5cm": walls["wall_f1_aligned_5cm"], **faces}


def _faces(world: World, robot: RobotSpec, segments: FloatArray, alignment: FloatArray) -> Scores:
    """The share of the visible sides of obstacles, however short, that aligned segments (k, 4) are
    within 5 cm of.
    """
    points, _, owner = metrics.visible_samples(world, robot.radius, robot.reach, shortest=0.0)
    points, moved = (
        points[owner >= len(world.walls)],
        transform_points(alignment, segments.reshape(-1, 2)),
    )
    if not len(points):
        return {}
    away = distances(points, moved.reshape(-1, 4)).min(axis=1, initial=np.inf)
    return {"faces_5cm": float(np.mean(away <= metrics.NEARER))}


def path_scores(
    true: FloatArray, poses: FloatArray, covariances: FloatArray | None, suffix: str
) -> Scores:
    """Errors of paths (t, n, 3) of n robots with covariances (t, n, 3, 3), as means over the
    robots.
    """

    def of_one(*columns: FloatArray) -> dict[str, float | None]:
        errors = metrics.trajectory_metrics(*columns[:2])
        found = {
            f"ate{suffix}_m": errors["ate_m"],
            f"ate{suffix}_aligned_m": errors["ate_aligned_m"],
            f"ate{suffix}_scaled_m": scaled_error(*columns[:2]),
        }
        nees = (
            {f"nees{suffix}": metrics.consistency_metrics(*columns)["anees"]}
            if len(columns) == 3
            else {}
        )
        return plain({**found, **nees})

    return over_robots(of_one, true, poses, *(() if covariances is None else (covariances,)))


def scaled_error(true: FloatArray, estimated: FloatArray) -> float:
    """The root mean square of the position errors of poses (n, 3), m, after alignment by a rigid
    motion and one scale.
    """
    alignment = metrics.rigid_alignment(true[:, :2], estimated[:, :2])
    target = true[:, :2] - true[:, :2].mean(axis=0)
    source = transform_points(alignment, estimated[:, :2])
    source -= source.mean(axis=0)
    spread = float((source**2).sum())
    scale = float((source * target).sum()) / spread if spread else 1.0
    return float(np.sqrt(((target - scale * source) ** 2).sum(axis=1).mean()))


def while_driving(
    time_s: FloatArray, true: FloatArray, estimated: FloatArray, levels: IntArray
) -> Scores:
    """How long poses (t, n, 3) were wrong although the status (t, n) was ok, and right although it
    was not, and how long it was ok, and off all the same: wrong, or turned too far, s.

    The times of several robots are added. Also the longest time that one was wrong without a break
    and the status ok.
    """
    errors = np.hypot(*(estimated - true)[..., :2].transpose(2, 0, 1))
    is_off = (errors > WRONG) | (np.abs(wrap_angle((estimated - true)[..., 2])) > TURNED)
    lasts, is_ok = np.append(np.diff(time_s), 0.0)[:, None], levels == LEVELS.index("ok")
    is_wrong = is_ok & (errors > WRONG)
    return {
        "wrong_ok_s": float((lasts * is_wrong).sum()),
        "longest_wrong_ok_s": max(_longest(lasts[:, 0], one) for one in is_wrong.T),
        "false_alarm_s": float((lasts * (~is_ok & (errors < RIGHT))).sum()),
        "ok_s": float((lasts * is_ok).sum()),
        "off_ok_s": float((lasts * (is_ok & is_off)).sum()),
    }


def _longest(lasts: FloatArray, holds: BoolArray) -> float:
    """The longest time for which something holds (t,) without a break, of steps that last (t,)."""
    total = np.append(0.0, np.cumsum(lasts))
    begins, ends = np.flatnonzero(np.diff(holds, prepend=0, append=0)).reshape(-1, 2).T
    return float((total[ends] - total[begins]).max(initial=0.0))


def at_the_end(level: str, true: FloatArray, poses: FloatArray) -> Scores:
    """The final status, and whether it is ok although a path (t, n, 3) is wrong."""
    errors = [
        metrics.trajectory_metrics(true[:, one], poses[:, one])["ate_aligned_m"]
        for one in range(true.shape[1])
    ]
    return {
        "status": level,
        "wrong_ok_end": int(level == "ok" and max(each or 0.0 for each in errors) > WRONG_PATH),
    }


def _exploration(row: Row, job: Job, jitter: float) -> Scores:
    """An exploration as ``limslam run`` does it. Jitter does not apply: it would lead to another
    drive.
    """
    del jitter
    kidnap_at, longest = None, row.seconds
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
        until="walls",
        unknown_starts=row.unknown_starts,
        kidnap_at=kidnap_at,
        true_noise=row.true_noise,
    )
    begin = time.process_time()
    episode = run_episode(config)
    driven = time.process_time()
    smoothed = episode.smoothed
    spent = time.process_time() - driven
    found, placed = score(episode), slice(episode.placed_robots)
    true, estimated = episode.true[:, placed], episode.estimated[:, placed]
    first = (episode.placed_steps, 0, slice(2))
    alignment = metrics.rigid_alignment(episode.true[first], episode.final_map.poses[first])
    faces = _faces(episode.world, config.robot, episode.final_map.segments, alignment)
    walls = {
        "f1_5cm": found["wall_f1_5cm"],
        "f1_aligned_5cm": found["wall_f1_aligned_5cm"],
        **faces,
    }
    if kidnap_at is None:
        paths = path_scores(true, estimated, episode.covariances[:, placed], "")
        paths |= (
            {}
            if smoothed is None
            else path_scores(true, smoothed.poses, smoothed.covariances, "_smoothed")
        )
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
    begin = time.process_time()
    found = replay_log(log, preset(job.preset, NominalNoise(row.noise)))
    spent = time.process_time() - begin
    errors = relation_scores(found, read_relations(data_file(row.relations)))
    scores = {
        f"ate{suffix}{kind}_m": errors.get(f"{prefix}{name}")
        for prefix, suffix in (("", ""), ("smoothed_", "_smoothed"), ("odometry_", "_odometry"))
        for kind, name in (("", "relation_error_m"), ("_aligned", "loop_relation_error_m"))
    }
    level, loops = _final_level(found), scores["ate_smoothed_aligned_m"]
    end = {
        "status": level,
        "wrong_ok_end": int(level == "ok" and loops is not None and loops > WRONG_PATH),
    }
    return {**scores, **end, **_times(found, spent)}


def _made_up_log(row: Row, job: Job, jitter: float) -> Scores:
    """A log of few points, smoothed without the filter in front of it."""
    from benchmarks.scoreboard.made_up_logs import made_up_log, smoothing_scores

    del row
    found = smoothing_scores(
        made_up_log(job.seed, revisits=job.seed // 4 % 2 == 0), job.seed, jitter
    )
    return {
        **found,
        "wrong_ok_end": int(
            found["status"] == "ok" and found["ate_smoothed_aligned_m"] > WRONG_PATH
        ),
    }


_KINDS: dict[str, Callable[[Row, Job, float], Scores]] = {
    "drive": _drive,
    "exploration": _exploration,
    "log": _log,
    "made-up log": _made_up_log,
}
