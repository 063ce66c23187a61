"""Signals of a smoothed path that need no truth, and the status that follows from them."""

from dataclasses import replace

import numpy as np
import pytest
from support.corridors import FOUR_BEAMS, corridor_log

from limslam_agent.config.graph import GraphConfig, RoundConfig
from limslam_agent.output.summary import replay_summary
from limslam_agent.replay.smoothing import trusted_path
from limslam_agent.replay.trust import PathSignals, _reach, longest_loose, reach_of_agreement
from limslam_agent.slam.graph.key_poses import ERRORS, Trajectory, choose_keys

BRIEF = GraphConfig(rounds=RoundConfig(hops=(1.0, 0.8), iterations=(6, 6), orientations=(0.0,)))
SURE = PathSignals(driven=100.0, size=8.0, points=3000, confirmed=0.5, contradicted=0.02, position_std=0.3)


def test_the_longest_stretch_without_a_loop_is_found():
    travel = np.array([0.0, 10.0, 20.0, 30.0, 60.0, 70.0, 75.0])
    assert longest_loose(travel, np.zeros((0, 2), dtype=int)) == (0, 6)
    assert longest_loose(travel, np.array([[2, 0]])) == (2, 6)
    assert longest_loose(travel, np.array([[1, 0], [6, 4]])) == (1, 4)
    assert longest_loose(travel, np.array([[0, 5], [1, 2]])) == (5, 6)


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (SURE, ""),
        (replace(SURE, confirmed=0.0, contradicted=0.0), "no other visit of a place confirms what was seen"),
        (replace(SURE, contradicted=0.1), "visits of a place contradict each other at 17% of the points"),
        (
            replace(SURE, doubtful_times=(12.3, 40.0)),
            "visits contradict each other much more than elsewhere after 12, 40 s",
        ),
        (
            replace(SURE, bend_times=(33.2, 91.0)),
            "the path is bent more than odometry and walls allow after 33, 91 s",
        ),
        (
            replace(SURE, position_std=0.7, loose=(3.0, 61.0)),
            "positions may be 0.7 m off, as no recognised place holds the path from 3 to 61 s",
        ),
        (replace(SURE, position_std=0.7, size=20.0), ""),  # of a large building
        (
            replace(SURE, position_std=1.3, size=20.0),
            "positions may be 1.3 m off, as no recognised place holds the path",
        ),
    ],
)
def test_the_status_names_each_reason(found, words):
    assert (found.status.level, found.status.reason) == ("unsure" if words else "ok", words)


def test_another_path_is_better_if_its_visits_agree_better_on_as_much():
    wrong = replace(SURE, confirmed=0.5, contradicted=0.05)
    assert wrong.is_worse_than(replace(wrong, confirmed=0.4, contradicted=0.03))
    assert not wrong.is_worse_than(replace(wrong, confirmed=0.4, contradicted=0.05))
    assert not wrong.is_worse_than(replace(wrong, confirmed=0.02, contradicted=0.0))


def test_the_summary_says_that_readings_are_few():
    assert len(replay_summary(SURE.figures)) == 1
    _, line = replay_summary(replace(SURE, points=620).figures)
    assert line.strip() == "6.2 readings of walls in a metre of driving: with fewer than 10, paths were often wrong"


def test_a_log_in_which_nothing_was_seen_is_not_trusted():
    data, truth = corridor_log(bias=0.0)
    _, _, judged, _ = trusted_path(replace(data, hit=np.zeros_like(data.hit)), truth[0], BRIEF)
    assert judged.status.level == "unsure"
    assert "no other visit of a place confirms what was seen" in judged.status.reason


def test_a_stretch_that_no_loop_holds_is_named():
    """The second lap is not driven to its end: nothing of the first lap's end is seen again."""
    data, truth = corridor_log(laps=1, bias=0.0)
    count = int(0.7 * len(truth))
    rows = {name: getattr(data, name)[:count] for name in ("time", "odometry", "ranges", "hit")}
    _, _, judged, _ = trusted_path(replace(data, **rows), truth[0], BRIEF)
    assert judged.loose == pytest.approx((0.0, data.time[count - 1] - data.time[0]), abs=3.0)
    assert judged.status.level == "unsure"


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


def test_ranges_at_which_few_points_were_judged_do_not_limit_the_reach():
    """Few readings are beyond 2 m, and those at 1.1 m happen to be contradicted."""
    ranges = np.concatenate((np.full(100, 0.6), np.full(40, 1.1), np.full(20, 2.6)))
    contradicted = np.zeros(160, dtype=bool)
    contradicted[100:130] = True
    assert _reach(ranges, ~contradicted, contradicted, 5.0) == 5.0
    many = np.concatenate((np.full(100, 1.6), np.full(60, 2.6)))
    assert _reach(many, many < 2.0, many > 2.0, 5.0) == 1.75


def test_a_range_that_rounding_has_made_too_long_is_counted():
    ranges, all_of, none = np.array([2.9, 3.0000000001]), np.array([True, False]), np.array([False, True])
    assert _reach(ranges, all_of, none, 3.0) == 3.0
