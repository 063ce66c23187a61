"""``limslam export``: each format is read back by the library that other programs read it with."""

import json
import math
import sys

import numpy as np
import pytest
from support.command_line import invoke

from limslam_agent import read_log
from limslam_agent.cli.export import export
from limslam_agent.logs.table_options import TableOptions
from limslam_agent.output.finished_run import position_error, read_run
from limslam_agent.output.formats.content import read_exported
from limslam_agent.output.formats.ros_builder import cells_of
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.results import write_episode
from limslam_agent.runs.run_config import RunConfig


def run_export(*arguments):
    """The files that the command says it has written."""
    return [line.split(maxsplit=1)[1] for line in invoke(export, *arguments).splitlines()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("run")
    write_episode(place, run_episode(RunConfig("env1", 0.02, max_time=6.0, seed=300)))
    return place


@pytest.fixture(scope="module")
def team_folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("team")
    write_episode(place, run_episode(RunConfig("env1", 0.02, max_time=3.0, seed=300, robots=2)))
    return place


def test_the_table_of_readings_is_the_log_of_the_run(folder, tmp_path):
    run_export(folder, "--csv", "--out", tmp_path)
    original = read_log(folder / "log.npz")
    table = read_log(tmp_path / "log.csv", table=TableOptions(robot=original.robot))
    np.testing.assert_array_equal(table.ranges, original.ranges)
    np.testing.assert_array_equal(table.wheels.astype(np.float32), original.wheels.astype(np.float32))
    np.testing.assert_allclose(table.time, original.time)


def test_tables_of_poses_and_walls(folder, tmp_path):
    run_export(folder, "--csv", "--out", tmp_path)
    run, poses = read_run(folder), np.genfromtxt(tmp_path / "trajectories.csv", delimiter=",", names=True)
    np.testing.assert_allclose(poses["estimated_x"], run.estimated[0][:, 0])
    np.testing.assert_allclose(
        poses["smoothed_std_theta"] ** 2, run.smoothed_covariances[0][:, 2, 2], rtol=1e-6, atol=1e-12
    )
    walls = np.loadtxt(tmp_path / "walls.csv", delimiter=",", skiprows=1, ndmin=2)
    np.testing.assert_allclose(walls, run.segments, rtol=1e-8)


def test_geojson_in_metres(folder, tmp_path):
    run_export(folder, "--geojson", "--out", tmp_path)
    content, run = json.loads((tmp_path / "map.geojson").read_text()), read_run(folder)
    walls = [each for each in content["features"] if each["properties"]["kind"] == "wall"]
    lines = [np.ravel(each["geometry"]["coordinates"]) for each in walls]
    np.testing.assert_allclose(lines, run.segments, atol=1e-6)
    assert content["frame"] == "local, m"
    assert {each["properties"].get("path") for each in content["features"]} >= {"true", "estimated", "smoothed"}


@pytest.mark.parametrize(("latitude", "longitude"), [(52.52, 13.4), (-33.9, 151.2), (0.0, -180.0)])
def test_geojson_on_the_globe_keeps_lengths(folder, tmp_path, latitude, longitude):
    run_export(folder, "--geojson", "--origin", f"{latitude},{longitude}", "--out", tmp_path)
    content = json.loads((tmp_path / "map.geojson").read_text())
    assert "frame" not in content
    wall = next(each for each in content["features"] if each["properties"]["kind"] == "wall")
    (x1, y1), (x2, y2) = np.radians(wall["geometry"]["coordinates"])
    # The haversine formula on the sphere of GeoJSON's datum.
    part = math.sin((y2 - y1) / 2.0) ** 2 + math.cos(y1) * math.cos(y2) * math.sin((x2 - x1) / 2.0) ** 2
    length = 2.0 * 6_378_137.0 * math.asin(math.sqrt(part))
    assert length == pytest.approx(wall["properties"]["length_m"], abs=1e-3)


def test_dxf_is_read_by_ezdxf(folder, tmp_path):
    ezdxf = pytest.importorskip("ezdxf")
    run_export(folder, "--dxf", "--out", tmp_path)
    drawing, run = ezdxf.readfile(tmp_path / "map.dxf"), read_run(folder)
    assert drawing.units == ezdxf.units.M
    assert not drawing.audit().has_errors
    walls = [[*line.dxf.start.vec2, *line.dxf.end.vec2] for line in drawing.modelspace().query('LINE[layer=="walls"]')]
    np.testing.assert_allclose(walls, run.segments)
    path = drawing.modelspace().query('LWPOLYLINE[layer=="path_smoothed"]').first
    np.testing.assert_allclose([point[:2] for point in path.get_points()], run.smoothed[0][:, :2])


def test_a_bag_is_replayed_as_the_run(folder, tmp_path):
    pytest.importorskip("rosbags")
    run_export(folder, "--bag", "--out", tmp_path)
    replayed, original, run = read_log(tmp_path / "bag"), read_log(folder / "log.npz"), read_run(folder)
    np.testing.assert_allclose(replayed.odometry, run.odometry[0], atol=1e-9)
    by_angle = np.argsort([beam.angle for beam in replayed.robot.beams])
    ours = np.argsort([beam.angle for beam in original.robot.beams])
    np.testing.assert_allclose(replayed.ranges[:, by_angle], original.ranges[:, ours], atol=1e-6)
    for seen, true in zip(by_angle, ours, strict=True):
        beam, wanted = replayed.robot.beams[seen], original.robot.beams[true]
        assert (beam.x, beam.y, beam.angle) == pytest.approx((wanted.x, wanted.y, wanted.angle), abs=1e-9)


def test_mcap_is_read_by_its_own_library(folder, tmp_path):
    pytest.importorskip("mcap_ros2")
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    run_export(folder, "--mcap", "--out", tmp_path)
    run, exported = read_run(folder), read_exported(folder)
    told = {}
    with (tmp_path / "run.mcap").open("rb") as file:
        for _, channel, _, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            told.setdefault(channel.topic, []).append(message)
    poses = told["/pose"]
    np.testing.assert_allclose([pose.pose.pose.position.x for pose in poses], run.estimated[0][:, 0])
    covariance = np.reshape(poses[-1].pose.covariance, (6, 6))[np.ix_((0, 1, 5), (0, 1, 5))]
    np.testing.assert_allclose(covariance, run.covariances[0][-1])
    ends = [(point.x, point.y) for point in told["/walls"][0].markers[0].points]
    np.testing.assert_allclose(np.reshape(ends, (-1, 4)), run.segments)
    grid = told["/map"][0]
    cells = np.reshape(grid.data, (grid.info.height, grid.info.width))
    np.testing.assert_array_equal(cells, cells_of(exported.grid))
    assert set(np.unique(cells)) == {-1, 0, 100}
    # The chain of frames leads from the map to the estimate.
    to_odom, to_base = told["/tf"][-1].transforms
    assert (to_odom.header.frame_id, to_odom.child_frame_id, to_base.child_frame_id) == ("map", "odom", "base_link")


def test_the_grid_lies_where_the_map_says(folder):
    exported = read_exported(folder)
    centres = exported.grid.centres(np.argwhere(exported.grid.free))
    position = exported.run.smoothed[0][0, :2]
    assert np.linalg.norm(centres - position, axis=1).min() < exported.grid.cell


def test_each_robot_of_a_team_has_tables_and_topics_of_its_own(team_folder, tmp_path):
    pytest.importorskip("rosbags")
    written = run_export(team_folder, "--csv", "--dxf", "--geojson", "--bag", "--out", tmp_path)
    assert {"log_0.csv", "log_1.csv", "trajectories_1.csv"} <= {path.rpartition("/")[2] for path in written}
    original = np.load(team_folder / "log.npz")["ranges"]
    log = np.loadtxt(tmp_path / "log_1.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(log[:, 3:].astype(np.float32), original[:, 1])
    with pytest.raises(ValueError, match="/robot_0/odom, /robot_1/odom: choose"):
        read_log(tmp_path / "bag")


def test_a_folder_without_readings_gives_the_rest(folder, tmp_path):
    import shutil

    bare = shutil.copytree(folder, tmp_path / "bare", ignore=shutil.ignore_patterns("log.npz", "map.yaml"))
    written = run_export(bare, "--csv", "--bag")
    assert [path.rpartition("/")[2] for path in written] == ["walls.csv", "trajectories.csv", "bag"]
    assert (bare / "export" / "bag" / "metadata.yaml").is_file()


class TestRerun:
    """The official library reads the recordings back."""

    @pytest.fixture
    def chunks(self):
        return pytest.importorskip("rerun.chunk", reason="needs the extra rerun (rerun-sdk)")

    def columns(self, chunks, path, entity, component):
        """The values of a component of an entity at all times."""
        found = []
        for chunk in chunks.RrdReader(path).stream():
            batch = chunk.to_record_batch()
            if chunk.entity_path == entity and not chunk.is_static and component in batch.schema.names:
                found += batch.column(component).to_pylist()
        return found

    def test_poses_errors_and_beams(self, chunks, folder, tmp_path):
        run_export(folder, "--rerun", "--out", tmp_path)
        run, readings, path = read_run(folder), read_exported(folder).readings, tmp_path / "run.rrd"
        places = self.columns(chunks, path, "/map/robot/smoothed", "Transform3D:translation")
        np.testing.assert_allclose(np.reshape(places, (-1, 3))[:, :2], run.smoothed[0][:, :2], atol=1e-6)
        errors = self.columns(chunks, path, "/plots/robot/position_error/estimated", "Scalars:scalars")
        np.testing.assert_allclose(np.ravel(errors), position_error(run.estimated[0], run.true[0]), atol=1e-9)
        seen = readings.ranges[:, 0] < np.array([beam.max_range for beam in readings.robot.beams], dtype=np.float32)
        beams = self.columns(chunks, path, "/map/robot/estimated/beams", "LineStrips3D:strips")
        assert [len(step or []) for step in beams] == seen.sum(axis=1).tolist()
        lengths = [math.dist(*strip) for step in beams for strip in step or []]
        np.testing.assert_allclose(lengths, readings.ranges[:, 0][seen], atol=1e-6)

    def test_the_viewer_has_a_layout(self, chunks, folder, tmp_path):
        run_export(folder, "--rerun", "--out", tmp_path)
        reader = chunks.RrdReader(tmp_path / "run.rrd")
        (layout,) = reader.blueprints()
        names = [chunk.entity_path for chunk in reader.stream(store=layout)]
        # The map, and the errors of position and heading beside the ranges.
        assert sum(name.startswith("/view/") and name.count("/") == 2 for name in names) == 4

    def test_a_team(self, chunks, team_folder, tmp_path):
        run_export(team_folder, "--rerun", "--out", tmp_path)
        names = {chunk.entity_path for chunk in chunks.RrdReader(tmp_path / "run.rrd").stream()}
        assert {"/map/walls", "/map/grid", "/map/robot_0/estimated", "/plots/robot_1/ranges/beam_5"} <= names


class TestRefusals:
    def test_nothing_is_replaced_by_accident_and_nothing_is_lost(self, folder, tmp_path):
        (tmp_path / "map.geojson").write_text("mine")
        with pytest.raises(ValueError, match=r"map\.geojson: already exists"):
            run_export(folder, "--geojson", "--csv", "--out", tmp_path)
        assert [path.name for path in tmp_path.iterdir()] == ["map.geojson"]
        run_export(folder, "--geojson", "--out", tmp_path, "--force")
        assert json.loads((tmp_path / "map.geojson").read_text())["type"] == "FeatureCollection"

    @pytest.mark.parametrize(
        ("options", "reason"),
        [
            ((), "a format is needed"),
            (("--geojson", "--origin", "north"), "--origin: two numbers"),
            (("--geojson", "--origin", "95,0"), "not a latitude"),
        ],
    )
    def test_one_line_says_why(self, folder, tmp_path, options, reason):
        with pytest.raises(ValueError, match=reason):
            run_export(folder, *options, "--out", tmp_path / "new")

    @pytest.mark.parametrize(
        ("option", "package", "extra"),
        [("--dxf", "ezdxf", "export"), ("--mcap", "rosbags", "ros"), ("--rerun", "rerun", "rerun")],
    )
    def test_a_missing_package_is_named(self, folder, tmp_path, monkeypatch, option, package, extra):
        for name in [name for name in sys.modules if name.partition(".")[0] == package]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(ValueError, match=rf"limslam\[{extra}\]"):
            run_export(folder, option, "--out", tmp_path)
        assert not list(tmp_path.iterdir())

    def test_a_damaged_grid(self, folder, tmp_path):
        import shutil

        damaged = shutil.copytree(folder, tmp_path / "damaged")
        (damaged / "map.pgm").write_bytes(b"P5\n10 10\n255\nshort")
        with pytest.raises(ValueError, match=r"map\.pgm is not as limslam writes it"):
            run_export(damaged, "--csv")
