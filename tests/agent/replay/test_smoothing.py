"""A replay with the preset graph: the smoothed path, its map, and what is written."""

import json
from dataclasses import replace

import numpy as np
import pytest
from support.corridors import SIX_BEAMS, corridor_log, loop_errors, walls

from limslam_agent import preset, replay_log
from limslam_agent.config.graph import GraphConfig
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.output.finished_run import FolderError, read_run
from limslam_agent.replay.replay import write_replay
from limslam_agent.replay.smoothing import draw_walls
from limslam_agent.runs.inspection import inspect_log
from limslam_agent.slam.graph.point_links import PointCloud
from limslam_env.geometry import se2, segment
from limslam_env.interface import NominalNoise

LAP = 345


def recorded():
    data, truth = corridor_log(laps=2, bias=np.radians(0.5))
    log = RecordedLog(
        robot=SIX_BEAMS,
        time=data.time,
        ranges=data.ranges.astype(np.float32),
        has_scan=np.ones(len(data.time), dtype=bool),
        start_pose=truth[0],
        odometry=data.odometry,
    )
    return log, truth


@pytest.fixture(scope="module")
def smoothed():
    log, truth = recorded()
    config = replace(preset("graph", NominalNoise(0.01)), smoothing=GraphConfig())
    stages: list[str] = []
    replay = replay_log(log, config, report=stages.append)
    assert any(stage.startswith("all poses, ") for stage in stages)
    return replay, truth


def test_the_smoothed_path_is_right_and_the_filter_keeps_its_own(smoothed):
    replay, truth = smoothed
    assert loop_errors(replay.smoothed.poses, truth, LAP).mean() < 0.1
    assert not np.array_equal(replay.estimated, replay.smoothed.poses)
    without = replay_log(replay.log, replace(replay.config, smoothing=None))
    assert np.array_equal(without.estimated, replay.estimated)
    assert without.smoothed is None


def test_the_map_is_drawn_from_the_smoothed_path(smoothed):
    replay, truth = smoothed
    seen = np.vstack([mark.ends for mark in replay.landmarks])
    start = se2.between(replay.smoothed.poses, truth)
    drift = np.hypot(start[:, 0], start[:, 1]).max()
    off = segment.distances(seen, walls()).min(axis=1)
    assert len(replay.landmarks) >= 8
    assert np.median(off) < 0.1 + drift
    assert replay.segments.shape == (len(replay.landmarks), 4)
    assert replay.grid.free.sum() > 100


def test_the_folder_holds_both_paths_and_the_loops(smoothed, tmp_path):
    replay, _ = smoothed
    write_replay(tmp_path, replay, {"log": "corridor", "relations": None}, {}, {})
    result = json.loads((tmp_path / "result.json").read_text())
    loops = json.loads((tmp_path / "loops.json").read_text())
    graph = json.loads((tmp_path / "graph.json").read_text())
    assert graph["key_pose_times"][0] == replay.log.time[0]
    assert len(graph["key_pose_times"]) > len(graph["local_map_times"]) > 1
    assert {each[name] for each in loops for name in ("first_time", "second_time")} <= set(graph["local_map_times"])
    found = inspect_log(replay.log, replay.config, lambda _: None, read_run(tmp_path))
    assert found.difference < 2e-6
    assert len(found.meta["path_loops"]) == len(loops)
    assert len(found.meta["graph"]["local_maps"]) == len(graph["local_map_times"])
    (tmp_path / "graph.json").write_text("[]")
    with pytest.raises(FolderError, match=r"graph\.json: is damaged"):
        inspect_log(replay.log, replay.config, lambda _: None, read_run(tmp_path))
    paths = [np.loadtxt(tmp_path / f"trajectory_{name}.tum") for name in ("est", "smoothed")]
    assert np.allclose(paths[0][:, 1:3], replay.estimated[:, :2], atol=1e-5)
    assert np.allclose(paths[1][:, 1:3], replay.smoothed.poses[:, :2], atol=1e-5)
    assert result["metrics"]["loops_found"] == len(loops)
    assert result["metrics"]["loops_kept"] == sum(each["reason"] == "kept" for each in loops)
    assert result["metrics"]["landmarks"] == len(json.loads((tmp_path / "map.json").read_text())["landmarks"])
    assert result["cost"]["smoothing_cpu_s"] > 0.0


def test_a_drawn_wall_is_the_least_squares_line_and_ends_at_gaps():
    generator = np.random.default_rng(0)
    along = np.concatenate((np.linspace(0.0, 2.0, 60), np.linspace(3.0, 5.0, 60)))
    places = np.column_stack((along, np.full(120, 1.5) + generator.normal(0.0, 0.01, 120)))
    normals = np.tile([0.0, -1.0], (120, 1))
    cloud = PointCloud(np.zeros(120, dtype=int), along, places, places, normals, normals, np.ones(120, dtype=bool))
    marks = draw_walls(cloud, 0.01)
    assert len(marks) == 2
    for mark in marks:
        assert mark.r == pytest.approx(1.5, abs=0.05)
        assert abs(se2.wrap_angle(mark.theta - np.pi / 2.0)) < 0.02
        assert np.ptp(mark.ends[:, 0]) == pytest.approx(2.0, abs=0.05)
        assert 1e-5 < np.sqrt(mark.covariance[1, 1]) < 0.01
