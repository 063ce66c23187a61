"""Associations that can be taken back: merging, splitting, giving readings to lines anew."""

import numpy as np
import pytest
from support.smoother_runs import noisy_run, position_error, state_from_motions, true_labels

from limslam_agent.slam.line_graph.reassociation import (
    merge,
    reassociate,
    solve_labels,
)


def agreeing(found, wanted):
    """Share of the used readings whose line holds mostly readings of the same wall."""
    used = found.labels >= 0
    pairs = np.zeros((found.labels.max() + 1, wanted.max() + 1), dtype=int)
    np.add.at(pairs, (found.labels[used], wanted[used]), 1)
    return pairs.max(axis=1).sum() / used.sum()


@pytest.mark.parametrize("noise", [0.0, 0.04])
def test_a_wrong_match_is_taken_back(noise):
    problem, poses = noisy_run(1, noise)
    wanted = true_labels(problem, poses)
    wrong = wanted.copy()
    of_right_wall = np.flatnonzero(wanted == 1)
    wrong[of_right_wall[: len(of_right_wall) // 4]] = 0
    begin = state_from_motions(problem)
    bent = solve_labels(problem, begin, wrong)
    mended = reassociate(problem, begin, wrong)
    best = solve_labels(problem, begin, wanted)
    assert position_error(bent.state, poses) > 3.0 * position_error(best.state, poses)
    assert position_error(mended.state, poses) < 1.5 * position_error(best.state, poses)
    assert agreeing(mended, wanted) > 0.99
    assert (mended.labels >= 0).mean() > 0.9


def test_lines_of_one_wall_are_merged():
    problem, poses = noisy_run(2)
    wanted = true_labels(problem, poses)
    halves = 2 * wanted + (problem.readings.places > problem.steps // 2)
    begin = solve_labels(problem, state_from_motions(problem), halves)
    assert len(begin.state.lines) > 4
    found, has_merged, _ = merge(begin)
    assert has_merged
    assert len(found.state.lines) == 4
    assert agreeing(found, wanted) == 1.0


def test_readings_that_the_filter_did_not_use_are_used():
    problem, poses = noisy_run(4)
    wanted = true_labels(problem, poses)
    few = np.where(np.arange(len(wanted)) % 5 == 0, wanted, -1)
    found = reassociate(problem, state_from_motions(problem), few)
    assert (found.labels >= 0).mean() > 0.9
    assert agreeing(found, wanted) > 0.99
