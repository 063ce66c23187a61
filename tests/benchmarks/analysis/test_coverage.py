"""The table of coverage over time."""

import numpy as np
import pytest

from benchmarks.analysis.coverage import Curves, curve_table, read_curves

TIME = np.arange(0.0, 241.0)


def curves(speed, plans=8, collisions=0.0):
    """Coverage grows steadily; the later a plan, the more slowly."""
    pace = speed * (1.0 - 0.02 * np.arange(plans))
    names = tuple(f"random:{number}" for number in range(plans))
    return Curves(names, TIME, np.minimum(pace[:, None] * TIME, 1.0), np.full(plans, collisions))


def test_times_and_gains_are_counted_by_plan():
    found = {"frontier_fast": curves(0.8 / 100.0), "learned": curves(0.8 / 50.0, collisions=0.5)}
    frontier, learned = curve_table(found).splitlines()[2:4]
    assert frontier.startswith("| frontier, 0.3 m/s | 8 |")
    assert frontier.count("| \N{EN DASH} |") == 1
    cells = [cell.strip() for cell in learned.split("|")]
    assert cells[-2] == "0.50"
    # 100 s / 0.93 and 50 s / 0.93 in the middle.
    assert cells[-3].startswith("-5")
    assert cells[-3].endswith("(8)")
    assert cells[-4] == "100%"


def test_what_was_never_covered_counts_as_the_longest_time():
    slow = curves(0.5 / 240.0)
    assert (slow.times == 240.0).all()
    assert "| 240 | 0% |" in curve_table({"random": slow})


def test_folders_without_explorations_are_refused(tmp_path):
    with pytest.raises(ValueError, match="no results there"):
        read_curves([tmp_path])
