"""Signals of a smoothed path that need no truth, and the status that follows from them."""

from dataclasses import replace

import numpy as np
import pytest
from support.corridors import corridor_log

from limslam_agent.config.graph import GraphConfig
from limslam_agent.output.summary import replay_summary
from limslam_agent.replay.smoothing import trusted_path
from limslam_agent.replay.trust import PathSignals, longest_loose

BRIEF = GraphConfig()
SURE = PathSignals(driven=100.0, points=3000, confirmed=0.5, contradicted=0.02, position_std=0.3)


def test_the_longest_stretch_without_a_loop_is_found():
    travel = np.array([0.0, 10.0, 20.0, 30.0, 60.0, 70.0, 75.0])
    assert longest_loose(travel, np.zeros((0, 2), dtype=int)) == (0, 6)
    assert longest_loose(travel, np.array([[2, 0]])) == (2, 6)
    assert longest_loose(travel, np.array([[1, 0], [6, 4]])) == (1, 4)
    assert longest_loose(travel, np.array([[0, 5], [1, 2]])) == (5, 6)


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (SURE, ""),
        (replace(SURE, confirmed=0.0, contradicted=0.0), "no other visit of a place confirms what was seen"),
        (replace(SURE, contradicted=0.1), "visits of a place contradict each other at 17% of the points"),
        (
            replace(SURE, doubtful_times=(12.3, 40.0)),
            "visits contradict what was seen more often than they confirm it after 12, 40 s",
        ),
        (
            replace(SURE, position_std=0.7, loose=(3.0, 61.0)),
            "positions may be 0.7 m off, as no recognised place holds the path from 3 to 61 s",
        ),
    ],
)
def test_the_status_names_each_reason(found, words):
    assert (found.status.level, found.status.reason) == ("unsure" if words else "ok", words)


def test_another_path_is_better_if_its_visits_agree_better_on_as_much():
    wrong = replace(SURE, confirmed=0.5, contradicted=0.05)
    assert wrong.is_worse_than(replace(wrong, confirmed=0.4, contradicted=0.03))
    assert not wrong.is_worse_than(replace(wrong, confirmed=0.4, contradicted=0.05))
    assert not wrong.is_worse_than(replace(wrong, confirmed=0.02, contradicted=0.0))


def test_the_summary_says_that_readings_are_few():
    assert len(replay_summary(SURE.figures)) == 1
    _, line = replay_summary(replace(SURE, points=620).figures)
    assert line.strip() == "6.2 readings of walls in a metre of driving: with fewer than 10, paths were often wrong"


def test_a_stretch_that_no_loop_holds_is_named():
    """The second lap is not driven to its end: nothing of the first lap's end is seen again."""
    data, truth = corridor_log(laps=1, bias=0.0)
    count = int(0.7 * len(truth))
    rows = {name: getattr(data, name)[:count] for name in ("time", "odometry", "ranges", "hit")}
    _, judged = trusted_path(replace(data, **rows), truth[0], BRIEF)
    assert judged.loose == pytest.approx((0.0, data.time[count - 1] - data.time[0]), abs=3.0)
    assert judged.status.level == "unsure"
