"""The graph of local maps while a log is driven: causality, places that are recognised, and the errors of odometry."""

from dataclasses import replace

import numpy as np
import pytest
from support.corridors import SIX_BEAMS, corridor_log

from limslam_agent.config.presets import preset
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.replay import hand_over
from limslam_agent.replay.filter_estimate import FilterEstimate
from limslam_agent.slam.online_graph.online_graph import Beams, OnlineGraph
from limslam_agent.status.status import Status
from limslam_env.geometry import se2
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


def test_the_position_becomes_uncertain_until_a_place_is_recognised(lap):
    stds = lap[2][4]
    assert stds[0] == 0.0
    assert stds.max() > 0.5
    assert stds[-1] < 0.5 * stds.max()


def test_the_local_frame_jumps_only_at_the_key_pose_after_a_job(lap):
    data, _, (_, poses, _, jobs, _) = lap
    jumps = se2.between(poses[:-1], poses[1:])
    moved = np.hypot(*(jumps - se2.between(data.odometry[:-1], data.odometry[1:]))[:, :2].T)
    assert moved[jobs[1:]].max() < 0.02
    assert moved.max() > 0.1


def test_the_missing_turn_of_the_odometry_is_found(lap):
    _, _, (graph, *_) = lap
    errors = graph.errors
    assert abs(np.degrees(errors.mean[0]) - 1.0) < 3.0 * np.degrees(np.sqrt(np.linalg.inv(errors.information)[0, 0]))
    assert abs(np.degrees(errors.mean[0]) - 1.0) < 0.4


def test_the_graph_goes_on_once_the_filter_is_lost(monkeypatch):
    data, truth = corridor_log(laps=1, bias=BIAS)
    count, lost = 150, 90
    ranges = data.ranges[:count].astype(np.float32)
    ranges[100, 0] = np.nan
    scans = np.ones(count, dtype=bool)
    log = RecordedLog(SIX_BEAMS, data.time[:count], ranges, scans, truth[0], odometry=data.odometry[:count])
    config = preset("graph", NominalNoise(0.01))
    seen = {"events": 0}

    def status(_):
        return Status("lost", "so") if seen["events"] > lost else Status()

    monkeypatch.setattr(FilterEstimate, "status", property(status))
    both = hand_over.HandedOverEstimate(Mapper(SIX_BEAMS, config, log.start_pose), log, config.smoothing)
    alone = Mapper(SIX_BEAMS, config, log.start_pose)
    graph = OnlineGraph(Beams(data.origins, data.angles, data.max_range, both._data.range_std), log.start_pose)
    for row, observation in enumerate(log.observations()):
        seen["events"] += 1
        both.step(observation)
        alone.step(observation)
        graph.step(log.time[row], alone.odometry[0], both._data.ranges[row], both._data.hit[row])
        np.testing.assert_array_equal(both.odometry, alone.odometry[0])
        expected = alone.slam.pose if row < lost else graph.pose
        np.testing.assert_array_equal(both.pose, expected)
    assert both.handed_over == lost
    np.testing.assert_array_equal(both.covariance, graph.covariance)
    assert both.refused_readings == alone.slam.refused_readings == 1
    assert both.status.level == ("unsure" if graph.position_std > hand_over.MOST_STD else "ok")
    monkeypatch.setattr(OnlineGraph, "position_std", 2.34)
    assert both.status == Status("unsure", "the position in the map may be 2.3 m off")
    assert not both.places.records
