# ruff: noqa: INP001
"""Draws ``drone.png`` from folders of replays: one row for each log, before on the left, now on the
right.

Run with ``python docs/images/drone.py FILTER_DEMO GRAPH_DEMO FILTER_3LOOP GRAPH_3LOOP``: folders of
``limslam replay`` of ``olsson-demo.csv.gz`` and ``olsson-3loop.csv.gz``, with ``--preset
consistent`` and without.
"""

import json
import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from limslam_agent.output.tum import read_tum
from limslam_env.geometry import FloatArray

SHOWN = 27.0  # m, each side of a map
WITHIN = 2.0  # deg: such walls are drawn as standing at right angles
RIGHT, OTHER, PATH = "#0072B2", "#D55E00", "0.6"
BEFORE, NOW = "trajectory_est.tum", "trajectory_smoothed.tum"


def draw(axes: Axes, folder: Path, trajectory: str, title: str) -> None:
    """The walls and the path of a replay, turned so that most walls are level or upright."""
    segments = np.array(
        json.loads((folder / "map.json").read_text(encoding="utf-8"))["segments"], dtype=float
    )
    along = segments[:, 2:] - segments[:, :2]
    angles, lengths = np.arctan2(along[:, 1], along[:, 0]), np.hypot(along[:, 0], along[:, 1])
    frame = 0.25 * np.angle((lengths * np.exp(4j * angles)).sum())
    cos, sin = np.cos(frame), np.sin(frame)
    turn = np.array([[cos, -sin], [sin, cos]])
    walls, path = segments.reshape(-1, 2, 2) @ turn, read_tum(folder / trajectory)[1][:, :2] @ turn
    off = np.degrees(np.abs((angles - frame + np.pi / 4) % (np.pi / 2) - np.pi / 4))
    colours = np.where(off <= WITHIN, RIGHT, OTHER)
    axes.plot(path[:, 0], path[:, 1], color=PATH, linewidth=0.8)
    axes.add_collection(LineCollection(list(walls), colors=colours.tolist(), linewidths=2.0))
    set_limits(axes, walls.reshape(-1, 2))
    share = lengths[off <= WITHIN].sum() / lengths.sum()
    axes.set_title(
        f"{title}: {len(segments)} walls, {share:.0%} within {WITHIN:g} deg", fontsize=10
    )


def set_limits(axes: Axes, places: FloatArray) -> None:
    """Show the same distance in all maps, without axes."""
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    axes.set_xlim(middle[0] - SHOWN / 2, middle[0] + SHOWN / 2)
    axes.set_ylim(middle[1] - SHOWN / 2, middle[1] + SHOWN / 2)
    axes.set_aspect("equal")
    axes.axis("off")


def main(folders: list[str]) -> None:
    """Draw the figure."""
    figure = Figure(figsize=(9.0, 9.6), layout="constrained")
    titles = [
        f"{log}, {how}"
        for log in ("olsson-demo", "olsson-3loop")
        for how in ("filter alone", "smoothed")
    ]
    for number, (folder, title) in enumerate(zip(folders, titles, strict=True)):
        axes = figure.add_subplot(2, 2, number + 1)
        draw(axes, Path(folder), NOW if number % 2 else BEFORE, title)
    figure.savefig(Path(__file__).with_name("drone.png"), dpi=100)


if __name__ == "__main__":
    main(sys.argv[1:])
