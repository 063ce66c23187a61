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
from dataclasses import replace
from datetime import datetime
from itertools import chain, islice, zip_longest

import numpy as np
from numpy.typing import NDArray

from limslam_agent.logs.columns import SCALE_OF, Column, Role, column_of
from limslam_agent.logs.labelled_lines import MONITOR_TIME, Line
from limslam_agent.logs.recorded_log import MOST_BEAMS, is_number, parse_number, parse_range
from limslam_agent.logs.table_layout import DOTS, Header, Layout, columns_of, completeness
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
_UNIT = "|".join(map(re.escape, SCALE_OF))
_SPACED_UNIT = re.compile(rf"\s+([\[(])\s*({_UNIT})\s*([\])])", re.IGNORECASE)
_REMARK = re.compile(r"\s*\([^()]*\)?\s*$")
_ANY_UNIT = re.compile(r"[\[(][^\s,;()]*[\])]\s*$")
_LONGEST_QUOTE = 60
_WITH_UNIT = re.compile(rf"[-+]?[\d.,]+\s*({_UNIT})".encode())
_SHOW_UNITS = 20  # rows
_YEAR_LAST = re.compile(r"^(\d\d?)[./-](\d\d?)[./-](\d{4})")
_SHORT_HOUR = re.compile(r"(?<!\S)(?=\d:)")
_HALF_OF_DAY = re.compile(r"\s*([ap])m$", re.IGNORECASE)
_BLANK = b' \t\r\n,;"'

# A semicolon goes first: a comma beside it is a decimal mark.
_SEPARATORS = (b";", b"|", b",", b"\t")


def split_header(
    lines: Iterator[Line], chosen: Sequence[str] = (), beams_deg: Sequence[float] = ()
) -> tuple[Header, Iterator[Line]]:
    """The header of a table, and the lines after it.

    Parameters
    ----------
    lines
        The lines of the file.
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
    lines = ((number, MONITOR_TIME.sub(b"", line)) for number, line in lines)
    seen: list[Line] = []
    size = 0
    for number, line in lines:
        seen.append((number, line))
        size += len(line)
        if chosen:
            if _is_row(line, len(chosen)):
                return _chosen_header(seen, chosen), chain(seen[-1:], lines)
        elif _is_complete(line):
            return _header(seen), lines
        if number >= _HEADER_WITHIN or size > _MOST_BYTES:
            break
    if chosen:
        return _chosen_header(seen, chosen), chain(seen[1:], lines)
    last = _most_like_a_header(seen, beams_deg)
    return _header(seen[: last + 1]), chain(seen[last + 1 :], lines)


def with_units_of_cells(header: Header, lines: Iterator[Line]) -> tuple[Header, Iterator[Line]]:
    """The header with the units that stand beside the numbers of the first rows, and the lines."""
    first = list(islice(lines, _SHOW_UNITS))
    columns = list(header.columns)
    endings = [b""] * len(columns)
    for _, line in first:
        for place, field in enumerate(_text_of(line).split(header.separator)[: len(columns)]):
            found = _WITH_UNIT.fullmatch(field.strip())
            if found is None or endings[place]:
                continue
            endings[place] = found[1]
            column = columns[place]
            if column.unit is None:
                columns[place] = column_of(f"{column.name} [{found[1].decode()}]")
    if any(endings):
        header = replace(header, columns=tuple(columns), endings=tuple(endings))
    return header, chain(first, lines)


def has_rows_of_numbers(lines: Iterable[Line]) -> bool:
    """Whether a text is a table: one of its first lines is a complete header, or a row of numbers.
    Lines of other logs begin with a word.
    """
    for number, line in lines:
        if number > _HEADER_WITHIN:
            return False
        if _is_row(line) or _is_complete(line):
            return True
    return False


class Rows:
    """The numbers of the rows read so far, in packed arrays: those of the columns in ``layout``, of
    which the odometry needs a number in each row, and those of the chosen ranges at some places.
    With a ``rate`` of rows in a second, the first column is not in the text.
    """

    def __init__(
        self, header: Header, layout: Layout, ranges: Sequence[int], rate: float | None = None
    ) -> None:
        self.header = header
        self.layout = layout
        self.rate = rate
        self.needed = list(layout.motion.values())
        self.optional = [*layout.inertial.values(), *ranges]
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
            values = self._values(text)
        except ValueError as error:
            self.is_cut = not line.endswith(b"\n")
            shown = text.decode("utf-8", "replace")
            end = "..." if len(shown) > _LONGEST_QUOTE else ""
            quoted = described(f"{shown[:_LONGEST_QUOTE]}{end}")
            self.add_damage(f"line {number}: {error}, in {quoted}")
            return
        self.previous = text
        self.values.extend(values)
        self.lines.append(number)

    def add_damage(self, words: str, count: int = 1) -> None:
        """Count lines that cannot be used. The words are about the first of them."""
        self.first_damage = self.first_damage or words
        self.damaged += count

    def allows(self, more: int = 0) -> bool:
        """Whether the damaged lines, and so many more, may be left out. A last line that is cut
        does not count.
        """
        count = self.damaged + more - self.is_cut
        lines = self.damaged + len(self.lines)
        return count <= MOST_DAMAGED * lines and len(self.lines) > more

    def check(self) -> None:
        """Raise a ValueError that quotes the first damaged line if there are too many of them."""
        if not self.damaged or self.allows():
            return
        lines = counted(self.damaged + len(self.lines), "line")
        is_helped = not (self.lines or self.header.is_chosen)
        columns = "; or --columns names the columns in place of the header" if is_helped else ""
        raise ValueError(
            f"{self.first_damage}. {self.damaged} of {lines} cannot be read as rows of the table: "
            f"{NO_ROW}{columns}"
        )

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

    def _values(self, text: bytes) -> list[float]:
        """The numbers of a row. Raises a ValueError if it is no row."""
        fields = self._fields_of(text)
        columns = self.header.columns
        is_short = len(fields) < len(columns)
        time, *others = self.needed
        values = [self._seconds(fields[time])]
        if (part := self.layout.fraction) is not None:
            values[0] += parse_number(fields[part], Role.TIME) * SCALE_OF[columns[part].unit or "s"]
        values += [parse_number(fields[place], str(columns[place].role)) for place in others]
        if is_short:
            values += [math.nan] * len(self.optional)
        else:
            values += [_reading(fields[place]) for place in self.optional]
        is_silent = is_short or all(fields[place] == NO_SCAN for place in self.layout.ranges)
        self.has_scan.append(not is_silent)
        return values

    def _fields_of(self, text: bytes) -> list[bytes]:
        """The fields of a row, without empty ones after its end. They are fewer than the columns
        where a mark stands once in place of the ranges.
        """
        separator = self.header.separator
        fields = [field.strip() for field in text.split(separator)]
        if separator != b",":
            fields = [field.replace(b",", b".") for field in fields]
        if self.header.endings:
            pairs = zip_longest(fields, self.header.endings[: len(fields)], fillvalue=b"")
            fields = [field.removesuffix(ending).rstrip() for field, ending in pairs]
        if self.rate is not None:
            fields.insert(0, b"%f" % ((len(self.lines) + self.damaged) / self.rate))
        count = len(self.header.columns)
        _trim(fields, count)
        is_marked = max(self.needed) < len(fields) - 1 <= min(self.layout.ranges)
        if len(fields) == count or (fields[-1] == NO_SCAN and is_marked):
            return fields
        # 0,1,0,031 has twice as many fields as numbers, or nearly so if some of them are whole.
        is_doubled = separator == b"," and 1.3 * count < len(fields) <= 2 * count
        decimal = ": if commas are decimal marks here, separate the columns by ; or tabs"
        hint = decimal if is_doubled else ""
        names = f"{self.header.source} names {count}{hint}"
        raise ValueError(f"{counted(len(fields), 'column')} where {names}")

    def _seconds(self, field: bytes) -> float:
        """The time in a field, s: a number, or one of the calendar like ``2026-11-28T14:03:05.25Z``
        or ``14:03:05.25``.
        """
        if is_number(field):
            return parse_number(field, Role.TIME)
        text = field.decode("ascii", "replace")
        half = _HALF_OF_DAY.search(text)
        clock = _YEAR_LAST.sub(_iso_date, _HALF_OF_DAY.sub("", text)).replace("/", "-")
        clock = _SHORT_HOUR.sub("0", clock)
        date = "" if "-" in clock.lstrip("-")[:8] else "1970-01-01T"
        try:
            moment = datetime.fromisoformat(date + clock)
            if half is not None:
                moment = moment.replace(hour=moment.hour % 12 + 12 * (half[1] in "pP"))
        except ValueError:
            raise ValueError(
                f"t is not a number, and no time such as 2026-11-28 14:03:05.25: {described(text)}"
            ) from None
        self.has_calendar = True
        return (moment - datetime(1970, 1, 1, tzinfo=moment.tzinfo)).total_seconds()


def _iso_date(found: re.Match[str]) -> str:
    """A date with the year at its end, whose month stands before the day where it cannot be
    otherwise.
    """
    day, month, year = found.groups()
    if int(month) > 12:
        day, month = month, day
    return f"{year}-{month:0>2}-{day:0>2}"


def _trim(fields: list[bytes], count: int) -> None:
    """Remove empty fields after the end of a row of ``count`` columns."""
    while not fields[-1] and (len(fields) > count or fields[-2:-1] == [NO_SCAN]):
        fields.pop()


def _reading(field: bytes) -> float:
    """A number that may be missing: NaN where the field is empty, or is a word such as ``null`` or
    ``out of range``.
    """
    if not is_number(field) and not _DIGIT.search(field):
        return math.nan
    try:
        return parse_range(field, "a range")
    except ValueError as error:
        raise ValueError(f"{error}; an empty field or nan is no reading") from None


def _names(line: bytes) -> tuple[list[str], bytes | None]:
    """Names of columns in a line, and the separator (None for spaces)."""
    text = _text_of(line).decode("utf-8", "replace")
    is_remark = text.startswith("#")
    text = _SPACED_UNIT.sub(r"\1\2\3", text.lstrip("#").strip(" "))
    if is_remark:
        text = text.partition(" (")[0]
    elif not _ANY_UNIT.search(text):
        text = _REMARK.sub("", text)
    separator = _separator_of(text.encode())
    mark = None if separator is None else separator.decode()
    names = [name.strip() for name in text.rstrip(mark).split(mark)]
    if separator == b"\t" and "" in names[1:]:  # of an index, the first name is empty
        return text.split(), None
    return (names if text else []), separator


def _columns_in(line: bytes) -> list[Column]:
    """What the columns of a line hold, if it is a header. Empty for a line that is none, such as
    one of a CARMEN log, which has a number after its first word.
    """
    if any(is_number(word) for word in line.split(None, 3)[:3]):
        return []
    names, _ = _names(line)
    return [column_of(name) for name in names[:MOST_BEAMS] if name != DOTS]


def _is_complete(line: bytes) -> bool:
    """Whether a line is a header that names all that is needed."""
    return completeness(_columns_in(line)) == _COMPLETE


def _header(seen: Sequence[Line]) -> Header:
    """The header in the last of these lines. Raises a ValueError that names the line."""
    number, line = seen[-1]
    names, separator = _names(line)
    try:
        columns = columns_of(names)
    except ValueError as error:
        raise ValueError(f"line {number}: {error}") from error
    return Header(columns, separator, _text_of(line), _count_of_text(seen[:-1]))


def _chosen_header(seen: Sequence[Line], chosen: Sequence[str]) -> Header:
    """The chosen columns, for a table whose first row is the last of these lines."""
    columns = columns_of(chosen)
    *before, row = [_text_of(line) for _, line in seen] or [b","]
    skipped = max(_count_of_text(seen[:-1]) - 1, 0)
    header = before[-1] if before else b""
    separator = _separator_of(row, len(columns))
    return Header(columns, separator, header, skipped, is_chosen=True)


def _most_like_a_header(seen: list[Line], beams_deg: Sequence[float]) -> int:
    """The place of the line that is most like a header, for the message about what it lacks."""
    counts = [completeness(_columns_in(line)) for _, line in seen]
    texts = [
        place for place, line in enumerate(seen) if _count_of_text([line]) or counts[place] > 1
    ]
    if not texts:
        raise ValueError("is empty: it has no header, such as t,left,right,r_90,r_0,...")
    first = next((place for place in texts if _is_row(seen[place][1])), len(seen))
    before = [place for place in texts if place < first]
    if before:
        most = max(counts[place] for place in before)
        return next(place for place in before if counts[place] == most) if most else before[-1]
    number, line = seen[first]
    text = _text_of(line)
    count = len(text.split(_separator_of(text)))
    motion = "t,x,y,theta" if count == len(beams_deg) + 4 else "t,left,right"
    beams = "".join(f",r_{round(degrees, 1):g}" for degrees in beams_deg)
    ranges = beams or ",r_90" + ",-" * max(count - 4, 0)
    raise ValueError(
        f"line {number}: has no header for {counted(count, 'column')}: --columns {motion}{ranges} "
        "names them, in the order of the file and with - for one that is not used"
    )


def _is_row(line: bytes, count: int | None = None) -> bool:
    """Whether a line begins as a row does, with a number or a time, and has numbers in most of its
    fields, or has ``count`` fields.
    """
    text = _text_of(line)
    if not text.strip() or text.lstrip()[:1] not in b"+-.0123456789":
        return False
    fields = [field.strip().replace(b",", b".") for field in text.split(_separator_of(text, count))]
    numbers = [not field or field == NO_SCAN or is_number(field) for field in fields]
    if count is not None:
        _trim(fields, count)
        if len(fields) > count or (len(fields) < count and fields[-1] != NO_SCAN):
            return False
    return len(fields) > 2 and sum(numbers) > 0.5 * len(fields)


def _text_of(line: bytes) -> bytes:
    """The text of a line without quotes. Tabs at its ends stay: they separate empty fields."""
    return line.strip(b" \r\n\v\f").replace(b'"', b"")


def _separator_of(text: bytes, count: int | None = None) -> bytes | None:
    """What separates the fields of a line; None for spaces, or tabs in any number."""
    separator = next((mark for mark in _SEPARATORS if mark in text), None)
    if separator == b"\t" and count not in (None, len(text.split(separator))):
        return None
    return separator


def _count_of_text(lines: Sequence[Line]) -> int:
    """How many of these lines are neither empty, separators included, nor remarks."""
    return sum(bool(line.strip(_BLANK)) and not line.startswith(b"#") for _, line in lines)
