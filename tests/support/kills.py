"""Processes that are killed at a chosen call to the file system."""

import os
import subprocess
import sys
from pathlib import Path

_PRELUDE = """
import os, signal

left = {number}
def deadly(function):
    def call(*arguments, **options):
        global left
        left -= 1
        if left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*arguments, **options)
    return call
for name in ("mkdir", "rmdir", "rename", "replace", "unlink", "fsync"):
    setattr(os, name, deadly(getattr(os, name)))
"""


def dies_at_call(number: int, code: str, cwd: Path) -> bool:
    """Run code that is killed just before its n-th change of the file system. Whether there was such a call."""
    program = _PRELUDE.format(number=number) + code
    ended = subprocess.run(
        [sys.executable, "-c", program], cwd=cwd, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode in {0, -9}, ended.stderr
    return ended.returncode == -9
