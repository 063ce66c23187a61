"""map.png: the map beside the truth, as one would print it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from limslam_env.geometry import FloatArray

TRUTH, WALLS = "0.72", "#c0392b"
TRUE_PATH, ESTIMATED_PATH, ODOMETRY_PATH = "0.25", "#1f6fb4", "#e08e2b"


@dataclass(frozen=True, eq=False)
class MapPicture:
    """What a picture of a map shows. All arrays are in the world frame, m.

    Attributes
    ----------
    title
        Written above it.
    segments
        Walls of the map (N, 4).
    estimated
        Believed positions (n, 2).
    odometry
        Positions by odometry alone (n, 2), from the same start.
    true_edges, true_path
        The truth (k, 4) and (n, 2), where it is known.
    """

    title: str
    segments: FloatArray
    estimated: FloatArray
    odometry: FloatArray
    true_edges: FloatArray | None = None
    true_path: FloatArray | None = None


def draw_map(path: Path, picture: MapPicture) -> None:
    """Draw a map as a PNG file."""
    low, high = _extent(picture)
    width, height = np.maximum(high - low, 0.5)
    scale = min(7.2 / width, 7.6 / height)
    figure = Figure(figsize=(max(scale * width, 4.6) + 0.5, scale * height + 1.35), layout="constrained")
    axes = figure.add_subplot()
    _draw_truth(axes, picture)
    _draw_paths(axes, picture)
    _draw_walls(axes, picture.segments)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_axis_off()
    axes.set_title(picture.title, fontsize=11, parse_math=False)
    _draw_scale(axes, low, high)
    handles = _legend(picture)
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 3), frameon=False, fontsize=9)
    figure.savefig(path, dpi=160, facecolor="white")


def _draw_truth(axes: Axes, picture: MapPicture) -> None:
    if picture.true_edges is not None:
        edges = picture.true_edges.reshape(-1, 2, 2)
        axes.add_collection(LineCollection(list(edges), colors=TRUTH, linewidths=5.0, capstyle="round", zorder=1))


def _draw_paths(axes: Axes, picture: MapPicture) -> None:
    axes.plot(*picture.odometry.T, color=ODOMETRY_PATH, linewidth=0.9, linestyle=(0, (4, 2)), zorder=2)
    if picture.true_path is not None:
        axes.plot(*picture.true_path.T, color=TRUE_PATH, linewidth=1.2, zorder=3)
    axes.plot(*picture.estimated.T, color=ESTIMATED_PATH, linewidth=1.2, zorder=4)
    axes.plot(*picture.estimated[0], marker="o", color=ESTIMATED_PATH, markersize=6, zorder=5)


def _draw_walls(axes: Axes, segments: FloatArray) -> None:
    ends = segments.reshape(-1, 2)
    axes.add_collection(LineCollection(list(segments.reshape(-1, 2, 2)), colors=WALLS, linewidths=1.6, zorder=6))
    axes.plot(*ends.T, linestyle="", marker="o", color="white", markeredgecolor=WALLS, markersize=3.6, zorder=7)


def _draw_scale(axes: Axes, low: FloatArray, high: FloatArray) -> None:
    """A bar of a round length, below the map on the left."""
    span = float(high[0] - low[0])
    length = max(size for size in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0) if size <= max(0.25 * span, 0.1))
    left, bottom = low + 0.015 * span
    axes.plot([left, left + length], [bottom, bottom], color="black", linewidth=2.5, solid_capstyle="butt")
    axes.annotate(
        f"{length:g} m", (left + 0.5 * length, bottom), xytext=(0, 3), textcoords="offset points",
        ha="center", va="bottom", fontsize=9,
    )  # fmt: skip


def _legend(picture: MapPicture) -> list[Line2D]:
    handles = [
        Line2D(
            [], [], color=WALLS, marker="o", markerfacecolor="white", markersize=4, label="walls of the map, end points"
        ),
        Line2D([], [], color=ESTIMATED_PATH, label="estimated path"),
        Line2D([], [], color=ODOMETRY_PATH, linestyle=(0, (4, 2)), label="path by odometry alone"),
    ]
    if picture.true_path is not None:
        handles.append(Line2D([], [], color=TRUE_PATH, label="true path"))
    if picture.true_edges is not None:
        handles.append(Line2D([], [], color=TRUTH, linewidth=5.0, label="true walls"))
    return handles


def _extent(picture: MapPicture) -> tuple[FloatArray, FloatArray]:
    parts: Sequence[FloatArray | None] = (
        picture.segments.reshape(-1, 2), picture.estimated, picture.odometry, picture.true_path,
        None if picture.true_edges is None else picture.true_edges.reshape(-1, 2),
    )  # fmt: skip
    points = np.vstack([part for part in parts if part is not None])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.04 * float((high - low).max()) + 0.05
    # The scale bar gets a strip of its own below.
    return low - np.array([margin, 2.2 * margin]), high + margin
