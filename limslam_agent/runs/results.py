"""The results of a run: metrics, cost, and the folder that keeps them.

The estimate is compared with the truth only here, after the run is over.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from limslam_agent.logs.recorded_log import write_npz
from limslam_agent.mapping.joining import NOT_YET_CONFIRMED
from limslam_agent.output.export import (
    WallsAndGrid,
    map_content,
    plain,
    write_covariances,
)
from limslam_agent.output.finished_run import COVARIANCES, WORLD, run_title
from limslam_agent.output.map_picture import MapPicture
from limslam_agent.output.results import Results, write_results
from limslam_agent.output.summary import calibration_record, record_of, run_cost, sensor_record
from limslam_agent.runs.optimum import offline_optimum
from limslam_agent.runs.policies import FROM_OUTSIDE
from limslam_agent.runs.policy_file import short_name
from limslam_agent.runs.record import Episode
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.status.status import (
    final_status_scores,
    lost_since,
    smoothed_status,
    status_scores,
    worst,
)
from limslam_env import metrics
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.metrics import (
    AssociationEvent,
    association_metrics,
    closure_metrics,
    dropped_beam_metrics,
)
from limslam_env.simulation.coverage import CELL, CoverageGrid
from limslam_env.worlds.formats.loading import load_world
from limslam_env.worlds.formats.tables import world_toml
from limslam_env.worlds.world import World

_ALIGNED_WALLS = (
    "wall_f1_aligned",
    "wall_f1_aligned_5cm",
    "spurious_walls",
    "spurious_m",
    "duplicate_m",
)
_IN_ANY_FRAME = {
    "ate_aligned_m",
    "limit_ate_m",
    "coverage_claimed",
    "landmarks",
    *_ALIGNED_WALLS,
    *(f"{name}_online" for name in _ALIGNED_WALLS),
}


def trajectory_scores(
    true: FloatArray, estimated: FloatArray, odometry: FloatArray, covariances: FloatArray
) -> dict[str, float | None]:
    """Errors of an estimated trajectory (n, 3) with covariances (n, 3, 3), and of odometry (n, 3),
    against the truth (n, 3).
    """
    by_odometry = metrics.trajectory_metrics(true, odometry)
    return {
        **metrics.trajectory_metrics(true, estimated),
        **{f"odometry_{name}": by_odometry[name] for name in ("ate_m", "heading_rmse_deg")},
        **plain(metrics.consistency_metrics(true, estimated, covariances)),
    }


def score(episode: Episode) -> dict[str, Any]:
    """Metrics of a run by their names in ``docs/metrics.md``. For several robots, means over the
    robots.
    """
    config = episode.config
    edges = len(episode.world.edges)
    events = _events(episode)
    closed = [(closure.older, closure.younger) for closure in episode.closures]
    # The poses of a robot that was not placed are in a frame of its own.
    placed = slice(episode.placed_robots)
    known = episode.placed_steps
    columns = (episode.true, episode.estimated, episode.odometry, episode.covariances)
    trajectory = over_robots(trajectory_scores, *(rows[:, placed] for rows in columns))
    has_limit = config.limit and not episode.is_interrupted
    limit = offline_optimum_scores(episode, trajectory["ate_m"]) if has_limit else {}
    smoothed = smoothed_scores(episode, limit.get("limit_ate_m"))
    has_explored = episode.claims_explored and not config.laps and config.policy not in FROM_OUTSIDE
    true = episode.true[known, placed]
    final = episode.final_map
    walls = map_scores(
        episode.world, config.robot, episode.coverage_grid, final, true, final.poses[known, placed]
    )
    if episode.smoothed is not None:
        # What the robots knew when the run stopped.
        online = episode.online_map
        poses = online.poses[known, placed]
        before = wall_scores(episode.world, config.robot, online.segments, true, poses)
        walls |= {f"{name}_online": value for name, value in before.items()}
    estimates = {**trajectory, **limit, **smoothed, **walls}
    if config.map is not None and not episode.in_prior_map:
        # The estimates are in a frame of their own, and can be compared with the truth only when
        # aligned.
        estimates = {
            name: value if name in _IN_ANY_FRAME else None for name, value in estimates.items()
        }
    return {
        **estimates,
        **drive_scores(
            episode.time, episode.coverage, episode.true, episode.contact, has_explored=has_explored
        ),
        **association_metrics(events, edges),
        **closure_metrics(events, closed, edges),
        **dropped_beam_metrics(episode.dropped, episode.wall_seen),
        **status_scores(episode.time, episode.levels, worst(episode.snapshot.statuses)),
        **final_status(episode),
        "stop_reason": episode.stop_reason,
    }


def over_robots(
    scores: Callable[..., Mapping[str, float | None]], *columns: FloatArray
) -> dict[str, float | None]:
    """Means over n robots of the scores of each one, from columns (t, n, ...)."""
    return mean_scores(
        [scores(*(rows[:, one] for rows in columns)) for one in range(columns[0].shape[1])]
    )


def mean_scores(each: Sequence[Mapping[str, float | None]]) -> dict[str, float | None]:
    """Means of several scores. A mean is None if one of them has no value."""
    columns: dict[str, Any] = {name: [scores[name] for scores in each] for name in each[0]}
    return {
        name: None if None in values else float(np.mean(values)) for name, values in columns.items()
    }


def drive_scores(
    time: FloatArray,
    coverage: FloatArray,
    true: FloatArray,
    contact: BoolArray,
    *,
    has_explored: bool,
) -> dict[str, float | None]:
    """Metrics that need no estimate.

    They are made from times (t,), s, true coverage (t,), 0 to 1, true poses (t, n, 3), and whether
    each robot touches something (t, n). ``has_explored`` says whether the agent itself has ended an
    exploration.
    """
    return {
        "path_m": float(np.mean([metrics.path_length(poses) for poses in true.swapaxes(0, 1)])),
        "coverage_true": float(coverage[-1]),
        **metrics.coverage_times(time, coverage),
        "exploration_time_s": float(time[-1]) if has_explored else None,
        "collisions": sum(metrics.contacts_begun(touched) for touched in contact.T),
    }


def map_scores(
    world: World,
    robot: RobotSpec,
    covered: CoverageGrid,
    final: WallsAndGrid,
    true: FloatArray,
    estimated: FloatArray,
) -> dict[str, float | None]:
    """Metrics of a map. True poses (t, n, 3), and the poses that the map was drawn from, align it
    with the world.
    """
    grid = final.grid
    claimed = grid.centres(np.argwhere(grid.free))
    return {
        **wall_scores(world, robot, final.segments, true, estimated),
        "doors_open": metrics.doors_open(world.doors, final.segments),
        **metrics.coverage_claims(claimed, grid.cell, covered.coverable, covered.low, CELL),
        "landmarks": len(final.segments),
    }


def wall_scores(
    world: World,
    robot: RobotSpec,
    segments: FloatArray,
    true: FloatArray,
    estimated: FloatArray,
) -> dict[str, float]:
    """Metrics of the walls of a map (m, 4), m. True poses (..., 3), and the poses that the map was
    drawn from, align it with the world.
    """
    # All robots share one map, so one rigid motion aligns it.
    alignment = metrics.rigid_alignment(true.reshape(-1, 3)[:, :2], estimated.reshape(-1, 3)[:, :2])
    visible = metrics.visible_samples(world, robot.radius, robot.reach)
    return metrics.wall_metrics(visible, world.edges, segments, alignment)


def offline_optimum_scores(episode: Episode, ate: float | None) -> dict[str, float | None]:
    """Error of the offline optimum, m, and the ratio of an estimate's error ``ate`` (m) to it.

    Both are None if there is no optimum, because no wall has enough readings.
    """
    config = episode.config
    true = episode.true
    limit = offline_optimum(
        config.robot,
        config.agent.noise,
        true,
        episode.wheels,
        episode.ranges,
        episode.wall_seen,
        episode.contact,
    )
    if limit is None:
        return {"limit_ate_m": None, "ate_over_limit": None}
    errors = np.linalg.norm(limit[..., :2] - true[..., :2], axis=-1)
    best = float(np.sqrt(np.mean(errors**2, axis=0)).mean())
    return {
        "limit_ate_m": best,
        "ate_over_limit": ate / best if ate is not None and best > 0.0 else None,
    }


def final_status(episode: Episode) -> dict[str, Any]:
    """The status of the smoothed path and map by the names in ``docs/metrics.md``; nothing if there
    are none.
    """
    online_statuses = episode.snapshot.statuses
    smoothed = episode.smoothed
    if smoothed is None:
        return {}
    places = episode.places
    since = lost_since(episode.time, places.placed.stop)
    status = smoothed_status(smoothed.contradictions, smoothed.covariances, lost_since=since)
    if status.level == "ok" and NOT_YET_CONFIRMED in online_statuses:
        status = NOT_YET_CONFIRMED
    if status.level == "ok":
        status = places.doubt
    return final_status_scores(status, worst(online_statuses), episode.time, episode.levels)


def smoothed_scores(episode: Episode, limit: float | None) -> dict[str, float | None]:
    """Metrics of the smoothed path, as means over the robots, and its ratio to the offline
    optimum's error (m).
    """
    smoothed = episode.smoothed
    if smoothed is None:
        return {}
    scores = over_robots(path_scores, episode.true, smoothed.poses, smoothed.covariances)
    if episode.config.limit:
        ate = scores["ate_smoothed_m"]
        scores["smoothed_over_limit"] = ate / limit if ate is not None and limit else None
    return scores


def path_scores(
    true: FloatArray, smoothed: FloatArray, covariances: FloatArray | None
) -> dict[str, float | None]:
    """Metrics of a smoothed path (n, 3) with covariances (n, 3, 3) against the truth (n, 3)."""
    errors = metrics.trajectory_metrics(true, smoothed)
    found: dict[str, float | None] = {
        "ate_smoothed_m": errors["ate_m"],
        "heading_smoothed_rmse_deg": errors["heading_rmse_deg"],
    }
    if covariances is not None:
        found["anees_smoothed"] = metrics.consistency_metrics(true, smoothed, covariances)["anees"]
    return plain(found)


def cost(episode: Episode) -> dict[str, float]:
    """Cost of a run. It is never part of a comparison of results."""
    duration = float(episode.time[-1])
    return run_cost(duration, episode.wall_clock, slam=episode.slam_ms, explore=episode.decide_ms)


def write_episode(folder: Path, episode: Episode) -> dict[str, Any]:
    """Write a run's folder and return the content of its ``result.json``."""
    smoothed = episode.smoothed
    final = episode.final_map
    paths = {"true": episode.true, "est": episode.estimated, "odometry": episode.odometry}
    if smoothed is not None:
        paths["smoothed"] = smoothed.poses
    shown = paths if smoothed is not None else {**paths, "est": final.poses}
    placed = {
        kind: [*poses[:, : episode.placed_robots].swapaxes(0, 1)] for kind, poses in shown.items()
    }
    _write_log(folder / "log.npz", episode)
    write_covariances(
        folder / COVARIANCES,
        episode.covariances,
        None if smoothed is None else smoothed.covariances,
    )
    write_world(folder, episode.world)
    results = Results(
        times=[episode.time] * episode.config.robots,
        paths={kind: [*poses.swapaxes(0, 1)] for kind, poses in paths.items()},
        final=final,
        picture=MapPicture.of(
            title_of(episode.config), final.segments, placed, true_edges=episode.world.edges
        ),
        content={
            "status": "interrupted" if episode.is_interrupted else "finished",
            "metrics": score(episode),
            "cost": cost(episode),
            "config": _config(episode),
            "record": _record(episode),
            "closures": [asdict(closure) for closure in episode.closures],
            "seed": episode.config.seed,
        },
        unplaced=episode.places.unplaced,
        tables={} if smoothed is None else {"map_online.json": map_content(episode.online_map)},
    )
    return write_results(folder, results)


def write_world(folder: Path, world: World) -> None:
    """Write the world of a run beside its results."""
    (folder / WORLD).write_text(world_toml(world), encoding="utf-8", newline="\n")


def _config(episode: Episode) -> dict[str, Any]:
    """The settings of a run, for ``result.json``."""
    config = episode.config
    return {
        "world": episode.world.name,
        "world_digest": episode.world.digest,
        "noise": config.noise,
        "robots": config.robots,
        "preset": config.preset,
        "ablation": config.ablation,
        "policy": config.driver or short_name(config.policy),
        "max_time": config.max_time,
        "laps": config.laps,
        "limit": config.limit,
        "kidnap_at": config.kidnap_at,
        "map": config.map and str(config.map),
        "unknown_starts": config.unknown_starts,
        "imu": config.imu,
        "robot": asdict(config.robot),
        "agent": asdict(config.agent),
    }


def _record(episode: Episode) -> dict[str, Any]:
    config = episode.config
    true, odometry = ([*rows.swapaxes(0, 1)] for rows in (episode.true, episode.odometry))
    return {
        **record_of(episode.time, true, odometry, episode.places.records),
        **sensor_record(episode.sensor, episode.beam_turns, config.agent.range_std, config.robot),
        "calibration": [
            found and calibration_record(found[0]._asdict(), found[1])
            for found in episode.calibrations
        ],
    }


def _write_log(path: Path, episode: Episode) -> None:
    arrays: dict[str, Any] = {
        "ranges": episode.ranges,
        "wheels": episode.wheels,
        "action": episode.actions,
        "true_pose": episode.true,
        "wall_seen": episode.wall_seen,
    }
    if episode.config.imu:
        arrays["yaw"] = episode.yaw
    if episode.config.robots == 1:
        arrays = {name: array[:, 0] for name, array in arrays.items()}
    write_npz(
        path, episode.config.robot, time=episode.time, start_pose=arrays["true_pose"][0], **arrays
    )


def title_of(config: RunConfig) -> str:
    """The settings of a run in one line."""
    told = {
        "world": load_world(config.world).name,
        "noise": config.noise,
        "preset": config.preset,
        "ablation": config.ablation,
        "policy": config.driver or short_name(config.policy),
        "laps": config.laps,
    }
    return run_title(told, config.robots, config.seed)


def _events(episode: Episode) -> list[AssociationEvent]:
    return [
        AssociationEvent(
            record.landmark,
            record.is_new,
            tuple(
                episode.wall_seen[
                    record.readings[:, 0], record.robot, record.readings[:, 1]
                ].tolist()
            ),
        )
        for record in episode.associations
    ]
