# ruff: noqa: INP001
"""Draws ``campus.png``: four made-up campuses, the drives through them, and their odometry.

Run with ``python docs/images/campus.py`` in a checkout.
"""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from benchmarks.scoreboard.campus import campus_log, campus_world

SEEDS = 7001, 7003, 7007, 7008
WALL, TRUTH, ODOMETRY = "0.35", "#0072B2", "#E69F00"
MARGIN = 6.0  # m
SCALE = 50.0  # m


def draw(axes: Axes, seed: int) -> None:
    """The walls, the true path and the path by odometry of a log."""
    log = campus_log(seed)
    walls = campus_world(seed)[0].edges.reshape(-1, 2, 2)
    axes.add_collection(LineCollection(list(walls), colors=WALL, linewidths=0.6))
    odometry = log.odometry - log.odometry[0] + log.truth[0]
    axes.plot(odometry[:, 0], odometry[:, 1], color=ODOMETRY, linewidth=0.7, label="odometry")
    axes.plot(log.truth[:, 0], log.truth[:, 1], color=TRUTH, linewidth=0.9, label="driven")
    low = walls.min(axis=(0, 1)) - MARGIN
    high = walls.max(axis=(0, 1)) + MARGIN
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1] - MARGIN, high[1])
    left = low[0] + MARGIN
    bottom = low[1]
    axes.plot([left, left + SCALE], [bottom, bottom], color="black", linewidth=2.0)
    axes.text(left + SCALE + 3.0, bottom, f"{SCALE:g} m", va="center", fontsize=8)
    axes.set_aspect("equal")
    axes.axis("off")
    axes.set_title(f"seed {seed}, odometry: {log.errors}", fontsize=9)


def main() -> None:
    """Draw the figure."""
    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    for number, seed in enumerate(SEEDS):
        draw(figure.add_subplot(2, 2, number + 1), seed)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    figure.savefig(Path(__file__).with_name("campus.png"), dpi=110)


if __name__ == "__main__":
    main()
