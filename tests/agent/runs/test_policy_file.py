"""A policy from a file that the user names drives a run; what cannot be is refused in one line with
its place.
"""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from support.command_line import limslam, told
from support.runs import result_of

GOOD = '''
import dataclasses
import numpy as np

@dataclasses.dataclass
class Ahead:
    """Drives ahead and stops after some steps."""
    left: int = 8
    stop_reason: str | None = None
    def __post_init__(self):
        self.plan = np.zeros((0, 2))
    def act(self, belief):
        self.left -= 1
        if self.left == 0:
            self.stop_reason = "enough"
        return np.array([0.5, 0.4])

def random_ahead(robot, seed):
    assert robot.max_wheel_speed > 0.0
    return Ahead(left=int(seed.integers(5, 9)))

class Divides(Ahead):
    def act(self, belief):
        return self.left / (self.left - self.left)

class Says(Ahead):
    def act(self, belief):
        return "left"

class Needs(Ahead):
    def __init__(self, speed):
        pass

class Raises(Ahead):
    def __init__(self):
        raise KeyError("boom")

class Listener:
    def act(self, observation):
        return 0.0, 0.0

class Two(Ahead):
    def act(self, belief, info):
        return 0.0, 0.0

class Mute(Ahead):
    class Error(Exception):
        def __str__(self):
            raise self
    def act(self, belief):
        raise self.Error

class Half:
    def act(self, belief):
        return 0.0, 0.0

number = 3
'''
EXAMPLE = Path(__file__).parents[3] / "examples" / "my_policy.py"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(GOOD)
    (tmp_path / "wrong.py").write_text("import math\ndef f(:\n")
    (tmp_path / "lacks.py").write_text("import math\nimport no_such_module\n")
    return tmp_path


def test_a_policy_of_a_file_gets_everything_that_a_run_gets(folder):
    done = told(
        "run", "--policy", "mine.py:Ahead", "--out", "first", "--video", "first.gif", "--seed", "4"
    )
    assert "stopped     enough" in done
    assert (folder / "first" / "map.png").is_file()
    assert (folder / "first.gif").is_file()
    result = result_of(folder / "first")
    assert (result["config"]["policy"], result["record"]["steps"]) == ("mine.py:Ahead", 8)
    assert "mine.py:Ahead" in limslam("show", "first", "--out", "sheet.png").stdout.splitlines()[0]


def test_the_folder_of_such_a_run_repeats_it_elsewhere(folder):
    told("run", "--policy", folder / "mine.py:random_ahead", "--out", "first")
    (folder / "mine.py").unlink()
    (folder / "first").rename(folder / "handed out")
    assert (
        tomllib.loads((folder / "handed out" / "run.toml").read_text())["policy"]
        == "mine.py:random_ahead"
    )
    told("run", "--config", folder / "handed out" / "run.toml", "--out", "second")
    one, other = (
        Path(name, "trajectory_true.tum").read_bytes() for name in ("handed out", "second")
    )
    assert one == other


def test_what_a_policy_imports_from_its_folder_is_kept_with_the_run(folder):
    (folder / "unused.py").write_text("")
    (folder / "gains_of_a_test.py").write_text("LEFT = 0.5\n")
    (folder / "parts_of_a_test").mkdir()
    (folder / "parts_of_a_test" / "right.py").write_text("RIGHT = 0.4\n")
    (folder / "mine.py").write_text(
        GOOD.replace(
            "return np.array([0.5, 0.4])",
            "from parts_of_a_test.right import RIGHT\n        return np.array([LEFT, RIGHT])",
        )
        + "from gains_of_a_test import LEFT\n"
    )
    words = [sys.executable, "-m", "limslam_agent", "run"]
    subprocess.run([*words, "--policy", "mine.py:Ahead", "--out", "first"], check=True)
    (folder / "elsewhere").mkdir()
    (folder / "first").rename(folder / "elsewhere" / "first")
    (folder / "gains_of_a_test.py").unlink()
    kept = {path.name for path in (folder / "elsewhere" / "first").rglob("*.py")}
    assert kept == {"mine.py", "gains_of_a_test.py", "right.py"}
    again = [*words, "--config", "first/run.toml", "--out", "second"]
    subprocess.run(again, check=True, cwd=folder / "elsewhere")
    one, other = (
        (folder / "elsewhere" / name / "trajectory_true.tum").read_bytes()
        for name in ("first", "second")
    )
    assert one == other


BAD = {
    "exits": ("import sys\nsys.exit(0)\n", "line 2: SystemExit: 0"),
    "hard": ("class Hard(BaseException): pass\nraise Hard('x')\n", "line 2: Hard: x"),
    "parses": ("import argparse\nargparse.ArgumentParser().error('x')\n", "line 2: SystemExit: 2"),
    "moves": ("import os\nos.chdir('/')\n" + GOOD, "has changed the working folder"),
    "moves_late": (
        GOOD.replace("self.left -= 1", "self.left -= 1; import os; os.chdir('/')"),
        "has changed the working folder",
    ),
    "exits_late": (GOOD.replace("self.left -= 1", "raise SystemExit"), "in act: SystemExit"),
    "property": (
        "class Ahead:\n    @property\n    def act(self): raise RuntimeError('x')\n",
        "line 3, in act: RuntimeError: x",
    ),
    "plan": (
        GOOD + "Ahead.plan = property(lambda self: 1 / 0, lambda self, value: None)\n",
        "ZeroDivisionError",
    ),
    "zero": ("a = 1\0", "null bytes"),
    "wide": ("class Ahead: pass".encode("utf-16"), "SyntaxError"),
    "sibling": ("import wrong\n", "line 1: SyntaxError"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_would_end_the_program_is_refused_in_one_line(name, folder):
    content, words = BAD[name]
    content = content if isinstance(content, bytes) else content.encode()
    (folder / f"{name}.py").write_bytes(content)
    done = limslam("run", "--policy", f"{name}.py:Ahead", "--max-time", "2", "--out", "out")
    assert done.returncode == 2, done
    last = done.stderr.splitlines()[-1]
    assert last.startswith(f"limslam: {name}.py")
    assert words in last
    assert Path.cwd() == folder
    assert [path.name for path in folder.iterdir() if "out" in path.name] == []


@pytest.mark.parametrize(
    ("policy", "words"),
    [
        ("nix.py:Ahead", "nix.py: no such file"),
        ("mine.py:Nobody", "mine.py: has no class and no function Nobody"),
        (
            "mine.py:Listener",
            "mine.py: Listener makes no policy: a policy has act(belief), stop_reason and plan",
        ),
        (
            "mine.py:Needs",
            "mine.py: Needs needs the argument speed: a policy is made without arguments",
        ),
        ("mine.py:Divides", "mine.py, line 24, in act: ZeroDivisionError: division by zero"),
        ("mine.py:Two", "mine.py: Two makes no policy: a policy has act(belief)"),
        ("mine.py:Mute", "mine.py, line 51, in act: Error"),
        ("mine.py:Says", "Says: act must return two finite numbers"),
        ("wrong.py:f", "wrong.py, line 2: SyntaxError"),
    ],
)
def test_what_cannot_drive_is_refused_in_one_line(policy, words, folder):
    done = limslam("run", "--policy", policy, "--max-time", "2", "--out", "out")
    assert done.returncode == 2
    last = done.stderr.splitlines()[-1]
    assert last.startswith(f"limslam: {words}")
    assert not (folder / "out").exists()


def test_the_example_drives(tmp_path):
    if not EXAMPLE.is_file():
        pytest.skip("the examples do not travel with the tests: run them in a checkout")
    told("run", "--policy", f"{EXAMPLE}:TurnFromWalls", "--max-time", "5", cwd=tmp_path)
    assert len(list((tmp_path / "runs").glob("*TurnFromWalls/map.png"))) == 1
