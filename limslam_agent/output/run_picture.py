"""Draws a finished run on one sheet: its map, and its errors over time."""

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.typing import LineStyleType

from limslam_agent.output.drawing import MapPicture, finish_errors, legend, paint_map, path_colours
from limslam_agent.output.finished_run import FinishedRun, heading_error, heading_std, position_error, position_std
from limslam_env.geometry import FloatArray

SIZE = (12.0, 6.8)
"""Size of the sheet, inches."""

_COLUMNS = 78  # letters beside each other in the text of a sheet
_MOST_PATHS_NAMED = 2  # robots up to which the legend of the plots names each path of each robot
_ANY_ROBOT = "0.45"  # colour of what a legend says of all robots
_BANDS = ("online", 0.15), ("smoothed", 0.3)  # names and opacity

_DASHES: LineStyleType = (0, (4, 2))
_DOTS: LineStyleType = (0, (1, 1))


def draw_run(figure: Figure, run: FinishedRun, lines: Sequence[str], true_edges: FloatArray | None = None) -> None:
    """Draw a finished run into an empty figure with a constrained layout.

    Parameters
    ----------
    figure
        The figure.
    run
        The run.
    lines
        Text about the run, line by line.
    true_edges
        Walls of the world (k, 4), m. None if they are unknown.
    """
    grid = figure.add_gridspec(3, 2, width_ratios=(1.25, 1.0), height_ratios=(1.0, 1.0, 0.55))
    online, odometry, true, smoothed = (
        [poses[:, :2] for poses in kind] for kind in (run.estimated, run.odometry, run.true, run.smoothed)
    )
    picture = MapPicture(
        run.title, run.segments, smoothed or online, odometry, true_edges, true, online=online if smoothed else ()
    )
    axes = figure.add_subplot(grid[:, 0])
    paint_map(axes, picture)
    figure.suptitle(run.title, fontsize=12, parse_math=False)
    handles = legend(picture)
    figure.legend(handles=handles, loc="outside lower left", ncols=min(len(handles), 5), frameon=False, fontsize=8.5)
    upper = figure.add_subplot(grid[0, 1])
    lower = figure.add_subplot(grid[1, 1], sharex=upper)
    _draw_errors(upper, lower, run)
    words = figure.add_subplot(grid[2, 1])
    words.set_axis_off()
    words.text(
        0.0, 1.0, "\n".join(_wrapped(lines)), va="top", fontsize=8, family="monospace", transform=words.transAxes,
        parse_math=False,
    )  # fmt: skip


def _wrapped(lines: Sequence[str]) -> list[str]:
    """The lines, with long ones continued below their second column."""
    return [part for line in lines for part in textwrap.wrap(line, _COLUMNS, subsequent_indent=12 * " ") or [""]]


def _draw_errors(upper: Axes, lower: Axes, run: FinishedRun) -> None:
    """Plot the errors against the truth. Without truth, plot the distance of the estimate from odometry."""
    reference, compared = (run.true, "error") if run.true else (run.odometry, "off odometry")
    colours = path_colours(len(run.estimated))
    for kind, which, style, name in _compared_paths(run):
        for number, (poses, other) in enumerate(zip(kind, reference, strict=False)):
            of_whom = f"robot {number + 1}, {name}" if len(kind) > 1 else name
            colour = colours[number][which]
            upper.plot(
                run.elapsed(number),
                position_error(poses, other),
                color=colour,
                linestyle=style,
                linewidth=1.2,
                label=of_whom,
            )
            turned = np.degrees(heading_error(poses, other))
            lower.plot(run.elapsed(number), _without_jumps(turned), color=colour, linestyle=style, linewidth=1.2)
    if run.true:
        _draw_bands(upper, lower, run)
    upper.set_ylabel(f"position {compared}, m", fontsize=9)
    lower.set_ylabel(f"heading {compared}, deg", fontsize=9)
    lower.set_xlabel("time, s", fontsize=9)
    upper.set_ylim(bottom=0.0)
    upper.tick_params(labelbottom=False)
    finish_errors(upper, lower)
    if upper.lines:
        # Between the plots, where it hides no curve.
        handles = _kinds(run) if len(colours) > _MOST_PATHS_NAMED else None
        upper.legend(handles=handles, fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(0.0, -0.03), ncols=3)
    else:
        upper.text(0.5, 0.5, "neither truth nor odometry is known", ha="center", transform=upper.transAxes, fontsize=9)


def _kinds(run: FinishedRun) -> list[Line2D | Patch]:
    """Entries of a legend for the kinds of paths and bands of many robots; the map's legend has the robots' colours."""
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=_ANY_ROBOT, linestyle=style, linewidth=1.2, label=name)
        for kind, _, style, name in _compared_paths(run)
        if kind
    ]
    if run.true:
        handles += [
            Patch(facecolor=_ANY_ROBOT, alpha=alpha, linewidth=0.0, label=_band_name(name))
            for kind, (name, alpha) in zip((run.covariances, run.smoothed_covariances), _BANDS, strict=True)
            if kind
        ]
    return handles


def _compared_paths(run: FinishedRun) -> list[tuple[list[FloatArray], int, LineStyleType, str]]:
    """The paths whose errors are plotted, with the number of their colour, their style and their name.

    Their styles are those of the map beside the plots: the best estimate has a line without gaps.
    """
    online: LineStyleType = _DOTS if run.smoothed else "-"
    paths: list[tuple[list[FloatArray], int, LineStyleType, str]] = [(run.estimated, 0, online, "estimated online")]
    if run.smoothed:
        paths.append((run.smoothed, 0, "-", "smoothed"))
    if run.true:
        paths.append((run.odometry, 1, _DASHES, "odometry alone"))
    return paths


def _draw_bands(upper: Axes, lower: Axes, run: FinishedRun) -> None:
    """Shade what the estimate says of its own error: two standard deviations, online and smoothed.

    An estimate that knows its error stays inside of its band most of the time.
    """
    time = run.time - run.time[0]
    colours = path_colours(len(run.estimated))
    for kind, (name, alpha) in zip((run.covariances, run.smoothed_covariances), _BANDS, strict=True):
        for number, covariances in enumerate(kind):
            colour, label = colours[number][0], _band_name(name) if number == 0 else None
            of_place, of_heading = 2.0 * position_std(covariances), 2.0 * np.degrees(heading_std(covariances))
            upper.fill_between(time, 0.0, of_place, color=colour, alpha=alpha, linewidth=0.0, label=label)
            lower.fill_between(time, -of_heading, of_heading, color=colour, alpha=alpha, linewidth=0.0)


def _band_name(name: str) -> str:
    return f"2 sigma, {name}"


def _without_jumps(degrees: FloatArray) -> FloatArray:
    """Angles with a gap where they pass 180 degrees, so that no line is drawn across the plot."""
    jumps = np.abs(np.diff(degrees, prepend=degrees[:1])) > 180.0
    return np.where(jumps, np.nan, degrees)
