"""Tables as data, and their output as Markdown."""

import re
from dataclasses import dataclass

from limslam_agent.measurements.statistics import MISSING


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
    """

    title: str
    note: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: int = 1

    def without_empty(self) -> "Sheet":
        """The table without columns of numbers that contain no number."""
        kept = [
            number
            for number in range(len(self.header))
            if number < self.words or any(row[number] != MISSING for row in self.rows)
        ]
        rows = tuple(tuple(row[number] for number in kept) for row in self.rows)
        return Sheet(self.title, self.note, tuple(self.header[number] for number in kept), rows, self.words)

    def markdown(self) -> str:
        """The table in Markdown."""
        marks = ["---" if number < self.words else "---:" for number in range(len(self.header))]
        lines = [f"### {_escaped(self.title)}", "", _line(map(_escaped, self.header)), f"|{'|'.join(marks)}|"]
        lines += [_line(map(_escaped, row)) for row in self.rows]
        return "\n".join([*lines, *(["", _escaped(self.note)] if self.note else [])])


def _line(cells: "map[str]") -> str:
    return f"| {' | '.join(cells)} |"


def _escaped(text: str) -> str:
    """Text without marks of Markdown; line breaks become spaces."""
    return re.sub(r"([\\|<*`])", r"\\\1", " ".join(text.split()))
