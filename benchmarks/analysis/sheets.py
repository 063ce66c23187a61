"""Tables as data, and their output as Markdown, LaTeX and HTML."""

import html
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from benchmarks.analysis.groups import Group, Value
from benchmarks.analysis.statistics import Estimate, medians

MISSING = "\N{EN DASH}"
"""The text of a cell without a number; such a cell never shows 0."""

_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "|": r"\textbar{}", "\N{EN DASH}": "--", "\N{PLUS-MINUS SIGN}": r"$\pm$", "\N{MULTIPLICATION SIGN}": r"$\times$",
    "\N{LESS-THAN OR EQUAL TO}": r"$\leq$", "\N{GREATER-THAN OR EQUAL TO}": r"$\geq$",
}  # fmt: skip
_LONG, _LONG_CELL = 35, 40


@dataclass(frozen=True)
class Sheet:
    """A table.

    Attributes
    ----------
    title, note
        The text above and below the table: its content, and how to read it.
    header
        Names of the columns.
    rows
        Cells; each row has as many cells as there are columns.
    words
        Number of columns, from the left, that contain words; the other columns contain numbers.
    marked
        Rows that are highlighted, such as sums.

    Raises
    ------
    ValueError
        If a row has more or fewer cells than there are columns.
    """

    title: str
    note: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: int = 1
    marked: frozenset[int] = frozenset()

    def __post_init__(self) -> None:
        if any(len(row) != len(self.header) for row in self.rows):
            raise ValueError(f"{self.title}: each row needs {len(self.header)} cells")

    def without_empty(self) -> "Sheet":
        """The table without number columns that contain no number."""
        kept = [
            number
            for number in range(len(self.header))
            if number < self.words or any(row[number] != MISSING for row in self.rows)
        ]
        rows = tuple(tuple(row[number] for number in kept) for row in self.rows)
        return Sheet(
            self.title, self.note, tuple(self.header[number] for number in kept), rows, self.words, self.marked
        )


@dataclass(frozen=True)
class Column:
    """A column of medians.

    Attributes
    ----------
    heading
        Name of the column, with the unit.
    value
        Function that gives the value of a run.
    decimals
        Number of decimal places.
    """

    heading: str
    value: Value
    decimals: int = 2


Style = Literal["markdown", "latex", "html"]


def written(estimate: Estimate | None, decimals: int, runs: int | None = None) -> str:
    """The text of an estimate in a cell.

    The interval is left out if its width is zero. The number of values is added if it differs from ``runs``.
    """
    if estimate is None:
        return MISSING
    words = _number(estimate.value, decimals)
    if estimate.low is not None and estimate.high is not None:
        low, high = _number(estimate.low, decimals), _number(estimate.high, decimals)
        words += "" if low == high == words else f" [{low}, {high}]"
    return words if runs is None or estimate.count == runs else f"{words} ({estimate.count})"


def counted(group: Group) -> str:
    """Number of successful runs of a group, followed by the number of failed runs in brackets."""
    return f"{len(group.rows) - group.failed} ({group.failed})" if group.failed else str(len(group.rows))


def median_cells(parts: Sequence[Group], columns: Sequence[Column]) -> list[tuple[str, ...]]:
    """The medians of groups, one row of cells for each group."""
    found = iter(medians([part.values(column.value) for part in parts for column in columns]))
    return [
        tuple(written(next(found), column.decimals, len(part.rows) - part.failed) for column in columns)
        for part in parts
    ]


def render(sheet: Sheet, style: Style) -> str:
    """The text of a table in a markup language."""
    return {"markdown": _markdown, "latex": _latex, "html": _html}[style](sheet)


def escaped(text: str, style: Style) -> str:
    """Text with escaped markup commands; line breaks become spaces."""
    text = " ".join(text.split())
    if style == "latex":
        return "".join(_LATEX.get(letter, letter) for letter in text)
    if style == "html":
        return html.escape(text)
    return re.sub(r"([\\|<*`])", r"\\\1", text)


def _number(value: float, decimals: int) -> str:
    words = f"{value:.{decimals}f}" if abs(value) < 1e5 else f"{value:.3g}"
    return words.removeprefix("-") if float(words) == 0.0 else words


def _markdown(sheet: Sheet) -> str:
    lines = [f"### {escaped(sheet.title, 'markdown')}", ""]
    lines.append("| " + " | ".join(escaped(name, "markdown") for name in sheet.header) + " |")
    lines.append("|" + "|".join("---" if number < sheet.words else "---:" for number in range(len(sheet.header))) + "|")
    for number, row in enumerate(sheet.rows):
        cells = [escaped(cell, "markdown") for cell in row]
        if number in sheet.marked:
            cells = [f"**{cell}**" for cell in cells]
        lines.append("| " + " | ".join(cells) + " |")
    if sheet.note:
        lines += ["", escaped(sheet.note, "markdown")]
    return "\n".join(lines)


def _latex(sheet: Sheet) -> str:
    cells = [sheet.header, *sheet.rows]
    long = [number for number in range(sheet.words) if max(len(row[number]) for row in cells) > _LONG_CELL]
    wrapped = rf"p{{{0.64 / max(len(long), 1):.2f}\linewidth}}"
    align = "".join(
        wrapped if number in long else "l" if number < sheet.words else "r" for number in range(len(sheet.header))
    )
    head = _latex_row(sheet.header, marked=False)
    body = [_latex_row(row, marked=number in sheet.marked) for number, row in enumerate(sheet.rows)]
    caption = rf"\caption{{{escaped(f'{sheet.title}. {sheet.note}', 'latex')}}}"
    if long or len(sheet.rows) > _LONG:
        # A LaTeX float cannot be longer than a page.
        begin = [rf"\begin{{longtable}}{{{align}}}", caption + r"\\", r"\toprule", head, r"\midrule", r"\endhead"]
        return "\n".join([r"{\small", *begin, *body, r"\bottomrule", r"\end{longtable}", "}"])
    # A table that is too wide is scaled down; no table is enlarged.
    fitted = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{"
    begin = [r"\begin{table}", r"\centering", caption, rf"{fitted}\begin{{tabular}}{{{align}}}"]
    return "\n".join([*begin, r"\toprule", head, r"\midrule", *body, r"\bottomrule", r"\end{tabular}}", r"\end{table}"])


def _latex_row(cells: Sequence[str], *, marked: bool) -> str:
    words = [escaped(cell, "latex") for cell in cells]
    return " & ".join(rf"\textbf{{{cell}}}" if marked else cell for cell in words) + r" \\"


def _html(sheet: Sheet) -> str:
    title = escaped(sheet.title, "html")
    head = "".join(
        f'<th scope="col" class="{_kind(sheet, number)}">{escaped(name, "html")}</th>'
        for number, name in enumerate(sheet.header)
    )
    body = "\n".join(
        f"{'<tr class=sum>' if number in sheet.marked else '<tr>'}{_html_cells(sheet, row)}</tr>"
        for number, row in enumerate(sheet.rows)
    )
    note = f'<p class="note">{escaped(sheet.note, "html")}</p>' if sheet.note else ""
    return (
        f'<div class="box" role="region" aria-label="{title}" tabindex="0">'
        f"<table><caption>{title}</caption>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>{note}"
    )


def _html_cells(sheet: Sheet, row: Sequence[str]) -> str:
    first = f'<th scope="row" class="word">{escaped(row[0], "html")}</th>'
    rest = (
        f'<td class="{_kind(sheet, number)}{" long" * (len(cell) > _LONG_CELL)}">{_quieter(escaped(cell, "html"))}</td>'
        for number, cell in enumerate(row[1:], start=1)
    )
    return first + "".join(rest)


def _quieter(cell: str) -> str:
    """Set intervals in smaller type, because the medians are more important."""
    return re.sub(r"(?<=\d) (\[[^\]]*\])", r' <span class="interval">\1</span>', cell)


def _kind(sheet: Sheet, number: int) -> str:
    return "word" if number < sheet.words else "number"
