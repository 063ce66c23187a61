"""Signals of a smoothed path that need no truth, and the status that follows from them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.corridors import FOUR_BEAMS, corridor_log

from limslam_agent.config.graph import GraphConfig, RoundConfig
from limslam_agent.output.summary import replay_summary
from limslam_agent.replay.smoothing import _blind, trusted_path
from limslam_agent.replay.trust import PathSignals, _reach, crossings, odometry_variances, reach_of_agreement
from limslam_agent.slam.graph.agreement import KEPT, NO_SUPPORT, LoopVerdict, VisitCounts
from limslam_agent.slam.graph.chunk_graph import Loop
from limslam_agent.slam.graph.key_poses import ERRORS, Trajectory, choose_keys, motion_variances
from limslam_env.geometry import se2

BRIEF = GraphConfig(rounds=RoundConfig(hops=(1.0, 0.8), iterations=(6, 6), orientations=(0.0,)))

ROOM = np.array([[0.0, 0.0, 4.0, 0.0], [4.0, 0.0, 4.0, 3.0]])


def signals(driven=100.0, times=(), confirmed=0.5, contradicted=0.05, loops=20, bends=(), pieces=(0, 0), blind=0.0):
    return PathSignals(driven, tuple(times), confirmed, contradicted, loops, tuple(bends), pieces=pieces, blind=blind)


def test_a_path_crosses_a_wall_only_inside_of_its_ends():
    along = np.array([[-1.0, -1.0], [-1.0, 1.0], [0.1, -1.0], [2.0, 1.0], [5.0, 1.0], [5.0, 4.0], [3.0, 4.0]])
    assert crossings(along, ROOM).tolist() == [False, False, True, True, False, False]
    assert not crossings(along, np.zeros((0, 4))).any()
    assert not crossings(along[:1], ROOM).any()


def test_ground_without_walls_is_blind_unless_a_loop_spans_it():
    loop = Loop(2, 0, np.zeros(3), np.eye(3), 1.0, "along the way")
    counts = np.array([3, 3, 50, 3])
    visits = VisitCounts(np.array([0, 10, 20, 30]), counts, counts, 0 * counts)
    found = SimpleNamespace(
        keys=SimpleNamespace(first_event=2 * np.arange(40)), chunk_events=np.array([10, 20, 30]),
        verdicts=[LoopVerdict(loop, KEPT)],
    )  # fmt: skip
    assert _blind(found, visits).tolist() == [True, False, False, True]
    found.verdicts = [LoopVerdict(loop, NO_SUPPORT)]
    assert _blind(found, visits).tolist() == [True, True, False, True]


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (signals(), ""),
        (signals(times=(1.0, 2.0)), ""),
        (signals(driven=20.0, times=(1.0,)), ""),
        (signals(times=(1.0, 2.0, 3.0, 4.0)), "the path passes through walls at 4 places"),
        (signals(contradicted=0.2), "visits of a place contradict each other at 29% of the points"),
        (signals(confirmed=0.0, contradicted=0.0, loops=0), "no place was recognised again in 100 m"),
        (signals(blind=40.0), ""),
        (signals(blind=70.0), "hardly a wall was seen in 70 m that no recognised place holds"),
        (signals(driven=30.0, confirmed=0.0, contradicted=0.0, loops=0), ""),
        (signals(pieces=(236, 6)), ""),
        (signals(pieces=(20, 2)), ""),
        (signals(pieces=(45, 4)), ""),  # of a moved cupboard in a short log
        (signals(pieces=(60, 6)), "of 60 pieces of walls, 6 are where other visits saw free space"),
        (signals(pieces=(152, 15)), "of 152 pieces of walls, 15 are where other visits saw free space"),
        (signals(bends=(33.2, 91.0)), "the path is bent more than odometry and walls allow after 33, 91 s"),
    ],
)
def test_the_status_names_each_reason(found, words):
    assert (found.status.level, found.status.reason) == ("unsure" if words else "ok", words)


def test_a_share_of_no_pieces_of_walls_is_not_known():
    assert signals().figures["smoothed_contradicted_walls"] is None
    assert signals(pieces=(50, 5)).figures["smoothed_contradicted_walls"] == 0.1


def test_odometry_is_better_only_if_it_crosses_fewer_walls_and_agrees_better():
    bent = signals(times=range(6), confirmed=0.3, contradicted=0.2)
    assert bent.is_worse_than(signals(times=(1.0,), confirmed=0.4, contradicted=0.1))
    assert not bent.is_worse_than(signals(times=(1.0,), confirmed=0.2, contradicted=0.2))
    assert not bent.is_worse_than(signals(times=range(5), confirmed=0.4, contradicted=0.1))
    assert not signals(times=(1.0,)).is_worse_than(signals(confirmed=0.9))


def test_the_summary_says_when_a_path_may_be_wrong():
    lines = replay_summary({"status": "lost", "status_reason": "why", **signals(times=(3.2, 250.0)).figures})
    assert lines[1:3] == [
        "            ok at the end",
        "            may be wrong where the path passes through walls, after 3, 250 s",
    ]


def floor_log():
    """Two laps of a drone that tilts: whatever is farther than 2 m away, its beams see nothing, or the floor."""
    data, truth = corridor_log(bias=0.0, robot=FOUR_BEAMS)
    generator = np.random.default_rng(1)
    far = data.ranges > 2.0
    sees_floor = far & (generator.random(far.shape) < 0.3)
    floor = np.minimum(data.ranges, generator.uniform(2.0, 3.5, far.shape))
    hit = data.hit & (sees_floor | ~far)
    return replace(data, ranges=np.where(sees_floor, floor, data.ranges), hit=hit), truth


def reach_on(data, path):
    keys = choose_keys(data, BRIEF.keys)
    trajectory = Trajectory(path[keys.first_event], np.zeros(ERRORS))
    return reach_of_agreement(keys, trajectory, BRIEF, data.max_range)


def test_visits_agree_up_to_the_range_at_which_the_floor_comes_into_view():
    data, truth = floor_log()
    assert reach_on(data, truth) == 2.0
    assert reach_on(data, data.odometry + np.linspace(0.0, 2.0, len(truth))[:, None]) == data.max_range
    clean, truth = corridor_log(bias=0.0, robot=FOUR_BEAMS)
    assert reach_on(clean, truth) == clean.max_range


def test_a_log_whose_far_readings_contradict_each_other_is_smoothed_again_without_them(monkeypatch):
    # In this narrow corridor only few readings are far.
    monkeypatch.setattr("limslam_agent.replay.trust.MOST_CONTRADICTED", 0.025)
    data, truth = floor_log()
    stages: list[str] = []
    found, _, judged, used = trusted_path(data, truth[0], BRIEF, stages.append)
    assert judged.reach == judged.figures["smoothed_reach_m"] == 2.0
    assert used.max_range == 2.0
    assert not (used.hit & (used.ranges >= 2.0)).any()
    assert used.variances is not None
    assert any(stage.startswith("ranges up to 2 m, ") for stage in stages)
    assert judged.status.level == "ok"
    (line,) = (line for line in replay_summary(judged.figures) if "left out" in line)
    assert line.strip() == "readings beyond 2 m left out at the end: visits of a place contradict them"
    assert len(found.keys.in_robot) < data.hit.sum()
    assert np.hypot(*(found.poses - truth)[:, :2].T).max() < 0.3


def test_the_first_look_only_puts_off_the_search_of_all_frames(monkeypatch):
    """No search of the first look is repeated, and groups of loops are refused by the limits of the settings."""
    monkeypatch.setattr("limslam_agent.replay.trust.MOST_CONTRADICTED", -1.0)
    config = GraphConfig(rounds=RoundConfig(hops=(1.0, 0.8), iterations=(3, 3), orientations=(0.0, 0.3, 0.6)))
    data, truth = corridor_log(laps=1, bias=0.0)
    stages: list[str] = []
    found, _, judged, used = trusted_path(data, truth[0], config, stages.append)
    assert judged.contradicts_itself
    assert used is data
    begins = [stage for stage in stages if "local smoothing" in stage]
    assert begins == [f"frame {number} of 3, local smoothing" for number in (1, 2, 3)]
    assert len(found.scores) == 9  # three starts a frame
    assert found.further is None


def test_a_range_that_rounding_has_made_too_long_is_counted():
    ranges, all_of, none = np.array([2.9, 3.0000000001]), np.array([True, False]), np.array([False, True])
    assert _reach(ranges, all_of, none, 3.0) == 3.0


def test_the_variances_of_odometry_follow_its_errors():
    data, truth = corridor_log(bias=0.0)
    keys = choose_keys(data, BRIEF.keys)
    trajectory = Trajectory(truth[keys.first_event], np.zeros(ERRORS))
    found = odometry_variances(data, keys, trajectory)
    steps = se2.between(data.odometry[:-1], data.odometry[1:])
    assumed = motion_variances(np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2]))
    ratios = found[1:] / assumed
    assert found.shape == (len(data.time), 3)
    assert ratios == pytest.approx(np.broadcast_to(ratios[0], ratios.shape))
    # The odometry of this log errs by 2 cm, 1 cm and 1.1 deg after a metre; 5 cm, 5 cm and 2 deg and more are assumed.
    assert (ratios[0] < 0.6).all()
