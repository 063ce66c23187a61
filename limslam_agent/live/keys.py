"""Single keys of the terminal, without waiting for them."""

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

KEYS = "p pauses and goes on, h drives home, Ctrl-C ends"
"""What the keys of a session are for."""

Keys = Callable[[], str]
"""Returns what was typed since its last call."""


@contextmanager
def typed_keys() -> Iterator[Keys | None]:
    """While the context is open, keys are read without Enter. None if nobody can type: standard
    input is no terminal, or another program has it.
    """
    if sys.stdin is None or not sys.stdin.isatty():
        yield None
        return
    if sys.platform == "win32":
        from msvcrt import getwch, kbhit

        def typed() -> str:
            found = ""
            while kbhit():
                found += getwch()
            return found

        yield typed
        return
    import termios
    import tty

    terminal = sys.stdin.fileno()

    def is_ours() -> bool:
        # Whoever asks a terminal for keys from the background is stopped, and so is the robot.
        with suppress(OSError):
            return os.tcgetpgrp(terminal) == os.getpgrp()
        return False

    def read() -> str:
        if is_ours() and select.select([terminal], [], [], 0.0)[0]:
            with suppress(OSError):  # the terminal may be closed
                return os.read(terminal, 100).decode(errors="ignore")
        return ""

    if not is_ours():
        yield None
        return
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)
    try:
        yield read
    finally:
        if is_ours():
            with suppress(termios.error):
                termios.tcsetattr(terminal, termios.TCSADRAIN, before)
