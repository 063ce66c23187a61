"""The scoreboard: what is missing is measured, and the figures are kept in one file."""

import ast
import io
import json
import os
import platform
import tokenize
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

import limslam_agent
from benchmarks.scoreboard.compare import Cell
from benchmarks.scoreboard.measure import measure
from benchmarks.scoreboard.rows import Row, Rows
from benchmarks.scoreboard.scores import RIGHT
from benchmarks.suite.jobs import Suite, digest
from benchmarks.suite.runner import Summary, data_folder, run_suite
from benchmarks.suite.store import read_rows
from limslam_agent.measurements.processes import Processes
from limslam_agent.measurements.statistics import MISSING, number
from limslam_agent.output.atomic_write import replace_content
from limslam_agent.output.provenance import commit
from limslam_agent.safe_files import read_limited
from limslam_agent.status.chance import LIMIT

FILE = "scoreboard.json"
_MAX_BYTES = 10_000_000
_DIGITS = 5
_BRACKETS = frozenset("()[]{},")
_LAYOUT = frozenset(
    {
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENDMARKER,
    }
)

ESTIMATOR = (
    "slam",
    "places",
    "status",
    "kernels",
    "mapping",
    "replay",
    "logs",
    "two_logs",
    "grid",
    "config",
    "belief.py",
    "readings.py",
    "dropouts.py",
)
"""The folders and files of the estimation side, in ``limslam_agent``. What does not exist is left
out.
"""

Board = dict[str, Any]
"""``provenance``, ``size`` and ``cells``, as in the file."""


def run_scoreboard(
    rows: Rows,
    patterns: Sequence[str],
    folder: Path,
    processes: Processes,
    *,
    unused: bool = False,
    retry_failed: bool = False,
) -> tuple[Board, Summary, list[str]]:
    """Measure the cells that have no result in a folder yet, and write ``scoreboard.json`` there.

    Of the rows, those are measured whose names match one of the patterns, or all if there are none.
    ``unused`` takes the seeds of figures that are published.

    Returns
    -------
    board, summary, skipped
        All figures in the folder, the summary of this execution, and the names of rows whose data
        are absent.

    Raises
    ------
    ValueError
        If a pattern matches nothing, or the folder holds results of another estimator or of other
        rows.
    """
    chosen = rows.chosen(patterns)
    has_data = data_folder().is_dir()
    skipped = [row.name for row in chosen if row.needs_data and not has_data]
    by_name = {row.name: row for row in rows.row}
    first = rows.unused_seed if unused else rows.tuning_seed
    jobs = [job for row in chosen if row.name not in skipped for job in row.cells(first)]
    known = digest([[asdict(row) for row in rows.row], first, digest_of(estimator_files())])
    suite = Suite("scoreboard", tuple(jobs), known)
    work = partial(measure, by_name)
    summary = run_suite(suite, folder, processes, work=work, retry_failed=retry_failed)
    board = board_of(folder, by_name, first)
    replace_content(folder / FILE, written(board))
    return board, summary, skipped


def board_of(folder: Path, rows: Mapping[str, Row], first_seed: int) -> Board:
    """The figures in a folder of results, in the order of the rows."""
    order = {name: number for number, name in enumerate(rows)}
    cells = []
    for result in sorted(read_rows(folder), key=lambda each: (order[each.policy], each.seed)):
        about = {"row": result.policy, "world": result.world, "seed": result.seed}
        error = {} if result.error is None else {"error": result.error}
        figures = {
            name: float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value
            for name, value in {**result.metrics, **result.cost}.items()
        }
        cells.append({**about, **error, **figures})
    provenance = {
        "commit": commit(),
        "python": platform.python_version(),
        "processors": os.cpu_count(),
        "first_seed": first_seed,
    }
    return {"provenance": provenance, "size": size_of(estimator_files()), "cells": cells}


def written(board: Board) -> bytes:
    """The content of a file, with a line for each cell."""
    cells = ",\n".join(json.dumps(cell, allow_nan=False) for cell in board["cells"])
    head = ",\n".join(
        f"{json.dumps(name)}: {json.dumps(board[name])}" for name in ("provenance", "size")
    )
    return f'{{{head},\n"cells": [\n{cells}\n]}}\n'.encode()


def read_board(path: Path) -> Board:
    """Read a scoreboard, by its file or by the folder of its results."""
    path = path / FILE if path.is_dir() else path
    try:
        board: Board = json.loads(read_limited(path, _MAX_BYTES))
        cells = [
            {**cell, **{name: cell[name] for name in ("row", "world", "seed")}}
            for cell in board["cells"]
        ]
        return {"provenance": board["provenance"], "size": board["size"], "cells": cells}
    except OSError as error:
        raise ValueError(f"{path}: no scoreboard there: {error.strerror or error}") from error
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise ValueError(f"{path}: is no scoreboard: {error}") from error


def table(board: Board) -> list[str]:
    """The lines of a scoreboard: the size of the estimator, and a line for each row, in
    Markdown.
    """
    names = dict.fromkeys(str(cell["row"]) for cell in board["cells"])
    rows = [_line(name, [cell for cell in board["cells"] if cell["row"] == name]) for name in names]
    size = ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in board["size"].items())
    ok, off = (sum(_values(board["cells"], each)) for each in ("ok_s", "off_ok_s"))
    share = f", of which {off / ok:.1%} off" if ok else ""
    return [
        f"estimator: {size}",
        f"status: {ok:.0f} s with a stated chance below {LIMIT:.0%}{share}",
        "",
        f"| row | n | {' | '.join(heading for heading, _ in _COLUMNS)} |",
        f"|{'---|' * (len(_COLUMNS) + 2)}",
        *rows,
    ]


def _line(name: str, all_cells: Sequence[Cell]) -> str:
    cells = [cell for cell in all_cells if "error" not in cell]
    failed = len(all_cells) - len(cells)
    count = f"{len(cells)} ({failed} failed)" if failed else str(len(cells))
    return f"| {' | '.join([name, count, *(text(cells) for _, text in _COLUMNS)])} |"


Text = Callable[[Sequence[Cell]], str]
"""The text of a column for the cells of a row."""


def _values(cells: Sequence[Cell], name: str) -> list[float]:
    return [float(cell[name]) for cell in cells if cell.get(name) is not None]


def _median(cells: Sequence[Cell], name: str, digits: int) -> str:
    values = _values(cells, name)
    return number(float(np.median(values)), digits) if values else MISSING


def _medians(digits: int, *names: str) -> Text:
    return lambda cells: " / ".join(_median(cells, name, digits) for name in names)


def _spread(name: str) -> Text:
    """The median and the worst, m."""

    def text(cells: Sequence[Cell]) -> str:
        values = _values(cells, name)
        return f"{np.median(values):.3f} ({max(values):.3f})" if values else MISSING

    return text


def _total(cells: Sequence[Cell], name: str, of: Callable[[list[float]], float] = sum) -> str:
    values = _values(cells, name)
    return f"{of(values):.0f}" if values else MISSING


def _wrong(cells: Sequence[Cell]) -> str:
    longest = _total(cells, "longest_wrong_ok_s", max)
    return f"{_total(cells, 'wrong_ok_s')} ({longest}, {_total(cells, 'wrong_ok_end')})"


def _statuses(cells: Sequence[Cell]) -> str:
    statuses = [cell.get("status") for cell in cells]
    counts = [
        f"{statuses.count(each)} {each}" for each in ("ok", "unsure", "lost") if each in statuses
    ]
    placed = [cell["placed"] for cell in cells if "placed" in cell]
    return ", ".join(counts) + (f", {sum(placed)} of {len(placed)} placed" if placed else "")


def _rights(cells: Sequence[Cell]) -> str:
    right = [each for each in cells if _is_right(each)]
    return f"{len(right)} ({sum(each.get('status') == 'ok' for each in right)})"


def _is_right(cell: Cell) -> bool:
    """Whether the best path of a cell is right, after alignment."""
    paths = ("ate_smoothed_aligned_m", "ate_aligned_m")
    errors = [cell[name] for name in paths if cell.get(name) is not None]
    return bool(errors) and errors[0] < RIGHT


_COLUMNS: tuple[tuple[str, Text], ...] = (
    ("filter ATE m", _spread("ate_m")),
    ("aligned", _spread("ate_aligned_m")),
    ("smoothed ATE m", _spread("ate_smoothed_m")),
    ("aligned", _spread("ate_smoothed_aligned_m")),
    ("NEES/3 filter / smoothed", _medians(1, "nees", "nees_smoothed")),
    ("F1 / faces 5 cm", _medians(2, "f1_5cm", "faces_5cm")),
    ("wrong and ok s (longest, at the end)", _wrong),
    ("false alarms s", lambda cells: _total(cells, "false_alarm_s")),
    ("status", _statuses),
    ("right (ok)", _rights),
    ("CPU s drive / smoothing", _medians(1, "drive_cpu_s", "smoothing_cpu_s")),
)


def estimator_files() -> list[Path]:
    """The files of the estimator of the package that is imported."""
    found = (Path(limslam_agent.__file__).parent / name for name in ESTIMATOR)
    return sorted(
        file
        for path in found
        for file in ([path] if path.suffix else path.rglob("*.py"))
        if file.is_file()
    )


def size_of(files: list[Path]) -> dict[str, int]:
    """Tokens of code, lines, files, and assignments at module level whose value has a number in
    it.
    """
    texts = [file.read_text(encoding="utf-8") for file in files]
    nodes = [node for text in texts for node in ast.parse(text).body]
    constants = sum(
        _has_number(node.value) for node in nodes if isinstance(node, ast.Assign | ast.AnnAssign)
    )
    return {
        "tokens": sum(code_tokens(text) for text in texts),
        "lines": sum(len(text.splitlines()) for text in texts),
        "files": len(files),
        "constants": constants,
    }


def code_tokens(text: str) -> int:
    """The number of tokens of a source, without comments, docstrings, imports, brackets and commas,
    so that neither its layout nor its explanations count.
    """
    left_out = {
        line
        for node in ast.walk(ast.parse(text))
        if _is_import(node) or _is_text(node)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    return sum(
        token.type not in _LAYOUT
        and token.start[0] not in left_out
        and token.string not in _BRACKETS
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
    )


def _is_import(node: ast.AST) -> TypeGuard[ast.stmt]:
    return isinstance(node, ast.Import | ast.ImportFrom)


def _is_text(node: ast.AST) -> TypeGuard[ast.stmt]:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def digest_of(files: list[Path]) -> str:
    """Digest of the content of files: 16 hexadecimal digits."""
    return sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def _has_number(value: ast.expr | None) -> bool:
    return value is not None and any(
        isinstance(node, ast.Constant) and type(node.value) in {int, float}
        for node in ast.walk(value)
    )
