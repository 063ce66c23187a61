"""Draws ``map.png``: the map beside the truth."""

import io
import textwrap
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from limslam_agent.grid.occupancy import GridView
from limslam_agent.output.map_picture import MapPicture, Paths
from limslam_agent.output.style import hexadecimal
from limslam_env.canvas import robot_colour
from limslam_env.geometry import FloatArray
from limslam_env.geometry.shapes import ellipse

TRUTH = "0.72"
WALLS = "#c0392b"
TRUE_PATH = "0.25"
ESTIMATED_PATH = "#1f6fb4"
ODOMETRY_PATH = "#e08e2b"

_DASHES = (0, (4, 2))
_DOTS = (0, (1, 1.5))
_ONLINE_WIDTH = 0.9
_START = "o"
_END = "s"
# of a title, and of a line of title or legend, inches
_LETTERS_PER_INCH = 11
_LINE_HEIGHT = 0.2
# of a legend, and the line and the gap beside its text, inches
_LETTERS_PER_INCH_OF_LEGEND = 15
_HANDLE = 0.6
_GRID = ListedColormap(["#c9ced6", "white", "#eef2f6"])
# m, and typical steps: a longer step of a path is not driven
_JUMP = 0.5
_JUMP_STEPS = 20.0
_WIDEST_BAND = 3.0  # height of a plot of errors over the largest error in it
_AROUND = 0.1  # share of the map's size around the map, beyond which odometry is cut off


def map_png(title: str, segments: FloatArray, paths: Paths, **others: Any) -> bytes:
    """What a notebook shows: the PNG file of :meth:`MapPicture.of`."""
    file = io.BytesIO()
    draw_map(file, MapPicture.of(title, segments, paths, **others), dpi=90)
    return file.getvalue()


def draw_map(file: Path | BinaryIO, picture: MapPicture, dpi: int = 160) -> None:
    """Draw a map into a PNG file."""
    low, high = _extent(picture)
    width, height = np.maximum(high - low, 0.5)
    scale = min(7.2 / width, 7.6 / height)
    handles = legend(picture)
    across = max(scale * width, 4.6) + 0.5
    remark = textwrap.wrap(picture.remark, int(_LETTERS_PER_INCH * across))
    columns = _columns([str(handle.get_label()) for handle in handles], across)
    rows = -(-len(handles) // columns) + len(remark)
    size = (across, scale * height + 0.95 + _LINE_HEIGHT * rows)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.add_subplot()
    paint_map(axes, picture)
    # A title of the axes may be cut off: their equal scales move it after the layout.
    figure.suptitle("\n".join((picture.title, *remark)), fontsize=11, parse_math=False)
    add_legend(figure, handles, columns)
    figure.savefig(file, format="png", dpi=dpi, facecolor="white")


def add_legend(
    figure: Figure,
    handles: list[Line2D],
    columns: int,
    place: Literal["outside lower center", "outside lower left"] = "outside lower center",
    size: float = 9.0,
) -> None:
    """Write the entries of a legend below a figure."""
    figure.legend(handles=handles, loc=place, ncols=columns, frameon=False, fontsize=size)


def _columns(labels: list[str], width: float) -> int:
    """How many columns, at most 3, of a legend with these labels fit beside each other in a width
    in inches.
    """
    for count in range(min(len(labels), 3), 1, -1):
        parts = np.array_split([len(label) for label in labels], count)
        if sum(_HANDLE + part.max() / _LETTERS_PER_INCH_OF_LEGEND for part in parts) <= width:
            return count
    return 1


def paint_map(axes: Axes, picture: MapPicture) -> None:
    """Draw truth, paths, walls and a scale bar into axes, without title and legend."""
    low, high = _extent(picture)
    if picture.grid is not None:
        _draw_grid(axes, picture.grid)
    if picture.true_edges is not None:
        edges = picture.true_edges.reshape(-1, 2, 2)
        axes.add_collection(
            LineCollection(list(edges), colors=TRUTH, linewidths=5.0, capstyle="round", zorder=1)
        )
    _draw_paths(axes, picture)
    _draw_ellipses(axes, picture)
    _draw_walls(axes, picture.segments, picture.colour or WALLS)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_axis_off()
    _draw_scale(axes, low, high)


def finish_errors(*plots: Axes) -> None:
    """Give plots of errors a grid, and limit their vertical axes: the band of a lost robot would
    hide the curves.
    """
    for axes in plots:
        largest = max(
            (float(np.nanmax(np.abs(line.get_ydata()), initial=0.0)) for line in axes.lines),
            default=0.0,
        )
        if largest > 0.0:
            low, high = axes.get_ylim()
            axes.set_ylim(max(low, -_WIDEST_BAND * largest), min(high, _WIDEST_BAND * largest))
        axes.tick_params(labelsize=8)
        axes.grid(color="0.9", linewidth=0.7)
        axes.spines[["top", "right"]].set_visible(False)


def path_colours(robots: int) -> list[tuple[str, str]]:
    """Colours of each robot's estimated path and odometry. A single robot has two colours, each of
    several robots has one.
    """
    if robots == 1:
        return [(ESTIMATED_PATH, ODOMETRY_PATH)]
    return [(hexadecimal(robot_colour(number)),) * 2 for number in range(robots)]


def legend(*pictures: MapPicture) -> list[Line2D]:
    """The entries of the legend of pictures: what is in one of them, once."""
    handles = {handle.get_label(): handle for each in pictures for handle in _handles(each)}
    return list(handles.values())


def _handles(picture: MapPicture) -> list[Line2D]:
    handles: list[Line2D] = []

    def add(label: str, **style: Any) -> None:
        handles.append(Line2D([], [], label=label, **style))

    colours = _colours(picture)
    several = len(set(colours)) > 1
    estimated, odometry = ("0.45", "0.45") if several else colours[0]
    walls = picture.colour or WALLS
    add("walls of the map, end points", color=walls, marker="o", markersize=3)
    for number, (colour, _) in enumerate(colours if several else ()):
        add(f"robot {number + 1}", color=colour)
    for label, style in _path_styles(picture):
        add(label, color=estimated, **style)
    if picture.odometry:
        low, high = _extent(picture)
        is_cut = any(((path < low) | (path > high)).any() for path in picture.odometry)
        away = ", runs out of the picture" if is_cut else ""
        add(f"path by odometry alone{away}", color=odometry, linestyle=_DASHES)
    if picture.true:
        add("true path", color=TRUE_PATH)
    if picture.true_edges is not None:
        add("true walls", color=TRUTH, linewidth=5.0)
    if picture.grid is not None:
        for kind, label in ((2, "seen free"), (0, "seen occupied")):
            add(label, linestyle="", marker="s", color=_GRID(kind), markeredgecolor="0.8")
    return handles


def _path_styles(picture: MapPicture) -> list[tuple[str, dict[str, Any]]]:
    """What is drawn in the colour of an estimate, by its name in the legend."""
    styles: list[tuple[str, dict[str, Any]]]
    if all(len(path) == 1 for path in picture.estimated):
        styles = [("robot", {"linestyle": "", "marker": _END})]
    else:
        styles = [
            ("smoothed path" if picture.online else "estimated path", {}),
            ("start", {"linestyle": "", "marker": _START}),
            ("end", {"linestyle": "", "marker": _END}),
        ]
    if picture.online:
        dots: dict[str, Any] = {"linestyle": _DOTS, "linewidth": _ONLINE_WIDTH}
        styles.insert(1, ("path as estimated online", dots))
    if picture.covariances:
        styles.append(("95 % of its positions", {"linewidth": 0.8}))
    return styles


def _colours(picture: MapPicture) -> list[tuple[str, str]]:
    """Colours of each robot's estimated path and odometry."""
    robots = len(picture.estimated)
    return [(picture.colour,) * 2] * robots if picture.colour else path_colours(robots)


def _unbroken(path: FloatArray) -> FloatArray:
    """A path (n, 2), m, with NaN where the robot was carried, or found to be elsewhere."""
    steps = np.hypot(*np.diff(path, axis=0).T)
    usual = steps.sum() / max(len(steps), 1)
    jumps = np.flatnonzero(steps > max(_JUMP, _JUMP_STEPS * usual))
    return np.insert(path, jumps + 1, np.nan, axis=0)


def _draw_paths(axes: Axes, picture: MapPicture) -> None:
    colours = _colours(picture)
    for (_, colour), path in zip(colours, picture.odometry, strict=False):
        axes.plot(*_unbroken(path).T, color=colour, linewidth=0.9, linestyle=_DASHES, zorder=2)
    for path in picture.true:
        axes.plot(*_unbroken(path).T, color=TRUE_PATH, linewidth=1.2, zorder=3)
    for (colour, _), path in zip(colours, picture.online, strict=False):
        axes.plot(
            *_unbroken(path).T, color=colour, linewidth=_ONLINE_WIDTH, linestyle=_DOTS, zorder=3
        )
    for (colour, _), path in zip(colours, picture.estimated, strict=True):
        axes.plot(*_unbroken(path).T, color=colour, linewidth=1.2, zorder=4)
        if len(path) > 1:
            axes.plot(*path[0], marker=_START, color=colour, markersize=6, zorder=8)
        axes.plot(
            *path[-1], marker=_END, color=colour, markersize=6, markeredgecolor="white", zorder=8
        )


def _draw_ellipses(axes: Axes, picture: MapPicture) -> None:
    """Draw what the last position of each robot may be."""
    colours = _colours(picture)
    for (colour, _), path, covariance in zip(
        colours, picture.estimated, picture.covariances, strict=False
    ):
        outline = path[-1] + ellipse(covariance[:2, :2], 48)
        axes.fill(*outline.T, facecolor="none", edgecolor=colour, linewidth=0.8, zorder=8)


def _draw_walls(axes: Axes, segments: FloatArray, colour: str) -> None:
    """Draw walls over their end points, which are small, so that short walls are not hidden by
    them.
    """
    ends = segments.reshape(-1, 2)
    axes.plot(
        *ends.T,
        linestyle="",
        marker="o",
        color=colour,
        markeredgewidth=0.0,
        markersize=2.6,
        zorder=6,
    )
    axes.add_collection(
        LineCollection(list(segments.reshape(-1, 2, 2)), colors=colour, linewidths=1.6, zorder=7)
    )


def _draw_grid(axes: Axes, grid: GridView) -> None:
    """Draw free cells pale and occupied cells darker. Unknown cells stay white."""
    if not grid.values.size:
        return
    low = grid.low
    high = grid.low + grid.cell * np.array(grid.values.shape[::-1])
    # Bytes, since matplotlib makes colours of numbers as floats, which takes 60 MB more.
    colours = _GRID(np.arange(3), bytes=True)
    axes.imshow(
        colours[np.sign(grid.values) + 1],
        origin="lower",
        interpolation="nearest",
        zorder=0,
        extent=(low[0], high[0], low[1], high[1]),
        aspect="equal",
    )


def _draw_scale(axes: Axes, low: FloatArray, high: FloatArray) -> None:
    """Draw a scale bar of a round length below the map on the left."""
    span = float(high[0] - low[0])
    length = max(
        size
        for size in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
        if size <= max(0.25 * span, 0.1)
    )
    left, bottom = low + 0.015 * span
    axes.plot(
        [left, left + length], [bottom, bottom], color="black", linewidth=2.5, solid_capstyle="butt"
    )
    axes.annotate(
        f"{length:g} m",
        (left + 0.5 * length, bottom),
        xytext=(0, 3),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=9,
    )


def _extent(picture: MapPicture) -> tuple[FloatArray, FloatArray]:
    """Corners of the region that is shown. Odometry that runs away does not make the map small."""
    edges = [] if picture.true_edges is None else [picture.true_edges.reshape(-1, 2)]
    points = np.vstack([picture.segments.reshape(-1, 2), *picture.estimated, *picture.true, *edges])
    low = points.min(axis=0)
    high = points.max(axis=0)
    around = _AROUND * float((high - low).max()) + 0.25
    odometry = np.vstack([points, *picture.odometry])
    low = np.maximum(odometry.min(axis=0), low - around)
    high = np.minimum(odometry.max(axis=0), high + around)
    margin = 0.04 * float((high - low).max()) + 0.05
    # The strip below the map is for the scale bar.
    return low - np.array([margin, 2.2 * margin]), high + margin
