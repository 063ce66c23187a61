"""The walls in ``map.json`` are the walls that were scored and drawn, with open doors."""

import json
from functools import partial

import numpy as np
import pytest
from support.command_line import call

from limslam_agent.cli.main import main
from limslam_agent.config.consistent import ExtentConfig
from limslam_agent.grid.occupancy import GridView
from limslam_agent.kernels.extents import pass_at
from limslam_agent.mapping.team import Snapshot
from limslam_agent.output.export import write_map
from limslam_agent.output.finished_run import FinishedRun, read_run
from limslam_agent.replay import replay as replay_module
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.wall_map import WallMap
from limslam_env.interface import RobotSpec
from limslam_env.metrics import metrics
from limslam_env.worlds.formats.loading import load_world

limslam = partial(call, main)

UNKNOWN = GridView(np.zeros(2), 0.1, np.zeros((2, 2)))


@pytest.fixture(scope="module")
def explored(tmp_path_factory):
    """A finished exploration of Env2, whose walls have doors."""
    folder = tmp_path_factory.mktemp("runs") / "env2"
    result = limslam("run", "--world", "env2", "--seed", "3", "--out", folder)
    assert result.returncode == 0, result.stderr
    return folder


def content(folder, name):
    return json.loads((folder / name).read_text())


def rows(segments):
    return np.array(segments, dtype=float).reshape(-1, 4)


def test_scores_of_the_file_are_the_scores_of_the_run(explored):
    run, world, robot = read_run(explored), load_world("env2"), RobotSpec()
    with np.load(explored / "log.npz") as log:
        true = log["true_pose"]
    visible = metrics.visible_samples(world, robot.radius, robot.reach)
    told = content(explored, "result.json")["metrics"]
    for name, suffix, paths in (("map.json", "", run.smoothed), ("map_online.json", "_online", run.estimated)):
        alignment = metrics.rigid_alignment(true[:, :2], paths[0][:, :2])
        scores = metrics.wall_metrics(visible, world.edges, rows(content(explored, name)["segments"]), alignment)
        for score in ("wall_f1", "wall_recall", "spurious_walls"):
            assert scores[score] == told[score + suffix]
        # Poses have six digits in the files.
        assert scores["wall_f1_aligned"] == pytest.approx(told["wall_f1_aligned" + suffix], abs=1e-3)
    assert len(run.segments) == told["landmarks"]


def test_the_map_of_a_run_is_drawn_from_the_smoothed_path(explored):
    final, online = content(explored, "map.json"), content(explored, "map_online.json")
    assert final["segments"] != online["segments"]
    assert all(np.linalg.eigvalsh(mark["cov"]).min() > 0.0 for mark in final["landmarks"])


def test_the_preset_consistent_gives_the_map_of_the_filter(tmp_path, explored):
    folder = tmp_path / "filter"
    result = limslam("run", "--world", "env2", "--seed", "3", "--preset", "consistent", "--out", folder)
    assert result.returncode == 0, result.stderr
    assert content(folder, "map.json") == content(explored, "map_online.json")
    assert not (folder / "trajectory_smoothed.tum").exists()
    assert "ate_smoothed_m" not in content(folder, "result.json")["metrics"]


def test_the_doors_of_env2_are_open_in_the_file(explored):
    assert metrics.doors_open(load_world("env2").doors, rows(content(explored, "map.json")["segments"])) == 1.0


def test_a_landmark_with_a_door_is_written_as_two_segments(tmp_path):
    """The wall is y = 1 from x = -1 to x = 1, and beams have passed through its middle."""
    belief = CloneEKF(np.zeros(3))
    belief.add_line(np.pi / 2, np.array([0.0, 1.0]))
    walls = WallMap(belief, ExtentConfig())
    along = np.arange(-1.0, 1.0, 0.05)
    walls.add_known(np.column_stack((along, np.ones(len(along)))))
    for through in np.repeat(along[np.abs(along) < 0.3], 3).tolist():
        pass_at(walls.arrays, 0, -through)
    write_map(tmp_path, Snapshot(*[np.zeros((1, 3))] * 3, walls.landmarks, walls.segments, UNKNOWN, [], []))
    final, doors = content(tmp_path, "map.json"), np.array([[-0.3, 1.0, 0.3, 1.0]])
    assert [mark["segments"] for mark in final["landmarks"]] == [[0, 1]]
    assert metrics.doors_open(doors, rows(final["segments"])) == 1.0
    assert metrics.doors_open(doors, rows([mark["ends"] for mark in final["landmarks"]])) == 0.0


def test_a_replay_and_show_have_the_walls_that_were_scored(explored, tmp_path, monkeypatch):
    replays, shown = [], []

    def write_replay(folder, replay, *others, written=replay_module.write_replay):
        replays.append(replay)
        return written(folder, replay, *others)

    monkeypatch.setattr(replay_module, "write_replay", write_replay)
    again = limslam("replay", explored / "log.npz", "--out", tmp_path / "again")
    assert again.returncode == 0, again.stderr
    expected = content(explored, "map.json")
    assert content(tmp_path / "again", "map.json") == expected
    assert replays[0].segments.tolist() == expected["segments"]
    for name in ("map.pgm", "trajectory_smoothed.tum"):
        assert (tmp_path / "again" / name).read_bytes() == (explored / name).read_bytes()
    assert not (tmp_path / "again" / "loops.json").exists()
    monkeypatch.setattr(FinishedRun, "title", property(lambda run: shown.append(run.segments) or "a run"))
    assert limslam("show", explored, "--out", tmp_path / "sheet.png").returncode == 0
    assert shown[0].tolist() == expected["segments"]
