"""Which chunks are searched for in wide windows."""

import numpy as np
import pytest

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph import wide_search
from limslam_agent.slam.graph.chunk_graph import ChunkSolution, Hops, Loop
from limslam_agent.slam.graph.loop_search import Chunks


def loop(first, second):
    return Loop(first, second, np.zeros(3), 1e4 * np.eye(3), 0.8, "along the way")


def searched(monkeypatch, loops):
    """Pairs of chunks that are compared, of 24 chunks that lie 2.5 m apart in driving and near each other in space."""
    poses, travel = np.zeros((24, 3)), 2.5 * np.arange(24)
    hops = Hops(np.zeros((23, 3)), np.tile(0.1 * np.eye(3), (23, 1, 1)))
    chunks = Chunks([None] * 24, np.arange(24), poses, travel, hops, GraphConfig())
    monkeypatch.setattr(wide_search, "_groups", lambda *given: [(given[3], given[4].tolist())])
    found = wide_search.search_widely(chunks, ChunkSolution(poses, np.ones(len(loops))), loops)
    return [(first, second) for first, seconds in found for second in seconds]


def test_the_parts_of_a_log_are_divided_by_hops_that_no_loop_spans():
    assert wide_search.parts_of([loop(0, 2), loop(4, 1), loop(6, 7)], 9).tolist() == [0, 0, 0, 0, 0, 1, 2, 2, 3]


@pytest.mark.parametrize("spanning", [False, True])
def test_recognised_chunks_are_compared_with_those_of_another_part_only(monkeypatch, spanning):
    """Two stretches with loops of their own, with a hop in between in which odometry may have turned wrongly."""
    own = [loop(begin + i, begin + 11 - i) for begin in (0, 12) for i in (0, 3)]
    pairs = searched(monkeypatch, [*own, loop(2, 20)] if spanning else own)
    assert {(first < 12, second < 12) for first, second in pairs} == (
        set() if spanning else {(True, False), (False, True)}
    )
    assert len({frozenset(pair) for pair in pairs}) == len(pairs)
