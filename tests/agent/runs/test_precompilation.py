"""A second process compiles kernels beside the first one."""

import sys

from limslam_agent.runs import precompilation


def test_a_run_goes_on_if_the_second_process_crashes_or_takes_too_long_or_cannot_begin(monkeypatch):
    monkeypatch.setattr(precompilation, "_LONGEST_WAIT", 0.1)
    for statements in ("raise SystemExit(1)", "import os; os.abort()", "import time; time.sleep(60)"):
        with precompilation.beside(statements) as wait:
            wait()
    monkeypatch.setattr(sys, "executable", "/there/is/no/interpreter")
    with precompilation.beside("print()") as wait:
        wait()
