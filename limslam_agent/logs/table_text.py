"""Takes a table in plain text apart: its header, its rows of numbers, and the lines that are
neither.

Columns are separated by commas, semicolons, tabs or spaces. A comma is the decimal mark where it
does not separate. Quotation marks, and a separator at the end of a line, do not matter. The header
may be a comment with a remark in brackets. A header that is repeated is skipped: some loggers write
it again when they start again. Text before the header is counted, and so are damaged lines.
"""

import math
import re
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from limslam_agent.logs.columns import UNITS, Column, column_of
from limslam_agent.logs.recorded_log import MOST_BEAMS, is_number
from limslam_agent.logs.table_layout import DOTS, columns_of, completeness
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.messages import counted, described

NO_SCAN = b"-"
"""Marks an event with odometry only. It stands in all range columns, or once instead of all of
them.
"""

MOST_DAMAGED = 0.05
"""Largest share of lines that are left out because they are damaged."""

NO_ROW = "delete the line if it is no row of the table, or begin it with #"
"""What helps against a line that is no row."""

_HEADER_WITHIN = 1000  # lines
_MOST_BYTES = 1 << 22  # in which the header is looked for
_COMPLETE = 3  # kinds of columns of a header that names all that is needed
_DIGIT = re.compile(rb"\d")
_UNIT = "|".join(map(re.escape, (unit for units in UNITS.values() for unit in units)))
_SPACED_UNIT = re.compile(rf"\s+([\[(])\s*({_UNIT})\s*([\])])", re.IGNORECASE)
_REMARK = re.compile(r"\s*\([^()]*\)?\s*$")
_ANY_UNIT = re.compile(r"[\[(][^\s,;()]*[\])]\s*$")
_LONGEST_QUOTE = 60
_BLANK = b' \t\r\n,;"'
# What a serial monitor writes before each line.
_MONITOR_TIME = re.compile(rb"^\d\d:\d\d:\d\d(?:\.\d+)? -> ")

# A semicolon goes first: a comma beside it is a decimal mark.
_SEPARATORS = (";", ",", "\t")


@dataclass(frozen=True)
class Header:
    """The names of the columns of a table.

    Attributes
    ----------
    columns
        What each column holds.
    separator
        What separates the columns. None for spaces.
    text
        The line itself, which is skipped where it is repeated. Empty without such a line.
    skipped
        How many lines of text stand before it.
    is_chosen
        Whether the columns are those of ``--columns``.
    """

    columns: tuple[Column, ...]
    separator: bytes | None
    text: bytes = b""
    skipped: int = 0
    is_chosen: bool = False

    @property
    def source(self) -> str:
        """What names the columns, in messages."""
        return "--columns" if self.is_chosen else "the header"


def split_header(
    lines: Iterator[tuple[int, bytes]],
    chosen: Sequence[str] = (),
    beams_deg: Sequence[float] = (),
) -> tuple[Header, Iterator[tuple[int, bytes]]]:
    """The header of a table, and the numbered lines after it.

    Parameters
    ----------
    lines
        The lines of the file with their numbers.
    chosen
        Names of the columns in place of those of the file, or nothing.
    beams_deg
        Directions of the robot's beams, deg, for the message about a table without a header.

    Returns
    -------
    tuple
        The header is the first line that names the time, an odometry and ranges, or else the line
        before the first row of numbers.

    Raises
    ------
    ValueError
        If there is neither a header nor a choice, or a choice is no list of columns.
    """
    lines = ((number, _MONITOR_TIME.sub(b"", line)) for number, line in lines)
    seen: list[tuple[int, bytes]] = []
    size = 0
    for number, line in lines:
        seen.append((number, line))
        size += len(line)
        if chosen:
            if _is_row(line, len(chosen)):
                return _chosen_header(seen, chosen), chain(seen[-1:], lines)
        elif completeness(_columns_in(line)) == _COMPLETE:
            return _header(seen), lines
        if number >= _HEADER_WITHIN or size > _MOST_BYTES:
            break
    if chosen:
        return _chosen_header(seen, chosen), chain(seen[1:], lines)
    return _incomplete_header(seen, lines, beams_deg)


def has_rows_of_numbers(lines: Iterable[tuple[int, bytes]]) -> bool:
    """Whether a text is a table: one of its first lines is a complete header, or a row of numbers.
    Lines of other logs begin with a word.
    """
    for number, line in lines:
        if number > _HEADER_WITHIN:
            return False
        if _is_row(line) or completeness(_columns_in(line)) == _COMPLETE:
            return True
    return False


class Rows:
    """The numbers of the rows read so far, in packed arrays.

    Parameters
    ----------
    header
        The names of the columns.
    needed
        Places of the columns that need a number in each row. The first is that of the time.
    optional
        Places of other columns that are used. They may be empty.
    ranges
        Places of all columns of ranges, used or not.
    """

    def __init__(
        self,
        header: Header,
        needed: Sequence[int],
        optional: Sequence[int],
        ranges: Sequence[int],
    ) -> None:
        self.header = header
        self.ranges = ranges
        self.needed = needed
        self.optional = optional
        self.values = array("d")
        self.lines = array("q")
        self.has_scan = bytearray()
        self.has_calendar = False
        self.damaged = 0
        self.is_cut = False
        self.first_damage = ""
        self.repeated = 0
        self.previous = b""

    def add(self, number: int, line: bytes) -> None:
        """Process one line after the header."""
        text = _text_of(line)
        if not text.strip() or text.startswith(b"#") or text == self.header.text:
            return
        if text == self.previous:
            self.repeated += 1
            return
        try:
            values, has_scan = self._values(text)
        except ValueError as error:
            self.is_cut = not line.endswith(b"\n")
            self.add_damage(f"line {number}: {error}, in {_quoted(text)}")
            return
        self.previous = text
        self.values.extend(values)
        self.has_scan.append(has_scan)
        self.lines.append(number)

    def add_damage(self, words: str, count: int = 1) -> None:
        """Count lines that cannot be used. The words are about the first of them."""
        self.first_damage = self.first_damage or words
        self.damaged += count

    def allows(self, more: int = 0) -> bool:
        """Whether the damaged lines, and so many more, may be left out. A last line that is cut
        does not count.
        """
        count = self.damaged + more
        lines = self.damaged + len(self.lines)
        return count - self.is_cut <= MOST_DAMAGED * lines and len(self.lines) > more

    def check(self) -> None:
        """Raise a ValueError that quotes the first damaged line if there are too many of them."""
        if not self.damaged or self.allows():
            return
        lines = self.damaged + len(self.lines)
        share = f"{self.damaged} of {counted(lines, 'line')} cannot be read as rows of the table"
        is_helped = not (self.lines or self.header.is_chosen)
        columns = "; or --columns names the columns in place of the header" if is_helped else ""
        raise ValueError(f"{self.first_damage}. {share}: {NO_ROW}{columns}")

    def arrays(self) -> tuple[FloatArray, BoolArray, NDArray[np.int64]]:
        """The numbers (n, needed and optional columns), whether each row has a scan (n,), and the
        numbers of the lines (n,).
        """
        width = len(self.needed) + len(self.optional)
        return (
            np.array(self.values).reshape(-1, width),
            np.frombuffer(self.has_scan, dtype=np.bool_),
            np.array(self.lines, dtype=np.int64),
        )

    def _values(self, text: bytes) -> tuple[list[float], bool]:
        """The numbers of a row, and whether it has a scan. Raises a ValueError if it is no row."""
        fields = self._fields_of(text)
        is_short = len(fields) < len(self.header.columns)
        silent = is_short or all(fields[place] == NO_SCAN for place in self.ranges)
        values = [self._seconds(fields[self.needed[0]])]
        values += [_finite(fields[place], self.header.columns[place]) for place in self.needed[1:]]
        if is_short:
            return values + [math.nan] * len(self.optional), False
        return values + [_reading(fields[place]) for place in self.optional], not silent

    def _fields_of(self, text: bytes) -> list[bytes]:
        """The fields of a row, without empty ones after its end. They are fewer than the columns
        where a mark stands once in place of the ranges.
        """
        fields = [field.strip() for field in text.split(self.header.separator)]
        if self.header.separator != b",":
            fields = [field.replace(b",", b".") for field in fields]
        count = len(self.header.columns)
        _trim(fields, count)
        first = min(self.ranges)
        if fields[-1] == NO_SCAN and max(self.needed) < len(fields) - 1 <= first:
            return fields
        if len(fields) == count:
            return fields
        # 0,1,0,031 has twice as many fields as numbers, or nearly so if some of them are whole.
        is_doubled = self.header.separator == b"," and 1.3 * count < len(fields) <= 2 * count
        hint = (
            ": if commas are decimal marks here, separate the columns by ; or tabs"
            if is_doubled
            else ""
        )
        names = "--columns names" if self.header.is_chosen else "the header names"
        raise ValueError(f"{counted(len(fields), 'column')} where {names} {count}{hint}")

    def _seconds(self, field: bytes) -> float:
        """The time in a field: a number, or a date and a time of the calendar, s."""
        if is_number(field):
            return _finite(field, self.header.columns[self.needed[0]])
        self.has_calendar = True
        return _calendar_seconds(field.decode("ascii", "replace"))


def _trim(fields: list[bytes], count: int) -> None:
    """Remove empty fields after the end of a row of ``count`` columns."""
    while not fields[-1] and (len(fields) > count or fields[-2:-1] == [NO_SCAN]):
        fields.pop()


def _calendar_seconds(text: str) -> float:
    """Seconds of a time like ``2026-11-28T14:03:05.25Z`` or ``14:03:05.25``. Raises a ValueError
    for another text.
    """
    date = "" if "-" in text.lstrip("-")[:8] or "/" in text else "1970-01-01T"
    try:
        found = datetime.fromisoformat(date + text.replace("/", "-"))
    except ValueError:
        raise ValueError(f"t is not a number: {text[:40]!r}") from None
    zero = datetime(1970, 1, 1, tzinfo=found.tzinfo)
    return (found - zero).total_seconds()


def _finite(field: bytes, column: Column) -> float:
    try:
        value = float(field)
    except ValueError:
        shown = field.decode("ascii", "replace")[:40]
        raise ValueError(f"{column.role} is not a number: {shown!r}") from None
    if not math.isfinite(value):
        raise ValueError(
            f"{column.role} is {field.decode('ascii', 'replace')[:40]}, not a finite number"
        )
    return value


def _reading(field: bytes) -> float:
    """A number that may be missing: NaN where the field is empty, or is a word such as ``null`` or
    ``out of range``.
    """
    try:
        return float(field or b"nan")
    except ValueError:
        if not _DIGIT.search(field):
            return math.nan
        shown = field.decode("ascii", "replace")[:40]
        raise ValueError(
            f"a range is not a number: {shown!r}; an empty field or nan is no reading"
        ) from None


def _names(line: bytes) -> tuple[list[str], bytes | None]:
    """Names of columns in a line, and the separator (None for spaces)."""
    text = _text_of(line).decode("utf-8", "replace")
    is_remark = text.startswith("#")
    text = _SPACED_UNIT.sub(r"\1\2\3", text.lstrip("#").strip(" "))
    if is_remark:
        text = text.partition(" (")[0]
    elif not _ANY_UNIT.search(text):
        text = _REMARK.sub("", text)
    separator = next((mark for mark in _SEPARATORS if mark in text), None)
    names = [name.strip() for name in text.rstrip(separator).split(separator)]
    if separator == "\t" and "" in names[1:]:  # of an index, the first name is empty
        separator = None
        names = text.split()
    return (names if text else []), separator.encode() if separator else None


def _columns_in(line: bytes) -> tuple[Column, ...]:
    """What the columns of a line hold, if it is a header. Empty for a line that is none, such as
    one of a CARMEN log, which has a number after its first word.
    """
    if any(is_number(word) for word in line.split(None, 3)[:3]):
        return ()
    names, _ = _names(line)
    return tuple(column_of(name) for name in names[:MOST_BEAMS] if name != DOTS)


def _header(seen: Sequence[tuple[int, bytes]]) -> Header:
    """The header in the last of these lines. Raises a ValueError that names the line."""
    number, line = seen[-1]
    names, separator = _names(line)
    try:
        columns = columns_of(names)
    except ValueError as error:
        raise ValueError(f"line {number}: {error}") from error
    return Header(columns, separator, _text_of(line), _count_of_text(seen[:-1]))


def _chosen_header(seen: Sequence[tuple[int, bytes]], chosen: Sequence[str]) -> Header:
    """The chosen columns, for a table whose first row is the last of these lines."""
    columns = columns_of(chosen)
    if not seen:
        return Header(columns, b",", is_chosen=True)
    separator = _separator_of_row(_text_of(seen[-1][1]), len(columns))
    before = _text_of(seen[-2][1]) if len(seen) > 1 else b""
    skipped = max(_count_of_text(seen[:-1]) - 1, 0)
    return Header(columns, separator, before, skipped, is_chosen=True)


def _incomplete_header(
    seen: list[tuple[int, bytes]],
    lines: Iterator[tuple[int, bytes]],
    beams_deg: Sequence[float],
) -> tuple[Header, Iterator[tuple[int, bytes]]]:
    """The line that is most like a header, for the message about what it lacks."""
    texts = [
        place
        for place, (_, line) in enumerate(seen)
        if _count_of_text([seen[place]]) or completeness(_columns_in(line)) > 1
    ]
    if not texts:
        raise ValueError("is empty: it has no header, such as t,left,right,r_90,r_0,...")
    rows = [place for place in texts if _is_row(seen[place][1])]
    first = rows[0] if rows else len(seen)
    before = [place for place in texts if place < first]
    if not before:
        text = _text_of(seen[first][1])
        count = len(text.split(_separator_of_row(text)))
        motion = "t,x,y,theta" if count == len(beams_deg) + 4 else "t,left,right"
        beams = [f",r_{round(degrees, 1):g}" for degrees in beams_deg]
        ranges = "".join(beams) or ",r_90" + ",-" * max(count - 4, 0)
        raise ValueError(
            f"line {seen[first][0]}: has no header for {counted(count, 'column')}: --columns "
            f"{motion}{ranges} names them, in the order of the file and with - for one that is not "
            "used"
        )
    counts = [completeness(_columns_in(seen[place][1])) for place in before]
    best = before[-1] if not any(counts) else before[counts.index(max(counts))]
    return _header(seen[: best + 1]), chain(seen[best + 1 :], lines)


def _is_row(line: bytes, count: int | None = None) -> bool:
    """Whether a line begins as a row does, with a number or a time, and has numbers in most of its
    fields, or has ``count`` fields.
    """
    text = _text_of(line)
    if not text.strip() or text.lstrip()[:1] not in b"+-.0123456789":
        return False
    separator = _separator_of_row(text, count)
    fields = [field.strip().replace(b",", b".") for field in text.split(separator)]
    numbers = [not field or field == NO_SCAN or is_number(field) for field in fields]
    if count is not None:
        _trim(fields, count)
        is_silent = len(fields) < count and fields[-1] == NO_SCAN
        if len(fields) != count and not is_silent:
            return False
    return len(fields) > 2 and sum(numbers) > 0.5 * len(fields)


def _text_of(line: bytes) -> bytes:
    """The text of a line without quotes. Tabs at its ends stay: they separate empty fields."""
    return line.strip(b" \r\n\v\f").replace(b'"', b"")


def _separator_of_row(text: bytes, count: int | None = None) -> bytes | None:
    """What separates the fields of a row; None for spaces, or tabs in any number."""
    separator = next((mark.encode() for mark in _SEPARATORS if mark.encode() in text), None)
    if separator == b"\t" and count not in (None, len(text.split(separator))):
        return None
    return separator


def _count_of_text(lines: Sequence[tuple[int, bytes]]) -> int:
    """How many of these lines are neither empty, separators included, nor remarks."""
    return sum(bool(line.strip(_BLANK)) and not line.startswith(b"#") for _, line in lines)


def _quoted(text: bytes) -> str:
    shown = text.decode("utf-8", "replace")
    return described(shown if len(shown) <= _LONGEST_QUOTE else f"{shown[:_LONGEST_QUOTE]}...")
