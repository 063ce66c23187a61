"""The examples, the README's code, and the exercise run without changes."""

import json
import re
import shlex
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from support.command_line import limslam
from support.markdown import ROOT, blocks, commands
from support.runs import result_of

from limslam_agent import preset, read_log, replay_log
from limslam_env import NominalNoise

EXAMPLES = Path(__file__).parents[2] / "examples"
EXAMPLE = EXAMPLES / "live_robot.py"
pytestmark = pytest.mark.skipif(
    not EXAMPLES.is_dir(), reason="the examples do not travel with the tests"
)
# Modules of the simulator, which a robot does not need.
SIMULATOR = {
    "pymunk",
    "pygame",
    "limslam_env.worlds.world",
    "limslam_env.simulation.simulation",
    "limslam_env.envs.env",
}


@pytest.fixture(scope="module")
def live_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("live") / "room"
    code = (
        "import runpy, sys\n"
        f"sys.argv = ['live_robot.py', '--steps', '230', '--out', {str(folder)!r}]\n"
        f"runpy.run_path({str(EXAMPLE)!r}, run_name='__main__')\n"
        f"print(sorted({SIMULATOR!r} & set(sys.modules)))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    return folder, result.stdout.splitlines()


def test_the_live_loop_maps_without_a_simulator(live_run):
    folder, (said, loaded) = live_run
    assert 150 < int(said.partition(" steps: ")[0]) <= 230
    assert loaded == "[]"
    assert {path.name for path in folder.iterdir()} == {
        "map.json",
        "map.pgm",
        "map.yaml",
        "map.png",
        "log.csv",
    }
    segments = np.array(json.loads((folder / "map.json").read_text())["segments"])
    lengths = np.hypot(segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1])
    # A room of 3 x 2 m.
    assert 4 <= len(segments) <= 6
    assert 1.0 < np.sort(lengths)[0] < np.sort(lengths)[-1] < 3.2


def test_its_log_can_be_replayed(live_run):
    log = read_log(live_run[0] / "log.csv", None, 1.58)
    assert len(log) > 150
    np.testing.assert_allclose(
        np.degrees(log.robot.beam_angles), [90.0, 45.0, 15.0, -15.0, -45.0, -90.0]
    )
    assert len(replay_log(log, preset("paper", NominalNoise(0.01))).segments) >= 3


def test_the_log_of_wheel_travel_is_replayed_by_the_command_of_its_page(tmp_path):
    page = EXAMPLES.parent / "docs" / "logs.md"
    command = next(
        words
        for block in blocks(page)
        for words in commands(block.text)
        if "wheel_log.csv" in str(words)
    )
    finished = limslam(*command[1:], "--out", tmp_path / "out", cwd=EXAMPLES.parent)
    assert (finished.returncode, finished.stderr) == (0, "")
    result = result_of(tmp_path / "out")
    assert result["config"]["robot"]["axle"] == 0.115
    assert result["record"]["driven_m"] == pytest.approx(5.7, abs=0.1)
    # An apartment of two parts with a triangular pillar and a door.
    assert 7 <= result["metrics"]["landmarks"] <= 11
    smoothed = np.loadtxt(tmp_path / "out" / "trajectory_smoothed.tum")
    # The drive was simulated. Its true end in the frame of its start is known.
    np.testing.assert_allclose(smoothed[-1, 1:3], [3.386, 1.206], atol=0.05)


README = ROOT / "README.md"


def texts(language):
    return [block.text for block in blocks(README) if block.language == language]


def test_the_python_example_explores_env1(capsys):
    (block,) = [block for block in blocks(README) if block.language == "python"]
    block.run_python({"__name__": "__main__"})
    share, seconds, walls = re.fullmatch(
        r"(\d+)% seen after (\d+) s, (\d+) walls", capsys.readouterr().out.strip()
    ).groups()
    assert int(share) >= 95
    assert int(seconds) < 600
    assert int(walls) >= 16


def test_the_two_commands_make_all_that_they_need():
    first, second = (text.strip() for text in texts("sh")[:2])
    for command, last in ((first, ".venv/bin/limslam"), (second, ".venv/bin/pytest")):
        steps = [shlex.split(step) for step in command.split("&&")]
        assert steps[0] == ["python3", "-m", "venv", ".venv"]
        assert steps[1][:2] == [".venv/bin/pip", "install"]
        assert steps[2][0] == last


def test_the_first_command_has_the_form_of_windows_too():
    """PowerShell and cmd read lines without shell tricks, one command each."""
    (block,) = texts("powershell")
    first = texts("sh")[0].strip().replace("python3 -m", "py -m")
    expected = re.sub(r"\.venv/bin/(\w+)", r".venv\\Scripts\\\1", first).split(" && ")
    assert block.strip().splitlines() == expected


def test_the_policy_of_the_exercise_is_filmed(tmp_path):
    example = ROOT / "examples" / "my_policy.py"
    if not example.is_file():
        pytest.skip("the examples do not travel with the tests: run them in a checkout")
    pytest.importorskip("moviepy")
    shutil.copy(example, tmp_path)
    (block,) = [each for each in blocks(ROOT / "docs" / "lab.md") if each.language == "sh"]
    (words,) = commands(block.text)
    done = limslam(*words[1:], "--max-time", "8", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert {"own", "own.mp4"} <= {path.name for path in tmp_path.iterdir()}


NEEDS = {
    "rl_sb3": ["stable_baselines3"],
    "rl_batch": ["stable_baselines3", "sb3_contrib"],
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
        pytest.skip(f'needs {", ".join(missing)}: pip install "limslam[rl]", or TorchRL on its own')
    few = ["--plans", "1"] if name in {"rl_batch", "rl_sb3", "rl_cleanrl"} else []
    few += ["--envs", "4"] if name == "rl_batch" else []
    command = [sys.executable, str(path), "--steps", "256", *few]
    result = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    said = re.search(r"^(\d+) steps: .*", result.stdout, re.MULTILINE)
    assert int(said[1]) >= 128
    if name == "rl_batch":
        assert said[0].endswith(": no episode has ended yet (needs about 2400 steps)")
    else:
        assert np.isfinite(float(re.search(r"(?:reward |: )(-?[\d.]+)", said[0])[1]))
    assert name not in {"rl_sb3", "rl_batch"} or "total_timesteps" in result.stdout
    if "--plans" in few:
        assert re.findall(r"^(\w+) +sees \d+% ", result.stdout, re.MULTILINE) == ["PPO", "frontier"]
