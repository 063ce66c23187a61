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
from limslam_agent.episode import Episode
from limslam_agent.export import map_content, write_grid, write_json, write_tum
from limslam_env import metrics
from limslam_env.coverage import CELL
from limslam_env.geometry import FloatArray


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
    """The metrics of a run, by their names in ``docs/metrics.md``."""
    robot, snapshot = episode.config.robot, episode.snapshot
    segments = snapshot.segments
    alignment = metrics.rigid_alignment(episode.true[:, :2], episode.estimated[:, :2])
    visible = metrics.visible_samples(episode.world, robot.radius, robot.reach)
    grid = snapshot.grid
    return {
        **trajectory_scores(episode.true, episode.estimated, episode.odometry, episode.covariances),
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
        "path_m": metrics.path_length(episode.true),
        "collisions": metrics.contacts_begun(episode.contact),
        "landmarks": len(segments),
        **metrics.association_metrics(_events(episode), len(episode.world.edges)),
        "stop_reason": episode.stop_reason,
    }


def cost(episode: Episode) -> dict[str, float]:
    """What a run cost, never part of a comparison for identity."""
    duration = float(episode.time[-1])
    return run_cost(duration, episode.wall_clock, slam=episode.slam_ms, explore=episode.decide_ms)


def write_episode(folder: Path, episode: Episode) -> dict[str, Any]:
    """Write a run's folder, and give back what its ``result.json`` holds."""
    from limslam_agent.drawing import MapPicture, draw_map

    config, robot = episode.config, episode.config.robot
    np.savez_compressed(
        folder / "log.npz",
        time=episode.time, ranges=episode.ranges, wheels=episode.wheels, action=episode.actions,
        true_pose=episode.true, wall_seen=episode.wall_seen, start_pose=episode.true[0],
        robot=np.array(robot.to_json()),
    )  # fmt: skip
    write_tum(folder / "trajectory_true.tum", episode.time, episode.true)
    write_tum(folder / "trajectory_est.tum", episode.time, episode.estimated)
    write_json(folder / "map.json", map_content(episode.snapshot.landmarks))
    write_grid(folder, episode.snapshot.grid)
    title = f"{episode.world.name}, range noise {100 * config.noise:g} cm, {config.preset}, seed {config.seed}"
    draw_map(
        folder / "map.png",
        MapPicture(
            title, episode.snapshot.segments, episode.estimated[:, :2], episode.odometry[:, :2],
            episode.world.edges, episode.true[:, :2],
        ),
    )  # fmt: skip
    written_config = {
        "world": episode.world.name, "world_digest": episode.world.digest, "noise": config.noise,
        "preset": config.preset, "max_time": config.max_time, "laps": config.laps,
        "robot": asdict(robot), "agent": asdict(config.agent),
    }  # fmt: skip
    result = {
        "metrics": score(episode), "cost": cost(episode), "config": written_config,
        "versions": versions(), "seed": config.seed,
    }  # fmt: skip
    write_json(folder / "result.json", result)
    return result


def versions() -> dict[str, str]:
    """Versions of all that a result depends on."""
    packages = ("limslam", "gymnasium", "pymunk", "numpy", "scipy", "numba", "filterpy", "opencv-python-headless")
    return {"python": sys.version.split()[0], **{name: version(name) for name in packages}}


def finite(scores: dict[str, float | None]) -> dict[str, float | None]:
    """JSON knows no infinity: a NEES that no covariance allows is written as null."""
    return {name: value if value is not None and math.isfinite(value) else None for name, value in scores.items()}


def _events(episode: Episode) -> list[metrics.AssociationEvent]:
    return [
        metrics.AssociationEvent(
            record.landmark,
            record.is_new,
            tuple(episode.wall_seen[record.readings[:, 0], record.readings[:, 1]].tolist()),
        )
        for record in episode.associations
    ]
