"""Two logs of wheel travel: joined if one map fits in the other, otherwise two maps, and one folder for both."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from support.command_line import call
from support.corridors import SIX_BEAMS, corridor_log, later_part, plain_walls, uneven_walls
from support.drives import ROBOT, along, drive

from limslam_agent import preset
from limslam_agent.cli.main import main
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.logs.relations import Relations
from limslam_agent.output.finished_run import FolderError, read_run
from limslam_agent.replay.joined_lines import joined_run
from limslam_agent.replay.replay import replay_log
from limslam_agent.replay.two_logs import check_logs, joined
from limslam_agent.replay.two_logs_output import LOG_FOLDERS, relation_scores
from limslam_agent.slam.merging.merge import Merging
from limslam_env.geometry import se2
from limslam_env.interface import NominalNoise

CONFIG = preset("graph", NominalNoise(0.01))
CORNERS = [(1.0, 1.0), (11.0, 1.0), (11.0, 8.0), (1.0, 8.0)]

limslam = partial(call, main)


def silent(_):
    """Report nothing."""


def wheel_log(places, heading, seed, world=None):
    """A log in a frame of its own, and the true poses."""
    start = np.array([*places[0], heading])
    walls = uneven_walls() if world is None else world
    seen, truth = drive(walls, start, along(places, heading), noise=0.01, seed=seed)
    log = RecordedLog(
        robot=ROBOT,
        time=0.1 * np.arange(len(seen)),
        ranges=np.array([each["ranges"] for each in seen]),
        has_scan=np.ones(len(seen), dtype=bool),
        start_pose=np.zeros(3),
        wheels=np.array([each["wheels"] for each in seen], dtype=float),
    )
    return log, truth


def lap_from(number):
    return [*CORNERS[number:], *CORNERS[: number + 1]]


@pytest.fixture(scope="module")
def replays():
    one, truth = wheel_log(lap_from(0), 0.0, 0)
    other, later = wheel_log([*lap_from(2), (1.0, 5.0)], np.pi, 1)
    return (replay_log(one, CONFIG), replay_log(other, CONFIG)), truth, later


@pytest.fixture(scope="module")
def both(replays):
    return joined(replays[0], silent)


def test_the_second_log_lies_in_the_first_one(replays, both):
    (one, other), truth, later = replays
    assert both.is_joined, both.status.reason
    assert both.status.level == "ok"
    assert both.unplaced is None
    assert [len(each) for each in both.poses] == [len(one.log), len(other.log)]
    for poses, true in zip(both.poses, (truth, later), strict=True):
        off = se2.between(se2.between(truth[0], true), poses)
        assert np.hypot(*off[:, :2].T).max() < 0.15
    np.testing.assert_allclose(both.record["start"], both.poses[1][0])
    assert len(both.segments) < len(one.segments) + len(other.segments)


def test_the_shorter_run_waits_at_its_end(replays):
    (one, other), _, _ = replays
    runs = one.smoothed.basis, other.smoothed.basis
    run = joined_run(runs, np.zeros(3))
    short = min(len(each.poses) for each in runs)
    which = int(np.argmin([len(each.poses) for each in runs]))
    assert len(run.poses) == max(len(each.poses) for each in runs)
    assert not run.usable[short:, which].any()
    assert abs(run.wheels[short:, which].sum(axis=0)).max() < 0.02
    assert (1, 1) in run.breaks
    assert not run.usable[0, 1].any()
    assert {record.robot for record in run.associations} == {0, 1}
    numbers = [{each.landmark for each in run.associations if each.robot == robot} for robot in (0, 1)]
    assert not numbers[0] & numbers[1]


def test_a_building_that_looks_the_same_after_half_a_turn_is_refused():
    logs = [
        wheel_log(lap_from(number), heading, number, plain_walls())[0] for number, heading in ((0, 0.0), (2, np.pi))
    ]
    found = joined((replay_log(logs[0], CONFIG), replay_log(logs[1], CONFIG)), silent)
    assert not found.is_joined
    assert found.status.level == "unsure"
    assert "ambiguous" in found.status.reason
    assert found.unplaced is not None
    assert np.array_equal(found.segments, found.replays[0].segments)


def test_relations_between_the_logs_are_scored_if_the_times_are_apart(replays, both):
    (_, other), truth, later = replays
    times = np.array([1.0, 20.0]), np.array([2.0, 30.0])
    known = Relations(*times, se2.between(truth[[10, 200]], truth[[20, 300]]))
    scores = relation_scores(both, (known, None))
    assert scores["smoothed_relation_error_m"] < 0.05
    assert not any("between" in name for name in scores)
    assert len(later) == len(other.log)


def pose_log(data):
    return RecordedLog(
        robot=SIX_BEAMS, time=data.time, ranges=data.ranges.astype(np.float32), start_pose=np.zeros(3),
        has_scan=np.ones(len(data.time), dtype=bool), odometry=data.odometry,
    )  # fmt: skip


def test_logs_are_joined_with_what_each_of_them_has_found_about_its_sensor(monkeypatch):
    data, _ = corridor_log(laps=1)
    replay = replay_log(pose_log(later_part(data, len(data.time) - 40)), CONFIG)
    used = replay.smoothed.data
    limited = replace(used, hit=used.hit & (used.ranges < 2.0), max_range=2.0)
    chains = []

    def not_merged(first, second, *_args, **_kwargs):
        chains.extend((first, second))
        return Merging(first, second, None, "no", {"event": "not joined", "reason": "no"})

    monkeypatch.setattr("limslam_agent.replay.two_logs.merge", not_merged)
    joined((replace(replay, smoothed=replace(replay.smoothed, data=limited)), replay), silent)
    assert [each.data.max_range for each in chains] == [2.0, SIX_BEAMS.max_ranges.max()]
    assert len(chains[0].keys.point_event) < len(chains[1].keys.point_event)


def test_logs_that_cannot_be_joined_are_refused(replays):
    one = replays[0][0].log
    data, _ = corridor_log(laps=1)
    poses = pose_log(data)
    with pytest.raises(ValueError, match="3 logs"):
        check_logs([one, one, one], CONFIG)
    with pytest.raises(ValueError, match="must have the same"):
        check_logs([one, poses], CONFIG)
    with pytest.raises(ValueError, match="needs the preset graph"):
        check_logs([one, one], preset("consistent"))
    assert len(later_part(data, 10).time) == len(data.time) - 10


TABLE = "t,left,right,r_90,r_45,r_15,r_-15,r_-45,r_-90\n" + "".join(
    f"{0.1 * row:.1f},0.02,0.02,0.6,0.9,1.4,1.4,0.9,0.7\n" for row in range(60)
)


@pytest.fixture
def tables(tmp_path):
    paths = [tmp_path / "one.csv", tmp_path / "other.csv"]
    for path in paths:
        path.write_text(TABLE)
    return paths


def test_two_short_logs_leave_one_folder_with_two_maps(tables, tmp_path):
    folder = tmp_path / "both"
    done = limslam("replay", *tables, "--robot", "paper", "--out", folder)
    assert done.returncode == 0, done.stderr
    assert "not joined" in done.stdout
    assert "unsure" in done.stdout
    for name in (*LOG_FOLDERS, "map.json", "map_unplaced.json", "map.png", "run.toml", "trajectory_smoothed_1.tum"):
        assert (folder / name).exists(), name
    result = json.loads((folder / "result.json").read_text())
    assert result["metrics"]["status"] == "unsure"
    assert result["record"]["places"][0]["event"] == "not joined"
    shown = limslam("show", folder, "--out", tmp_path / "sheet.png")
    assert shown.returncode == 0, shown.stderr
    assert limslam("show", folder / LOG_FOLDERS[1]).returncode == 0
    with pytest.raises(FolderError, match="times of their own"):
        read_run(folder).with_one_time()
    again = limslam("replay", "--config", folder / "run.toml", "--out", tmp_path / "again")
    assert again.returncode == 0, again.stderr
    assert (tmp_path / "again" / "map_unplaced.json").read_text() == (folder / "map_unplaced.json").read_text()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--map", "x"], "--map is for one log"),
        (["--calibrate", "x"], "--calibrate is for one log"),
        (["--preset", "consistent"], "needs the preset graph"),
        (["third.csv"], "3 were given"),
    ],
)
def test_options_that_make_no_sense_with_two_logs_are_refused_in_one_line(tables, tmp_path, options, words):
    done = limslam("replay", *tables, "--robot", "paper", *options, "--out", tmp_path / "no")
    assert done.returncode == 2
    assert words in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "no").exists()


def test_relations_of_two_logs_need_two_logs(tables, tmp_path):
    done = limslam("replay", tables[0], "--relations", "a", "--relations", "b", "--out", tmp_path / "no")
    assert done.returncode == 2
    assert "two logs" in done.stderr
