"""The map that is drawn from a solution, and the beams that contradict it."""

from dataclasses import replace

import numpy as np
from support.drives import room
from support.smoother_runs import (
    noisy_run,
    state_from_motions,
    true_labels,
)

from limslam_agent.slam.line_graph.reassociation import reassociate, solve_labels
from limslam_agent.slam.line_graph.smoothed_map import smoothed_map, tally


def truth(seed, noise=0.02, **changes):
    problem, poses = noisy_run(seed, noise, **changes)
    labels = true_labels(problem, poses, **({"walls": changes["walls"]} if "walls" in changes else {}))
    return solve_labels(problem, state_from_motions(problem), labels)


def test_beams_that_go_through_a_wall_are_counted():
    found = truth(3)
    assert tally(found)[1] == 0
    moved = found.state.lines.copy()
    line, anchor = found.state.lines[0], found.state.anchors[0]
    moved[0, 0] += 0.4 if anchor @ [np.cos(line[1]), np.sin(line[1])] < 1.0 else -0.4
    wrong = replace(found, solution=replace(found.solution, state=replace(found.state, lines=moved)))
    assert tally(wrong)[1] > 100


def test_the_map_has_the_walls_and_leaves_the_door_open():
    walls = np.vstack((room(0.0, 0.0, 3.0, 2.4)[1:], [[0.0, 0.0, 1.2, 0.0], [1.7, 0.0, 3.0, 0.0]]))
    found = truth(9, 0.02, walls=walls)
    joined = reassociate(found.problem, found.state, found.labels)
    landmarks, segments = smoothed_map(joined)
    low = segments[np.abs(segments[:, [1, 3]]).max(axis=1) < 0.1]
    covered = [min(x1, x2) < 1.45 < max(x1, x2) for x1, _, x2, _ in low]
    assert len(low) == 2
    assert not any(covered)
    assert len(segments) == 5
    assert sorted(row for mark in landmarks for row in mark.segments) == [0, 1, 2, 3, 4]
    for mark in landmarks:
        ends = segments[list(mark.segments)].reshape(-1, 2)
        assert np.abs(ends @ [np.cos(mark.theta), np.sin(mark.theta)] - mark.r).max() < 1e-9


def test_landmarks_lie_where_their_covariances_say():
    squared = []
    for seed in range(6):
        found = truth(20 + seed, 0.02)
        for mark in smoothed_map(found)[0]:
            wanted = min(TRUE_LINES, key=lambda line, mark=mark: abs(line[0] - mark.r) + abs(turn(line[1], mark.theta)))
            off = np.array([mark.r - wanted[0], turn(mark.theta, wanted[1])])
            squared.append(off @ np.linalg.solve(mark.covariance, off))
    assert 0.4 < np.mean(squared) / 2.0 < 2.0


TRUE_LINES = [(0.0, -0.5 * np.pi), (0.0, 0.5 * np.pi), (3.0, 0.0), (2.4, 0.5 * np.pi), (0.0, 0.0), (0.0, np.pi)]


def turn(first, second):
    return (first - second + np.pi) % (2.0 * np.pi) - np.pi
