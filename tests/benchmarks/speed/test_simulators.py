"""Other simulators in the table of speeds: those that are missing or fail are left out with the reason."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.speed import simulators
from benchmarks.speed.simulators import REACH, SIDE, Simulator, irsim_world, simulator_loops, walls
from benchmarks.speed.vector import OURS, print_simulators


def broken():
    raise RuntimeError("no  such\ndevice")


def test_a_simulator_that_is_missing_or_fails_is_skipped_with_the_reason(monkeypatch, capsys):
    made = {
        "works": Simulator("numpy", lambda: lambda: 4, "what it does"),
        "fails": Simulator("numpy", broken, "fails at once"),
        "fails later": Simulator("numpy", lambda: broken, "fails in its first step"),
        "missing": Simulator("no-such-distribution", lambda: lambda: 1, "is not here"),
    }
    for module in (simulators, __import__("benchmarks.speed.vector", fromlist=["SIMULATORS"])):
        monkeypatch.setattr(module, "SIMULATORS", made)
    found, skipped = simulator_loops()
    assert list(found) == ["works"]
    assert skipped == {
        "fails": "RuntimeError: no such device",
        "fails later": "RuntimeError: no such device",
        "missing": "no-such-distribution is not installed",
    }
    print_simulators({OURS: np.array([30.0, 20.0, 10.0]), "works": np.array([3.0, 1.0, 2.0])}, skipped)
    lines = capsys.readouterr().out.splitlines()
    assert "| works | 10 | what it does |" in lines
    assert "| missing | skipped: no-such-distribution is not installed | is not here |" in lines


def test_the_walls_of_the_other_simulators():
    found = walls()
    assert found.shape == (simulators.NUM_WALLS, 4)
    assert np.hypot(found[:, 2] - found[:, 0], found[:, 3] - found[:, 1]) == pytest.approx(0.8)
    middles = 0.5 * (found[:, :2] + found[:, 2:])
    assert np.hypot(*(middles - 0.5 * SIDE).T).min() > 1.0


def test_the_world_file_of_ir_sim():
    with irsim_world("  - {shape: {name: circle}}\n") as path:
        text = Path(path).read_text(encoding="utf-8")
    assert f"range_max: {REACH}" in text
    assert text.endswith("obstacle:\n  - {shape: {name: circle}}\n")
