# ruff: noqa: INP001
"""Draws ``results.png`` from the tables of ``benchmarks/RESULTS.md``. Run with ``python docs/images/results.py``."""

import re
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

RESULTS = Path(__file__).parents[2] / "benchmarks" / "RESULTS.md"
RUNS, LOGS = "This version", "Logs of real robots"
# Columns of the table of explorations, with the colours of Okabe and Ito, which the colour-blind can tell apart.
ESTIMATES = {
    "odometry": ("0.55", "X"),
    "published method": ("#D55E00", "s"),
    "filter": ("#56B4E9", "^"),
    "smoothed": ("#0072B2", "o"),
}

Row = dict[str, str]


def table(text: str, heading: str) -> list[Row]:
    """The rows of the first table below a heading, by the names of their columns."""
    section = text[text.index(f"## {heading}") :]
    lines = re.search(r"(?:^\|.*\|$\n?)+", section, re.MULTILINE)
    if lines is None:
        raise SystemExit(f"{RESULTS}: no table below {heading!r}")
    cells = [[cell.strip(" *") for cell in line.strip("|").split("|")] for line in lines[0].strip().splitlines()]
    return [dict(zip(cells[0], row, strict=True)) for row in cells[2:]]


def number(cell: str) -> float:
    """The first number of a cell."""
    return float(cell.split(maxsplit=1)[0])


def draw_runs(axes: Axes, rows: list[Row]) -> None:
    """Errors of the explorations over worlds and noises, on a logarithmic scale."""
    places = np.array([k + 0.6 * (k // 3) for k in range(len(rows))])
    for name, (colour, marker) in ESTIMATES.items():
        errors = np.array([number(row[f"ATE {name}, m"]) for row in rows])
        for start in range(0, len(rows), 3):
            part = slice(start, start + 3)
            axes.plot(
                places[part],
                errors[part],
                color=colour,
                marker=marker,
                linewidth=1.6,
                markersize=6,
                label=name if not start else None,
            )
    axes.set(yscale="log", ylabel="error of the path, m (median)", title="Simulated: six beams of 1.5 m")
    axes.set_xticks(places, [row["noise"].removesuffix(" cm") for row in rows])
    axes.set_xlabel("noise of the ranges, cm", labelpad=20)
    for start in range(0, len(rows), 3):
        axes.text(
            places[start + 1], -0.1, rows[start]["world"], ha="center", va="top", transform=axes.get_xaxis_transform()
        )
    axes.set_yticks([0.01, 0.03, 0.1, 0.3, 1.0], ["0.01", "0.03", "0.1", "0.3", "1"])
    axes.minorticks_off()


def draw_logs(axes: Axes, rows: list[Row]) -> None:
    """Errors of the logs of real robots beside those of their odometry, on a logarithmic scale."""
    for name, style in (("odometry", "odometry"), ("LimSLAM", "smoothed")):
        colour, marker = ESTIMATES[style]
        for k, row in enumerate(rows):
            error = number(row[f"{name}, m"])
            axes.plot(k, error, color=colour, marker=marker, markersize=8)
            axes.annotate(
                f"{error:.2g} m", (k, error), va="center", fontsize=10, xytext=(9, 0), textcoords="offset points"
            )
    axes.set(
        yscale="log",
        xlim=(-0.5, len(rows) - 0.25),
        ylim=(0.03, 20.0),
        ylabel="mean relation error, m",
        title="Real logs: six beams of 5 m",
    )
    axes.set_xticks(range(len(rows)), [row["log"].split()[0] for row in rows])
    axes.set_yticks([0.1, 1.0, 10.0], ["0.1", "1", "10"])
    axes.minorticks_off()


def main() -> None:
    """Draw the figure."""
    text = RESULTS.read_text(encoding="utf-8")
    figure = Figure(figsize=(10.5, 3.9), layout="constrained", facecolor="white")
    left, right = figure.subplots(1, 2, width_ratios=(2.4, 1.0))
    draw_runs(left, table(text, RUNS))
    draw_logs(right, table(text, LOGS))
    for axes in (left, right):
        axes.grid(axis="y", color="0.9", linewidth=0.7)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", frameon=False, ncols=4)
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=130, metadata={"Software": None})


if __name__ == "__main__":
    main()
