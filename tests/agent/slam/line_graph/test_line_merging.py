"""Two lines that were read from opposite sides are one wall only if they are a board."""

import numpy as np
import pytest

from limslam_agent.slam.line_graph.line_merging import NEGATIVE, POSITIVE, Lines, merge_lines, wall_kinds

UNSEEN = [np.inf, -np.inf]


def parallel(behind, second, std=0.01, *, turned=False):
    """Two lines along the x axis, the first read from y > 0, and the second, ``behind`` m below, from a side."""
    lines = np.array([[0.0, 0.5 * np.pi], [0.0, -0.5 * np.pi if turned else 0.5 * np.pi]])
    anchors = np.array([[0.3, 0.0], [0.5, -behind]])
    seen = np.array([[UNSEEN, UNSEEN], [UNSEEN, UNSEEN]])
    seen[0, POSITIVE] = seen[1, 1 - second if turned else second] = [-1.0, 1.0]
    return Lines(lines, anchors, seen, np.diag([std**2, 1e-4] * 2))


def merged(behind, std, second=NEGATIVE, kinds=(0.0, 0.0), *, turned=False):
    lines = parallel(behind, second, std, turned=turned)
    return merge_lines(lines, kinds), lines


@pytest.mark.parametrize("turned", [False, True])
def test_a_board_is_one_line_and_a_wall_two(turned):
    has_merged, lines = merged(0.002, 0.01, turned=turned)
    assert has_merged
    assert lines.merged_into.tolist() == [1, 1]
    assert (lines.seen[1, :, 0] < lines.seen[1, :, 1]).all()
    assert not merged(0.13, 0.06, turned=turned)[0]
    # The same difference, seen from one side, is a matter of chi-square alone.
    assert merged(0.13, 0.06, POSITIVE, turned=turned)[0]


@pytest.mark.parametrize("turned", [False, True])
def test_merged_lines_meet_where_both_say(turned):
    _, lines = merged(0.02, 0.02, POSITIVE, turned=turned)
    heights = lines.anchors[:, 1] + lines.lines[:, 0] * np.sin(lines.lines[:, 1])
    assert heights == pytest.approx([-0.01, -0.01], abs=1e-4)
    assert lines.covariance[2, 2] == pytest.approx(0.5 * 0.02**2, rel=0.01)


@pytest.mark.parametrize("turned", [False, True])
def test_lengths_of_boards_and_walls(turned):
    lines = parallel(0.2, NEGATIVE, turned=turned)
    lines.covariance = np.diag([1e-4, 1e-6] * 2)
    assert wall_kinds(lines) == (0.0, pytest.approx(1.8))
    lines.seen[0, NEGATIVE] = [0.0, 0.7]
    assert wall_kinds(lines)[0] == pytest.approx(0.7)
