"""Two logs of one building with an unknown relative start become one map, and logs that do not fit stay apart."""

import numpy as np
import pytest
from support.corridors import FOUR_BEAMS, corridor_log, later_part, plain_walls, uneven_walls
from support.drives import room

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.key_poses import APART
from limslam_agent.slam.graph.smooth import smooth_log
from limslam_agent.slam.merging.chains import Chain, joined_keys, poses_of_both
from limslam_agent.slam.merging.merge import NO_MATCH, merge
from limslam_env.geometry import se2

CONFIG = GraphConfig()
ELSEWHERE = np.array([20.0, -7.0, 2.1])
LATER = 170  # events: the second log begins on another side of the corridor


def chain(log):
    return Chain.of(log, smooth_log(log, np.zeros(3), CONFIG), CONFIG)


@pytest.fixture(scope="module")
def logs():
    one, truth = corridor_log(bias=np.radians(0.5), world=uneven_walls())
    other, later = corridor_log(bias=np.radians(-0.5), seed=1, world=uneven_walls())
    return chain(one), chain(later_part(other, LATER)), truth, later[LATER:]


@pytest.fixture(scope="module")
def merged(logs):
    first, second, _, _ = logs
    return merge(first, second.moved(ELSEWHERE), CONFIG)


def test_the_second_log_is_placed_in_the_first_one(logs, merged):
    _, _, truth, later = logs
    found, joint = merged, merged.joint
    assert joint is not None, merged.refusal
    assert merged.record["event"] == "joined"
    poses, others = poses_of_both(joint.trajectory, found.first, found.second)
    assert (len(poses), len(others)) == (len(truth), len(later))
    off = se2.between(se2.between(truth[0], later), se2.compose(se2.inverse(poses[0]), others))
    assert np.hypot(*off[:, :2].T).max() < 0.4
    assert merged.record["loops_between"] >= 3
    assert merged.record["match"]["runner_up"] < 0.5
    np.testing.assert_allclose(others[0], merged.record["start"], atol=1e-9)


def test_the_order_of_the_logs_does_not_matter(logs):
    first, second, truth, later = logs
    found = merge(second, first, CONFIG)
    joint = found.joint
    assert joint is not None
    poses, others = poses_of_both(joint.trajectory, found.first, found.second)
    off = se2.between(se2.between(later[0], truth), se2.compose(se2.inverse(poses[0]), others))
    assert np.hypot(*off[:, :2].T).max() < 0.4


def test_the_second_log_lies_far_behind_the_first_one(logs):
    first, second, _, _ = logs
    keys = joined_keys(first, second)
    count = len(first.keys)
    assert len(keys) == count + len(second.keys)
    assert keys.key_travel[count] - keys.key_travel[count - 1] >= APART
    assert keys.first_event[count] == len(first.data.time)
    assert len(keys.point_key) == len(first.keys.point_key) + len(second.keys.point_key)
    assert keys.point_key.max() < len(keys)


def test_a_corridor_that_looks_the_same_after_half_a_turn_is_ambiguous():
    one, _ = corridor_log(world=plain_walls())
    other, _ = corridor_log(world=plain_walls(), seed=1)
    found = merge(chain(one), chain(later_part(other, LATER)), CONFIG)
    assert found.joint is None
    assert found.refusal.startswith("ambiguous")
    assert found.record["reason"] == found.refusal


def test_logs_of_different_buildings_stay_apart(logs):
    hall = np.vstack((room(0.0, 0.0, 12.0, 9.0), room(3.5, 3.0, 4.0, 3.5), room(6.0, 5.0, 8.5, 6.0)))
    other, _ = corridor_log(world=hall, robot=FOUR_BEAMS, seed=2)
    found = merge(logs[0], chain(other), CONFIG)
    assert found.joint is None
    assert found.record["event"] == "not joined"
    assert found.refusal


def test_a_log_without_local_maps_is_not_placed(logs):
    log, _ = corridor_log(world=uneven_walls())
    short = later_part(log, len(log.time) - 12)
    found = merge(logs[0], chain(short), CONFIG)
    assert found.refusal == NO_MATCH


def test_a_joining_that_contradicts_itself_is_taken_back(logs, monkeypatch):
    first, second, _, _ = logs
    monkeypatch.setattr("limslam_agent.slam.merging.merge._LEAST_LOOPS", 1000)
    found = merge(first, second, CONFIG)
    assert found.joint is None
    assert found.refusal.startswith("joined and taken back: only")
    assert found.record["loops_between"] >= 3
