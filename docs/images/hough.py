# ruff: noqa: INP001
"""Draws ``hough.png``: a wall with its r and theta, and the Hough plane. Run with ``python
docs/images/hough.py``.
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

ORIGIN, WALLS = "0.3", ("#c0392b", "#1f6fb4")
# Two walls at a corner: r (m), theta (rad) and the places of their points along the wall, m.
LINES = (
    (1.6, np.radians(60.0), np.linspace(-1.3, 0.6, 7)),
    (1.3, np.radians(150.0), np.linspace(-1.5, -0.1, 6)),
)


def points_of(r: float, theta: float, along: np.ndarray) -> np.ndarray:
    """Points (k, 2) of a line, m, at places along it."""
    normal, tangent = (
        np.array([np.cos(theta), np.sin(theta)]),
        np.array([-np.sin(theta), np.cos(theta)]),
    )
    return r * normal + along[:, None] * tangent


def draw_lines(axes: Axes) -> None:
    """The walls in the plane, with the perpendicular of one of them from the origin."""
    axes.axhline(0.0, color="0.85", linewidth=1.0, zorder=0)
    axes.axvline(0.0, color="0.85", linewidth=1.0, zorder=0)
    for colour, (r, theta, along) in zip(WALLS, LINES, strict=True):
        ends = points_of(r, theta, np.array([along[0] - 0.25, along[-1] + 0.25]))
        axes.plot(*ends.T, color=colour, linewidth=1.2, alpha=0.5)
        axes.plot(*points_of(r, theta, along).T, "o", color=colour, markersize=5)
        foot = points_of(r, theta, np.zeros(1))[0]
        axes.plot([0.0, foot[0]], [0.0, foot[1]], color=colour, linestyle="--", linewidth=1.2)
        beside = 10.0 * np.array([-np.sin(theta), np.cos(theta)])
        words = {"ha": "center", "va": "center", "color": colour, "style": "italic"}
        axes.annotate("r", 0.7 * foot, xytext=beside, textcoords="offset points", **words)
    angle = np.linspace(0.0, LINES[0][1], 40)
    axes.plot(0.45 * np.cos(angle), 0.45 * np.sin(angle), color=WALLS[0], linewidth=1.2)
    axes.annotate(
        "theta",
        (0.45, 0.12),
        xytext=(4, 0),
        textcoords="offset points",
        color=WALLS[0],
        style="italic",
    )
    axes.plot(0.0, 0.0, "o", color=ORIGIN, markersize=5)
    axes.annotate(
        "origin", (0.0, 0.0), xytext=(0, -14), textcoords="offset points", ha="center", color=ORIGIN
    )
    axes.set(
        xlabel="x, m", ylabel="y, m", ylim=(-0.4, 2.3), aspect="equal", title="Points on two walls"
    )


def draw_plane(axes: Axes) -> None:
    """The curve of each point: all lines through it."""
    theta = np.linspace(0.0, np.pi, 400)
    for colour, (r, angle, along) in zip(WALLS, LINES, strict=True):
        for x, y in points_of(r, angle, along):
            axes.plot(
                np.degrees(theta),
                x * np.cos(theta) + y * np.sin(theta),
                color=colour,
                linewidth=0.9,
                alpha=0.8,
            )
        axes.plot(
            np.degrees(angle),
            r,
            "o",
            color="black",
            fillstyle="none",
            markersize=13,
            markeredgewidth=1.6,
        )
        words = f"r = {r:.1f} m, theta = {np.degrees(angle):.0f} degrees"
        place, arrow = (46.0 if r > 1.5 else 136.0, 2.35), {"arrowstyle": "-", "shrinkB": 8.0}
        axes.annotate(
            words, (np.degrees(angle), r), place, ha="center", fontsize=9, arrowprops=arrow
        )
    axes.set(
        xlabel="theta, degrees",
        ylabel="r, m",
        xlim=(0, 180),
        ylim=(-2.6, 2.6),
        title="The Hough plane",
    )
    axes.set_xticks([0, 45, 90, 135, 180])


def main() -> None:
    """Draw the figure beside this file."""
    figure = Figure(figsize=(9.6, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    draw_lines(left)
    draw_plane(right)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=110, facecolor="white")


if __name__ == "__main__":
    main()
