"""Correct coverage, and lost plans."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from limslam_agent.arena.scoring import correct_coverage, exploration_scores, loss
from limslam_agent.arena.tracks import plans_of

PLAN = replace(plans_of()[0], max_time=100.0)
TIME, COVERAGE = np.array([0.0, 10.0, 20.0, 30.0]), np.array([0.1, 0.8, 0.96, 0.99])


def floor():
    """A floor of 2 x 3 m, all of which can be seen."""
    return SimpleNamespace(coverable=np.ones((20, 30), dtype=bool), low=np.zeros(2))


def free(shift=0.0, columns=30):
    """A map that calls the left part of that floor free, moved to the right by some metres."""
    x, y = np.meshgrid(np.arange(columns), np.arange(20))
    centres = np.column_stack((0.1 * (x.ravel() + 0.5) + shift, 0.1 * (y.ravel() + 0.5)))
    return SimpleNamespace(free=np.ones(len(centres), dtype=bool), centres=lambda index: centres[index.ravel()])


@pytest.mark.parametrize(
    ("seen_columns", "grid", "share"),
    [
        (30, free(), 1.0),
        (15, free(), 0.5),  # a map of what was never seen
        (30, free(columns=14), 0.5),  # cells beside a free cell count
        (30, free(shift=0.1), 1.0),
        (30, free(shift=0.6), 25 / 30),
        (30, free(shift=9.0), 0.0),
        (30, free(columns=0), 0.0),
    ],
)
def test_coverage_is_correct_where_it_was_seen_and_the_map_says_so(seen_columns, grid, share):
    seen = np.zeros((20, 30), dtype=bool)
    seen[:, :seen_columns] = True
    assert correct_coverage(floor(), seen, grid) == pytest.approx(share)


def test_a_plan_takes_the_time_to_its_coverage():
    scores = exploration_scores(PLAN, TIME, COVERAGE, 0.97, is_finished=True)
    assert (scores["plan_time_to_80_s"], scores["plan_time_to_95_s"], scores["lost"]) == (10.0, 20.0, "")


def test_the_time_since_the_last_new_cell_is_that_of_the_end():
    waited = np.append(TIME, [40.0, 55.0]), np.append(COVERAGE, [0.99, 0.99])
    assert exploration_scores(PLAN, *waited, 0.97, is_finished=True)["since_new_s"] == 25.0
    assert exploration_scores(PLAN, TIME, COVERAGE, 0.97, is_finished=True)["since_new_s"] == 0.0


def test_a_lost_plan_takes_the_longest_time():
    scores = exploration_scores(PLAN, TIME, COVERAGE, 0.94, is_finished=True)
    assert (scores["plan_time_to_80_s"], scores["plan_time_to_95_s"]) == (100.0, 100.0)
    assert scores["time_to_95_s"] == 20.0
    assert scores["lost"] == "claims to be done and is not"
    assert loss(0.94, is_finished=False) == "not explored in time"
