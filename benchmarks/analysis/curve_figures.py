"""Curves: errors over laps (the paper's Figs 13 to 15), scores over noise, coverage over time, methods compared."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from benchmarks.analysis.figure_style import (
    BAND,
    COLOURS,
    DASHES,
    FAINT,
    MARKERS,
    MOST_LINES,
    Drawing,
    chosen,
    file_word,
    headline,
    legend_below,
    method_suffix,
    plain_axes,
    sheet_of,
)
from benchmarks.analysis.groups import FRONTIER, Group, Setting, Value, centimetres, is_exploration, metric
from benchmarks.analysis.series import Series, distance, read_series
from benchmarks.analysis.statistics import medians
from benchmarks.suite.jobs import LAPS_POLICY
from benchmarks.suite.store import Row
from limslam_env.messages import counted

_SWEPT: tuple[tuple[str, Value, str], ...] = (
    ("aligned F1", metric("wall_f1_aligned"), "linear"),
    ("spurious walls", metric("spurious_walls"), "linear"),
    ("right associations, share", metric("association_right_share"), "linear"),
    ("ATE, m", metric("ate_m"), "linear"),
    ("ANEES (1 is honest)", metric("anees"), "log"),
    ("exploration time, s", metric("exploration_time_s"), "linear"),
)
_COMPONENTS = (("x, m", 1.0), ("y, m", 1.0), ("heading, deg", math.degrees(1.0)))
_LAP_STYLE: dict[str, Any] = {"color": "0.6", "linewidth": 0.8, "linestyle": (0, (2, 2))}
_ACROSS = _DOWN = 3
_MOMENTS = 300


def error_drawings(parts: Sequence[Group], folder: Path) -> Iterator[Drawing]:
    """Errors over laps, without and with the filter; one sheet for each setting."""
    for part in parts:
        if part.setting.policy == LAPS_POLICY:
            found = [(row, series) for row in part.rows if (series := read_series(folder, row)) is not None]
            ranked = sorted((ate, row.seed, row) for row, _ in found if (ate := metric("ate_m")(row)) is not None)
            if ranked:
                yield _errors(part.setting, found, ranked[(len(ranked) - 1) // 2][2])


def _errors(setting: Setting, found: Sequence[tuple[Row, Series]], shown: Row) -> Drawing:
    figure, axes = sheet_of(3, 2, (4.6, 1.9))
    for row, series in found:
        _draw_errors(axes, series, is_shown=row is shown)
    _label_errors(axes, setting, length=max(distance(series)[-1] for _, series in found))
    title = (
        f"Errors over {counted(setting.laps, 'lap')} of {setting.world}, {centimetres(setting.noise)}: "
        f"seed {shown.seed} (median ATE) of {len(found)}"
    )
    headline(figure, title)
    ends_of_laps = [Line2D([], [], **_LAP_STYLE, label="end of a lap")] if setting.laps > 1 else []
    legend_below(figure, [
        Line2D([], [], color=COLOURS[0], label=f"seed {shown.seed}"),
        Line2D([], [], color=FAINT, linewidth=0.7, label="other seeds"),
        Line2D([], [], color=COLOURS[0], linewidth=7, alpha=2 * BAND, label="twice the filter's standard deviation"),
        *ends_of_laps,
    ])  # fmt: skip
    name = f"errors_{file_word(setting.world)}_{1000.0 * setting.noise:g}mm{method_suffix(setting.method)}"
    alt = (
        f"{title}. Six curves over distance: errors in x, y and heading, on the left by odometry alone, on the right "
        f"with the filter and the band of two standard deviations that it claims, on the same scales. {_ends(found)}"
    )
    return Drawing(name, title, alt, figure)


def _label_errors(axes: Sequence[Sequence[Axes]], setting: Setting, *, length: float) -> None:
    """Titles, labels and laps of a sheet (3, 2): a row for each component, odometry on the left; ``length`` in m."""
    for line, (name, _) in zip(axes, _COMPONENTS, strict=True):
        line[0].set_ylabel(f"error in {name}", fontsize=9)
        line[1].sharey(line[0])
        line[1].tick_params(labelleft=False)
        for axis in line:
            plain_axes(axis)
            axis.axhline(0.0, color="0.5", linewidth=0.8)
            axis.set_xlim(0.0, length)
            for lap in range(1, setting.laps):
                axis.axvline(length * lap / setting.laps, **_LAP_STYLE)
            axis.tick_params(labelbottom=line is axes[-1])
    for axis, name in zip(axes[0], ("without the EKF: odometry alone", f"with the EKF: {setting.method}"), strict=True):
        axis.set_title(name, fontsize=10, parse_math=False)
    for axis in axes[-1]:
        axis.set_xlabel("distance driven, m", fontsize=9)


def _draw_errors(axes: Sequence[Sequence[Axes]], series: Series, *, is_shown: bool) -> None:
    driven = distance(series)
    style: dict[str, Any] = (
        {"color": COLOURS[0], "linewidth": 1.5, "zorder": 4} if is_shown else {"color": FAINT, "linewidth": 0.5}
    )
    for column, poses in enumerate((series.odometry, series.estimated)):
        errors = series.errors(poses)[:, 0]
        for component, (_, scale) in enumerate(_COMPONENTS):
            axes[component][column].plot(driven, scale * errors[:, component], **style)
            if is_shown and column == 1 and series.sigma is not None:
                band = 2.0 * scale * series.sigma[:, 0, component]
                axes[component][column].fill_between(
                    driven, -band, band, color=COLOURS[0], alpha=2 * BAND, linewidth=0.0, zorder=1
                )


def _ends(found: Sequence[tuple[Row, Series]]) -> str:
    """The errors at the end of the runs, as text."""
    without, with_it = (
        float(np.median([np.linalg.norm(series.errors(poses)[-1, 0, :2]) for series, poses in pairs]))
        for pairs in ([(each, each.odometry) for _, each in found], [(each, each.estimated) for _, each in found])
    )
    return f"At the end the median position error is {without:.2f} m without and {with_it:.2f} m with the filter."


def sweep_drawings(parts: Sequence[Group]) -> Iterator[Drawing]:
    """Scores over noise, with one sheet for each method and number of robots that was run at two or more noises."""
    explored = [part for part in parts if part.setting.policy == FRONTIER and part.setting.ablation is None]
    for robots, method in dict.fromkeys((part.setting.robots, part.setting.method) for part in explored):
        of_kind = [part for part in explored if (part.setting.robots, part.setting.method) == (robots, method)]
        by_world: dict[str, list[Group]] = {}
        for part in of_kind:
            by_world.setdefault(part.setting.world, []).append(part)
        swept = {world: runs for world, runs in by_world.items() if len(runs) > 1}
        if swept:
            yield _sweep(swept, robots, method)


def _sweep(swept: dict[str, list[Group]], robots: int, method: str) -> Drawing:
    figure, axes = sheet_of(2, 3, (3.4, 2.6))
    worlds = chosen(list(swept), MOST_LINES)
    said = []
    for axis, (name, value, scale) in zip([axis for line in axes for axis in line], _SWEPT, strict=True):
        plain_axes(axis)
        axis.set(yscale=scale)
        axis.set_ylabel(name, fontsize=9)
        axis.set_xlabel("range noise, cm", fontsize=9)
        for number, world in enumerate(worlds):
            runs = sorted(swept[world], key=lambda part: part.setting.noise)
            said.append(_draw_sweep(axis, runs, value, number))
        if scale == "linear":
            axis.set_ylim(bottom=0.0, top=1.02 if "F1" in name or "share" in name else None)
    team = "one robot" if robots == 1 else f"{robots} robots"
    some = f", {len(worlds)} of {len(swept)} worlds" if len(worlds) < len(swept) else ""
    title = f"Noise, {team}, preset {method}{some}: medians and their 95 % intervals"
    headline(figure, title)
    legend_below(figure, [_mark(number, world) for number, world in enumerate(worlds)])
    first = "; ".join(f"{world}: {words}" for world, words in zip(worlds, said, strict=False))
    alt = f"{title}. Six panels over range noise: {', '.join(name for name, *_ in _SWEPT)}. Aligned F1: {first}."
    return Drawing(f"noise_{robots}_robot{'s' if robots > 1 else ''}{method_suffix(method)}", title, alt, figure)


def _draw_sweep(axes: Axes, runs: Sequence[Group], value: Value, number: int) -> str:
    found = [
        (100.0 * part.setting.noise, estimate)
        for part, estimate in zip(runs, medians([part.values(value) for part in runs]), strict=True)
        if estimate is not None
    ]
    if not found:
        return "no values"
    noise, middle = [noise for noise, _ in found], [estimate.value for _, estimate in found]
    low, high = (
        [estimate.value if end is None else end for _, estimate in found for end in [getattr(estimate, name)]]
        for name in ("low", "high")
    )
    axes.plot(noise, middle, clip_on=False, **_line(number))
    axes.fill_between(noise, low, high, color=COLOURS[number], alpha=BAND, linewidth=0.0)
    return f"{middle[0]:.2f} at {noise[0]:g} cm, {middle[-1]:.2f} at {noise[-1]:g} cm"


def coverage_drawings(parts: Sequence[Group], folder: Path) -> Iterator[Drawing]:
    """Coverage over time: one row for each world, one column for each noise, one line for each group.

    A group is a policy, a method and a number of robots.
    """
    explored = [part for part in parts if is_exploration(part.setting) and part.setting.ablation is None]
    worlds = list(dict.fromkeys(part.setting.world for part in explored))
    names = list(dict.fromkeys(_who(part.setting, explored) for part in explored))
    for first in range(0, len(worlds), _DOWN):
        shown = worlds[first : first + _DOWN]
        page = f"_{first // _DOWN + 1}" if len(worlds) > _DOWN else ""
        here = [(_who(part.setting, explored), part) for part in explored if part.setting.world in shown]
        yield from _coverage(f"coverage{page}", shown, here, names, folder)


def _coverage(
    file: str, worlds: Sequence[str], here: Sequence[tuple[str, Group]], names: Sequence[str], folder: Path
) -> Iterator[Drawing]:
    all_noises = sorted({part.setting.noise for _, part in here})
    noises = chosen(all_noises, _ACROSS)
    figure, axes = sheet_of(len(worlds), len(noises), (3.4, 2.4))
    said = []
    for name, part in here:
        if part.setting.noise in noises:
            axis = axes[worlds.index(part.setting.world)][noises.index(part.setting.noise)]
            time = _draw_coverage(axis, part, folder, names.index(name))
            said += [] if time is None else [(part.setting, name, time)]
    if not said:
        return
    some = f", {len(noises)} of {len(all_noises)} noises" if len(noises) < len(all_noises) else ""
    title = f"Coverage over time{some}: median and middle half of the runs"
    _finish_coverage(axes, worlds, noises)
    headline(figure, title)
    present = {name for _, name, _ in said}
    marks = [_mark(number, name, marker=False) for number, name in enumerate(names) if name in present]
    legend_below(figure, marks, 4)
    words = "; ".join(
        f"{setting.world}, {centimetres(setting.noise)}, {name}: {f'{time:.0f} s' if time else 'never'}"
        for setting, name, time in said
    )
    yield Drawing(file, title, f"{title}. The medians reach 90 % at: {words}.", figure)


def _draw_coverage(axes: Axes, part: Group, folder: Path, number: int) -> float | None:
    """Draw a line with its band, and return the time of 90 % coverage.

    The time is 0 if 90 % is never reached, and None if there is nothing to draw.
    """
    courses = [
        (series.time, series.coverage)
        for row in part.rows
        if (series := read_series(folder, row)) is not None and series.coverage is not None
    ]
    if not courses:
        return None
    end = max(float(time[-1]) for time, _ in courses)
    grid = np.linspace(0.0, end, _MOMENTS)
    # A run that has ended keeps its last coverage.
    table = np.array([np.interp(grid, time, coverage) for time, coverage in courses])
    low, middle, high = np.quantile(table, (0.25, 0.5, 0.75), axis=0)
    style = {**_line(number), "marker": ""}
    axes.plot(grid, middle, **style)
    axes.fill_between(grid, low, high, color=COLOURS[number % len(COLOURS)], alpha=BAND, linewidth=0.0)
    reached = np.flatnonzero(middle >= 0.9)
    return float(grid[reached[0]]) if reached.size else 0.0


def _finish_coverage(axes: Sequence[Sequence[Axes]], worlds: Sequence[str], noises: Sequence[float]) -> None:
    for line, world in zip(axes, worlds, strict=True):
        longest = max((float(np.asarray(curve.get_xdata())[-1]) for axis in line for curve in axis.lines), default=1.0)
        for axis, noise in zip(line, noises, strict=True):
            plain_axes(axis)
            axis.set(ylim=(0.0, 1.03), xlim=(0.0, longest))
            axis.set_xlabel("time, s", fontsize=9)
            if axis.lines:
                axis.set_title(f"{world}, {centimetres(noise)}", fontsize=9, parse_math=False)
            else:
                axis.set_axis_off()
        line[0].set_ylabel("coverage", fontsize=9)


def _who(setting: Setting, among: Sequence[Group]) -> str:
    """The facts that distinguish a line from the other lines."""
    parts = [setting.policy]
    if len({part.setting.method for part in among}) > 1:
        parts.append(setting.method)
    if len({part.setting.robots for part in among}) > 1:
        parts.append("one robot" if setting.robots == 1 else f"{setting.robots} robots")
    return ", ".join(parts)


def _line(number: int) -> dict[str, Any]:
    """Colour, marker and dashes of a line. Each of the three alone distinguishes the lines.

    Lines can therefore be distinguished in print without colours, and by colour-blind readers.
    """
    return {
        "color": COLOURS[number % len(COLOURS)], "marker": MARKERS[number % len(MARKERS)], "markersize": 4.5,
        "linestyle": DASHES[number % len(DASHES)], "linewidth": 1.5,
    }  # fmt: skip


def _mark(number: int, name: str, *, marker: bool = True) -> Line2D:
    style = _line(number) if marker else {**_line(number), "marker": ""}
    handle = Line2D([], [], **style)
    handle.set_label(name)
    return handle
