"""What commands show on a terminal: warnings, tables, and a progress bar."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import typer

Advance = Callable[[float, str], None]
"""Told how much is done, and the state in words."""


@contextmanager
def progress_bar(task: str, total: float) -> Iterator[Advance]:
    """A progress bar on a terminal, and nothing elsewhere."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True, highlight=False)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[state]}"), TimeElapsedColumn())
    quiet = not console.is_terminal
    with Progress(*columns, console=console, transient=True, refresh_per_second=5, disable=quiet) as progress:
        bar = progress.add_task(task, total=total, state="")
        yield lambda done, state: progress.update(bar, completed=done, state=state)


def warn(warnings: Iterable[str]) -> None:
    """Print warnings on standard error, one line each."""
    # The package of the messages loads numpy, and `limslam --help` must not wait for that.
    from limslam_env.messages import printable

    for warning in warnings:
        typer.echo(printable(f"limslam: warning: {warning}"), err=True)


def print_table(rows: list[tuple[str, ...]]) -> None:
    """Print rows as aligned columns; plain, so that other programs can read them too."""
    from limslam_env.messages import printable

    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        line = "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        typer.echo(printable(line.rstrip()))
