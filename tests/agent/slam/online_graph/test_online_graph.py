"""The graph of local maps while a log is driven: causality, places that are recognised, and the errors of odometry."""

from dataclasses import replace

import numpy as np
import pytest
from support.corridors import SIX_BEAMS, corridor_log

from limslam_agent import Mapper, preset
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.replay import hand_over
from limslam_agent.replay.filter_estimate import FilterEstimate
from limslam_agent.slam.online_graph.online_graph import Beams, OnlineGraph
from limslam_agent.status.status import Status
from limslam_env.interface import NominalNoise

BIAS = np.radians(1.0)
CUT = 400


def driven(data, start, count):
    """The graph after the first events, and at each: pose, covariance, whether there was a job, and position_std."""
    beams = Beams(data.origins, data.angles, data.max_range, data.range_std)
    graph, found = OnlineGraph(beams, start), []
    for row in range(count):
        graph.step(data.time[row], data.odometry[row], data.ranges[row], data.hit[row])
        found.append((graph.pose, graph.covariance, graph.job_ms > 0.0, graph.position_std))
    return graph, *map(np.array, zip(*found, strict=True))


@pytest.fixture(scope="module")
def lap():
    data, truth = corridor_log(laps=2, bias=BIAS, slip=np.radians(10.0))
    return data, truth, driven(data, truth[0], len(data.time))


def test_a_pose_uses_no_later_event(lap):
    data, truth, (_, poses, covariances, _, _) = lap
    # Whatever comes after the cut, even nonsense, changes nothing before it.
    odometry, ranges = data.odometry.copy(), data.ranges.copy()
    odometry[CUT + 5 :], ranges[CUT + 5 :] = 0.0, 1.0
    data = replace(data, odometry=odometry, ranges=ranges)
    _, cut_poses, cut_covariances, _, _ = driven(data, truth[0], CUT + 20)
    cut_poses, cut_covariances = cut_poses[:CUT], cut_covariances[:CUT]
    np.testing.assert_array_equal(cut_poses, poses[:CUT])
    np.testing.assert_array_equal(cut_covariances, covariances[:CUT])


def test_a_place_is_recognised_and_the_pose_jumps_there(lap):
    _, truth, (graph, poses, covariances, _, _) = lap
    assert graph.places.loops
    assert all(loop.first < loop.second for loop in graph.places.loops)
    off = np.hypot(*(poses - truth)[:, :2].T)
    assert np.median(off[-200:]) < 0.3
    assert off[-200:].max() < 1.0
    spread = np.sqrt(covariances[:, 0, 0] + covariances[:, 1, 1])
    assert spread[-1] < 0.5 * spread.max()
    assert graph.position_std < 1.0


def test_the_graph_goes_on_once_the_filter_is_lost(monkeypatch):
    data, truth = corridor_log(laps=1, bias=BIAS)
    count, lost = 150, 90
    log = RecordedLog(
        SIX_BEAMS, data.time[:count], data.ranges[:count].astype(np.float32), np.ones(count, dtype=bool), truth[0],
        odometry=data.odometry[:count],
    )  # fmt: skip
    config, steps = preset("graph", NominalNoise(0.01)), []
    monkeypatch.setattr(
        FilterEstimate, "status", property(lambda _: Status("lost", "") if len(steps) > lost else Status())
    )
    both = hand_over.HandedOverEstimate(Mapper(SIX_BEAMS, config, log.start_pose), log, config.smoothing)
    alone = Mapper(SIX_BEAMS, config, log.start_pose)
    for observation in log.observations():
        steps.append(observation)
        both.step(observation)
        alone.step(observation)
        np.testing.assert_array_equal(both.odometry, alone.odometry[0])
        assert np.array_equal(both.pose, alone.slam.pose) == (len(steps) <= lost)
    assert both.handed_over == lost
    assert np.hypot(*(both.pose - truth[count - 1])[:2]) < 0.5
    monkeypatch.setattr(OnlineGraph, "position_std", 2.34)
    assert both.status == Status("unsure", "the position in the map may be 2.3 m off")
