"""Figures that compare other methods with the published method, such as methods without one part."""

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import replace

from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from benchmarks.analysis.figure_style import (
    COLOURS,
    MARKERS,
    MOST_LINES,
    Drawing,
    chosen,
    headline,
    legend_below,
    plain_axes,
    sheet_of,
)
from benchmarks.analysis.groups import PUBLISHED, Group, Value, metric
from benchmarks.analysis.statistics import Comparison, Estimate, compare

_PANELS: tuple[tuple[str, str, bool], ...] = (
    ("ATE over that of the published method", "ate_m", True),
    ("aligned F1 minus that of the published method", "wall_f1_aligned", False),
)


def method_drawings(parts: Sequence[Group]) -> Iterator[Drawing]:
    """One sheet of all methods, paired with the published method by world, noise and seed.

    There is no sheet if there are no other methods.
    """
    known = {part.setting: part for part in parts}
    matched = [
        (known[base], part)
        for part in parts
        if not part.setting.is_published
        and (base := replace(part.setting, preset=PUBLISHED, ablation=None)) in known
    ]  # fmt: skip
    methods = list(dict.fromkeys(part.setting.method for _, part in matched))
    if not methods:
        return
    worlds = chosen(list(dict.fromkeys(part.setting.world for _, part in matched)), MOST_LINES - 1)
    figure, axes = sheet_of(1, 2, (4.8, 1.0 + 0.5 * len(methods)))
    said = [_draw(axis, matched, methods, worlds, panel) for axis, panel in zip(axes[0], _PANELS, strict=True)]
    axes[0][1].tick_params(labelleft=False)
    title = "Other methods against the published one: medians over pairs, 95 % intervals"
    headline(figure, title)
    handles = [_handle("all together", "0.0", "D", 7)]
    handles += [_handle(world, COLOURS[number], MARKERS[number], 4) for number, world in enumerate(worlds)]
    legend_below(figure, handles)
    yield Drawing("methods", title, f"{title}. {' '.join(said)}", figure)


def _draw(
    axes: Axes, matched: Sequence[tuple[Group, Group]], methods: Sequence[str], worlds: Sequence[str],
    panel: tuple[str, str, bool],
) -> str:  # fmt: skip
    name, of, is_ratio = panel
    said = []
    for place, method in enumerate(methods):
        for number, world in enumerate((None, *worlds)):
            pairs = [
                (first, second)
                for first, second in matched
                if second.setting.method == method and world in {None, second.setting.world}
            ]
            compared = _compared(pairs, metric(of))
            estimate = compared.ratio if is_ratio else compared.difference
            if estimate is None:
                continue
            if world is None:  # all worlds together
                _point(axes, estimate, place, "black", "D", 6.0)
                said.append(f"{method}: {estimate.value:.2f} (n = {estimate.count})")
            else:
                height = place - 0.14 - 0.11 * (number - 1)
                _point(axes, estimate, height, COLOURS[number - 1], MARKERS[number - 1], 3.5)
    plain_axes(axes)
    axes.axvline(1.0 if is_ratio else 0.0, color="0.5", linewidth=0.9)
    axes.set(ylim=(-0.35 - 0.11 * len(worlds), len(methods) - 0.6), xscale="log" if is_ratio else "linear")
    if is_ratio:
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_yticks(range(len(methods)), methods, fontsize=9, parse_math=False)
    axes.set_xlabel(name, fontsize=9)
    return f"{name}: {'; '.join(said)}."


def _compared(pairs: Sequence[tuple[Group, Group]], value: Value) -> Comparison:
    first, second = dict[Hashable, float | None](), dict[Hashable, float | None]()
    for number, (one, other) in enumerate(pairs):
        first |= {(number, key): found for key, found in one.by_job(value).items()}
        second |= {(number, key): found for key, found in other.by_job(value).items()}
    return compare(first, second)


def _point(axes: Axes, estimate: Estimate, height: float, colour: str, marker: str, size: float) -> None:
    if estimate.low is not None and estimate.high is not None:
        axes.plot([estimate.low, estimate.high], [height, height], color=colour, linewidth=1.4, solid_capstyle="butt")
    axes.plot(estimate.value, height, marker=marker, markersize=size, color=colour)


def _handle(name: str, colour: str, marker: str, size: float) -> Line2D:
    handle = Line2D([], [], color=colour, marker=marker, markersize=size, linewidth=1.4)
    handle.set_label(name)
    return handle
