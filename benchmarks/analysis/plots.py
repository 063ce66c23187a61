"""All figures of a folder of results: the figures of the paper, and additional figures."""

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

from benchmarks.analysis.curve_figures import coverage_drawings, error_drawings, sweep_drawings
from benchmarks.analysis.figure_style import Drawing, save
from benchmarks.analysis.groups import groups
from benchmarks.analysis.map_figures import map_drawings
from benchmarks.analysis.method_figures import method_drawings
from benchmarks.suite.store import Row, read_jobs


def drawings(rows: Sequence[Row], folder: Path) -> Iterator[Drawing]:
    """All figures of the given rows and their series, one at a time.

    Raises
    ------
    ValueError
        If there are no rows, or a series is missing or damaged.
    """
    if not rows:
        raise ValueError(f"{folder}: no results: there is not one row to draw")
    parts = groups(rows)
    yield from chain(
        map_drawings(parts, folder),
        error_drawings(parts, folder),
        sweep_drawings(parts),
        coverage_drawings(parts, folder),
        method_drawings(parts),
    )


def plot(folder: Path, out: Path, *, svg: bool = False) -> list[Path]:
    """Draw the figures of a folder of results.

    Parameters
    ----------
    folder
        Folder of results.
    out
        Folder for the figures; created if it does not exist.
    svg
        Write SVG files beside the PNG files.

    Returns
    -------
    list of Path
        Paths of the written files; empty if there is nothing to draw because all runs failed.

    Raises
    ------
    ValueError
        If there are no rows, or a series is missing or damaged.
    """
    rows, written = read_jobs([folder]), list[Path]()
    for drawing in drawings(rows, folder):
        out.mkdir(parents=True, exist_ok=True)
        for ending in ("png", "svg") if svg else ("png",):
            path = out / f"{drawing.name}.{ending}"
            save(drawing, path)
            written.append(path)
    return written
