"""What a new user meets first: a floor plan by its seed, progress by coverage, and ``limslam warmup``."""

import os
import subprocess
import sys

import pytest
from support.command_line import limslam

import limslam_env  # noqa: F401 (registers the environments)
from limslam_agent.cli import warmup as warmup_module
from limslam_env import load_world


@pytest.mark.parametrize("name", ["random:x", "random:-1", "random:" + "9" * 5000])
def test_what_names_no_floor_plan_is_refused_in_a_short_line(name):
    with pytest.raises(ValueError, match="a seed is needed, as in random:17") as refusal:
        load_world(name)
    assert len(str(refusal.value)) < 200


def test_a_floor_plan_is_run_by_its_seed(tmp_path):
    code, out, _ = limslam("run", "--world", "random:17", "--max-time", 1, "--out", tmp_path / "run")
    assert code == 0
    assert "stopped" in out
    assert 'world = "random:17"' in (tmp_path / "run" / "run.toml").read_text()


def test_warming_up_says_what_it_does_and_ends_each_line(monkeypatch):
    done = []
    steps = {name: (seconds, lambda name=name: done.append(name)) for name, (seconds, _) in warmup_module.STEPS.items()}
    monkeypatch.setattr(warmup_module, "STEPS", steps)
    monkeypatch.setattr(warmup_module, "LAST", "no step")
    monkeypatch.setenv("LIMSLAM_QUIET", "")
    code, out, error = limslam("warmup")
    assert (code, error) == (0, "")
    assert done == ["simulator", "batch", "smoothers", "BatchSlam"]
    assert [line.split()[0] for line in out.splitlines()] == done
    assert all("up to about" in line and "done after" in line for line in out.splitlines())


@pytest.mark.parametrize("name", ["simulator", "batch", "smoothers", "BatchSlam"])
def test_each_step_of_the_warm_up_runs(name):
    warmup_module.STEPS[name][1]()


SLOW = """
from limslam_env import compilation
compilation._SECONDS["slow"] = 7
import kernels
print(kernels.slow(1), kernels.slow(2))
"""
KERNELS = """
from limslam_env.compilation import entry
@entry
def slow(x):
    return x + 1
"""


@pytest.mark.parametrize(("quiet", "first"), [("", "limslam: compiling 'slow', once, about 7 s\n"), ("1", "")])
def test_a_kernel_says_that_it_is_compiled_once_and_never_again(tmp_path, quiet, first):
    (tmp_path / "kernels.py").write_text(KERNELS)
    (tmp_path / "slow.py").write_text(SLOW)
    paths = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    environment = {**os.environ, "LIMSLAM_QUIET": quiet, "NUMBA_CACHE_DIR": str(tmp_path / "kept"), "PYTHONPATH": paths}
    for expected in (first, ""):
        result = subprocess.run(
            [sys.executable, str(tmp_path / "slow.py")], env=environment, capture_output=True, text=True, check=True
        )
        assert (result.stdout, result.stderr) == ("2 3\n", expected)
