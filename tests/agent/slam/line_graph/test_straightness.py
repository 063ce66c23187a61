"""Lines that are more than one wall are divided."""

import numpy as np
import pytest
from support.smoother_runs import noisy_run, true_labels

from limslam_agent.slam.line_graph.problem import state_from_poses
from limslam_agent.slam.line_graph.reassociation import solve_labels, straightened


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.04])
def test_straight_walls_stay_whole(noise):
    problem, poses = noisy_run(1, noise)
    found = solve_labels(problem, state_from_poses(problem, np.moveaxis(poses, 0, 1)), true_labels(problem, poses))
    result = straightened(found)
    assert len(result.state.lines) == len(found.state.lines)
    assert np.mean(result.labels == found.labels) > 0.99


def test_two_walls_with_one_line_are_divided():
    problem, poses = noisy_run(2, 0.04)
    wanted = true_labels(problem, poses)
    begin = solve_labels(problem, state_from_poses(problem, np.moveaxis(poses, 0, 1)), np.where(wanted == 1, 0, wanted))
    result = straightened(begin)
    pairs = np.zeros((result.labels.max() + 1, wanted.max() + 1), dtype=int)
    used = (result.labels >= 0) & (wanted >= 0)
    np.add.at(pairs, (result.labels[used], wanted[used]), 1)
    assert len(result.state.lines) > len(begin.state.lines)
    assert pairs.max(axis=1).sum() > 0.95 * used.sum()
