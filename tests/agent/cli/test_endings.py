"""Runs that are ended by Ctrl-C, a termination, or a terminal that is closed."""

import signal
import subprocess
import sys

import numpy as np
import pytest
from support.command_line import limslam
from support.runs import result_of

from limslam_agent import read_log
from limslam_agent.output.tum import read_tum

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals")

POLICY = """
import signal
import numpy as np

class Drives:
    stop_reason, plan, count = None, np.zeros((0, 2)), 0

    def act(self, belief):
        self.count += 1
        if self.count == {step}:
            for number in {numbers}:
                signal.raise_signal(number)
        return np.array([0.5, 0.4])
"""


def ended(tmp_path, *options, step, numbers, ignored=None):
    """A run whose policy raises signals in a step: its process, and its folder."""
    policy = tmp_path / "mine.py"
    folder = tmp_path / "run"
    policy.write_text(POLICY.format(step=step, numbers=[int(number) for number in numbers]))
    told = ["--policy", f"{policy}:Drives", "--preset", "consistent", "--world", "square"]
    command = [sys.executable, "-m", "limslam_agent", "run", *told, "--out", folder, *options]
    finished = subprocess.run(
        [*map(str, command)],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=None if ignored is None else lambda: signal.signal(ignored, signal.SIG_IGN),
    )
    assert "Traceback" not in finished.stderr
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []
    return finished, folder


@pytest.mark.parametrize(
    ("numbers", "code"),
    [
        ([signal.SIGINT], 130),
        ([signal.SIGHUP, signal.SIGHUP, signal.SIGTERM], 129),  # as a shell that is closed sends
        ([signal.SIGTERM, signal.SIGTERM], 143),
    ],
)
def test_an_interrupted_run_keeps_what_it_has(tmp_path, numbers, code):
    finished, folder = ended(tmp_path, step=30, numbers=numbers)
    assert finished.returncode == code, finished.stderr
    assert "interrupted: writing what there is" in finished.stderr
    assert "stopped     interrupted" in finished.stdout
    result = result_of(folder)
    assert result["status"] == "interrupted"
    assert result["metrics"]["stop_reason"].startswith("interrupted")
    assert result["metrics"]["exploration_time_s"] is None
    assert len(read_log(folder / "log.npz")) == 30
    assert {"map.json", "map.png", "run.toml", "trajectory_est.tum"} <= {
        path.name for path in folder.iterdir()
    }
    assert not (folder / "trajectory_smoothed.tum").exists()
    shown = limslam("show", folder, "--out", tmp_path / "shown.png")
    assert (shown.returncode, shown.stderr) == (0, "")


@pytest.mark.parametrize("options", [(), ("--limit", "--imu")])
def test_a_run_of_one_step_has_a_folder(tmp_path, options):
    finished, folder = ended(tmp_path, *options, step=1, numbers=[signal.SIGINT])
    assert finished.returncode == 130, finished.stderr
    assert len(read_log(folder / "log.npz")) == 1


def test_two_robots_keep_what_they_have(tmp_path):
    # Both robots' policies raise the signal, of which the second one changes nothing.
    told = ("--robots", "2", "--world", "env1")
    finished, folder = ended(tmp_path, *told, step=20, numbers=[signal.SIGTERM])
    assert finished.returncode == 143, finished.stderr
    for number in range(2):
        assert len(read_tum(folder / f"trajectory_est_{number}.tum")[0]) == 20


def test_a_second_ctrl_c_ends_a_run_at_once(tmp_path):
    finished, folder = ended(tmp_path, step=20, numbers=[signal.SIGINT] * 2)
    assert (finished.returncode, finished.stdout) == (130, "")
    assert not folder.exists()


def test_nohup_is_respected(tmp_path):
    told = ("--max-time", "4")
    finished, folder = ended(
        tmp_path, *told, step=10, numbers=[signal.SIGHUP], ignored=signal.SIGHUP
    )
    assert finished.returncode == 0, finished.stderr
    assert result_of(folder)["status"] == "finished"


@pytest.mark.parametrize(("ending", "code"), [(KeyboardInterrupt(), 130), (SystemExit(143), 143)])
@pytest.mark.parametrize(
    "place",
    ["limslam_agent.slam.line_graph.smoother.smooth_run", "limslam_agent.runs.results.score"],
)
def test_what_follows_a_run_is_broken_off_and_the_run_is_kept(
    tmp_path, monkeypatch, ending, code, place
):
    module, _, name = place.rpartition(".")
    __import__(module)
    rest = getattr(sys.modules[module], name)
    endings = [ending]

    def interrupted(*arguments):
        if endings:
            raise endings.pop()
        return rest(*arguments)

    monkeypatch.setattr(place, interrupted)
    told = ("--world", "square", "--max-time", "5")
    finished = limslam("run", *told, "--out", tmp_path / "run")
    assert finished.returncode == code, finished.stderr
    result = result_of(tmp_path / "run")
    assert result["status"] == "interrupted"
    assert result["metrics"]["stop_reason"] == "time: the run's longest time is over"
    assert not (tmp_path / "run" / "trajectory_smoothed.tum").exists()
    assert np.isfinite(result["metrics"]["ate_m"])
