"""Visits that contradict each other at one place only."""

import numpy as np
import pytest

from limslam_agent.slam.graph.agreement import VisitCounts


def counts(contradicted):
    shares = np.asarray(contradicted)
    number = np.arange(len(shares))
    return VisitCounts(3 * number, np.full(len(shares), 200), 200 - shares, shares)


def test_a_stretch_is_doubtful_if_it_is_contradicted_much_more_than_the_rest():
    visits = counts([2] * 20 + [50] * 5 + [2] * 20)
    assert visits.doubtful(0.12).tolist() == [60, 63, 66, 69, 72]
    assert visits.shares == pytest.approx((1.0 - 330 / 9000, 330 / 9000))


@pytest.mark.parametrize("contradicted", [[2] * 25, [20] * 20 + [50] * 5 + [20] * 20, [2] * 12 + [80] + [2] * 12])
def test_clutter_and_single_chunks_are_not_doubtful(contradicted):
    assert len(counts(contradicted).doubtful(0.12)) == 0


def test_a_stretch_that_is_contradicted_more_often_than_confirmed_is_doubtful_in_any_clutter():
    visits = counts([20] * 20 + [140] * 5 + [20] * 20)
    assert visits.doubtful(0.12).tolist() == [63, 66, 69]


def test_a_stretch_of_one_log_does_not_count_around_chunks_of_the_next_log():
    visits = counts([2] * 20 + [60, 60] + [2] * 20)
    assert visits.doubtful(0.12).tolist() == [57, 60, 63, 66]
    assert visits.doubtful(0.12, seam=63).tolist() == []


def test_chunks_that_no_other_visit_has_seen_are_not_doubtful():
    unseen = np.zeros(9, dtype=np.int64)
    assert len(VisitCounts(np.arange(9), np.full(9, 200), unseen, unseen).doubtful(0.12)) == 0
