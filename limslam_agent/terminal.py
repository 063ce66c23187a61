"""What commands show on a terminal: warnings, tables, a progress bar, and errors."""

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from html import escape
from typing import NoReturn

import typer

INTERRUPTED = 130
"""Exit code of a command that Ctrl-C ended."""

_NOTEBOOK_PERIOD = 0.2  # s between two states of a bar

Advance = Callable[[float, str], None]
"""Told how much is done, and the state in words."""


def in_notebook() -> bool:
    """Whether this is the kernel of a notebook, which shows pictures."""
    return "ipykernel" in sys.modules


@contextmanager
def _notebook_bar(task: str, total: float) -> Iterator[Advance]:
    from IPython.display import display

    nothing = {"text/html": "", "text/plain": ""}
    # Its types are not there in all environments.
    bar = display(nothing, raw=True, display_id=True)  # type: ignore[no-untyped-call, unused-ignore]
    due = 0.0

    def show(done: float, state: str) -> None:
        nonlocal due
        if time.monotonic() < due:
            return
        due = time.monotonic() + _NOTEBOOK_PERIOD
        words = escape(f"{task}: {state}")
        html = f"<progress max='{total:g}' value='{done:g}'></progress> {words}"
        bar.update({"text/html": html, "text/plain": words}, raw=True)

    yield show
    bar.update(nothing, raw=True)


@contextmanager
def progress_bar(task: str, total: float) -> Iterator[Advance]:
    """A progress bar on a terminal and in a notebook, and nothing elsewhere."""
    if in_notebook():
        with _notebook_bar(task, total) as show:
            yield show
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True, highlight=False)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[state]}"),
        TimeElapsedColumn(),
    )
    quiet = not console.is_terminal
    with Progress(
        *columns, console=console, transient=True, refresh_per_second=5, disable=quiet
    ) as progress:
        bar = progress.add_task(task, total=total, state="")
        yield lambda done, state: progress.update(bar, completed=done, state=state)


def say(*lines: str, err: bool = False) -> None:
    """Print lines, which may hold texts of files and users."""
    # The package of the messages loads numpy, and `limslam --help` must not wait for that.
    from limslam_env.messages import printable

    for line in lines:
        # While a progress bar is shown, sys.stderr is what prints above it.
        typer.echo(printable(line), file=sys.stderr if err else None)


def warn(warnings: Iterable[str]) -> None:
    """Print warnings on standard error, one line each."""
    say(*(f"limslam: warning: {warning}" for warning in warnings), err=True)


def print_table(rows: list[tuple[str, ...]]) -> None:
    """Print rows as aligned columns; plain, so that other programs can read them too."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        line = "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        say(line.rstrip())


def run_command(
    app: typer.Typer,
    name: str,
    *,
    interrupted: str = "stopped",
    resource: str = "output",
    numbers: bool = False,
) -> NoReturn:
    """Run the command line of a program, and exit.

    An error that the user can correct gives exit code 2 and one line, which begins with the
    program's name, not a traceback. ``interrupted`` is said after Ctrl-C, and ``resource`` is what
    an error of the operating system without the name of a file is about. With ``numbers``, a number
    that cannot be computed with comes from the user. Otherwise it is a fault of the program, which
    ends with a traceback.
    """
    try:
        code = app(standalone_mode=False)
    except typer.TyperException as error:
        _fail(name, error.format_message())
    except (typer.Abort, KeyboardInterrupt):
        code = INTERRUPTED
    except ValueError as error:
        # All errors that the project raises itself are ValueErrors: worlds, logs, outputs,
        # settings.
        _fail(name, str(error))
    except OSError as error:
        _fail(name, f"{error.filename or resource}: {error.strerror or error}")
    except MemoryError as error:
        _fail(name, f"there is not enough memory for this{f': {error}' if str(error) else ''}")
    except ArithmeticError as error:
        if not numbers:
            raise
        _fail(name, f"a number is too large or too small to compute with: {error}")
    if code == INTERRUPTED:  # which typer itself returns after Ctrl-C
        typer.echo(f"{name}: {interrupted}", err=True)
    sys.exit(code if isinstance(code, int) else 0)


def _fail(name: str, message: str) -> NoReturn:
    if message:
        from limslam_env.messages import one_line

        typer.echo(f"{name}: {one_line(message)}", err=True)
    sys.exit(2)
