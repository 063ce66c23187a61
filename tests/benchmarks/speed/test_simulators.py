"""Other simulators in the table of speeds: those that are missing or fail are left out with the reason."""

import numpy as np

from benchmarks.speed import simulators
from benchmarks.speed.simulators import Simulator, simulator_loops
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
