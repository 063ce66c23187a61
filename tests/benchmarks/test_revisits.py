"""Visits of one place: where they coincide, and where the second visit is displaced."""

import re

import numpy as np
import pytest
from support.corridors import corridor_log

from benchmarks.revisits import revisits, revisits_of
from limslam_agent.output.tum import write_tum
from limslam_env.geometry import se2

LAP = 345  # events, about


@pytest.fixture(scope="module")
def laps():
    return corridor_log()


def test_laps_of_the_true_path_coincide(laps):
    found = revisits(*laps)
    assert found.pairs >= len(found.shifts) > 10
    # A match in a corridor hardly determines the shift along it.
    assert found.coinciding > 0.9
    assert np.median(found.shifts) < 0.15  # cells have sides of 0.1 m
    assert np.degrees(np.median(found.turns)) < 2.0
    assert f"{len(found.shifts)} of {found.pairs} pairs of visits match" in found.words


def test_a_displaced_lap_is_measured(laps):
    log, truth = laps
    displaced = truth.copy()
    displaced[LAP:] = se2.compose(np.array([0.5, 0.2, 0.0]), truth[LAP:])
    found = revisits(log, displaced)
    assert found.coinciding < 0.5
    assert 0.2 < np.median(found.shifts) < 0.7


def test_the_folder_of_another_log_is_named(tmp_path):
    (log := tmp_path / "log.csv").write_text("t,x,y,theta,r_0\n0,0,0,0,1\n1,0,0,0,1\n", encoding="utf-8")
    write_tum(tmp_path / "trajectory_smoothed.tum", np.arange(3.0), np.zeros((3, 3)))
    words = f"{tmp_path}: the path has 3 poses and the log {log} has 2 events"
    with pytest.raises(ValueError, match=re.escape(words)):
        revisits_of(log, tmp_path)
