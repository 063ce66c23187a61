"""Draws finished runs on a sheet: one with its map, its errors and what is said of it, or several
beside each other.
"""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.typing import LineStyleType

from limslam_agent.output.drawing import add_legend, finish_errors, legend, paint_map, path_colours
from limslam_agent.output.finished_run import FinishedRun
from limslam_agent.output.map_picture import MapPicture
from limslam_env.geometry import FloatArray
from limslam_env.geometry.consistency import BAND_95, has_left_start, nees
from limslam_env.geometry.se2 import wrap_angle

SIZE = (12.0, 6.8)
"""Size of the sheet of one run, inches."""

MOST_RUNS = 8
"""Most runs that one sheet can show."""

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f4f24", "#4d4d4d")
"""A colour for each run. People with any kind of colour blindness can tell them apart (Okabe and
Ito, 2008).
"""

TABLE = (
    ("exploration_time_s", "exploration time, s"),
    ("path_m", "path, m"),
    ("coverage_true", "coverage"),
    ("collisions", "collisions"),
    ("ate_m", "position error online, m"),
    ("ate_smoothed_m", "position error smoothed, m"),
    ("odometry_ate_m", "position error of odometry, m"),
    ("heading_rmse_deg", "heading error online, deg"),
    ("heading_smoothed_rmse_deg", "heading error smoothed, deg"),
    ("anees", "NEES / 3 online"),
    ("anees_smoothed", "NEES / 3 smoothed"),
    ("wall_recall", "wall recall"),
    ("wall_f1_aligned", "wall F1 aligned"),
    ("wall_f1_aligned_5cm", "wall F1 aligned at 5 cm"),
    ("spurious_walls", "spurious walls"),
    ("relation_error_m", "relation error online, m"),
    ("smoothed_relation_error_m", "relation error smoothed, m"),
    ("smoothed_relation_error_deg", "relation error smoothed, deg"),
    ("status", "status"),
)
"""Metrics that are compared, and how they are called."""

_COLUMNS = 4
_LETTERS = 78  # beside each other in the text of a sheet

_DASHES: LineStyleType = (0, (4, 2))
_DOTS: LineStyleType = (0, (1, 1))


def names_of(runs: Sequence[FinishedRun]) -> list[str]:
    """A short name of each run: the settings in which it differs from the others, else its
    folder.
    """
    parts = [run.title.split(", ") for run in runs]
    common = set.intersection(*map(set, parts))
    names = [", ".join(part for part in each if part not in common) for each in parts]
    is_clear = len(set(names)) == len(names) and all(names)
    return names if is_clear else [run.folder.absolute().name for run in runs]


def common_title(runs: Sequence[FinishedRun]) -> str:
    """The settings that all runs have in common."""
    parts = [run.title.split(", ") for run in runs]
    return ", ".join(part for part in parts[0] if all(part in each for each in parts))


def table_of(runs: Sequence[FinishedRun]) -> list[tuple[str, ...]]:
    """Rows of a table: the names of the runs, then each metric that one of the runs has."""
    found = [run.result.get("metrics") for run in runs]
    metrics = [each if isinstance(each, dict) else {} for each in found]
    rows = [("", *names_of(runs))]
    for key, words in TABLE:
        if any(each.get(key) is not None for each in metrics):
            rows.append((words, *(_text(each.get(key)) for each in metrics)))
    return rows


def sheet_size(count: int) -> tuple[float, float]:
    """Size of the sheet for a number of runs, inches."""
    columns = min(count, _COLUMNS)
    return max(4.2 * columns, 8.0), 4.4 * math.ceil(count / columns) + 4.0


def draw_run(
    figure: Figure, run: FinishedRun, lines: Sequence[str], true_edges: FloatArray | None = None
) -> None:
    """Draw a finished run into an empty figure with a constrained layout: its map, with the walls
    of the world (k, 4), m, if they are known, its errors over time, and lines of text about it.
    """
    has_nees = bool(run.true and run.covariances)
    rows = 3 + has_nees
    heights = [*[1.0] * (rows - 1), 0.7]
    grid = figure.add_gridspec(rows, 2, width_ratios=(1.25, 1.0), height_ratios=heights)
    picture = _map_of(run, true_edges, odometry=run.odometry)
    paint_map(figure.add_subplot(grid[:, 0]), picture)
    figure.suptitle(run.title, fontsize=12, parse_math=False)
    handles = legend(picture)
    add_legend(figure, handles, min(len(handles), 5), "outside lower left", 8.5)
    upper = figure.add_subplot(grid[0, 1])
    lower = figure.add_subplot(grid[1, 1], sharex=upper)
    colours = [estimated for estimated, _ in path_colours(len(run.estimated))]
    reference, compared = (run.true, "error") if run.true else (run.odometry, "off odometry")
    # The styles are those of the map beside the plots: the best estimate has a line without gaps.
    online = _DOTS if run.smoothed else "-"
    _plot((upper, lower), run, run.estimated, reference, colours, "estimated online", style=online)
    _plot((upper, lower), run, run.smoothed, reference, colours, "smoothed")
    if run.true:
        by_odometry = [odometry for _, odometry in path_colours(len(run.estimated))]
        _plot(
            (upper, lower),
            run,
            run.odometry,
            reference,
            by_odometry,
            "odometry alone",
            style=_DASHES,
        )
        _shade((upper, lower), run, run.covariances, colours, 0.15, "2 sigma, online")
        _shade((upper, lower), run, run.smoothed_covariances, colours, 0.3, "2 sigma, smoothed")
    _finish(upper, lower, compared)
    upper.tick_params(labelbottom=False)
    upper.set_xlabel("")
    if has_nees:
        lower.tick_params(labelbottom=False)
        lower.set_xlabel("")
        _plot_nees(figure.add_subplot(grid[2, 1], sharex=upper), run, colours, online)
    if upper.lines:
        # Between the plots, where it hides no curve.
        upper.legend(
            fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(0.0, -0.03), ncols=3
        )
    else:
        upper.text(
            0.5,
            0.5,
            "neither truth nor odometry is known",
            ha="center",
            transform=upper.transAxes,
            fontsize=9,
        )
    _write(figure.add_subplot(grid[-1, 1]), lines)


def _plot_nees(axes: Axes, run: FinishedRun, colours: Sequence[str], online: LineStyleType) -> None:
    """Plot the squared error in units of the covariance, over its three components: about 1 if an
    estimate knows its error.
    """
    kinds = (
        (run.estimated, run.covariances, online),
        (run.smoothed, run.smoothed_covariances, "-"),
    )
    for paths, stated, style in kinds:
        for number, (poses, true, covariances) in enumerate(
            zip(paths, run.true, stated, strict=False)
        ):
            ratio = nees(true, poses, covariances) / 3.0
            ratio[~has_left_start(true)] = np.nan
            time = run.elapsed(number)
            axes.plot(time, ratio, color=colours[number], linestyle=style, linewidth=1.0)
    low, high = (each / 3.0 for each in BAND_95)
    axes.axhspan(low, high, color="0.88", linewidth=0.0, zorder=0)
    axes.axhline(1.0, color="0.4", linewidth=0.8)
    axes.set(yscale="log", ylim=(0.01, None))
    axes.set_ylabel("NEES / 3\n(grey: 95 %)", fontsize=9)
    axes.set_xlabel("time, s", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)


def _write(axes: Axes, lines: Sequence[str]) -> None:
    """Write lines of text into empty axes."""
    axes.set_axis_off()
    wrapped = [
        part
        for line in lines
        for part in textwrap.wrap(line, _LETTERS, subsequent_indent=12 * " ") or [""]
    ]
    axes.text(
        0.0,
        1.0,
        "\n".join(wrapped),
        va="top",
        fontsize=8,
        family="monospace",
        transform=axes.transAxes,
        parse_math=False,
    )


def draw_comparison(
    figure: Figure, runs: Sequence[FinishedRun], edges: Sequence[FloatArray | None]
) -> None:
    """Draw at most ``MOST_RUNS`` runs into an empty figure with a constrained layout, with the
    walls (k, 4), m, of the world of each run where they are known.
    """
    columns = min(len(runs), _COLUMNS)
    rows = math.ceil(len(runs) / columns)
    has_truth = all(run.true for run in runs)
    grid = figure.add_gridspec(
        rows + has_truth, 2 * columns, height_ratios=[1.0] * rows + [0.75] * has_truth
    )
    pictures = [
        _map_of(run, walls, colour=colour)
        for run, walls, colour in zip(runs, edges, COLOURS, strict=False)
    ]
    for number, (picture, name) in enumerate(zip(pictures, names_of(runs), strict=True)):
        column = 2 * (number % columns)
        axes = figure.add_subplot(grid[number // columns, column : column + 2])
        paint_map(axes, picture)
        axes.set_title(
            name, fontsize=11, color=COLOURS[number], fontweight="bold", parse_math=False
        )
    if has_truth:
        left = figure.add_subplot(grid[-1, :columns])
        right = figure.add_subplot(grid[-1, columns:])
        for run, name, colour in zip(runs, names_of(runs), COLOURS, strict=False):
            colours = [colour] * len(run.estimated)
            _plot((left, right), run, run.smoothed or run.estimated, run.true, colours, name)
            _shade((left, right), run, run.smoothed_covariances or run.covariances, colours, 0.12)
        _finish(left, right, "error", " (shaded: 2 standard deviations)")
        # Above the plot, where it hides no curve.
        left.legend(fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    handles = legend(*(replace(picture, colour="0.45") for picture in pictures))
    add_legend(figure, handles, min(len(handles), 4))
    figure.suptitle(common_title(runs), fontsize=12, parse_math=False)


def _map_of(
    run: FinishedRun,
    edges: FloatArray | None,
    odometry: Sequence[FloatArray] = (),
    colour: str = "",
) -> MapPicture:
    paths = {"est": run.estimated, "true": run.true, "smoothed": run.smoothed, "odometry": odometry}
    return MapPicture.of(run.title, run.segments, paths, true_edges=edges, colour=colour)


def _plot(
    plots: tuple[Axes, Axes],
    run: FinishedRun,
    each: Sequence[FloatArray],
    reference: Sequence[FloatArray],
    colours: Sequence[str],
    name: str,
    *,
    style: LineStyleType = "-",
) -> None:
    """Plot the distance and the difference of heading between each robot's poses (n, 3) and the
    reference's.
    """
    for number, (poses, other) in enumerate(zip(each, reference, strict=False)):
        turned = np.degrees(wrap_angle(poses[:, 2] - other[:, 2]))
        # Where angles pass 180 degrees, no line is drawn across the plot.
        turned = np.where(np.abs(np.diff(turned, prepend=turned[:1])) > 180.0, np.nan, turned)
        label = name if number == 0 else None
        for axes, off in zip(plots, (np.hypot(*(poses - other)[:, :2].T), turned), strict=True):
            axes.plot(
                run.elapsed(number),
                off,
                color=colours[number],
                linestyle=style,
                linewidth=1.2,
                label=label,
            )


def _shade(
    plots: tuple[Axes, Axes],
    run: FinishedRun,
    each: Sequence[FloatArray],
    colours: Sequence[str],
    alpha: float,
    name: str | None = None,
) -> None:
    """Shade what the estimate says of its own error: two standard deviations, by covariances (n, 3,
    3) of each robot.

    An estimate that knows its error stays inside of its band most of the time.
    """
    upper, lower = plots
    for number, covariances in enumerate(each):
        label = name if number == 0 else None
        style: dict[str, Any] = {"color": colours[number], "alpha": alpha, "linewidth": 0.0}
        place = 2.0 * np.sqrt(np.maximum(covariances[:, 0, 0] + covariances[:, 1, 1], 0.0))
        heading = 2.0 * np.degrees(np.sqrt(np.maximum(covariances[:, 2, 2], 0.0)))
        upper.fill_between(run.elapsed(number), 0.0, place, label=label, **style)
        lower.fill_between(run.elapsed(number), -heading, heading, **style)


def _finish(upper: Axes, lower: Axes, compared: str, remark: str = "") -> None:
    upper.set_ylabel(f"position {compared}, m", fontsize=9)
    lower.set_ylabel(f"heading {compared}, deg", fontsize=9)
    for axes in (upper, lower):
        axes.set_xlabel(f"time, s{remark}", fontsize=9)
    upper.set_ylim(bottom=0.0)
    finish_errors(upper, lower)


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    return "-" if value is None else str(value)
