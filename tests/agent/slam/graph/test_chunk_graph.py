"""The graph of chunks: a loop closes, wrong loops and slips are survived, and corrections reach the key poses."""

import numpy as np
import pytest

from limslam_agent.slam.graph.agreement import supported
from limslam_agent.slam.graph.chunk_graph import ChunkGraph, Hops, Loop, joint_covariance, solve_annealed
from limslam_agent.slam.graph.local_maps import LocalMap
from limslam_env.geometry import se2

INFORMATION = np.diag([1.0 / 0.1**2, 1.0 / 0.1**2, 1.0 / 0.03**2])


def ring(laps=2, sides=4, each=6):
    """True poses of chunks 2.5 m apart round a square."""
    pose, poses = np.zeros(3), [np.zeros(3)]
    for step in range(laps * sides * each):
        turn = np.pi / 2.0 if step % each == each - 1 else 0.0
        pose = se2.compose(pose, np.array([2.5, 0.0, turn]))
        poses.append(pose)
    return np.array(poses)


def drifting(truth, bias=0.05, seed=0):
    """Hops with a constant heading error, and noise."""
    generator = np.random.default_rng(seed)
    motions = se2.between(truth[:-1], truth[1:])
    motions[:, 2] += bias
    motions += generator.normal(0.0, [0.03, 0.03, 0.01], motions.shape)
    covariance = np.diag([0.1**2, 0.1**2, 0.05**2])
    return Hops(motions, np.tile(covariance, (len(motions), 1, 1)))


def loops_of(truth, pairs):
    return [Loop(a, b, se2.between(truth[a], truth[b]), INFORMATION, 0.7) for a, b in pairs]


def worst(poses, truth):
    return np.hypot(*(poses - truth)[:, :2].T).max()


@pytest.fixture
def truth():
    return ring()


def right_pairs(truth):
    return [(number, number + 24) for number in range(0, len(truth) - 24, 3)]


def test_right_loops_bring_a_drifting_chain_back(truth):
    hops = drifting(truth)
    alone, _ = solve_annealed(truth[0], hops, [])
    closed, weights = solve_annealed(truth[0], hops, loops_of(truth, right_pairs(truth)))
    revisits = np.hypot(*(closed[24:48] - closed[:24])[:, :2].T)
    assert worst(alone, truth) > 10.0
    assert revisits.max() < 0.5
    assert np.all(weights > 0.5)


def test_wrong_loops_lose_their_weight(truth):
    generator = np.random.default_rng(4)
    hops, right = drifting(truth, bias=0.02), loops_of(truth, right_pairs(truth))
    wrong = [
        Loop(int(a), int(a) + 15, generator.normal(0.0, 2.0, 3), INFORMATION, 0.7) for a in generator.integers(0, 30, 5)
    ]
    with_wrong, weights = solve_annealed(truth[0], hops, right + wrong)
    without, _ = solve_annealed(truth[0], hops, right)
    assert np.all(weights[len(right) :] < 0.1)
    assert np.all(weights[: len(right)] > 0.5)
    assert worst(with_wrong, without) < 0.5


def test_covariance_of_a_chain_is_that_of_compounded_motions():
    truth = ring(laps=1)[:4]
    hops = drifting(truth, bias=0.0)
    poses, _ = solve_annealed(truth[0], hops, [])
    joint = joint_covariance(poses, hops, [])
    covariance = np.zeros((3, 3))
    for row in range(3):
        by_pose, by_motion = se2.compose_jacobians(poses[row], hops.motions[row])
        covariance = by_pose @ covariance @ by_pose.T + by_motion @ hops.covariances[row] @ by_motion.T
    assert np.allclose(joint[9:, 9:], covariance, atol=1e-6)


def test_a_lone_loop_has_no_support_and_two_that_agree_have(truth):
    travel = 2.5 * np.arange(len(truth))
    pair = loops_of(truth, [(0, 24), (1, 25)])
    astray = Loop(10, 40, np.array([1.0, 1.0, 1.0]), INFORMATION, 0.8)
    same_chunk = loops_of(truth, [(12, 36), (13, 36)])
    found = supported([*pair, astray, *same_chunk], truth, travel)
    assert found.tolist() == [True, True, False, False, False]
    assert supported([], truth, travel).tolist() == []


def test_the_covariance_stays_symmetric_and_positive_over_many_loops():
    truth = ring(laps=6)
    hops = drifting(truth, bias=0.0)
    blank = [LocalMap(2.5 * n, np.zeros((0, 2)), np.zeros((2, 2), np.int8), 0.1) for n in range(len(truth))]
    graph = ChunkGraph(blank[0], truth[0])
    for newest in range(1, len(truth)):
        graph.add(blank[newest], hops.motions[newest - 1 : newest], hops.covariances[newest - 1])
        graph.close(loops_of(truth, [(old, newest) for old in range(newest % 24, newest - 12, 24)]))
    covariance = graph.covariance
    assert np.allclose(covariance, covariance.T, atol=1e-9)
    assert np.linalg.eigvalsh(covariance).min() > -1e-9
