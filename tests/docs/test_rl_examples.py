"""The examples for RL libraries run for a few hundred steps, where those libraries are."""

import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
pytestmark = pytest.mark.skipif(not EXAMPLES.is_dir(), reason="the examples do not travel with the tests")

NEEDS = {
    "rl_sb3": ["stable_baselines3"],
    "rl_batch": ["stable_baselines3"],
    "rl_recurrent": ["sb3_contrib"],
    "rl_two_robots": ["stable_baselines3", "supersuit"],
    "rl_cleanrl": ["torch"],
    "rl_torchrl": ["torchrl"],
}


def test_no_example_is_left_out():
    assert {path.stem for path in EXAMPLES.glob("rl_*.py")} == set(NEEDS)


@pytest.mark.parametrize("name", NEEDS)
def test_it_learns_for_some_steps(name, tmp_path):
    path = EXAMPLES / f"{name}.py"
    if missing := [library for library in NEEDS[name] if find_spec(library) is None]:
        pytest.skip(f"needs {', '.join(missing)}: pip install 'limslam[rl]', or TorchRL on its own")
    few = {"rl_batch": ["--envs", "4", "--plans", "1"], "rl_sb3": ["--plans", "1"]}.get(name, [])
    command = [sys.executable, str(path), "--steps", "256", *few]
    result = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    said = re.search(r"^(\d+) steps: .*", result.stdout, re.MULTILINE)
    assert int(said[1]) >= 128
    if name == "rl_batch":
        assert said[0].endswith(": no episode has ended yet (needs about 2400 steps)")
    else:
        assert np.isfinite(float(re.search(r"(?:reward |: )(-?[\d.]+)", said[0])[1]))
    if name in {"rl_sb3", "rl_batch"}:
        assert "total_timesteps" in result.stdout, "no progress is printed"
        assert re.findall(r"^(\w+) +sees \d+% ", result.stdout, re.MULTILINE) == ["PPO", "frontier"]
