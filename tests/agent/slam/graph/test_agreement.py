"""Visits that contradict each other at one place only."""

import numpy as np
import pytest

from limslam_agent.slam.graph.agreement import VisitCounts


def counts(contradicted):
    shares = np.asarray(contradicted)
    number = np.arange(len(shares))
    return VisitCounts(3 * number, np.full(len(shares), 200), 200 - shares, shares)


def test_a_stretch_is_doubtful_if_it_is_contradicted_more_often_than_confirmed():
    visits = counts([20] * 20 + [140] * 5 + [20] * 20)
    assert visits.doubtful().tolist() == [63, 66, 69]
    assert visits.shares == pytest.approx((1.0 - 1500 / 9000, 1500 / 9000))
    assert len(counts([80] * 25).doubtful()) == 0  # clutter
    unseen = np.zeros(9, dtype=np.int64)
    assert len(VisitCounts(np.arange(9), np.full(9, 200), unseen, unseen).doubtful()) == 0


def test_a_stretch_of_one_log_does_not_count_around_chunks_of_the_next_log():
    visits = counts([2] * 20 + [200] * 3 + [10] * 20)
    assert visits.doubtful().tolist() == [60, 63, 66]
    assert visits.doubtful(seam=66).tolist() == [60, 63]
