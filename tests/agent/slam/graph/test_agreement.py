"""Visits that contradict each other at one place only, and groups of loops that would make them do so."""

from types import SimpleNamespace

import numpy as np
import pytest

from limslam_agent.slam.graph.agreement import (
    DOUBTFUL_SHARE,
    Decision,
    Evidence,
    VisitCounts,
    plausible_groups,
)
from limslam_agent.slam.graph.chunk_graph import ChunkSolution, Hops, Loop, Strain


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


def similar_corridors(contradicted, hops, kernel):
    """A stand-in for the score of ten chunks, of which the first is laid onto the last by a loop.

    Of 1000 points, 500 are confirmed by right loops. The wrong loop adds 300 points, of which a number is contradicted.
    A narrow kernel makes the path count as bent.
    """

    def verdicts(poses):
        laid_on = np.hypot(*(poses[9] - poses[0])[:2]) < 1.0
        confirmed, wrong = np.zeros(1000, dtype=np.bool_), np.zeros(1000, dtype=np.bool_)
        confirmed[:500] = True
        if laid_on:
            confirmed[500 : 800 - contradicted] = wrong[800 - contradicted : 800] = True
        return confirmed, wrong

    return SimpleNamespace(points=np.zeros((1000, 2)), verdicts=verdicts, strain=Strain(hops, kernel, 0.1))


@pytest.mark.parametrize(
    ("contradicted", "kernel", "refused"), [(10, 0.1, False), (30, 0.1, False), (60, 0.1, True), (30, 9.0, True)]
)
def test_a_group_is_refused_if_the_visits_that_it_joins_contradict_each_other(contradicted, kernel, refused):
    poses = np.column_stack((np.arange(10.0), np.zeros((10, 2))))
    hops = Hops(np.tile([1.0, 0.0, 0.0], (9, 1)), np.tile(0.1 * np.eye(3), (9, 1, 1)))
    loop = Loop(0, 9, np.zeros(3), 1e4 * np.eye(3), 0.8, "wide search")
    placed = Decision([], ChunkSolution(poses, np.zeros(0)), [])
    score = similar_corridors(contradicted, hops, kernel)
    assert plausible_groups((poses, hops), placed, [], score) == ([], [])
    kept, left = plausible_groups((poses, hops), placed, [[loop]], score)
    assert (kept, left) == (([], [loop]) if refused else ([[loop]], []))


@pytest.mark.parametrize(
    ("known", "contradicted", "bend", "adds"),
    [(2376, 98, 2.5, True), (2376, 40, 2.5, False), (2376, 40, 20.0, True), (1700, 98, 20.0, False)],
)
def test_a_map_adds_contradictions_if_much_of_what_it_adds_is_contradicted(known, contradicted, bend, adds):
    straight = Evidence(points=5430, confirmed=1616, contradicted=5, bend=0.1)
    other = Evidence(points=5430, confirmed=known - contradicted, contradicted=contradicted, bend=bend)
    assert other.adds_contradictions(straight, DOUBTFUL_SHARE) == adds
    assert not straight.adds_contradictions(other, DOUBTFUL_SHARE)
