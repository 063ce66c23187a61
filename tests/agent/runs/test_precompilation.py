"""The kernels of the smoother are compiled beside the first run, for the arguments that a smoothing has."""

import os
import subprocess
import sys

import numpy as np
import pytest

from limslam_agent.runs import precompilation
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.runs.smoothing import smooth_episode
from limslam_env import compilation

KERNEL = """from limslam_env.compilation import entry

@entry
def total(row, table, factor):
    return factor * row.sum() * (table.shape[0] - 1)
"""


def test_a_smoothing_calls_these_kernels_with_these_arguments():
    assert smooth_episode(run_episode(RunConfig("square", 0.02, max_time=20.0))) is not None
    for kernel, arguments in precompilation.kernels_of_smoother():
        assert tuple(compilation._type_of(word) for word in arguments.split()) in kernel.overloads, kernel.__name__


@pytest.mark.parametrize(("processors", "kept", "begins"), [(2, False, True), (1, False, False), (2, True, False)])
def test_a_second_process_begins_if_it_is_needed_and_ends_with_the_run(monkeypatch, capsys, processors, kept, begins):
    started = []
    popen = subprocess.Popen

    def sleep(*_, **options):
        started.append(popen([sys.executable, "-c", "import time; time.sleep(60)"], **options))
        return started[-1]

    monkeypatch.setenv("LIMSLAM_QUIET", "")
    monkeypatch.setattr(precompilation, "processors", lambda: processors)
    monkeypatch.setattr(compilation, "is_kept", lambda _: kept)
    monkeypatch.setattr(subprocess, "Popen", sleep)
    with pytest.raises(KeyboardInterrupt), precompilation.smoother_beside():
        raise KeyboardInterrupt
    assert len(started) == begins
    assert all(child.poll() is not None for child in started)
    assert ("a second process compiles the smoother" in capsys.readouterr().err) == begins


def test_a_run_goes_on_if_the_second_process_crashes_or_takes_too_long_or_cannot_begin(monkeypatch):
    monkeypatch.setattr(precompilation, "_LONGEST_WAIT", 0.1)
    for statements in ("raise SystemExit(1)", "import os; os.abort()", "import time; time.sleep(60)"):
        with precompilation.beside(statements) as wait:
            wait()
    monkeypatch.setattr(sys, "executable", "/there/is/no/interpreter")
    with precompilation.beside("print()") as wait:
        wait()


def test_the_second_process_compiles_what_a_run_looks_for_on_disk(monkeypatch, tmp_path):
    (tmp_path / "kernels_of_test.py").write_text(KERNEL)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    from kernels_of_test import total

    assert not compilation.is_kept(total)
    statements = "from limslam_env.compilation import compile_for; from kernels_of_test import total"
    with precompilation.beside(f"{statements}; compile_for(total, 'f1 F2 i')") as wait:
        wait()
    assert compilation.is_kept(total)
    assert total(np.ones(3), np.ones((2, 8))[:, ::2], 2) == 6.0
    assert sum(total.stats.cache_hits.values()) == 1
