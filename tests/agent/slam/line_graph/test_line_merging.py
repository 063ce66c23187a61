"""Two lines that were read from opposite sides are one wall only if they are a board."""

import numpy as np
import pytest

from limslam_agent.slam.core.wall_faces import NEGATIVE, POSITIVE
from limslam_agent.slam.line_graph.line_merging import merge_lines, share_side, wall_kinds
from limslam_agent.slam.line_graph.reassociation import ONE_WALL

LIMITS = np.array(ONE_WALL._replace(max_offset=0.4))
UNSEEN = [np.inf, -np.inf]


def parallel(behind, second, *, turned=False):
    """Two lines along the x axis, the first read from y > 0, and the second, ``behind`` m below, from a side."""
    lines = np.array([[0.0, 0.5 * np.pi], [0.0, -0.5 * np.pi if turned else 0.5 * np.pi]])
    anchors = np.array([[0.3, 0.0], [0.5, -behind]])
    ends = np.array([[-1.0, 1.0], [-1.0, 1.0]])
    seen = np.array([[UNSEEN, UNSEEN], [UNSEEN, UNSEEN]])
    seen[0, POSITIVE] = ends[0]
    seen[1, 1 - second if turned else second] = ends[1]
    return lines, anchors, ends, seen


def merged(behind, std, second=NEGATIVE, kinds=(0.0, 0.0), *, turned=False):
    lines, anchors, ends, seen = parallel(behind, second, turned=turned)
    into = np.empty(2, dtype=np.int64)
    count = merge_lines(
        lines, anchors, ends, seen, np.diag([std**2, 1e-4] * 2), LIMITS, np.array(kinds), np.array([9.0, 9.0]), into
    )  # fmt: skip
    return count, seen[0]


@pytest.mark.parametrize("turned", [False, True])
def test_a_board_is_one_line_and_a_wall_two(turned):
    count, seen = merged(0.002, 0.01, turned=turned)
    assert count == 1
    assert (seen[:, 0] < seen[:, 1]).all()
    assert merged(0.13, 0.06, turned=turned)[0] == 0
    # The same difference, seen from one side, is a matter of chi-square alone.
    assert merged(0.13, 0.06, POSITIVE, turned=turned)[0] == 1


def test_what_is_known_of_a_building_decides_about_vague_lines():
    assert merged(0.05, 0.2)[0] == 0
    assert merged(0.05, 0.2, kinds=(20.0, 0.0))[0] == 1
    assert merged(0.05, 0.2, kinds=(20.0, 20.0))[0] == 0


def test_two_lines_of_which_little_is_known_are_left_apart_within_wide_limits():
    lines, anchors, ends, seen = parallel(0.5, POSITIVE)
    into, wide = np.empty(2, dtype=np.int64), ONE_WALL.wider(max_offset=0.8, max_angle=0.4, min_overlap=0.1)
    for limits, std, merges in ((wide, 1.0, 0), (wide, 0.2, 1), (wide._replace(weakest=np.inf), 1.0, 1)):
        parts = (lines.copy(), anchors, ends.copy(), seen.copy(), np.diag([std**2, (0.2 * std) ** 2] * 2))
        assert merge_lines(*parts, np.array(limits), np.zeros(2), np.array([9.0, 9.0]), into) == merges


@pytest.mark.parametrize("turned", [False, True])
def test_lengths_of_boards_and_walls(turned):
    lines, anchors, ends, seen = parallel(0.2, NEGATIVE, turned=turned)
    covariance, limits = np.diag([1e-4, 1e-6] * 2), np.array([np.inf, *LIMITS[1:]])
    assert wall_kinds(lines, anchors, ends, seen, covariance, limits) == (0.0, pytest.approx(1.8))
    seen[0, NEGATIVE] = [0.0, 0.7]
    assert wall_kinds(lines, anchors, ends, seen, covariance, limits)[0] == pytest.approx(0.7)


def test_lines_that_share_a_side():
    for second, wanted in ((POSITIVE, True), (NEGATIVE, False)):
        lines, anchors, _, seen = parallel(0.1, second)
        assert share_side(np.array([[0, 1]]), lines, anchors, seen).tolist() == [wanted]


@pytest.mark.parametrize("turned", [False, True])
def test_a_world_whose_place_is_unknown_does_not_merge_two_walls(turned):
    """The lines are known to 0.02 m beside each other, but the world may be shifted by 2.5 m along them."""
    lines, anchors, ends, seen = parallel(0.13, POSITIVE, turned=turned)
    lines[1, 1] += 0.04
    normals = np.stack((np.cos(lines[:, 1]), np.sin(lines[:, 1])), axis=1)
    by_shift = np.zeros((6, 2))
    by_shift[:4:2], by_shift[4:] = normals, normals[:, ::-1] * [-1.0, 1.0]
    covariance = np.diag([0.02**2, 1e-4] * 2 + [0.0, 0.0]) + by_shift @ np.diag([2.5**2, 0.0]) @ by_shift.T
    merges = [
        merge_lines(
            lines.copy(), anchors, ends.copy(), seen.copy(), covariance[:size, :size].copy(), LIMITS, np.zeros(2),
            np.array([9.0, 9.0]), np.empty(2, dtype=np.int64),
        )
        for size in (4, 6)
    ]  # fmt: skip
    assert merges == [1, 0]
