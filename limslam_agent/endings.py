"""Signals that ask a program to end: Ctrl-C, a termination, and a terminal or connection that is
closed.
"""

import os
import signal
import stat
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import NoReturn

_HANG_UP: int | None = getattr(signal, "SIGHUP", None)  # Windows has none
_FROM_OUTSIDE = [number for number in (signal.SIGTERM, _HANG_UP) if number is not None]


def end_cleanly() -> None:
    """Let a termination and a closed terminal run the clean-up code, as Ctrl-C does.

    They end the program with a SystemExit, whose code is that of a shell. Where a closed terminal
    is ignored, as ``nohup`` has it, it stays ignored.
    """
    for number in _FROM_OUTSIDE:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end)


def exit_code(number: int) -> int:
    """The exit code of a program that a signal has ended, as shells have it."""
    return 128 + number


def code_of(ending: KeyboardInterrupt | SystemExit) -> int:
    """The exit code of a program that ends by one of the exceptions of :func:`end_by`."""
    code = ending.code if isinstance(ending, SystemExit) else None
    return code if isinstance(code, int) else exit_code(signal.SIGINT)


def end_by(number: int) -> NoReturn:
    """End as a signal asks: by a KeyboardInterrupt after Ctrl-C, else by a SystemExit."""
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    sys.exit(exit_code(number))


@contextmanager
def noted_endings() -> Iterator[list[int]]:
    """While the context is open, the first signal that asks to end is only noted. A second Ctrl-C
    raises a KeyboardInterrupt. Threads other than the main one get no signals, and note none.

    Yields
    ------
    list
        The signal that has come, if there was one.
    """
    noted = list[int]()
    if threading.current_thread() is not threading.main_thread():
        yield noted
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, *_FROM_OUTSIDE)}

    def note(number: int, _: FrameType | None) -> None:
        noted.append(number)
        signal.signal(signal.SIGINT, before[signal.SIGINT])
        _prepare_for(number)

    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, note)
    try:
        yield noted
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) is note:
                signal.signal(number, handler)


def _end(number: int, _: FrameType | None) -> None:
    _prepare_for(number)
    end_by(number)


def _prepare_for(number: int) -> None:
    """Let nothing disturb the clean-up code after a signal: a termination is often followed by
    others, and a terminal that is closed cannot be written to.
    """
    if number in _FROM_OUTSIDE:
        for each in _FROM_OUTSIDE:
            signal.signal(each, lambda *_: None)
    if number == _HANG_UP:
        nothing = os.open(os.devnull, os.O_WRONLY)
        for stream in (1, 2):
            with suppress(OSError):  # it may be closed
                if stat.S_ISCHR(os.fstat(stream).st_mode):
                    os.dup2(nothing, stream)
        os.close(nothing)
