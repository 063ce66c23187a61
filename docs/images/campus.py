# ruff: noqa: INP001
"""Draws ``campus.png``: a long drive through a building that looks alike in many places, by
odometry alone, and smoothed.

Run with ``python docs/images/campus.py``. It takes a minute.
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from benchmarks.scoreboard.campus import campus_log, campus_world
from benchmarks.scoreboard.made_up_logs import as_recorded
from limslam_agent.config.graph import GraphConfig
from limslam_agent.replay.smoothing import log_data, trusted_path
from limslam_agent.slam.map_graph.reversing import with_reversing
from limslam_env.geometry import FloatArray, se2
from limslam_env.metrics import rigid_alignment, trajectory_metrics

SEED, DRIVEN, ODOMETRY, BEAMS = 7003, (500.0, 700.0), "as csail", 11
TRUE, ESTIMATE, WALLS = "#D55E00", "#0072B2", "0.75"


def draw(axes: Axes, walls: FloatArray, true: FloatArray, path: FloatArray, name: str) -> None:
    """The walls, the true path, and an estimated path that is aligned with it."""
    axes.add_collection(LineCollection(list(walls.reshape(-1, 2, 2)), colors=WALLS, linewidths=0.6))
    places = se2.transform_points(rigid_alignment(true[:, :2], path[:, :2]), path[:, :2])
    axes.plot(true[:, 0], true[:, 1], color=TRUE, linewidth=1.6, label="true")
    axes.plot(places[:, 0], places[:, 1], color=ESTIMATE, linewidth=0.8, label=name)
    error = trajectory_metrics(true, path)["ate_aligned_m"]
    axes.set_title(f"{name}: {error:.2f} m off", fontsize=10)
    axes.set_aspect("equal")
    axes.legend(loc="upper left", fontsize=8)
    axes.set_xlabel("x / m")
    axes.set_ylabel("y / m")


def main() -> None:
    """Draw the figure."""
    log = campus_log(SEED, DRIVEN, [ODOMETRY])
    beams = tuple(np.linspace(90.0, -90.0, BEAMS).tolist())
    recorded = as_recorded(log, beams, 5.0)
    config = GraphConfig()
    data = with_reversing(log_data(recorded, recorded.odometry, 0.02), config)
    smoothed = trusted_path(data, recorded.start_pose, config)[0].poses
    walls = campus_world(SEED, DRIVEN)[0].edges
    figure = Figure(figsize=(11.0, 5.5), layout="constrained")
    for axes, name, path in zip(
        figure.subplots(1, 2), ("odometry", "smoothed"), (log.odometry, smoothed), strict=True
    ):
        draw(axes, walls, log.truth, path, name)
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=90)


if __name__ == "__main__":
    main()
