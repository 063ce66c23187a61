"""The common style of all figures: colours for colour-blind readers, axes, legends, and the saving of figures.

Figures are made without pyplot. No global state is changed, and no figure has to be closed.
"""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from limslam_agent.output.atomic_write import atomic_write

# Okabe & Ito, Color Universal Design, 2008, without yellow, which is hard to see on white; darkest colour first.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#7F7F7F")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
DASHES = ("-", (0, (5, 2)), (0, (1.5, 1.5)), (0, (6, 2, 1.5, 2)))
TRUTH, WALLS, FAINT, INK = "0.76", "#A3201A", "0.62", "0.15"
BAND = 0.15
"""Opacity of a band of half of the values."""

_NARROWEST, _AROUND = 5.0, 1.0  # inches: least width of a sheet, and height of title and legend
_ENTRY, _LETTERS = 1.75, 11.0  # width of a legend entry, inches, and number of title letters per inch

_Value = TypeVar("_Value")


@dataclass(frozen=True, eq=False)
class Drawing:
    """A figure and its description.

    Attributes
    ----------
    name
        Name of the file, without the extension.
    title
        One line that says what the figure shows.
    figure
        The figure.
    """

    name: str
    title: str
    figure: Figure


def sheet_of(heights: Sequence[float], columns: int, width: float) -> tuple[Figure, list[list[Axes]]]:
    """A figure with a grid of axes, with the height of each row and the width of all columns, inches."""
    # A title and a legend need more width than one narrow column has.
    size = (max(columns * width, _NARROWEST), sum(heights) + 0.25 * len(heights) + _AROUND)
    figure = Figure(figsize=size, layout="constrained", facecolor="white")
    axes = figure.subplots(len(heights), columns, squeeze=False, height_ratios=list(heights))
    return figure, [list(line) for line in axes]


def plain_axes(axes: Axes) -> None:
    """Draw a light grid, and hide the parts of the frame that carry no information."""
    axes.grid(color="0.9", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("0.6")
    axes.tick_params(labelsize=8, color="0.6")


def handle(label: str, **style: object) -> Line2D:
    """An entry of a legend. Matplotlib would leave out labels that begin with an underscore if given at once."""
    found = Line2D([], [], **style)  # type: ignore[arg-type] # the style of a line
    found.set_label(label)
    return found


def legend_below(figure: Figure, handles: Sequence[Line2D], columns: int = 5) -> None:
    """Draw a legend below the figure."""
    fitting = max(int(figure.get_figwidth() / _ENTRY), 1)
    figure.legend(
        handles=list(handles), loc="outside lower center", ncols=max(1, min(columns, len(handles), fitting)),
        frameon=False, fontsize=9,
    )  # fmt: skip


def headline(figure: Figure, title: str) -> None:
    """Draw a title above the figure. The text is never interpreted as mathematics."""
    lines = textwrap.wrap(title, max(int(figure.get_figwidth() * _LETTERS), 20), break_long_words=False)
    figure.suptitle("\n".join(lines), fontsize=11, parse_math=False)


def chosen(values: Sequence[_Value], most: int) -> list[_Value]:
    """All values, or at most ``most`` values, spaced evenly from the first value to the last."""
    if len(values) <= most:
        return list(values)
    return [values[round(float(place))] for place in np.linspace(0, len(values) - 1, most)]


def file_word(name: str) -> str:
    """A name, converted to a part of a file name."""
    return "-".join(filter(None, "".join(letter if letter.isalnum() else " " for letter in name).split()))


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG. The same figure always gives the same file."""
    with atomic_write(path) as beside:
        figure.savefig(beside, format="png", dpi=160, facecolor="white", metadata={"Software": None})
