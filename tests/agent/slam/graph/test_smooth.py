"""Whole logs: laps of a simulated corridor with wrong odometry come out right, and so do the recorded ones."""

import re
from dataclasses import replace

import numpy as np
import pytest
from support.corridors import corridor_log, loop_errors
from support.data import data_folder

from limslam_agent import read_log
from limslam_agent.config.graph import GraphConfig
from limslam_agent.logs.relations import read_relations, relation_errors, summary
from limslam_agent.replay.smoothing import log_data
from limslam_agent.slam.graph.key_poses import delayed
from limslam_agent.slam.graph.smooth import rounds
from limslam_env.geometry import se2

LAP = 345  # events, about
CONFIG = GraphConfig()


def first_events(log, count):
    return replace(log, **{name: getattr(log, name)[:count] for name in ("time", "odometry", "ranges", "hit")})


def smooth_log(log, start, config=None, report=lambda _: None):
    return next(rounds(log, start, config or GraphConfig(), report))


@pytest.fixture(scope="module")
def two_laps():
    log, truth = corridor_log()
    return log, truth, smooth_log(log, truth[0], CONFIG)


def test_biased_odometry_comes_out_right(two_laps):
    log, truth, result = two_laps
    assert loop_errors(log.odometry, truth, LAP).mean() > 3.0
    assert loop_errors(result.poses, truth, LAP).mean() < 0.1
    assert np.hypot(*(result.poses - truth)[:, :2].T).mean() < 0.5


def test_ranges_that_are_late_and_beams_that_are_turned_come_out_right(two_laps):
    log, truth, _ = two_laps
    late = replace(delayed(log, -0.2), angles=log.angles - np.radians(2.0))
    result = smooth_log(late, truth[0], CONFIG)
    assert result.errors[3] == pytest.approx(0.2, abs=0.05)
    assert np.degrees(result.errors[4]) == pytest.approx(-2.0, abs=0.7)
    assert loop_errors(result.poses, truth, LAP).mean() < 0.1


def test_the_same_log_gives_the_same_poses_and_the_stages_are_reported(two_laps):
    log, truth, result = two_laps
    stages: list[str] = []
    assert np.array_equal(smooth_log(log, truth[0], CONFIG, stages.append).poses, result.poses)
    assert stages[:2] == ["local smoothing", "search for loops"]
    match = re.fullmatch(r"all poses, (\d+) loops", stages[2])
    assert int(match[1]) >= sum(verdict.kept for verdict in result.verdicts) >= 5


def test_start_pose_and_frame_of_odometry_only_move_the_result(two_laps):
    log, truth, result = two_laps
    start = np.array([3.7, -12.2, 2.5])
    elsewhere = replace(log, odometry=se2.compose(np.array([576.5, 0.1, -2.25]), log.odometry))
    moved = smooth_log(elsewhere, start, CONFIG)
    motion = se2.compose(start, se2.inverse(truth[0]))
    assert np.allclose(moved.poses[0], start, atol=1e-6)
    assert np.abs(se2.between(se2.compose(motion, result.poses), moved.poses)).max() < 0.01


def test_a_slip_of_the_wheels_is_survived():
    log, truth = corridor_log(slip=np.radians(25.0), seed=1)
    assert loop_errors(smooth_log(log, truth[0], CONFIG).poses, truth, LAP).mean() < 0.1


def test_a_log_without_readings_is_its_odometry():
    log, truth = corridor_log(laps=1)
    result = smooth_log(replace(log, hit=np.zeros_like(log.hit)), truth[0])
    assert result.kind == "odometry"
    assert np.allclose(result.poses[:, :2], se2.compose(truth[0], log.odometry)[:, :2], atol=1e-4)


@pytest.mark.parametrize("count", [1, 2, 30])
def test_a_short_log_needs_no_loops(count):
    log, truth = corridor_log(laps=1)
    result = smooth_log(first_events(log, count), truth[0])
    assert result.verdicts == []
    assert np.abs(result.poses - truth[:count]).max() < 0.3


RECORDED = {
    "fr079": ("fr079/fr079_raw.clf.gz", "fr079/fr079.relations.gz", 0.10, 2.5),
    "csail": ("csail/mit-csail.clf.gz", "csail/csail_pseudo.relations.gz", 0.15, 5.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDED)
def test_a_recorded_log_is_as_good_as_published(name):
    path, relations, metres, degrees = RECORDED[name]
    log = read_log(data_folder() / path, (90.0, 54.0, 18.0, -18.0, -54.0, -90.0), 5.0)
    result = smooth_log(log_data(log, log.odometry, 0.0), log.start_pose)
    known = read_relations(data_folder() / relations)
    figures = summary(relation_errors(known, log.time, result.poses, log.odometry))
    assert figures["relation_error_m"] < metres
    assert figures["relation_error_deg"] < degrees
    assert figures["loop_relation_error_m"] < 0.2
