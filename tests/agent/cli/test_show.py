"""``limslam show``: a finished run is read back, told in words and drawn."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image as Pictures
from support.command_line import invoke

from limslam_agent import Mapper, save_map
from limslam_agent.cli.show import show, true_edges
from limslam_agent.output.export import write_json
from limslam_agent.output.finished_run import FolderError, read_run
from limslam_agent.output.tum import write_tum
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.results import write_episode
from limslam_agent.runs.run_config import RunConfig
from limslam_env import RobotSpec, load_world

pytestmark = pytest.mark.usefixtures("no_display")

WALLS = [[0.0, 0.0, 4.0, 0.0], [4.0, 0.0, 4.0, 3.0]]
METRICS = {
    "stop_reason": "explored: no frontier is left", "exploration_time_s": 20.0, "path_m": 3.2, "coverage_true": 0.98,
    "collisions": 1, "ate_m": 0.05, "odometry_ate_m": 0.21, "landmarks": 2, "wall_f1_aligned": 0.9,
}  # fmt: skip


def poses(count=30, *, offset=0.0):
    turns = np.linspace(0.0, 3.0, count)
    return np.column_stack((1.0 + np.cos(turns) + offset, 1.0 + np.sin(turns), turns + 1.5 + offset))


def write_folder(folder, *, robots=1, truth=True, config=None, metrics=None, log=False):
    """A small finished run, made by hand."""
    folder.mkdir(parents=True, exist_ok=True)
    time = 0.1 * np.arange(30)
    for number in range(robots):
        suffix = f"_{number}" if robots > 1 else ""
        write_tum(folder / f"trajectory_est{suffix}.tum", time, poses(offset=0.1 * (number + 1)))
        if truth:
            write_tum(folder / f"trajectory_true{suffix}.tum", time, poses())
    if log:
        write_tum(folder / "trajectory_odometry.tum", time, poses(offset=0.3))
    write_json(folder / "map.json", {"frame": "world", "segments": WALLS, "landmarks": []})
    config = {"world": "hall", "noise": 0.02, "preset": "paper"} if config is None else config
    result = {"metrics": METRICS if metrics is None else metrics, "cost": {"speed_x_real_time": 80.0}}
    write_json(folder / "result.json", {**result, "config": config, "seed": 3, "versions": {}})
    (folder / "map.png").write_bytes(b"")
    return folder


def assert_picture(path):
    with Pictures.open(path) as picture:
        picture.load()
        assert picture.size == (1800, 1020)


@pytest.fixture(scope="module")
def real_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    write_episode(folder, run_episode(RunConfig("env1", 0.02, max_time=4.0, seed=300)))
    return folder


def test_the_true_walls_are_those_of_the_world_that_was_run_in(real_run):
    run = read_run(real_run)
    np.testing.assert_array_equal(true_edges(run), load_world("env1").edges)
    run.result["config"]["world_digest"] = "another"
    assert true_edges(run) is None


def test_a_real_run_is_told_and_drawn(real_run, tmp_path):
    told = invoke(show, real_run, "--out", tmp_path / "deep" / "show.png")
    assert "stopped     time" in told
    assert "rms; by odometry alone" in told
    assert_picture(tmp_path / "deep" / "show.png")
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["show.png"]


def test_without_a_display_it_says_where_the_picture_is(tmp_path):
    folder = write_folder(tmp_path / "run")
    before = sorted(path.name for path in folder.iterdir())
    told = invoke(show, folder)
    assert str(folder / "map.png") in told
    assert "--out" in told
    assert sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.parametrize(
    ("config", "robots", "truth", "log"),
    [
        ({"log": "fr079.log", "agent": {"preset": "paper"}}, 1, False, True),
        ({"log": "log.npz", "relations": None}, 1, True, True),
        ({"world": "hall", "robots": 2}, 2, True, False),
        ({}, 3, False, False),
    ],
)
def test_replays_and_several_robots_are_drawn(tmp_path, config, robots, truth, log):
    folder = write_folder(tmp_path / "run", robots=robots, truth=truth, config=config, log=log)
    invoke(show, folder, "--out", tmp_path / "show.png")
    assert_picture(tmp_path / "show.png")
    run = read_run(folder)
    assert len(run.estimated) == robots
    assert run.is_replay == ("log" in config)


def spoil_json(folder):
    (folder / "result.json").write_text('{"metrics": ')


def drop(name):
    return lambda folder: (folder / name).unlink()


def write(name, words):
    return lambda folder: (folder / name).write_text(words)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (drop("result.json"), "no result.json"),
        (spoil_json, "is not JSON"),
        (write("map.json", '{"segments": [[1, 2, 3]]}'), "four numbers"),
        (drop("trajectory_est.tum"), "no trajectory_est.tum"),
        (write("trajectory_est.tum", "0 1 2 3\n"), "line 1 is not t x y z"),
        (write("trajectory_true.tum", "0 0 0 0 0 0 0 1\n"), "have other robots or times"),
    ],
)
def test_what_is_missing_or_damaged_is_said_in_one_line(tmp_path, spoil, words):
    folder = write_folder(tmp_path / "run")
    spoil(folder)
    with pytest.raises(ValueError, match=words) as refused:
        invoke(show, folder)
    assert str(folder) in str(refused.value)
    assert isinstance(refused.value, FolderError)


def test_a_folder_must_be_one(tmp_path):
    with pytest.raises(FolderError, match="no such folder"):
        invoke(show, tmp_path / "nowhere")
    (tmp_path / "file").write_text("")
    with pytest.raises(FolderError, match="is not a folder"):
        invoke(show, tmp_path / "file")


def test_a_picture_is_only_replaced_by_force_and_must_be_of_a_known_kind(tmp_path):
    folder, out = write_folder(tmp_path / "run"), tmp_path / "show.svg"
    out.write_text("mine")
    with pytest.raises(ValueError, match="--force"):
        invoke(show, folder, "--out", out)
    assert out.read_text() == "mine"
    invoke(show, folder, "--out", out, "--force")
    assert "<svg" in out.read_text()
    with pytest.raises(ValueError, match=r"\.png, \.pdf, \.svg"):
        invoke(show, folder, "--out", tmp_path / "show.docx")
    shutil.copytree(folder, tmp_path / "copy.png")
    with pytest.raises(ValueError, match="is a folder"):
        invoke(show, folder, "--out", tmp_path / "copy.png")


def test_numbers_of_another_version_do_no_harm(tmp_path):
    folder = write_folder(tmp_path / "run", metrics={"ate_m": "small", "landmarks": None, "new": [1]})
    content = json.loads((folder / "result.json").read_text())
    for config in ("none", {"noise": 10**400}):
        content["seed"], content["config"] = None, config
        write_json(folder / "result.json", content)
        assert "stopped" in invoke(show, folder)


def test_a_folder_with_the_map_of_a_live_robot_names_its_picture(limslam, tmp_path):
    save_map(tmp_path / "room", Mapper(RobotSpec()).snapshot())
    code, _, said = limslam("show", tmp_path / "room")
    assert code == 2
    assert said.rstrip().endswith(
        "there is no result.json; it holds the map of a live robot, which is drawn in map.png"
    )
