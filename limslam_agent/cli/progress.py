"""The progress bar, and the names of folders that no option names."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

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


def unused(path: Path) -> Path:
    """The path, or the first numbered path like it that does not exist."""
    candidates = [path, *(path.with_name(f"{path.name}-{number}") for number in range(2, 10_000))]
    return next(candidate for candidate in candidates if not candidate.exists())
