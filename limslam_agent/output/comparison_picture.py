"""Draws several finished runs on one sheet: their maps side by side, and their errors over time in one plot."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from limslam_agent.output.drawing import MapPicture, finish_errors, legend, paint_map
from limslam_agent.output.finished_run import FinishedRun, heading_error, heading_std, position_error, position_std
from limslam_env.geometry import FloatArray

MOST_RUNS = 8
"""Most runs that one sheet can show."""

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f4f24", "#4d4d4d")
"""A colour for each run. People with any kind of colour blindness can tell them apart (Okabe and Ito, 2008)."""

TABLE = (
    ("exploration_time_s", "exploration time, s"), ("path_m", "path, m"), ("coverage_true", "coverage"),
    ("collisions", "collisions"), ("ate_m", "position error online, m"),
    ("ate_smoothed_m", "position error smoothed, m"), ("odometry_ate_m", "position error of odometry, m"),
    ("heading_rmse_deg", "heading error online, deg"), ("heading_smoothed_rmse_deg", "heading error smoothed, deg"),
    ("anees", "NEES / 3 online"), ("anees_smoothed", "NEES / 3 smoothed"), ("wall_recall", "wall recall"),
    ("wall_f1_aligned", "wall F1 aligned"), ("wall_f1_aligned_5cm", "wall F1 aligned at 5 cm"),
    ("spurious_walls", "spurious walls"), ("relation_error_m", "relation error online, m"),
    ("smoothed_relation_error_m", "relation error smoothed, m"),
    ("smoothed_relation_error_deg", "relation error smoothed, deg"), ("status", "status"),
)  # fmt: skip
"""Metrics that are compared, and how they are called."""

_COLUMNS = 4


def names_of(runs: Sequence[FinishedRun]) -> list[str]:
    """A short name of each run: the settings in which it differs from the others, else its folder."""
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


def draw_comparison(figure: Figure, runs: Sequence[FinishedRun], edges: Sequence[FloatArray | None]) -> None:
    """Draw runs into an empty figure with a constrained layout.

    Parameters
    ----------
    figure
        The figure.
    runs
        The runs, at most ``MOST_RUNS``.
    edges
        The walls (k, 4), m, of the world of each run. None where they are unknown.
    """
    columns = min(len(runs), _COLUMNS)
    rows = math.ceil(len(runs) / columns)
    has_truth = all(run.true for run in runs)
    grid = figure.add_gridspec(rows + has_truth, 2 * columns, height_ratios=[1.0] * rows + [0.75] * has_truth)
    pictures = [_map_of(run, walls) for run, walls in zip(runs, edges, strict=True)]
    for number, (picture, name) in enumerate(zip(pictures, names_of(runs), strict=True)):
        column = 2 * (number % columns)
        axes = figure.add_subplot(grid[number // columns, column : column + 2])
        paint_map(axes, picture)
        axes.set_title(name, fontsize=11, color=COLOURS[number], fontweight="bold", parse_math=False)
    if has_truth:
        _draw_errors(figure.add_subplot(grid[-1, :columns]), figure.add_subplot(grid[-1, columns:]), runs)
    handles = legend(max(pictures, key=lambda picture: len(legend(picture))))
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4), frameon=False, fontsize=9)
    figure.suptitle(common_title(runs), fontsize=12, parse_math=False)


def _map_of(run: FinishedRun, edges: FloatArray | None) -> MapPicture:
    online, true, smoothed = ([poses[:, :2] for poses in kind] for kind in (run.estimated, run.true, run.smoothed))
    return MapPicture(
        run.title, run.segments, smoothed or online, true_edges=edges, true=true, online=online if smoothed else ()
    )


def _draw_errors(left: Axes, right: Axes, runs: Sequence[FinishedRun]) -> None:
    """Plot the errors of what each run delivers, with bands of two standard deviations."""
    for run, name, colour in zip(runs, names_of(runs), COLOURS, strict=False):
        time = run.time - run.time[0]
        poses, covariances = (run.smoothed or run.estimated), (run.smoothed_covariances or run.covariances)
        place = _over_robots([position_error(*pair) for pair in zip(poses, run.true, strict=True)])
        turn = _over_robots([heading_error(*pair) for pair in zip(poses, run.true, strict=True)])
        left.plot(time, place, color=colour, linewidth=1.3, label=name)
        right.plot(time, np.degrees(turn), color=colour, linewidth=1.3)
        if covariances:
            of_place = 2.0 * _over_robots([position_std(each) for each in covariances])
            of_turn = 2.0 * _over_robots([heading_std(each) for each in covariances])
            left.fill_between(time, 0.0, of_place, color=colour, alpha=0.12, linewidth=0.0)
            right.fill_between(time, 0.0, np.degrees(of_turn), color=colour, alpha=0.12, linewidth=0.0)
    left.set_ylabel("position error, m", fontsize=9)
    right.set_ylabel("heading error, deg", fontsize=9)
    for axes in (left, right):
        axes.set_xlabel("time, s (shaded: 2 standard deviations)", fontsize=9)
        axes.set_ylim(bottom=0.0)
    finish_errors(left, right)
    # Above the plot, where it hides no curve.
    left.legend(fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)


def _over_robots(each: Sequence[FloatArray]) -> FloatArray:
    """Root of the mean square over the robots at each time, (n,)."""
    return np.asarray(np.sqrt(np.mean(np.square(each), axis=0)))


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    return "-" if value is None else str(value)
