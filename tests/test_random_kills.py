"""Commands that are killed at random moments: nothing is lost, half-written or left behind."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from limslam_agent.output.claims import clear_up
from limslam_agent.output.finished_run import read_run

ROOT = Path(__file__).parents[1]
KILLS = 30

pytestmark = pytest.mark.slow


@dataclass
class Command:
    """A command in a folder of its own, and how long it takes when it is left alone."""

    arguments: tuple[str, ...]
    cwd: Path
    seconds: float = 0.0
    outcomes: Counter[str] = field(default_factory=Counter)

    def start(self) -> subprocess.Popen[bytes]:
        """Start it as the leader of a group of processes."""
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]),
            "OPENBLAS_NUM_THREADS": "1",
        }
        return subprocess.Popen(
            [sys.executable, "-m", *self.arguments],
            cwd=self.cwd,
            env=environment,
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )

    def finish(self) -> None:
        """Let it end by itself."""
        begin = time.monotonic()
        with self.start() as process:
            _, said = process.communicate(timeout=600)
            assert process.returncode == 0, said.decode()
        self.seconds = time.monotonic() - begin

    def kill(self, after: float) -> bool:
        """Kill the process itself, not those that it has started. Whether it was still running."""
        with self.start() as process:
            try:
                process.wait(after)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
            process.wait()
            self.outcomes["killed" if process.returncode == -signal.SIGKILL else "done"] += 1
            assert process.returncode in {0, -signal.SIGKILL}, process.stderr.read().decode()
            return process.returncode != 0


def hidden_files(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob(".*"))


def assert_nothing_is_lost(target: Path, files: set[str]) -> None:
    """After the clear-up of a next start, the old or the new results are there as a whole, and
    nothing else.
    """
    clear_up(target.parent)
    assert {path.name for path in target.iterdir()} == files
    read_run(target)
    json.loads((target / "result.json").read_text())
    assert hidden_files(target.parent) == []


@pytest.mark.parametrize("kind", ["run", "replay"])
def test_a_run_or_a_replay_that_is_killed_leaves_its_results_whole(tmp_path, kind):
    run = ("limslam_agent", "run", "--world", "square", "--max-time", "2")
    first = Command((*run, "--out", "results/first"), tmp_path)
    first.finish()
    target = tmp_path / "results" / kind
    log = str(tmp_path / "results" / "first" / "log.npz")
    arguments = run if kind == "run" else ("limslam_agent", "replay", log)
    command = Command((*arguments, "--out", str(target), "--force"), tmp_path)
    command.finish()
    command.finish()
    files = {path.name for path in target.iterdir()}
    chance = random.Random(0)  # noqa: S311 (moments, not secrets)
    for _ in range(KILLS):
        # Most kills come late: that is when the results take their place.
        command.kill(
            command.seconds * chance.choice((chance.uniform(0.0, 1.0), chance.uniform(0.8, 1.05)))
        )
        assert_nothing_is_lost(target, files)
    command.finish()
    assert_nothing_is_lost(target, files)
    assert command.outcomes["killed"] > KILLS // 2, command.outcomes
    print(dict(command.outcomes))  # noqa: T201 (seen with pytest -s)
