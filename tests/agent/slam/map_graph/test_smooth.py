"""The graph of local maps on whole logs: at the end, while a log is driven, and when odometry
misses reversing.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from support.corridors import EVERY, FOUR_BEAMS, SIX_BEAMS, corridor_log, loop_errors, walls
from support.data import data_folder
from support.drives import drive, room, straight, turn

from limslam_agent import Mapper, preset, read_log
from limslam_agent.config.graph import GraphConfig
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.logs.relations import read_relations, relation_errors, summary
from limslam_agent.replay.hand_over import LogEstimate
from limslam_agent.replay.smoothing import log_data
from limslam_agent.slam.map_graph.key_poses import LogData, choose_keys, delayed, integrate
from limslam_agent.slam.map_graph.loops import KEPT
from limslam_agent.slam.map_graph.online import OnlineGraph
from limslam_agent.slam.map_graph.reversing import (
    driven_backwards,
    reversed_distance,
    with_reversing,
)
from limslam_agent.slam.map_graph.stages import by_odometry, rounds
from limslam_agent.slam.map_graph.window import RecentEvents
from limslam_agent.status.status import Status
from limslam_env import NominalNoise
from limslam_env.geometry import se2

LAP = 345  # events, about
CONFIG = GraphConfig()


def first_events(log, count):
    return replace(
        log, **{name: getattr(log, name)[:count] for name in ("time", "odometry", "ranges", "hit")}
    )


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


def test_the_noise_of_odometry_is_learned_from_the_log(two_laps):
    log, truth, noisy = two_laps
    exact = smooth_log(replace(log, odometry=truth), truth[0], CONFIG)
    assert np.hypot(*(exact.poses - truth)[:, :2].T).max() < 0.1
    assumed = choose_keys(log, CONFIG).step_variances[:, 2].sum()
    learned = [each.learned.step_variances[:, 2].sum() / assumed for each in (exact, noisy)]
    assert learned[0] < 0.01 < learned[1] < 0.5
    # What odometry alone states follows from it: the odometry of ``noisy`` misses turns.
    stated = [np.trace(by_odometry(each, truth[0])[1]) for each in (exact, noisy)]
    assert stated[0] < 0.01 * stated[1]


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
    assert int(match[1]) >= sum(loop.reason == KEPT for loop in result.loops) >= 5


@pytest.mark.parametrize("earlier", [0.0, 0.004])
def test_rows_of_odometry_between_scans_change_nothing(two_laps, earlier):
    log, truth, result = two_laps
    rows = np.repeat(np.arange(len(log.time)), 2)
    hit = log.hit[rows]
    hit[::2] = False
    time = log.time[rows]
    time[::2] -= earlier
    split = replace(log, time=time, odometry=log.odometry[rows], ranges=log.ranges[rows], hit=hit)
    poses = smooth_log(split, truth[0], CONFIG).poses[1::2]
    assert np.abs(se2.between(poses, result.poses)).max() < 0.01


def test_few_scans_between_many_rows_of_odometry_come_out_right(two_laps):
    log, truth, _ = two_laps
    hit = log.hit & (np.arange(len(log.time)) % 4 == 2)[:, None]
    poses = smooth_log(replace(log, hit=hit), truth[0], CONFIG).poses
    assert loop_errors(poses, truth, LAP).mean() < 0.15


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
    assert result.loops == []
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


STOP = [(0.0, 0.0)] * 12
START = np.array([1.0, 1.0, 0.0])


def there_and_back(robot=SIX_BEAMS, noise=0.01):
    """A log with true odometry: ahead to a corner, back and round it, back twice more, and on."""
    turned = turn(90.0, robot)
    wheels = (
        straight(9.8) + STOP + straight(-1.6) + STOP + straight(1.6) + turned + straight(3.0) + STOP
    )
    wheels += straight(-0.6) + STOP + straight(1.2) + STOP + straight(-0.6) + STOP + straight(3.0)
    return recorded_drive(walls(), wheels, robot, noise)


def recorded_drive(world, wheels, robot=SIX_BEAMS, noise=0.01):
    observations, poses = drive(world, START, wheels, robot, noise)
    rows = np.arange(0, len(poses), EVERY)
    ranges = np.array([observations[row]["ranges"] for row in rows], dtype=float)
    hit = (ranges > robot.too_near) & (ranges < robot.too_far)
    time = 0.1 * np.asarray(rows, dtype=float)
    return LogData(
        time, poses[rows], ranges, hit, robot.beam_origins, robot.beam_angles, 5.0, noise
    )


def without_signs(log):
    moves = se2.between(log.odometry[:-1], log.odometry[1:])
    moves[moves[:, 0] < 0.0, :2] *= -1.0
    return replace(log, odometry=integrate(log.odometry[0], moves))


# With four beams only one stretch contradicts clearly that it was driven ahead.
@pytest.mark.parametrize(("robot", "fewest"), [(SIX_BEAMS, 2), (FOUR_BEAMS, 1)])
def test_all_stretches_are_found(robot, fewest):
    signed = there_and_back(robot)
    recorded = without_signs(signed)
    directed = with_reversing(
        recorded, replace(CONFIG, reversing=replace(CONFIG.reversing, fewest=fewest))
    )
    assert reversed_distance(recorded, directed) == (pytest.approx(2.8, abs=0.3), 3)
    assert np.hypot(*(recorded.odometry - signed.odometry)[-1, :2]) > 3.0
    assert np.hypot(*(directed.odometry - signed.odometry)[-1, :2]) < 0.5


def test_a_stretch_is_found_while_driving():
    wheels = (
        straight(9.8)
        + STOP
        + straight(-3.0)
        + STOP
        + straight(3.0)
        + turn(90.0, SIX_BEAMS)
        + straight(6.0)
    )
    signed = recorded_drive(walls(), wheels)
    log = without_signs(signed)
    config = replace(CONFIG, reversing=replace(CONFIG.reversing, fewest=1))
    graph = OnlineGraph(log, log.odometry[0], config)
    poses = []
    for event in zip(log.time, log.odometry, log.ranges, log.hit, strict=True):
        graph.step(*event)
        poses.append(graph.pose)
    off = np.hypot(*(np.array(poses) - signed.odometry)[:, :2].T)
    # It is found before its end: what was driven since the last job is not smoothed yet.
    assert off.max() < 4.0
    assert np.hypot(*(log.odometry - signed.odometry)[-1, :2]) > 3.0
    assert off[-1] < 0.5


def test_a_tiny_step_back_is_no_proof_that_a_stretch_was_driven_backwards():
    log = recorded_drive(walls(), straight(6.0) + STOP + straight(4.0))
    moves = se2.between(log.odometry[:-1], log.odometry[1:])
    assert not list(driven_backwards(log, CONFIG, 0))
    moves[-20, 0] = -1e-5
    shaken = replace(log, odometry=integrate(log.odometry[0], moves))
    assert not list(driven_backwards(shaken, CONFIG, 0))


def test_odometry_that_reports_driving_backwards_is_believed():
    signed = there_and_back()
    assert with_reversing(signed, CONFIG) is signed


def test_a_drive_ahead_stays_as_it_is():
    log, _ = corridor_log(laps=1)
    assert with_reversing(log, CONFIG) is log
    blind = replace(log, hit=np.zeros_like(log.hit))
    assert with_reversing(blind, CONFIG) is blind


def test_a_log_of_short_beams_is_not_judged():
    # Beams of 1.5 m do not see the ground ahead of a stop, and driving back over known ground would
    # fit better.
    recorded = replace(without_signs(there_and_back()), max_range=1.5)
    assert with_reversing(recorded, CONFIG) is recorded


def test_a_corridor_with_stops_stays_as_it_is():
    # The known ground behind fits better than the new ground ahead, but nothing contradicts that
    # the robot drove ahead.
    corridor = np.vstack(
        (room(0.0, 0.0, 24.0, 2.0), room(9.0, -0.3, 9.9, 0.0), room(14.0, 1.8, 15.0, 2.0))
    )
    wheels = straight(6.0) + STOP
    for length in (0.5, 0.4, 0.6, 3.0, 0.5, 0.4, 3.0):
        wheels += straight(length) + STOP
    log = recorded_drive(corridor, wheels)
    assert with_reversing(log, CONFIG) is log
    by_score_alone = replace(
        CONFIG, reversing=replace(CONFIG.reversing, contradicted=0.0, fewest=1)
    )
    assert reversed_distance(log, with_reversing(log, by_score_alone))[0] > 0.3


BIAS = np.radians(1.0)
CUT = 400


def driven(data, start, count):
    """The graph after the first events, and at each: pose, covariance, whether there was a job, and
    position_std.
    """
    graph = OnlineGraph(data, start)
    found = []
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
    odometry = data.odometry.copy()
    ranges = data.ranges.copy()
    odometry[CUT + 5 :] = 0.0
    ranges[CUT + 5 :] = 1.0
    data = replace(data, odometry=odometry, ranges=ranges)
    _, cut_poses, cut_covariances, _, _ = driven(data, truth[0], CUT + 20)
    cut_poses = cut_poses[:CUT]
    cut_covariances = cut_covariances[:CUT]
    np.testing.assert_array_equal(cut_poses, poses[:CUT])
    np.testing.assert_array_equal(cut_covariances, covariances[:CUT])


def test_the_motion_of_the_last_moment_is_a_share_of_the_last_motions():
    recent = RecentEvents()
    for time, x in ((0.0, 0.0), (1.0, 1.0), (2.0, 3.0)):
        pose = np.array([x, 0.0, 0.0])
        recent.append(time, pose, np.ones(6), np.ones(6, dtype=bool))
    for moment, ahead in ((0.5, 1.0), (1.5, 2.5), (9.0, 3.0), (-1.0, 0.0)):
        assert recent.motion_during(moment) == pytest.approx([ahead, 0.0, 0.0])


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


@pytest.mark.parametrize("blind", [slice(0, 150), slice(150, 420)])
def test_where_nothing_is_seen_the_graph_goes_on_by_odometry(blind):
    data, truth = corridor_log(laps=2, bias=0.0)
    hit = data.hit.copy()
    hit[blind] = False
    graph, poses, covariances, _, _ = driven(replace(data, hit=hit), truth[0], len(data.time))
    off = np.hypot(*(poses - truth)[:, :2].T)
    assert off.max() < 1.5
    assert off[-1] < 0.6
    # The motion that only odometry tells is part of the chain of chunks, with its uncertainty.
    assert covariances[blind.stop - 1, :2, :2].trace() > covariances[blind.start, :2, :2].trace()
    travel = [chunk.travel for chunk in graph.places.maps]
    driven_blind = np.hypot(*np.diff(truth[blind, :2], axis=0).T).sum()
    assert np.diff(travel, prepend=0.0).max() == pytest.approx(driven_blind, abs=12.0)
    longest = int(np.argmax(np.diff(travel))) if blind.start else 0
    variances = graph.places.hops.covariances[:, :2, :2].trace(axis1=1, axis2=2)
    assert not blind.start or variances.argmax() == longest


def test_a_robot_that_stands_for_long_goes_on_as_before():
    data, truth = corridor_log(laps=1, bias=0.0)
    stand = 100
    count = len(data.time)
    rows = np.concatenate((np.arange(stand), np.full(2000, stand), np.arange(stand, count)))
    standing = replace(
        data,
        time=0.4 * np.arange(len(rows)),
        odometry=data.odometry[rows],
        ranges=data.ranges[rows],
        hit=data.hit[rows],
    )
    graph, poses, _, _, _ = driven(standing, truth[0], len(rows))
    # Ranges may be older than their time, and the first ones be measured before the stop.
    np.testing.assert_allclose(
        poses[stand + 1 : stand + 2000], poses[stand + 2000][None].repeat(1999, 0)
    )
    assert np.hypot(*(poses[-1] - truth[-1])[:2]) < 0.5
    assert graph.places is not None


def log_of(data, start, count):
    return RecordedLog(
        SIX_BEAMS,
        data.time[:count],
        data.ranges[:count].astype(np.float32),
        np.ones(count, dtype=bool),
        start,
        odometry=data.odometry[:count],
    )


def test_the_graph_goes_on_from_a_doubtful_filter(monkeypatch, lap):
    data, truth, _ = lap
    log = log_of(data, truth[0], len(data.time))
    config = preset("graph", NominalNoise(0.01))
    odometry = iter(data.odometry)
    doubtful = Mapper(SIX_BEAMS, config, log.start_pose)
    monkeypatch.setattr(Mapper, "step", lambda *_: None)
    monkeypatch.setattr(Mapper, "odometry", property(lambda _: [next(odometry)]), raising=False)
    monkeypatch.setattr(Mapper, "statuses", property(lambda _: [Status("unsure", "")]))
    both = LogEstimate(doubtful, log)
    observations = iter(log.observations())
    while both.handed_over is None:
        both.step(next(observations))
    # The first chunk takes 7 m.
    driven = np.hypot(*np.diff(data.odometry[: both.handed_over + 1, :2], axis=0).T).sum()
    assert 7.0 <= driven < 7.5


def test_the_graph_goes_on_once_the_filter_is_lost(monkeypatch):
    data, truth = corridor_log(laps=1, bias=BIAS)
    count = 150
    lost = 90
    log = log_of(data, truth[0], count)
    config = preset("graph", NominalNoise(0.01))
    steps = []
    is_lost = property(lambda _: [Status("lost", "") if len(steps) > lost else Status()])
    monkeypatch.setattr(Mapper, "statuses", is_lost)
    both = LogEstimate(Mapper(SIX_BEAMS, config, log.start_pose), log)
    alone = Mapper(SIX_BEAMS, config, log.start_pose)
    for observation in log.observations():
        steps.append(observation)
        pose, _, odometry, *_ = both.step(observation)
        alone.step(observation)
        np.testing.assert_array_equal(odometry, alone.odometry[0])
        assert np.array_equal(pose, alone.slam.pose) == (len(steps) <= lost)
    assert both.handed_over == lost
    assert np.hypot(*(pose - truth[count - 1])[:2]) < 0.5
    monkeypatch.setattr(OnlineGraph, "position_std", 2.34)
    assert both.status == Status(
        "unsure",
        "the chance that the position in the map is more than 0.5 m off is 96 % "
        "(standard deviation 2.34 m)",
    )
