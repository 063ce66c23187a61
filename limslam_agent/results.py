"""What a run was worth: its metrics and its cost, and the folder that keeps them.

The estimate meets the truth here, after the run is over.
"""

import math
import sys
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from limslam_agent.cost import run_cost
from limslam_agent.episode import Episode, RunConfig
from limslam_agent.export import map_content, write_grid, write_json, write_tum
from limslam_env import metrics
from limslam_env.association_metrics import (
    AssociationEvent,
    association_metrics,
    closure_metrics,
    dropped_beam_metrics,
)
from limslam_env.coverage import CELL
from limslam_env.geometry import FloatArray
from limslam_env.world import load_world


def trajectory_scores(
    true: FloatArray, estimated: FloatArray, odometry: FloatArray, covariances: FloatArray
) -> dict[str, float | None]:
    """Errors of an estimated trajectory (n, 3) with covariances (n, 3, 3), and of odometry alone beside them."""
    by_odometry = metrics.trajectory_metrics(true, odometry)
    return {
        **metrics.trajectory_metrics(true, estimated),
        **{f"odometry_{name}": by_odometry[name] for name in ("ate_m", "heading_rmse_deg")},
        **finite(metrics.consistency_metrics(true, estimated, covariances)),
    }


def score(episode: Episode) -> dict[str, Any]:
    """The metrics of a run, by their names in ``docs/metrics.md``; of several robots the means over them."""
    robot, snapshot = episode.config.robot, episode.snapshot
    segments, grid = snapshot.segments, snapshot.grid
    # All robots draw one map, and one motion aligns it.
    alignment = metrics.rigid_alignment(_joined(episode.true)[:, :2], _joined(episode.estimated)[:, :2])
    visible = metrics.visible_samples(episode.world, robot.radius, robot.reach)
    events, closed = _events(episode), [(closure.older, closure.younger) for closure in episode.closures]
    return {
        **mean_scores([_robot_scores(episode, number) for number in range(episode.config.robots)]),
        **metrics.wall_metrics(visible, episode.world.edges, segments, alignment),
        "doors_open": metrics.doors_open(episode.world.doors, segments),
        "coverage_true": float(episode.coverage[-1]),
        **metrics.coverage_claims(
            grid.centres(np.argwhere(grid.free)),
            grid.cell,
            episode.coverage_grid.coverable,
            episode.coverage_grid.low,
            CELL,
        ),
        **metrics.coverage_times(episode.time, episode.coverage),
        "exploration_time_s": float(episode.time[-1]) if episode.is_finished and not episode.config.laps else None,
        "collisions": sum(metrics.contacts_begun(contact) for contact in episode.contact.T),
        "landmarks": len(segments),
        **association_metrics(events, len(episode.world.edges)),
        **closure_metrics(events, closed, len(episode.world.edges)),
        **dropped_beam_metrics(episode.dropped, episode.wall_seen),
        "stop_reason": episode.stop_reason,
    }


def _robot_scores(episode: Episode, robot: int) -> dict[str, float | None]:
    true = episode.true[:, robot]
    return {
        **trajectory_scores(
            true, episode.estimated[:, robot], episode.odometry[:, robot], episode.covariances[:, robot]
        ),
        "path_m": metrics.path_length(true),
    }


def mean_scores(each: list[dict[str, float | None]]) -> dict[str, float | None]:
    """Means of several robots' scores; None where one has none."""
    columns = {name: [scores[name] for scores in each] for name in each[0]}
    return {
        name: None
        if any(value is None for value in values)
        else float(np.mean([value for value in values if value is not None]))
        for name, values in columns.items()
    }


def cost(episode: Episode) -> dict[str, float]:
    """What a run cost, never part of a comparison for identity."""
    duration = float(episode.time[-1])
    return run_cost(duration, episode.wall_clock, slam=episode.slam_ms, explore=episode.decide_ms)


def write_episode(folder: Path, episode: Episode) -> dict[str, Any]:
    """Write a run's folder, and give back what its ``result.json`` holds."""
    config = episode.config
    _write_log(folder / "log.npz", episode)
    for number in range(config.robots):
        suffix = f"_{number}" if config.robots > 1 else ""
        write_tum(folder / f"trajectory_true{suffix}.tum", episode.time, episode.true[:, number])
        write_tum(folder / f"trajectory_est{suffix}.tum", episode.time, episode.estimated[:, number])
    write_json(folder / "map.json", map_content(episode.snapshot.landmarks))
    write_grid(folder, episode.snapshot.grid)
    _draw(folder / "map.png", episode)
    written_config = {
        "world": episode.world.name, "world_digest": episode.world.digest, "noise": config.noise,
        "robots": config.robots, "preset": config.preset, "ablation": config.ablation,
        "max_time": config.max_time, "laps": config.laps,
        "robot": asdict(config.robot), "agent": asdict(config.agent),
    }  # fmt: skip
    result = {
        "metrics": score(episode), "cost": cost(episode), "config": written_config,
        "closures": [asdict(closure) for closure in episode.closures],
        "versions": versions(), "seed": config.seed,
    }  # fmt: skip
    write_json(folder / "result.json", result)
    return result


def _write_log(path: Path, episode: Episode) -> None:
    arrays: dict[str, Any] = {
        "ranges": episode.ranges, "wheels": episode.wheels, "action": episode.actions,
        "true_pose": episode.true, "wall_seen": episode.wall_seen,
    }  # fmt: skip
    if episode.config.robots == 1:
        arrays = {name: array[:, 0] for name, array in arrays.items()}
    np.savez_compressed(
        path, time=episode.time, start_pose=arrays["true_pose"][0], robot=np.array(episode.config.robot.to_json()),
        **arrays,
    )  # fmt: skip


def title_of(config: RunConfig) -> str:
    """What was run, in a line."""
    team = f"{config.robots} robots, " if config.robots > 1 else ""
    ablation = f" {config.ablation}" if config.ablation else ""
    laps = f", {config.laps} laps" if config.laps else ""
    noise = f"range noise {100 * config.noise:g} cm"
    return f"{load_world(config.world).name}, {team}{noise}, {config.preset}{ablation}{laps}, seed {config.seed}"


def _draw(path: Path, episode: Episode) -> None:
    from limslam_agent.drawing import MapPicture, draw_map

    config, title = episode.config, title_of(episode.config)
    estimated, odometry, true = (
        [poses[:, number, :2] for number in range(config.robots)]
        for poses in (episode.estimated, episode.odometry, episode.true)
    )
    picture = MapPicture(title, episode.snapshot.segments, estimated, odometry, episode.world.edges, true)
    draw_map(path, picture)


def _joined(poses: FloatArray) -> FloatArray:
    return np.asarray(poses.reshape(-1, 3))


def versions() -> dict[str, str]:
    """Versions of all that a result depends on."""
    packages = ("limslam", "gymnasium", "pymunk", "numpy", "scipy", "numba", "filterpy", "opencv-python-headless")
    return {"python": sys.version.split()[0], **{name: version(name) for name in packages}}


def finite(scores: dict[str, float | None]) -> dict[str, float | None]:
    """JSON knows no infinity: a NEES that no covariance allows is written as null."""
    return {name: value if value is not None and math.isfinite(value) else None for name, value in scores.items()}


def _events(episode: Episode) -> list[AssociationEvent]:
    return [
        AssociationEvent(
            record.landmark,
            record.is_new,
            tuple(episode.wall_seen[record.readings[:, 0], record.robot, record.readings[:, 1]].tolist()),
        )
        for record in episode.associations
    ]
