"""Rates of candidates that take turns, and how many times faster than its robot an agent is."""

import sys

import numpy as np
import pytest

from benchmarks import speed
from benchmarks.scoreboard import measure
from benchmarks.suite.jobs import Outcome


class Machine:
    """A clock that candidates move on, and that runs slower in later rounds."""

    def __init__(self) -> None:
        self.now = 0.0
        self.slowness = 1.0
        self.calls = []

    def clock(self) -> float:
        return self.now

    def loop(self, name: str, seconds: float):
        def run() -> int:
            self.calls.append(name)
            self.now += seconds * self.slowness
            if name == "last":
                self.slowness *= 3.0
            return 10

        return run


def test_candidates_take_turns_and_ratios_are_of_one_round():
    machine = Machine()
    candidates = {"fast": machine.loop("fast", 0.01), "last": machine.loop("last", 0.04)}
    rates = speed.rates_in_turn(candidates, 5, machine.clock)
    order = [
        name
        for number, name in enumerate(machine.calls)
        if number == 0 or machine.calls[number - 1] != name
    ]
    assert order == ["fast", "last"] * 6
    assert rates["fast"].shape == rates["last"].shape == (5,)
    assert rates["fast"][0] > 10.0 * rates["fast"][-1], "the machine became slower"
    assert speed.ratio(rates, "fast", "last") == pytest.approx(4.0)


def test_a_run_is_timed_by_its_simulated_time():
    ticks = iter(np.arange(0.0, 100.0, 0.5))
    assert speed.times_faster(
        "square", 1, lambda: float(next(ticks)), max_time=2.0
    ) == pytest.approx(4.0)


def test_long_rows_say_what_they_cost_or_what_is_missing(monkeypatch):
    def cost_of(rows, job):
        if rows[job.policy].needs_data:
            raise ValueError("recorded data not found")
        return Outcome({}, {"drive_cpu_s": 60.2, "smoothing_cpu_s": 7.7}, "")

    monkeypatch.setattr(measure, "measure", cost_of)
    building, hour = speed.long_figures()
    assert building[1] == "not measured: recorded data not found"
    assert hour == ("an hour, drive + smoothing", "60 + 8", "s of processor time")


def test_without_a_gpu_its_row_says_so(monkeypatch):
    def refuse(_):
        raise RuntimeError("no GPU")

    monkeypatch.setattr(speed, "_device_rates", refuse)
    assert speed.device_figure()[1] == "not measured"


def test_a_timed_process_gets_variables():
    command = [sys.executable, "-c", "import os; os.environ['LIMSLAM_TIMED']"]
    assert speed.spent_by(command, LIMSLAM_TIMED="yes") > 0.0
