"""Rates of candidates that take turns, and their ratios."""

import numpy as np
import pytest

from benchmarks.speed import rates as rates_module
from benchmarks.speed.rates import print_rates, rates_in_turn, ratio


class Machine:
    """A clock that candidates move on, and that runs slower in later rounds."""

    def __init__(self) -> None:
        self.now, self.slowness, self.calls = 0.0, 1.0, []

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
    rates = rates_in_turn(candidates, 5, machine.clock)
    order = [name for number, name in enumerate(machine.calls) if number == 0 or machine.calls[number - 1] != name]
    assert order == ["fast", "last"] * 6
    assert rates["fast"].shape == rates["last"].shape == (5,)
    assert rates["fast"][0] > 10.0 * rates["fast"][-1], "the machine became slower"
    assert ratio(rates, "fast", "last") == pytest.approx(4.0)


def test_the_table_has_medians_and_a_column_for_each_reference(capsys):
    rates = {"one": np.array([100.0, 300.0, 200.0]), "other": np.array([50.0, 100.0, 200.0])}
    print_rates(rates, {"one": "one"})
    assert capsys.readouterr().out.splitlines() == [
        "| candidate | steps/s | x one |",
        "|---|---|---|",
        "| one | 200 | 1 |",
        "| other | 100 | 0.5 |",
    ]


def test_a_burst_lasts_as_long_as_said():
    machine = Machine()
    rates_in_turn({"fast": machine.loop("fast", rates_module.SECONDS / 4.0)}, 1, machine.clock)
    assert len(machine.calls) == 1 + 4
