"""Visits that contradict each other at one place only, and groups of loops that would make them do so."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.corridors import corridor_log

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.agreement import (
    DOUBTFUL_SHARE,
    Decision,
    Evidence,
    VisitCounts,
    exchange_groups,
    plausible_groups,
    visit_counts,
)
from limslam_agent.slam.graph.chunk_graph import ChunkSolution, Hops, Loop, Strain, solve_annealed
from limslam_agent.slam.graph.key_poses import ERRORS, Trajectory, choose_keys
from limslam_env.geometry import se2


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


def test_a_wrong_path_contradicts_whole_pieces_of_walls():
    """The second of two laps of a corridor lies 1 m beside the first one, or where it was driven."""
    data, truth = corridor_log(bias=0.0)
    keys = choose_keys(data, GraphConfig().keys)
    shares = []
    for beside in (0.0, 1.0):
        poses = truth[keys.first_event] + [0.0, beside, 0.0] * (keys.key_travel > 0.5 * keys.key_travel[-1])[:, None]
        seen, against = visit_counts(keys, Trajectory(poses, np.zeros(ERRORS)), GraphConfig(), data.max_range).pieces
        assert seen > 50
        shares.append(against / seen)
    assert shares[0] < 0.01
    assert shares[1] > 0.1


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


CHAIN = np.column_stack((np.arange(10.0), np.zeros((10, 2))))
HOPS = Hops(np.tile([1.0, 0.0, 0.0], (9, 1)), np.tile(0.1 * np.eye(3), (9, 1, 1)))


def loop_to(place, first=0, last=9):
    """A loop that places the last chunk of the chain so far from its first chunk, m."""
    return Loop(first, last, np.array([place - first, 0.0, 0.0]), 1e4 * np.eye(3), 0.8, "union")


def exchanged(wrong, refused, place):
    """The decision about refused loops and a wrong one, if the score is highest with the last chunk at a place, m."""
    placed = Decision([wrong], solve_annealed(CHAIN[0], HOPS, [wrong]), refused)
    return exchange_groups(CHAIN, HOPS, placed, lambda poses: -abs(poses[9, 0] - place))


@pytest.mark.parametrize(("place", "other", "is_better"), [(8.0, 1, True), (6.0, 1, False), (8.0, 5, False)])
@pytest.mark.parametrize("backward", [False, True])
def test_a_refused_group_takes_the_place_of_a_loop_that_joins_the_same_visits_otherwise(
    place, other, is_better, backward
):
    """The score is highest where the last chunk is 8 m from the first one; loops from chunk 5 are of another visit."""
    wrong, right = loop_to(6.0), loop_to(8.0, other)
    if backward:
        right = replace(right, first=9, second=other, relative=se2.inverse(right.relative))
    found = exchanged(wrong, [right], place)
    assert (found.loops, found.dropped) == (([right], [wrong]) if is_better else ([wrong], [right]))
    assert found.solution.poses[9, 0] == pytest.approx(8.0 if is_better else 6.0, abs=0.1)


@pytest.mark.parametrize(("said", "place"), [(8.0, 9.2), (60.0, 9.2)])
def test_a_group_takes_no_place_if_only_the_removal_of_the_other_loops_raises_the_score(said, place):
    """The kernels accept the first group, which is worse than no loop, and reject the second one."""
    wrong, refused = loop_to(6.0), loop_to(said)
    found = exchanged(wrong, [refused], place)
    assert (found.loops, found.dropped) == ([wrong], [refused])


def test_only_some_groups_are_tried_in_the_place_of_other_loops():
    wrong, calls = loop_to(6.0), []
    placed = Decision([wrong], solve_annealed(CHAIN[0], HOPS, [wrong]), [loop_to(10.0 + place) for place in range(15)])
    exchange_groups(CHAIN, HOPS, placed, lambda poses: float(calls.append(poses) or 0.0))
    assert len(calls) == 1 + 10


@pytest.mark.parametrize(
    ("known", "contradicted", "bend", "adds"),
    [(2376, 98, 2.5, True), (2376, 40, 2.5, False), (2376, 40, 20.0, True), (1700, 98, 20.0, False)],
)
def test_a_map_adds_contradictions_if_much_of_what_it_adds_is_contradicted(known, contradicted, bend, adds):
    straight = Evidence(points=5430, confirmed=1616, contradicted=5, bend=0.1)
    other = Evidence(points=5430, confirmed=known - contradicted, contradicted=contradicted, bend=bend)
    assert other.adds_contradictions(straight, DOUBTFUL_SHARE) == adds
    assert not straight.adds_contradictions(other, DOUBTFUL_SHARE)
