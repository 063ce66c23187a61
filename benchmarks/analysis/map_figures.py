"""Maps beside the true walls, like Figs 7 to 12 of the paper: one row for each world, one column for each noise."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from benchmarks.analysis.figure_style import (
    COLOURS,
    FAINT,
    INK,
    TRUTH,
    WALLS,
    Drawing,
    chosen,
    headline,
    legend_below,
    method_suffix,
    uneven_sheet,
)
from benchmarks.analysis.groups import FRONTIER, Group, centimetres, is_log, metric
from benchmarks.analysis.series import Series, read_series
from benchmarks.suite.jobs import RANDOM
from benchmarks.suite.store import Row
from limslam_env.geometry import FloatArray

_F1 = metric("wall_f1")
_ACROSS = _DOWN = 3
_CELL = 3.3
_SCALES = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
_ROBOTS = (COLOURS[0], COLOURS[5], COLOURS[2], COLOURS[3], COLOURS[4], COLOURS[6], COLOURS[7], COLOURS[1])


@dataclass(frozen=True, eq=False)
class _Cell:
    """A map and its caption."""

    title: str
    row: Row


def map_drawings(parts: Sequence[Group], folder: Path) -> Iterator[Drawing]:
    """Sheets of maps: the worlds for each number of robots and method, random plans, logs."""
    explored = [part for part in parts if part.setting.policy == FRONTIER and part.setting.ablation is None]
    own = [part for part in explored if not part.rows[0].world.startswith(RANDOM)]
    kinds = dict.fromkeys((part.setting.robots, part.setting.method) for part in own)
    for robots, method in kinds:
        of_kind = [part for part in own if (part.setting.robots, part.setting.method) == (robots, method)]
        yield from _grid(of_kind, robots, method, folder)
    for part in explored:
        if part.rows[0].world.startswith(RANDOM):
            yield from _by_rank(part, folder)
    yield from _logs([part for part in parts if is_log(part.setting)], folder)


def median_run(rows: Sequence[Row]) -> tuple[Row, int] | None:
    """The run with the median F1 among the runs with a series, and the number of these runs.

    Of two middle runs, the run with the lower F1 is taken.
    """
    ranked = _ranked(rows)
    return (ranked[(len(ranked) - 1) // 2], len(ranked)) if ranked else None


def _ranked(rows: Sequence[Row]) -> list[Row]:
    scored = [(score, row.world, row.seed, row) for row in rows if (score := _F1(row)) is not None and row.series]
    return [row for *_, row in sorted(scored, key=lambda each: each[:3])]


def _grid(parts: Sequence[Group], robots: int, method: str, folder: Path) -> Iterator[Drawing]:
    """Sheets of at most three worlds by three noises."""
    worlds = list(dict.fromkeys(part.setting.world for part in parts))
    all_noises = sorted({part.setting.noise for part in parts})
    noises = chosen(all_noises, _ACROSS)
    runs = {(part.setting.world, part.setting.noise): part for part in parts}
    team = "one robot" if robots == 1 else f"{robots} robots"
    some = f", {len(noises)} of {len(all_noises)} noises" if len(noises) < len(all_noises) else ""
    for first in range(0, len(worlds), _DOWN):
        shown = worlds[first : first + _DOWN]
        cells = [[_median_cell(runs.get((world, noise))) for noise in noises] for world in shown]
        page = f"_{first // _DOWN + 1}" if len(worlds) > _DOWN else ""
        name = f"maps_{robots}_robot{'s' if robots > 1 else ''}{method_suffix(method)}{page}"
        title = f"Maps by {team}, preset {method}: the run with the median F1 of each setting{some}"
        yield from _sheet(name, title, cells, folder)


def _median_cell(part: Group | None) -> _Cell | None:
    found = None if part is None else median_run(part.rows)
    if part is None or found is None:
        return None
    row, count = found
    where = f"{part.setting.world}, {centimetres(part.setting.noise)}"
    return _Cell(f"{where}: seed {row.seed}, F1 {_F1(row):.2f} (median of {count})", row)


def _by_rank(part: Group, folder: Path) -> Iterator[Drawing]:
    """Random plans in the order from the worst map to the best map."""
    ranked = _ranked(part.rows)
    places = chosen(range(len(ranked)), _ACROSS * _DOWN)
    cells = [
        _Cell(f"{ranked[place].world}: F1 {_F1(ranked[place]):.2f} (rank {len(ranked) - place})", ranked[place])
        for place in places
    ]
    lines = [list[_Cell | None](cells[first : first + _ACROSS]) for first in range(0, len(cells), _ACROSS)]
    setting = part.setting
    name = f"maps_random_{1000.0 * setting.noise:g}mm_{setting.robots}{method_suffix(setting.method)}"
    noise = centimetres(setting.noise)
    title = f"Random plans, {noise}, preset {setting.method}: from the worst of {len(ranked)} to the best"
    yield from _sheet(name, title, lines, folder)


def _logs(parts: Sequence[Group], folder: Path) -> Iterator[Drawing]:
    cells: list[_Cell | None] = [
        _Cell(f"{row.world}, {part.setting.method}", row) for part in parts for row in part.rows[:1] if row.series
    ]
    lines = [cells[first : first + _ACROSS] for first in range(0, len(cells), _ACROSS)]
    yield from _sheet("maps_logs", "Maps from recorded logs", lines, folder)


def _sheet(name: str, title: str, lines: Sequence[Sequence[_Cell | None]], folder: Path) -> Iterator[Drawing]:
    """A figure of maps, one for each cell whose job has series. Nothing if none has."""
    maps = [[_loaded(cell, folder) for cell in line] for line in lines]
    shown = [[each for each in line if each is not None] for line in maps]
    present = [each for line in shown for each in line]
    if not present:
        return
    boxes = [_box([series for _, series in line]) for line in shown]
    heights = [_CELL * float(min((high - low)[1] / (high - low)[0], 1.6)) for low, high in boxes]
    figure, axes = uneven_sheet(heights, max(map(len, lines)), _CELL)
    for axis in (each for line in axes for each in line):
        axis.set_axis_off()
    for line_of_axes, line, box in zip(axes, maps, boxes, strict=True):
        for axis, each in zip(line_of_axes, line, strict=False):
            if each is not None:
                cell, series = each
                axis.set_title(cell.title, fontsize=8, parse_math=False)
                _paint(axis, series, box)
    is_known = any(series.edges is not None for _, series in present)
    headline(figure, title)
    legend_below(figure, _legend(max(series.estimated.shape[1] for _, series in present), is_known=is_known))
    what = "true walls grey, walls of the map red over them, paths in colour" if is_known else "walls of the map, paths"
    yield Drawing(name, title, f"{title}. In each: {what}. {'; '.join(cell.title for cell, _ in present)}.", figure)


def _loaded(cell: _Cell | None, folder: Path) -> tuple[_Cell, Series] | None:
    """A cell with the series of its job; None if the cell is empty or its job has none."""
    series = None if cell is None else read_series(folder, cell.row)
    return None if cell is None or series is None else (cell, series)


def _box(shown: Sequence[Series]) -> tuple[FloatArray, FloatArray]:
    """Corners (2,) of a common bounding box for one row of maps, so that the maps have the same scale; m."""
    points = [np.zeros((0, 2))]
    for series in shown:
        points += [series.segments.reshape(-1, 2), series.estimated[..., :2].reshape(-1, 2)]
        points += [] if series.edges is None else [series.edges.reshape(-1, 2)]
        points += [] if series.true is not None else [series.odometry[..., :2].reshape(-1, 2)]
    together = np.vstack(points)
    low, high = (together.min(axis=0), together.max(axis=0)) if len(together) else (np.zeros(2), np.ones(2))
    margin = 0.02 * float((high - low).max()) + 0.05
    # The scale bar has a separate strip below the map.
    return low - np.array([margin, 3.0 * margin]), high + margin


def _paint(axes: Axes, series: Series, box: tuple[FloatArray, FloatArray]) -> None:
    low, high = box
    if series.edges is not None:
        _draw_lines(axes, series.edges, TRUTH, 3.6, 1)
    for poses, colour, width in _paths(series):
        axes.plot(*poses[:, :2].T, color=colour, linewidth=width, zorder=2)
    for number in range(series.estimated.shape[1]):
        axes.plot(*series.estimated[0, number, :2], marker="o", color=_colour(number), markersize=4.5, zorder=4)
    _draw_lines(axes, series.segments, WALLS, 1.3, 3)
    span = float(high[0] - low[0])
    length = max(size for size in _SCALES if size <= max(0.25 * span, _SCALES[0]))
    left, bottom = low + 0.015 * span
    axes.plot([left, left + length], [bottom, bottom], color="black", linewidth=1.8, solid_capstyle="butt")
    axes.annotate(
        f"{length:g} m", (left + length, bottom), xytext=(4, 0), textcoords="offset points", va="center", fontsize=7
    )
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


def _paths(series: Series) -> Iterator[tuple[FloatArray, str, float]]:
    """For each robot, the true path (or the odometry path if the truth is unknown) and the estimated path."""
    other = series.odometry if series.true is None else series.true
    for number in range(series.estimated.shape[1]):
        yield other[:, number], FAINT if series.true is None else INK, 0.5
        yield series.estimated[:, number], _colour(number), 0.9


def _draw_lines(axes: Axes, segments: FloatArray, colour: str, width: float, order: int) -> None:
    lines = list(segments.reshape(-1, 2, 2))
    axes.add_collection(LineCollection(lines, colors=colour, linewidths=width, capstyle="round", zorder=order))


def _legend(robots: int, *, is_known: bool) -> list[Line2D]:
    walls = [Line2D([], [], color=WALLS, linewidth=1.6, label="walls of the map")]
    if is_known:
        walls.append(Line2D([], [], color=TRUTH, linewidth=4.0, label="true walls"))
    names = ["believed path"] if robots == 1 else [f"robot {number + 1}, believed path" for number in range(robots)]
    paths = [
        Line2D([], [], color=_colour(number), marker="o", markersize=4, label=name) for number, name in enumerate(names)
    ]
    other = Line2D([], [], color=INK if is_known else FAINT, linewidth=0.8)
    other.set_label("true path" if is_known else "path by odometry alone")
    return [*walls, *paths, other]


def _colour(robot: int) -> str:
    return _ROBOTS[robot % len(_ROBOTS)]
