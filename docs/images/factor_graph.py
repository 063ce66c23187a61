# ruff: noqa: INP001
"""Draws ``factor_graph.png``: the graphs of both smoothers. Run with ``python
docs/images/factor_graph.py``.
"""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

# The colours of Okabe and Ito, which the colour-blind can tell apart.
POSE, LINE, ERROR = "#0072B2", "#E69F00", "#999999"
MOTION, RANGE, LOOP, PRIOR = "0.15", "#009E73", "#D55E00", "#CC79A7"

Place = tuple[float, float]


def draw_unknown(
    axes: Axes, place: Place, name: str, colour: str, *, is_known: bool = False
) -> None:
    """A circle with a name; a double circle for a known pose."""
    axes.plot(
        *place,
        "o",
        color=colour,
        markersize=25,
        markeredgecolor="white",
        markeredgewidth=1.5,
        zorder=3,
    )
    if is_known:
        axes.plot(
            *place,
            "o",
            color=colour,
            markersize=31,
            fillstyle="none",
            markeredgewidth=1.2,
            zorder=3,
        )
    axes.text(*place, name, ha="center", va="center", color="white", fontsize=10, zorder=4)


def draw_factor(axes: Axes, place: Place, ends: Sequence[Place], colour: str) -> None:
    """A square, with an edge to each unknown of the factor."""
    for x, y in ends:
        axes.plot([place[0], x], [place[1], y], color=colour, linewidth=1.1, alpha=0.8, zorder=1)
    axes.plot(*place, "s", color=colour, markersize=8, zorder=2)


def between(first: Place, second: Place, share: float = 0.5) -> Place:
    """A place on the way from one place to another one."""
    x, y = (1.0 - share) * np.array(first) + share * np.array(second)
    return float(x), float(y)


def draw_line_smoother(axes: Axes) -> None:
    """All poses are a chain. The wall of the first readings is read again at the end: that is the
    loop.
    """
    poses = [(float(k), 1.0) for k in range(7)]
    lines, sizes = [(1.0, 2.4), (4.0, 2.4)], (3.0, -0.5)
    for first, second in pairwise(poses):
        draw_factor(axes, between(first, second), (first, second, sizes), MOTION)
    for pose, line in ((0, 0), (1, 0), (2, 0), (2, 1), (3, 1), (4, 1), (5, 1), (5, 0), (6, 0)):
        colour, share = (LOOP, 0.7) if line == 0 and pose > 4 else (RANGE, 0.45)
        ends = poses[pose], lines[line]
        draw_factor(axes, between(*ends, share), ends, colour)
    draw_factor(axes, (4.3, -0.5), (sizes,), PRIOR)
    for number, place in enumerate(poses):
        draw_unknown(axes, place, f"$x_{number}$", POSE, is_known=number == 0)
    for number, place in enumerate(lines):
        draw_unknown(axes, place, f"$l_{number + 1}$", LINE)
    draw_unknown(axes, sizes, "$c$", ERROR)
    axes.set_title("Line smoother: every step, every reading")


def draw_local_maps(axes: Axes) -> None:
    """Key poses with odometry, points of one wall along the way, walls, and matches of local
    maps.
    """
    poses = [(float(k), 1.0) for k in range(7)]
    wall, errors = (3.0, 2.0), (3.0, -0.5)
    for first, second in pairwise(poses):
        draw_factor(axes, between(first, second), (first, second, errors), MOTION)
    for pose in poses[2:5]:
        draw_factor(axes, between(pose, wall), (pose, wall), RANGE)
    for first in (0, 1, 4, 5):
        draw_factor(axes, (first + 0.5, 1.45), (poses[first], poses[first + 1]), RANGE)
    for first, second, height in ((0, 6, 3.5), (1, 5, 2.9)):
        ends = np.array([poses[first], (3.0, height), poses[second]])
        share = np.linspace(0.0, 1.0, 60)[:, None]
        top = 2.0 * ends[1] - 0.5 * (ends[0] + ends[2])
        curve = (
            (1.0 - share) ** 2 * ends[0] + 2.0 * share * (1.0 - share) * top + share**2 * ends[2]
        )
        axes.plot(*curve.T, color=LOOP, linewidth=1.1, alpha=0.8, zorder=0)
        axes.plot(3.0, height, "s", color=LOOP, markersize=8, zorder=2)
    draw_factor(axes, (4.3, -0.5), (errors,), PRIOR)
    for number, place in enumerate(poses):
        draw_unknown(axes, place, f"$x_{number}$", POSE, is_known=number == 0)
    draw_unknown(axes, wall, "$l_1$", LINE)
    draw_unknown(axes, errors, "$b$", ERROR)
    axes.set_title("Graph of local maps: key poses and loops")


def handles() -> list[Line2D]:
    """The legend: circles are unknowns, and squares are factors."""
    circles = {"pose (double: known)": POSE, "wall: a line": LINE, "constant errors": ERROR}
    squares = {
        "wheels or odometry": MOTION,
        "range, or link of points": RANGE,
        "loop": LOOP,
        "prior": PRIOR,
    }
    shown = [(circles, "o", 12), (squares, "s", 8)]
    return [
        Line2D([], [], linestyle="none", marker=marker, color=colour, markersize=size, label=name)
        for kinds, marker, size in shown
        for name, colour in kinds.items()
    ]


def main() -> None:
    """Draw the figure beside this file."""
    figure = Figure(figsize=(12.0, 4.9), layout="constrained")
    left, right = figure.subplots(1, 2)
    draw_line_smoother(left)
    draw_local_maps(right)
    for axes in (left, right):
        axes.set(xlim=(-0.5, 6.5), ylim=(-0.95, 3.75))
        axes.set_axis_off()
    figure.legend(
        handles=handles(), loc="outside lower center", ncols=7, frameon=False, fontsize=10
    )
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=110, facecolor="white")


if __name__ == "__main__":
    main()
