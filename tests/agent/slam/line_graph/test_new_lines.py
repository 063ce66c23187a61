"""Short faces that the filter has no landmarks of are found in the readings that no line explains."""

import numpy as np
import pytest
from support.smoother_runs import WALLS, noisy_run, state_from_motions, true_labels

from limslam_agent.slam.line_graph.new_lines import with_new_lines
from limslam_agent.slam.line_graph.reassociation import reassociate, solve_labels
from limslam_agent.slam.line_graph.smoothed_map import smoothed_map
from limslam_env.geometry import FloatArray, segment


def polygon(corners: int, across: float) -> FloatArray:
    """A pillar (k, 4), m, in the middle of the room."""
    angles = 2.0 * np.pi * np.arange(corners + 1) / corners + 0.3
    points = np.array([1.5, 1.2]) + 0.5 * across * np.column_stack((np.cos(angles), np.sin(angles)))
    return np.hstack((points[:-1], points[1:]))


@pytest.mark.parametrize(
    ("corners", "across", "noise", "share"),
    [(4, 0.3, 0.0, 0.9), (8, 0.3, 0.0, 0.9), (6, 0.3, 0.02, 0.9), (4, 0.2, 0.04, 0.7)],
)
def test_the_faces_of_a_pillar_are_drawn_and_nothing_else(
    corners: int, across: float, noise: float, share: float
) -> None:
    walls = np.vstack((WALLS, polygon(corners, across)))
    problem, poses = noisy_run(5, noise, walls=walls)
    labels = true_labels(problem, poses, walls)
    known = np.where(labels < len(WALLS), labels, -1)
    _, segments = smoothed_map(reassociate(problem, state_from_motions(problem), known))
    faces, _ = segment.sample(walls[len(WALLS) :], 0.02)
    assert (segment.distances(faces, segments).min(axis=1) < 0.05).mean() > share
    drawn, _ = segment.sample(segments, 0.02)
    assert (segment.distances(drawn, walls).min(axis=1) < 0.05).mean() > 0.95


def test_five_readings_are_no_line() -> None:
    problem, poses = noisy_run(5)
    found = solve_labels(problem, state_from_motions(problem), true_labels(problem, poses))
    wall = np.flatnonzero(found.labels == 0)
    assert with_new_lines(problem, found.state, found.labels, wall).max() >= len(found.state.lines)
    assert with_new_lines(problem, found.state, found.labels, wall[:5]).max() < len(found.state.lines)
