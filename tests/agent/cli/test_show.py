"""``limslam show`` and ``limslam compare``: finished runs are read back, told in words and
drawn.
"""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image as Pictures
from support.command_line import refused, told
from support.runs import Folder, result_of, run, write_poses, write_run

from limslam_agent import Mapper, read_run, save_map
from limslam_agent.cli.show import true_edges
from limslam_agent.output.run_picture import draw_run
from limslam_agent.output.summary import record_of, record_summary
from limslam_env import RobotSpec

pytestmark = pytest.mark.usefixtures("no_display")


def picture_in(path):
    with Pictures.open(path) as picture:
        return np.asarray(picture.convert("RGB"))


@pytest.fixture(scope="module")
def real_run(tmp_path_factory):
    return run(
        tmp_path_factory.mktemp("run") / "short", "--noise", 0.02, "--max-time", 4, "--seed", 300
    )


def test_a_real_run_is_told_and_drawn_with_the_walls_of_its_world(real_run, tmp_path):
    said = told("show", real_run.path, "--out", tmp_path / "deep" / "show.png")
    assert "stopped     time" in said
    assert "rms; by odometry alone" in said
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["show.png"]
    drawn = picture_in(tmp_path / "deep" / "show.png")
    assert drawn.shape == (1020, 1800, 3)
    # The world of a run is known by its content. In a changed one there would be other walls, so
    # none are drawn.
    shutil.copytree(real_run.path, tmp_path / "changed")
    result = real_run.result
    result["config"]["world_digest"] = "another"
    (tmp_path / "changed" / "result.json").write_text(json.dumps(result))
    told("show", tmp_path / "changed", "--out", tmp_path / "changed.png")
    assert (picture_in(tmp_path / "changed.png") != drawn).any()


def test_a_replay_beside_its_world_is_scored_and_drawn_with_the_true_walls(real_run, tmp_path):
    folder = tmp_path / "again"
    told("replay", real_run.path / "log.npz", "--preset", "paper", "--out", folder)
    assert 0.0 <= result_of(folder)["metrics"]["wall_f1_aligned"] <= 1.0
    edges = true_edges(read_run(folder))
    np.testing.assert_array_equal(edges, true_edges(read_run(real_run.path)))
    # Without that file, there is nothing to compare with.
    shutil.copy(real_run.path / "log.npz", tmp_path)
    told("replay", tmp_path / "log.npz", "--preset", "paper", "--out", tmp_path / "alone")
    assert "wall_f1_aligned" not in result_of(tmp_path / "alone")["metrics"]
    assert true_edges(read_run(tmp_path / "alone")) is None


def test_the_sheet_of_a_run_with_a_known_truth_has_its_nees(real_run):
    run = read_run(real_run.path)
    for sheet, has_truth in ((run, True), (replace(run, true=[]), False)):
        draw_run(figure := Figure(layout="constrained"), sheet, ["words"])
        titles = [axes.get_ylabel() for axes in figure.axes]
        assert any("NEES" in title for title in titles) == has_truth


def test_events_are_told_in_the_order_of_time():
    places = [{"event": "found", "step": 7}, {"event": "lost", "step": 3}]
    poses = [np.zeros((9, 3))]
    record = record_of(np.arange(9.0), poses, poses, places)
    said = record_summary({"record": record})
    assert [line for line in said if "place" in line] == [
        "place       lost at 3.0 s, found at 7.0 s"
    ]


def test_without_a_display_it_says_where_the_picture_is(tmp_path):
    folder = write_run(tmp_path / "run")
    before = sorted(path.name for path in folder.iterdir())
    said = told("show", folder)
    assert str(folder / "map.png") in said
    assert "--out" in said
    assert sorted(path.name for path in folder.iterdir()) == before
    assert "--out FILE.png" in told("compare", folder, write_run(tmp_path / "other"))


@pytest.mark.parametrize(
    ("config", "robots", "truth", "has_odometry"),
    [
        ({"log": "fr079.log", "agent": {"preset": "paper"}}, 1, False, True),
        ({"log": "log.npz", "relations": None}, 1, True, True),
        ({"world": "hall", "robots": 2}, 2, True, False),
        ({}, 3, False, False),
    ],
)
def test_replays_and_several_robots_are_drawn(tmp_path, config, robots, truth, has_odometry):
    folder = write_run(tmp_path / "run", robots=robots, truth=truth, config=config)
    if has_odometry:
        write_poses(
            folder / "trajectory_odometry.tum",
            Folder(folder).time,
            Folder(folder).poses("est") + 0.2,
        )
    told("show", folder, "--out", tmp_path / "show.png")
    assert picture_in(tmp_path / "show.png").shape == (1020, 1800, 3)


def drop(name):
    return lambda folder: (folder / name).unlink()


def write(name, words):
    return lambda folder: (folder / name).write_text(words)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (drop("result.json"), "no result.json"),
        (write("result.json", '{"metrics": '), "is not JSON"),
        (write("map.json", '{"segments": [[1, 2, 3]]}'), "four numbers"),
        (drop("trajectory_est.tum"), "no trajectory_est.tum"),
        (write("trajectory_est.tum", "0 1 2 3\n"), "line 1 is not t x y z"),
        (write("trajectory_true.tum", "0 0 0 0 0 0 0 1\n"), "have other robots or times"),
    ],
)
def test_what_is_missing_or_damaged_is_said_in_one_line(tmp_path, spoil, words):
    folder = write_run(tmp_path / "run")
    spoil(folder)
    said = refused("show", folder)
    assert words in said
    assert str(folder) in said


def test_what_is_no_run_and_no_picture_is_refused(tmp_path):
    folder = write_run(tmp_path / "run")
    out = tmp_path / "show.svg"
    assert "no such folder" in refused("show", tmp_path / "nowhere")
    (tmp_path / "file").write_text("")
    assert "is not a folder" in refused("show", tmp_path / "file")
    out.write_text("mine")
    assert "--force" in refused("show", folder, "--out", out)
    assert out.read_text() == "mine"
    told("show", folder, "--out", out, "--force")
    assert "<svg" in out.read_text()
    assert ".png, .pdf, .svg" in refused("show", folder, "--out", tmp_path / "show.docx")
    shutil.copytree(folder, tmp_path / "copy.png")
    assert "is a folder" in refused("show", folder, "--out", tmp_path / "copy.png")
    assert "2 to 8 folders" in refused("compare", folder)
    assert "not 9" in refused("compare", *[folder] * 9)
    assert "a picture ends in" in refused("compare", folder, folder, "--out", tmp_path / "a.txt")
    assert "no such folder" in refused("compare", folder, tmp_path / "none")


def test_numbers_of_another_version_do_no_harm(tmp_path):
    folder = write_run(tmp_path / "run", metrics={"ate_m": "small", "landmarks": None, "new": [1]})
    content = result_of(folder)
    for config in ("none", {"noise": 10**400}):
        content["seed"] = None
        content["config"] = config
        (folder / "result.json").write_text(json.dumps(content))
        assert "stopped" in told("show", folder)


def test_a_folder_with_the_map_of_a_live_robot_names_its_picture(tmp_path):
    save_map(tmp_path / "room", Mapper(RobotSpec()).snapshot())
    said = refused("show", tmp_path / "room")
    assert said.endswith(
        "there is no result.json; it holds the map of a live robot, which is drawn in map.png"
    )


def test_metrics_stand_side_by_side_under_what_differs(tmp_path):
    noises = [{"world": "hall", "noise": noise, "preset": "paper"} for noise in (0.0, 0.04)]
    folders = [
        write_run(tmp_path / "a", offset=0.05, config=noises[0], metrics={"ate_m": 0.05}),
        write_run(tmp_path / "b", config=noises[1], metrics={"ate_m": 0.1}, robots=2, truth=False),
    ]
    said = told("compare", *folders, "--out", tmp_path / "both.png").splitlines()
    assert said[0].split("  ")[-1] == "2 robots, range noise 4 cm"
    assert said[1].split()[-2:] == ["0.05", "0.1"]
    told("compare", *folders, *folders, folders[0], "--out", tmp_path / "five.png")
    both, five = (picture_in(tmp_path / name).shape for name in ("both.png", "five.png"))
    assert five[0] > both[0] > 500
