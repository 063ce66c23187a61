"""The figures of a folder of results: maps, errors over laps and scores over noise, like the paper's Figs 7 to 15."""

import math
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from benchmarks.analysis.groups import FRONTIER, PUBLISHED, Group, Setting, groups, metric
from benchmarks.analysis.series import Series, read_series
from benchmarks.analysis.style import (
    BAND,
    COLOURS,
    DASHES,
    FAINT,
    INK,
    MARKERS,
    TRUTH,
    WALLS,
    Drawing,
    chosen,
    file_word,
    handle,
    headline,
    legend_below,
    plain_axes,
    save,
    sheet_of,
)
from benchmarks.suite.jobs import LAPS_POLICY, RANDOM
from benchmarks.suite.store import Row, read_rows
from limslam_agent.measurements.statistics import median
from limslam_env.geometry import FloatArray

_F1 = metric("wall_f1")
_ACROSS = _DOWN = 3
_CELL = 3.3  # inches
_SCALES = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
_ROBOTS = (COLOURS[0], COLOURS[5], COLOURS[2], COLOURS[3], COLOURS[4], COLOURS[6], COLOURS[7], COLOURS[1])
_SWEPT = (
    ("aligned F1", "wall_f1_aligned"), ("spurious walls", "spurious_walls"),
    ("right associations, share", "association_right_share"), ("ATE, m", "ate_m"), ("ANEES (1 is honest)", "anees"),
    ("exploration time, s", "exploration_time_s"),
)  # fmt: skip
_COMPONENTS = (("x, m", 1.0), ("y, m", 1.0), ("heading, deg", math.degrees(1.0)))


class _Map(NamedTuple):
    """A map and its caption."""

    title: str
    series: Series


def drawings(rows: Sequence[Row], folder: Path) -> Iterator[Drawing]:
    """All figures of the given rows and their series, one at a time.

    Raises
    ------
    ValueError
        If there are no rows, or a series is missing or damaged.
    """
    if not rows:
        raise ValueError(f"{folder}: no results: there is not one row to draw")
    parts = groups(rows)
    yield from chain(_maps(parts, folder), _errors_over_laps(parts, folder), _sweeps(parts))


def plot(folder: Path, out: Path) -> list[Path]:
    """Draw the figures of a folder of results.

    Parameters
    ----------
    folder
        Folder of results.
    out
        Folder for the figures; created if it does not exist.

    Returns
    -------
    list of Path
        Paths of the written files; empty if there is nothing to draw because all runs failed.

    Raises
    ------
    ValueError
        If there are no rows, or a series is missing or damaged.
    """
    written = []
    for drawing in drawings(read_rows(folder), folder):
        written.append(out / f"{drawing.name}.png")
        save(drawing.figure, written[-1])
    return written


def _suffix(setting: Setting) -> str:
    """The part of a file name for robots and method: empty for one robot with the published method."""
    robots = f"_{setting.robots}_robots" if setting.robots > 1 else ""
    return robots + ("" if setting.method == PUBLISHED else f"_{file_word(setting.method)}")


def _who(setting: Setting) -> str:
    return f"{'one robot' if setting.robots == 1 else f'{setting.robots} robots'}, preset {setting.method}"


def _by_kind(parts: Sequence[Group]) -> Iterator[list[Group]]:
    """Groups of frontier explorers, together where number of robots and method are the same."""
    explored = [part for part in parts if part.setting.policy == FRONTIER and part.setting.ablation is None]
    kinds = dict.fromkeys((part.setting.robots, part.setting.method) for part in explored)
    for kind in kinds:
        yield [part for part in explored if (part.setting.robots, part.setting.method) == kind]


def _maps(parts: Sequence[Group], folder: Path) -> Iterator[Drawing]:
    """Sheets of maps: the worlds for each number of robots and method, and random plans."""
    for kind in _by_kind(parts):
        suffix, who = _suffix(kind[0].setting), _who(kind[0].setting)
        own = [part for part in kind if not part.rows[0].world.startswith(RANDOM)]
        worlds, noises = (
            list(dict.fromkeys(getattr(part.setting, name) for part in own)) for name in ("world", "noise")
        )
        runs = {(part.setting.world, part.setting.noise): part for part in own}
        for page, first in enumerate(range(0, len(worlds), _DOWN)):
            cells = [
                [_median_map(runs.get((world, noise)), folder) for noise in chosen(noises, _ACROSS)]
                for world in worlds[first : first + _DOWN]
            ]
            title = f"Maps by {who}: the run with the median F1 of each setting"
            yield from _sheet_of_maps(f"maps{suffix}{f'_{page + 1}' if page else ''}", title, cells)
        for part in kind:
            if part not in own:
                yield from _by_rank(part, folder)


def _ranked(rows: Sequence[Row]) -> list[Row]:
    """The runs with a series, from the worst map to the best."""
    scored = [(score, row.world, row.seed, row) for row in rows if (score := _F1(row)) is not None and row.series]
    return [row for *_, row in sorted(scored, key=lambda each: each[:3])]


def _median_map(part: Group | None, folder: Path) -> _Map | None:
    """The run with the median F1; of two middle runs, the one with the lower F1."""
    ranked = [] if part is None else _ranked(part.rows)
    if part is None or not ranked:
        return None
    row = ranked[(len(ranked) - 1) // 2]
    series = read_series(folder, row)
    where = f"{part.setting.world}, {part.setting.noise_text}"
    title = f"{where}: seed {row.seed}, F1 {_F1(row):.2f} (median of {len(ranked)})"
    return None if series is None else _Map(title, series)


def _by_rank(part: Group, folder: Path) -> Iterator[Drawing]:
    """Random plans in the order from the worst map to the best map."""
    ranked, setting = _ranked(part.rows), part.setting
    maps = [
        _Map(f"{row.world}: F1 {_F1(row):.2f} (rank {len(ranked) - place})", series)
        for place, row in chosen(list(enumerate(ranked)), _ACROSS * _DOWN)
        if (series := read_series(folder, row)) is not None
    ]
    name = f"maps_random_{file_word(setting.noise_text)}{_suffix(setting)}"
    title = f"Random plans, {setting.noise_text}, {_who(setting)}: from the worst of {len(ranked)} to the best"
    yield from _sheet_of_maps(name, title, [maps[first : first + _ACROSS] for first in range(0, len(maps), _ACROSS)])


def _sheet_of_maps(name: str, title: str, lines: Sequence[Sequence[_Map | None]]) -> Iterator[Drawing]:
    """A figure of maps, with one scale in each line; nothing if there are none."""
    lines = [line for line in lines if any(line)]
    if not lines:
        return
    boxes = [_box([each.series for each in line if each is not None]) for line in lines]
    heights = [_CELL * float(min((high - low)[1] / (high - low)[0], 1.6)) for low, high in boxes]
    figure, axes = sheet_of(heights, max(map(len, lines)), _CELL)
    for line_of_axes, line, box in zip(axes, lines, boxes, strict=True):
        for axis, each in zip(line_of_axes, [*line, *[None] * len(axes[0])], strict=False):
            axis.set_axis_off()
            if each is not None:
                axis.set_title(each.title, fontsize=8, parse_math=False)
                _paint(axis, each.series, box)
    shown = [each.series for line in lines for each in line if each is not None]
    headline(figure, title)
    legend_below(figure, _legend(max(each.estimated.shape[1] for each in shown)))
    yield Drawing(name, title, figure)


def _box(shown: Sequence[Series]) -> tuple[FloatArray, FloatArray]:
    """Corners (2,) of a common bounding box for one row of maps, so that the maps have the same scale; m."""
    points = []
    for series in shown:
        points += [series.segments.reshape(-1, 2), series.estimated[..., :2].reshape(-1, 2)]
        points += [series.edges.reshape(-1, 2)]
    together = np.vstack(points)
    low, high = together.min(axis=0), together.max(axis=0)
    margin = 0.02 * float((high - low).max()) + 0.05
    # The scale bar has a separate strip below the map.
    return low - np.array([margin, 3.0 * margin]), high + margin


def _paint(axes: Axes, series: Series, box: tuple[FloatArray, FloatArray]) -> None:
    low, high = box
    _draw_lines(axes, series.edges, TRUTH, 3.6, 1)
    for number in range(series.estimated.shape[1]):
        own = _ROBOTS[number % len(_ROBOTS)]
        axes.plot(*series.true[:, number, :2].T, color=INK, linewidth=0.5, zorder=2)
        axes.plot(*series.estimated[:, number, :2].T, color=own, linewidth=0.9, zorder=2)
        axes.plot(*series.estimated[0, number, :2], marker="o", color=own, markersize=4.5, zorder=4)
    _draw_lines(axes, series.segments, WALLS, 1.3, 3)
    span = float(high[0] - low[0])
    length = max(size for size in _SCALES if size <= max(0.25 * span, _SCALES[0]))
    left, bottom = low + 0.015 * span
    axes.plot([left, left + length], [bottom, bottom], color="black", linewidth=1.8, solid_capstyle="butt")
    axes.annotate(
        f"{length:g} m", (left + length, bottom), xytext=(4, 0), textcoords="offset points", va="center", fontsize=7
    )
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


def _draw_lines(axes: Axes, segments: FloatArray, colour: str, width: float, order: int) -> None:
    lines = list(segments.reshape(-1, 2, 2))
    axes.add_collection(LineCollection(lines, colors=colour, linewidths=width, capstyle="round", zorder=order))


def _legend(robots: int) -> list[Line2D]:
    names = ["believed path"] if robots == 1 else [f"robot {number + 1}, believed path" for number in range(robots)]
    return [
        handle("walls of the map", color=WALLS, linewidth=1.6),
        handle("true walls", color=TRUTH, linewidth=4.0),
        *(handle(name, color=_ROBOTS[k % len(_ROBOTS)], marker="o", markersize=4) for k, name in enumerate(names)),
        handle("true path", color=INK, linewidth=0.8),
    ]


def _errors_over_laps(parts: Sequence[Group], folder: Path) -> Iterator[Drawing]:
    """Errors over laps, without and with the filter; one sheet for each setting."""
    for part in parts:
        if part.setting.policy == LAPS_POLICY:
            found = [(row, series) for row in part.rows if (series := read_series(folder, row)) is not None]
            ranked = sorted((ate, row.seed, row) for row, _ in found if (ate := metric("ate_m")(row)) is not None)
            if ranked:
                yield _errors(part.setting, found, ranked[(len(ranked) - 1) // 2][2])


def _errors(setting: Setting, found: Sequence[tuple[Row, Series]], shown: Row) -> Drawing:
    """Errors in x, y and heading of all runs, of which one is ``shown`` in colour with the filter's band."""
    figure, axes = sheet_of([1.9] * 3, 2, 4.6)
    length = max(series.distance[-1] for _, series in found)
    for line, (name, scale) in zip(axes, _COMPONENTS, strict=True):
        line[0].set_ylabel(f"error in {name}", fontsize=9)
        line[1].sharey(line[0])
        line[1].tick_params(labelleft=False)
        for axis, poses in zip(line, ("odometry", "estimated"), strict=True):
            plain_axes(axis)
            axis.set_xlim(0.0, length)
            axis.tick_params(labelbottom=line is axes[-1])
            for lap in range(1, setting.laps):
                axis.axvline(length * lap / setting.laps, color="0.6", linewidth=0.8, linestyle=(0, (2, 2)))
            for row, series in found:
                _draw_error(axis, series, poses, axes.index(line), scale, is_shown=row is shown)
    for axis, title in zip(
        axes[0], ("without the EKF: odometry alone", f"with the EKF: {setting.method}"), strict=True
    ):
        axis.set_title(title, fontsize=10, parse_math=False)
    for axis in axes[-1]:
        axis.set_xlabel("distance driven, m", fontsize=9)
    title = (
        f"Errors over {setting.laps} laps of {setting.world}, {setting.noise_text}: seed {shown.seed} (median ATE) of "
        f"{len(found)}"
    )
    headline(figure, title)
    legend_below(figure, [
        handle(f"seed {shown.seed}", color=COLOURS[0]), handle("other seeds", color=FAINT, linewidth=0.7),
        handle("twice the filter's standard deviation", color=COLOURS[0], linewidth=7, alpha=2 * BAND),
        handle("end of a lap", color="0.6", linewidth=0.8, linestyle=(0, (2, 2))),
    ])  # fmt: skip
    name = f"errors_{file_word(setting.world)}_{file_word(setting.noise_text)}{_suffix(setting)}"
    return Drawing(name, title, figure)


def _draw_error(axis: Axes, series: Series, poses: str, component: int, scale: float, *, is_shown: bool) -> None:
    style: dict[str, Any] = (
        {"color": COLOURS[0], "linewidth": 1.5, "zorder": 4} if is_shown else {"color": FAINT, "linewidth": 0.5}
    )
    driven, errors = series.distance, series.errors(getattr(series, poses))
    axis.plot(driven, scale * errors[:, 0, component], **style)
    if is_shown and poses == "estimated":
        band = 2.0 * scale * series.sigma[:, 0, component]
        axis.fill_between(driven, -band, band, color=COLOURS[0], alpha=2 * BAND, linewidth=0.0, zorder=1)


def _sweeps(parts: Sequence[Group]) -> Iterator[Drawing]:
    """Scores over noise, with one sheet for each method and number of robots that was run at two or more noises."""
    for kind in _by_kind(parts):
        by_world: dict[str, list[Group]] = {}
        for part in kind:
            by_world.setdefault(part.setting.world, []).append(part)
        swept = [runs for runs in by_world.values() if len(runs) > 1]
        if swept:
            yield _sweep(chosen(swept, len(COLOURS)), kind[0].setting)


def _sweep(worlds: Sequence[list[Group]], setting: Setting) -> Drawing:
    figure, axes = sheet_of([2.6] * 2, 3, 3.4)
    for axis, (name, value) in zip([axis for line in axes for axis in line], _SWEPT, strict=True):
        plain_axes(axis)
        axis.set_ylabel(name, fontsize=9)
        axis.set_xlabel("range noise, cm", fontsize=9)
        for number, runs in enumerate(worlds):
            found = [(part.setting.noise or 0.0, median(part.values(metric(value)))) for part in runs]
            points = [(100.0 * noise, each) for noise, each in found if each is not None]
            noises, middle = [noise for noise, _ in points], [each.value for _, each in points]
            low = [each.value if each.low is None else each.low for _, each in points]
            high = [each.value if each.high is None else each.high for _, each in points]
            if points:  # a line of no points has no place, and the layout fails
                axis.plot(noises, middle, clip_on=False, **_line_style(number))
                axis.fill_between(noises, low, high, color=COLOURS[number], alpha=BAND, linewidth=0.0)
        if value == "anees":
            axis.set_yscale("log")
        else:
            axis.set_ylim(bottom=0.0, top=1.02 if "F1" in name or "share" in name else None)
    title = f"Noise, {_who(setting)}: medians and their 95 % intervals"
    headline(figure, title)
    legend_below(figure, [handle(runs[0].setting.world, **_line_style(k)) for k, runs in enumerate(worlds)])
    return Drawing(f"noise{_suffix(setting)}", title, figure)


def _line_style(number: int) -> dict[str, Any]:
    """Colour, marker and dashes of a line. Each of the three alone distinguishes the lines.

    Lines can therefore be distinguished in print without colours, and by colour-blind readers.
    """
    return {
        "color": COLOURS[number % len(COLOURS)], "marker": MARKERS[number % len(MARKERS)], "markersize": 4.5,
        "linestyle": DASHES[number % len(DASHES)], "linewidth": 1.5,
    }  # fmt: skip
