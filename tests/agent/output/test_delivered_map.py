"""The walls in ``map.json`` are the walls that were scored and drawn, with open doors."""

import json

import numpy as np
import pytest
from support.command_line import limslam

from limslam_agent.output.finished_run import read_run
from limslam_env import load_world
from limslam_env.interface import RobotSpec
from limslam_env.metrics import metrics


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
