"""Two logs of one building become one map, logs that do not fit stay apart, and one folder has the
results of both.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from support.command_line import limslam
from support.corridors import (
    FOUR_BEAMS,
    SIX_BEAMS,
    corridor_log,
    later_part,
    plain_walls,
    uneven_walls,
)
from support.drives import ROBOT, along, drive, room

from limslam_agent import preset, replay_log
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.logs.relations import Relations
from limslam_agent.output.finished_run import FolderError, read_run
from limslam_agent.two_logs.joining import check_logs, joined
from limslam_agent.two_logs.output import LOG_FOLDERS, relation_scores
from limslam_env import NominalNoise
from limslam_env.geometry import se2

CONFIG = preset("graph", NominalNoise(0.01))
CORNERS = [(1.0, 1.0), (11.0, 1.0), (11.0, 8.0), (1.0, 8.0)]
LATER = 170  # events: the second log begins on another side of the corridor


def silent(_):
    """Report nothing."""


def wheel_log(places, heading, seed, walls):
    """A log in a frame of its own, and the true poses."""
    start = np.array([*places[0], heading])
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


def pose_log(data, robot=SIX_BEAMS):
    return RecordedLog(
        robot=robot,
        time=data.time,
        ranges=data.ranges.astype(np.float32),
        start_pose=np.zeros(3),
        has_scan=np.ones(len(data.time), dtype=bool),
        odometry=data.odometry,
    )


def largest_error(both, truth, later):
    """The largest distance of a pose from the truth, in the frame of the first log's first pose."""
    errors = []
    for poses, true in zip(both.poses, (truth, later), strict=True):
        off = se2.between(
            se2.between(truth[0], true), se2.compose(se2.inverse(both.poses[0][0]), poses)
        )
        errors.append(np.hypot(*off[:, :2].T).max())
    return max(errors)


@pytest.fixture(scope="module")
def of_wheels():
    one, truth = wheel_log(lap_from(0), 0.0, 0, uneven_walls())
    other, later = wheel_log([*lap_from(2), (1.0, 5.0)], np.pi, 1, uneven_walls())
    both = joined((replay_log(one, CONFIG), replay_log(other, CONFIG)), silent)
    return both, truth, later


@pytest.fixture(scope="module")
def of_poses():
    one, truth = corridor_log(bias=np.radians(0.5), world=uneven_walls())
    other, later = corridor_log(bias=np.radians(-0.5), seed=1, world=uneven_walls())
    replays = (
        replay_log(pose_log(one), CONFIG),
        replay_log(pose_log(later_part(other, LATER)), CONFIG),
    )
    return joined(replays, silent), truth, later[LATER:]


def test_the_second_log_of_wheels_lies_in_the_first_one(of_wheels):
    both, truth, later = of_wheels
    one, other = both.replays
    assert both.is_joined, both.status.reason
    assert both.status.level == "ok"
    assert both.unplaced is None
    assert [len(each) for each in both.poses] == [len(one.log), len(other.log)]
    assert largest_error(both, truth, later) < 0.15
    np.testing.assert_allclose(both.record["start"], both.poses[1][0])
    assert len(both.segments) < len(one.segments) + len(other.segments)


def test_the_second_log_of_poses_lies_in_the_first_one(of_poses):
    both, truth, later = of_poses
    assert both.is_joined, both.status.reason
    assert largest_error(both, truth, later) < 0.4
    assert both.record["loops_between"] >= 3
    assert {(each["first_log"], each["second_log"]) for each in both.loops} >= {(0, 0), (0, 1)}
    np.testing.assert_allclose(both.record["start"], both.poses[1][0])


@pytest.mark.parametrize("kind", ["wheels", "poses"])
def test_a_building_that_looks_the_same_after_half_a_turn_is_refused(kind):
    if kind == "wheels":
        logs = [
            wheel_log(lap_from(at), turn, at, plain_walls())[0]
            for at, turn in ((0, 0.0), (2, np.pi))
        ]
    else:
        one, other = (corridor_log(world=plain_walls(), seed=seed)[0] for seed in (0, 1))
        logs = [pose_log(one), pose_log(later_part(other, LATER))]
    found = joined((replay_log(logs[0], CONFIG), replay_log(logs[1], CONFIG)), silent)
    assert not found.is_joined
    assert found.status.level == "unsure"
    assert "ambiguous" in found.status.reason
    assert found.unplaced is not None
    assert np.array_equal(found.segments, found.replays[0].segments)


def test_logs_of_different_buildings_stay_apart(of_poses):
    hall = np.vstack(
        (room(0.0, 0.0, 12.0, 9.0), room(3.5, 3.0, 4.0, 3.5), room(6.0, 5.0, 8.5, 6.0))
    )
    other, _ = corridor_log(world=hall, robot=FOUR_BEAMS, seed=2)
    found = joined(
        (of_poses[0].replays[0], replay_log(pose_log(other, FOUR_BEAMS), CONFIG)), silent
    )
    assert not found.is_joined
    assert found.record["event"] == "not joined"
    assert found.record["reason"] in found.status.reason


def test_relations_in_the_logs_and_between_them_are_scored(of_poses):
    both, truth, later = of_poses
    one, other = (each.log for each in both.replays)
    times = np.array([one.time[10], one.time[200]]), np.array([one.time[20], one.time[300]])
    known = Relations(*times, se2.between(truth[[10, 200]], truth[[20, 300]]))
    scores = relation_scores(both, (known, None))
    assert scores["smoothed_relation_error_m"] < 0.3
    assert not any("between" in name for name in scores)
    later_log = replace(other, time=other.time + one.time[-1] + 100.0)
    across = Relations(one.time[[10]], later_log.time[[5]], se2.between(truth[[10]], later[[5]]))
    apart = replace(both, replays=(both.replays[0], replace(both.replays[1], log=later_log)))
    scores = relation_scores(apart, (across, across))
    assert scores["smoothed_between_relations"] == 1
    assert scores["smoothed_between_relation_error_m"] < 0.4


def test_logs_that_cannot_be_joined_are_refused(of_wheels, of_poses):
    wheels, poses = (both[0].replays[0].log for both in (of_wheels, of_poses))
    with pytest.raises(ValueError, match="3 logs"):
        check_logs([wheels, wheels, wheels], CONFIG)
    with pytest.raises(ValueError, match="must have the same"):
        check_logs([wheels, poses], CONFIG)
    with pytest.raises(ValueError, match="needs the preset graph"):
        check_logs([wheels, wheels], preset("consistent"))


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
    for name in (
        *LOG_FOLDERS,
        "map.json",
        "map_unplaced.json",
        "map.png",
        "run.toml",
        "trajectory_smoothed_1.tum",
    ):
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
    assert (tmp_path / "again" / "map_unplaced.json").read_text() == (
        folder / "map_unplaced.json"
    ).read_text()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--map", "x"], "--map is for one log"),
        (["--preset", "consistent"], "needs the preset graph"),
        (["third.csv"], "3 were given"),
    ],
)
def test_options_that_make_no_sense_with_two_logs_are_refused_in_one_line(
    tables, tmp_path, options, words
):
    done = limslam("replay", *tables, "--robot", "paper", *options, "--out", tmp_path / "no")
    assert done.returncode == 2
    assert words in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "no").exists()
