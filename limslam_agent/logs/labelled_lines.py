"""Lines whose values have their names beside them, or stand in lists, as rows of a table.

A serial plotter takes ``left:12 right:13``, and programs write objects of JSON, one a line or all
in one list. The names become a header, and each line becomes a row of values. Programs also write a
whole scan into one field, as ``"[1.2, 0.8, 0.7]"``, which becomes as many columns.
"""

import json
import re
from collections.abc import Iterable, Iterator
from functools import partial
from typing import Any

from limslam_agent.logs.columns import SCALE_OF

_FEWEST = 3  # values in a line that has names beside them
_NAME = r"[^\W\d][^\s:=,;|{}\[\]]*"
_UNIT = rf"(?:\s+(?:{'|'.join(map(re.escape, SCALE_OF))})(?=[\s,;|]|$))?"
_VALUE = rf"[^\s:=,;|]*(?::\d[\d:.]*)?{_UNIT}"
_PAIR = re.compile(rf"\s*({_NAME})\s*[:=]\s*({_VALUE})\s*(?:[,;|]|\s|$)")
_ITEM = rb"[-+]?(?:[\d.][\d.eE+-]*|inf|nan|none|null)"
_LIST = re.compile(rb"[\[(]\s*(%b(?:[,;\s]+%b)+)[,;\s]*[\])]" % (_ITEM, _ITEM), re.IGNORECASE)
_AS_JSON = {"'": '"', "None": "null", "nan": "NaN", "inf": "Infinity"}
_PYTHON = re.compile(r"'|\b(?:None|nan|inf)\b")
_MARKS = (b";", b"\t", b",")
_JSON = re.compile(r"\s*\[?\s*\{")

MONITOR_TIME = re.compile(rb"^(\d\d:\d\d:\d\d(?:\.\d+)?) -> ")
"""What a serial monitor writes before each line."""

Line = tuple[int, bytes]
"""A line with its number, counted from 1."""


def unlabelled(lines: Iterable[Line]) -> Iterator[Line]:
    """The lines of a table, of which those with names beside their values become a header and rows
    that are separated by tabs. All others stay as they are.
    """
    names: list[str] = []
    first: dict[str, str] = {}
    number = 0
    for number, line in lines:
        records = _records(line) if b":" in line or b"=" in line else []
        if not records:
            yield number, line
        for record in records:
            if not first:
                first = record
                continue
            if not names:
                names = list(record)  # those of the first line may be cut
                yield number, _row(names)
                yield number, _row([first.get(name, "") for name in names])
            yield number, _row([record.get(name, "") for name in names])
    if first and not names:
        yield number, _row(first)
        yield number, _row(first.values())


def unpacked(lines: Iterable[Line]) -> Iterator[Line]:
    """The lines of a table, of which a list of numbers in brackets becomes as many fields. The line
    before the first one with a list is the header.
    """
    mark = b""
    before: Line = 0, b""
    for number, line in lines:
        text = line
        has_bracket = line[:1] != b"#" and (b"[" in line or b"(" in line)
        found = _LIST.search(line) if has_bracket else None
        if found and not mark:
            mark = next((each for each in _MARKS if each in before[1]), b",")
            names = before[1].strip().split(mark)
            place = _LIST.sub(b"", line[: found.start()]).count(mark)
            count = _fields(mark, found).count(mark) + 1
            if place < len(names):
                name = names[place].strip(b'" ')
                names[place : place + 1] = [name + b".%d" % index for index in range(count)]
                before = before[0], mark.join(names) + b"\n"
        if found:
            text = _LIST.sub(partial(_fields, mark), line)
        if before[0]:
            yield before
        before = number, text
    if before[0]:
        yield before


def _fields(mark: bytes, found: re.Match[bytes]) -> bytes:
    """The numbers of a list, separated by a mark."""
    return mark.join(re.split(rb"[,;\s]+", found[1].strip()))


def _row(fields: Iterable[str]) -> bytes:
    return "\t".join(fields).encode() + b"\n"


def _records(line: bytes) -> list[dict[str, str]]:
    """The values of a line by their names, for each record in it; none for another line."""
    if monitor := MONITOR_TIME.match(line):
        clock = {"monitor_time": monitor[1].decode()}
        return [record | clock for record in _records(line[monitor.end() :])]
    text = line.decode("utf-8", "replace").strip()
    if _JSON.match(text):
        return list(_objects(text.lstrip("[ \t")))
    record: dict[str, str] = {}
    end = 0
    while pair := _PAIR.match(text, end):
        record[pair[1]] = pair[2]
        end = pair.end()
    return [record] if end == len(text) and len(record) >= _FEWEST else []


def _objects(text: str) -> Iterator[dict[str, str]]:
    """The objects of JSON at the beginning of a text, which commas separate."""
    decoder = json.JSONDecoder()
    if "'" in text:  # as Python prints it
        text = _PYTHON.sub(lambda found: _AS_JSON[found[0]], text)
    while text.startswith("{"):
        try:
            found, end = decoder.raw_decode(text)
        except (ValueError, RecursionError):
            return
        yield dict(_flat("", found))
        text = text[end:].lstrip(", \t")


def _flat(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """The values in a part of an object, by names that are joined by dots."""
    parts = value.items() if isinstance(value, dict) else enumerate(value)
    for key, part in parts:
        path = f"{name}.{key}" if name else str(key)
        if isinstance(part, dict | list):
            yield from _flat(path, part)
        else:
            yield path, "" if part is None else str(part)
