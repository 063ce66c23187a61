# ruff: noqa: INP001
"""Draws ``results.png``, ``status.png`` and ``speed.png``, and writes the table of the scoreboard
into RESULTS.md.

They are made of the tables of ``benchmarks/RESULTS.md`` and of ``benchmarks/data/scoreboard.json``.
Run with ``python docs/images/results.py`` in a checkout.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.scoreboard.board import read_board, table
from benchmarks.scoreboard.compare import Cell

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
RESULTS, BOARD = BENCHMARKS / "RESULTS.md", BENCHMARKS / "data" / "scoreboard.json"
RUNS, DRIVES, LOGS, SPEED = (
    "Explorations with the default settings",
    "Drives with and without faults",
    "Logs of real robots",
    "Speed of the batch",
)
# Columns of the table of explorations, with the colours of Okabe and Ito, which the colour-blind
# can tell apart.
ESTIMATES = {
    "odometry": ("0.55", "X"),
    "published method": ("#D55E00", "s"),
    "filter": ("#56B4E9", "^"),
    "smoothed": ("#0072B2", "o"),
}
STATUSES = {"ok": ("#0072B2", "o"), "unsure": ("#E69F00", "D"), "lost": ("#D55E00", "X")}
SPEEDS = {"two cores": ("#0072B2", "o"), "H100": ("#009E73", "s")}
# Columns of a scoreboard that are shown: row, drives, errors of filter and smoothed path, the last
# one also aligned, NEES, wrong and ok, status.
SHOWN = (0, 1, 2, 4, 5, 6, 8, 10)

Row = dict[str, str]


def lines_of_table(text: str, heading: str) -> re.Match[str]:
    """The first table below a heading."""
    found = re.compile(r"(?:^\|.*\|$\n?)+", re.MULTILINE).search(text, text.index(f"## {heading}"))
    if found is None:
        raise SystemExit(f"{RESULTS}: no table below {heading!r}")
    return found


def rows_of(text: str, heading: str) -> list[Row]:
    """The rows of the first table below a heading, by the names of their columns."""
    lines = lines_of_table(text, heading)[0].strip().splitlines()
    cells = [[cell.strip(" *") for cell in line.strip("|").split("|")] for line in lines]
    return [dict(zip(cells[0], row, strict=True)) for row in cells[2:]]


def number(cell: str) -> float:
    """The first number of a cell; NaN of an empty one."""
    return float(cell.split(maxsplit=1)[0].replace(",", "")) if cell else np.nan


def scoreboard_lines(lines: Sequence[str]) -> str:
    """The table of a scoreboard with the columns that are shown."""
    rows = [line.strip("|").split("|") for line in lines if line.startswith("|")]
    return "".join(f"|{'|'.join(row[column] for column in SHOWN)}|\n" for row in rows)


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
    axes.set(
        yscale="log", ylabel="error of the path, m (median)", title="Simulated: six beams of 1.5 m"
    )
    axes.set_xticks(places, [row["noise"].removesuffix(" cm") for row in rows])
    axes.set_xlabel("noise of the ranges, cm", labelpad=20)
    for start in range(0, len(rows), 3):
        axes.text(
            places[start + 1],
            -0.1,
            rows[start]["world"],
            ha="center",
            va="top",
            transform=axes.get_xaxis_transform(),
        )
    axes.set_yticks([0.01, 0.03, 0.1, 0.3, 1.0])


def draw_logs(axes: Axes, rows: list[Row]) -> None:
    """Errors of the logs of real robots beside those of their odometry, on a logarithmic scale."""
    for name, style in (("odometry", "odometry"), ("LimSLAM", "smoothed")):
        colour, marker = ESTIMATES[style]
        for k, row in enumerate(rows):
            error = number(row[f"{name}, m"])
            axes.plot(k, error, color=colour, marker=marker, markersize=8)
            axes.annotate(
                f"{error:.2g} m",
                (k, error),
                va="center",
                fontsize=10,
                xytext=(9, 0),
                textcoords="offset points",
            )
    axes.set(
        yscale="log",
        xlim=(-0.5, len(rows) - 0.25),
        ylim=(0.03, 20.0),
        ylabel="mean relation error, m",
        title="Real logs: six beams of 5 m",
    )
    axes.set_xticks(range(len(rows)), [row["log"].split()[0] for row in rows])


def draw_status(by_status: Axes, by_stated: Axes, cells: Sequence[Cell]) -> None:
    """Errors of the smoothed paths by the status at the end, and beside the error that the estimate
    states.
    """
    for place, (status, (colour, marker)) in enumerate(STATUSES.items()):
        found = sorted(
            (cell for cell in cells if cell["status"] == status),
            key=lambda cell: cell["ate_smoothed_m"],
        )
        errors = np.array([cell["ate_smoothed_m"] for cell in found])
        stated = errors / np.sqrt([cell.get("nees_smoothed") or np.nan for cell in found])
        # Neighbours of nearly the same error are beside each other.
        spread = place + 0.15 * np.array([-1.0, 0.0, 1.0])[np.arange(len(errors)) % 3]
        style = {
            "color": colour,
            "marker": marker,
            "linestyle": "none",
            "markersize": 5,
            "alpha": 0.75,
        }
        by_status.plot(errors, spread, **style)
        by_stated.plot(stated, errors, label=f"{status} ({len(errors)})", **style)
    by_status.set(
        xscale="log", xlabel="error of the smoothed path, m", title="Error by the status at the end"
    )
    by_status.set_yticks(range(len(STATUSES)), STATUSES)
    by_status.set_ylim(len(STATUSES) - 0.6, -0.4)
    low, high = 0.001, 40.0
    by_stated.plot([low, high], [low, high], color="0.4", linewidth=1.0, label="as stated")
    by_stated.set(xscale="log", yscale="log", xlim=(low, high), ylim=(low, high))
    by_stated.set(xlabel="stated error, m", ylabel="error, m", title="Error and stated error")


def draw_speed(axes: Axes, rows: list[Row]) -> None:
    """Steps a second over the number of environments, on logarithmic scales."""
    counts = np.array([number(row["environments in Env1"]) for row in rows])
    for name, (colour, marker) in SPEEDS.items():
        rates = np.array([number(row[f"{name}, million steps/s"]) for row in rows])
        known = np.isfinite(rates)
        axes.plot(
            counts[known],
            rates[known],
            color=colour,
            marker=marker,
            linewidth=1.6,
            markersize=6,
            label=name,
        )
    axes.set(xscale="log", yscale="log", xlabel="environments", ylabel="million steps a second")


def save(figure: Figure, name: str, legend_columns: int) -> None:
    """Write a figure beside this file, with a legend below it."""
    for axes in figure.axes:
        axes.grid(axis="both" if axes.get_xscale() == "log" else "y", color="0.9", linewidth=0.7)
        axes.minorticks_off()
        for axis in (axes.xaxis, axes.yaxis):
            if axis.get_scale() == "log":
                axis.set_major_formatter("{x:,.7g}")
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", frameon=False, ncols=legend_columns)
    figure.savefig(Path(__file__).with_name(name), dpi=130, metadata={"Software": None})


def main() -> None:
    """Write the table, and draw the figures."""
    text, board = RESULTS.read_text(encoding="utf-8"), read_board(BOARD)
    old = lines_of_table(text, DRIVES)
    text = text[: old.start()] + scoreboard_lines(table(board)) + text[old.end() :]
    RESULTS.write_text(text, encoding="utf-8")

    figure = Figure(figsize=(10.5, 3.9), layout="constrained", facecolor="white")
    left, right = figure.subplots(1, 2, width_ratios=(2.4, 1.0))
    draw_runs(left, rows_of(text, RUNS))
    draw_logs(right, rows_of(text, LOGS))
    save(figure, "results.png", 4)

    figure = Figure(figsize=(10.5, 4.4), layout="constrained", facecolor="white")
    draw_status(
        *figure.subplots(1, 2), [cell for cell in board["cells"] if cell.get("ate_smoothed_m")]
    )
    save(figure, "status.png", 4)

    figure = Figure(figsize=(6.4, 3.6), layout="constrained", facecolor="white")
    draw_speed(figure.subplots(), rows_of(text, SPEED))
    save(figure, "speed.png", 2)


if __name__ == "__main__":
    main()
