"""A robot that stands, is lost or sees nothing keeps no more from step to step."""

import gc
import sys
from dataclasses import replace

import pytest

from benchmarks.growth import CASES, hours_of
from limslam_agent import preset
from limslam_agent.config.smoother import RenewalConfig
from limslam_agent.mapping import recovery

CONFIG = replace(preset("graph"), renewal=RenewalConfig(period=50.0))


@pytest.mark.parametrize(
    ("case", "first"), [("stands", 4000), ("lost", 5000), ("placed", 6000), ("blind", 1500)]
)
def test_what_is_kept_stops_growing(case, first, monkeypatch):
    monkeypatch.setattr(recovery, "LONGEST_ABSENCE", 1500)
    going = CASES[case](CONFIG)
    # Readings that are compared with the map come and go in 1500 steps, renewed stretches in 500.
    blocks = []
    for steps in (first, 3000):
        for _ in range(steps):
            next(going)
        gc.collect()
        blocks.append(sys.getallocatedblocks())
    assert blocks[1] - blocks[0] < 3000, "a step whose readings are kept takes nine blocks"


def test_a_case_is_measured_hour_by_hour():
    rows = hours_of("blind", 2, steps=100)
    assert rows.shape == (2, 3)
    assert (rows[:, 1] > 0.0).all()
    assert (rows[:, 2] >= rows[:, 1]).all()
