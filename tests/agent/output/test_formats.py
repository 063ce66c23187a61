"""``limslam export``: each format is read back by the library that other programs read it with."""

import shutil
import sys

import numpy as np
import pytest
from PIL import Image
from support.command_line import refused, told
from support.runs import Folder, run

from limslam_agent import read_log

SHORT = ("--noise", 0.02, "--seed", 300)


def run_export(source, *arguments):
    """The files that the command says it has written."""
    return [line.split(maxsplit=1)[1] for line in told("export", source, *arguments).splitlines()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return run(tmp_path_factory.mktemp("run") / "run", *SHORT, "--max-time", 6).path


@pytest.fixture(scope="module")
def team_folder(tmp_path_factory):
    return run(tmp_path_factory.mktemp("team") / "run", *SHORT, "--max-time", 3, "--robots", 2).path


def test_the_table_of_readings_is_the_log_of_the_run(folder, tmp_path):
    run_export(folder, "--csv", "--out", tmp_path)
    original = read_log(folder / "log.npz")
    table = np.loadtxt(tmp_path / "log.csv", delimiter=",", skiprows=1)
    assert (
        (tmp_path / "log.csv")
        .read_text()
        .startswith("t,left,right,r_90,r_45,r_15,r_-15,r_-45,r_-90\n")
    )
    np.testing.assert_allclose(table[:, 0], original.time)
    np.testing.assert_array_equal(
        table[1:, 1:3].astype(np.float32), original.wheels[1:].astype(np.float32)
    )
    np.testing.assert_array_equal(table[:, 3:].astype(np.float32), original.ranges)


def test_tables_of_poses_and_walls(folder, tmp_path):
    run_export(folder, "--csv", "--out", tmp_path)
    done = Folder(folder)
    poses = np.genfromtxt(tmp_path / "trajectories.csv", delimiter=",", names=True)
    np.testing.assert_allclose(poses["estimated_x"], done.poses("est")[:, 0])
    np.testing.assert_allclose(
        poses["smoothed_std_theta"] ** 2,
        done.covariances("smoothed")[:, 2, 2],
        rtol=1e-6,
        atol=1e-12,
    )
    walls = np.loadtxt(tmp_path / "walls.csv", delimiter=",", skiprows=1, ndmin=2)
    np.testing.assert_allclose(walls, done.segments, rtol=1e-8)


def test_dxf_is_read_by_ezdxf(folder, tmp_path):
    ezdxf = pytest.importorskip("ezdxf")
    run_export(folder, "--dxf", "--out", tmp_path)
    drawing = ezdxf.readfile(tmp_path / "map.dxf")
    done = Folder(folder)
    assert drawing.units == ezdxf.units.M
    assert not drawing.audit().has_errors
    walls = [
        [*line.dxf.start.vec2, *line.dxf.end.vec2]
        for line in drawing.modelspace().query('LINE[layer=="walls"]')
    ]
    np.testing.assert_allclose(walls, done.segments)
    path = drawing.modelspace().query('LWPOLYLINE[layer=="path_smoothed"]').first
    np.testing.assert_allclose(
        [point[:2] for point in path.get_points()], done.poses("smoothed")[:, :2]
    )


def test_a_bag_is_replayed_as_the_run(folder, tmp_path):
    pytest.importorskip("rosbags")
    run_export(folder, "--bag", "--out", tmp_path)
    replayed = read_log(tmp_path / "bag")
    original = read_log(folder / "log.npz")
    np.testing.assert_allclose(replayed.odometry, Folder(folder).poses("odometry"), atol=1e-6)
    by_angle = np.argsort([beam.angle for beam in replayed.robot.beams])
    ours = np.argsort([beam.angle for beam in original.robot.beams])
    np.testing.assert_allclose(replayed.ranges[:, by_angle], original.ranges[:, ours], atol=1e-6)
    for seen, true in zip(by_angle, ours, strict=True):
        beam = replayed.robot.beams[seen]
        wanted = original.robot.beams[true]
        assert (beam.x, beam.y, beam.angle) == pytest.approx(
            (wanted.x, wanted.y, wanted.angle), abs=1e-9
        )


def test_mcap_is_read_by_its_own_library(folder, tmp_path):
    pytest.importorskip("mcap_ros2")
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    run_export(folder, "--bag", "--out", tmp_path)
    done = Folder(folder)
    heard = {}
    with (tmp_path / "bag" / "bag.mcap").open("rb") as file:
        for _, channel, _, message in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            heard.setdefault(channel.topic, []).append(message)
    poses = heard["/pose"]
    np.testing.assert_allclose(
        [pose.pose.pose.position.x for pose in poses], done.poses("est")[:, 0]
    )
    covariance = np.reshape(poses[-1].pose.covariance, (6, 6))[np.ix_((0, 1, 5), (0, 1, 5))]
    np.testing.assert_allclose(covariance, done.covariances()[-1])
    ends = [(point.x, point.y) for point in heard["/walls"][0].markers[0].points]
    np.testing.assert_allclose(np.reshape(ends, (-1, 4)), done.segments)
    grid = heard["/map"][0]
    cells = np.reshape(grid.data, (grid.info.height, grid.info.width))
    shades = np.flipud(np.asarray(Image.open(folder / "map.pgm")))
    np.testing.assert_array_equal(cells, np.select([shades == 0, shades == 254], [100, 0], -1))
    assert set(np.unique(cells)) == {-1, 0, 100}
    # The chain of frames leads from the map to the estimate.
    to_odom, to_base = heard["/tf"][-1].transforms
    assert (to_odom.header.frame_id, to_odom.child_frame_id, to_base.child_frame_id) == (
        "map",
        "odom",
        "base_link",
    )


def test_each_robot_of_a_team_has_tables_and_topics_of_its_own(team_folder, tmp_path):
    pytest.importorskip("rosbags")
    written = run_export(team_folder, "--csv", "--dxf", "--bag", "--out", tmp_path)
    assert {"log_0.csv", "log_1.csv", "trajectories_1.csv"} <= {
        path.rpartition("/")[2] for path in written
    }
    original = np.load(team_folder / "log.npz")["ranges"]
    log = np.loadtxt(tmp_path / "log_1.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(log[:, 3:].astype(np.float32), original[:, 1])
    with pytest.raises(ValueError, match="/robot_0/odom, /robot_1/odom: choose"):
        read_log(tmp_path / "bag")


def test_a_folder_without_readings_gives_the_rest(folder, tmp_path):
    bare = shutil.copytree(
        folder, tmp_path / "bare", ignore=shutil.ignore_patterns("log.npz", "map.yaml")
    )
    written = run_export(bare, "--csv", "--bag")
    assert [path.rpartition("/")[2] for path in written] == ["walls.csv", "trajectories.csv", "bag"]
    assert (bare / "export" / "bag" / "metadata.yaml").is_file()


class TestRefusals:
    def test_nothing_is_replaced_by_accident_and_nothing_is_lost(self, folder, tmp_path):
        (tmp_path / "walls.csv").write_text("mine")
        assert "walls.csv: already exists" in refused("export", folder, "--csv", "--out", tmp_path)
        assert [path.name for path in tmp_path.iterdir()] == ["walls.csv"]
        run_export(folder, "--csv", "--out", tmp_path, "--force")
        assert (tmp_path / "walls.csv").read_text().startswith("x1,y1,x2,y2")

    def test_a_format_is_needed(self, folder, tmp_path):
        assert "a format is needed" in refused("export", folder, "--out", tmp_path / "new")

    @pytest.mark.parametrize(
        ("option", "package", "extra"),
        [("--dxf", "ezdxf", "export"), ("--bag", "rosbags", "ros")],
    )
    def test_a_missing_package_is_named(
        self, folder, tmp_path, monkeypatch, option, package, extra
    ):
        for name in [name for name in sys.modules if name.partition(".")[0] == package]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setitem(sys.modules, package, None)
        assert f"limslam[{extra}]" in refused("export", folder, option, "--out", tmp_path)
        assert not list(tmp_path.iterdir())

    def test_a_damaged_grid(self, folder, tmp_path):
        damaged = shutil.copytree(folder, tmp_path / "damaged")
        (damaged / "map.pgm").write_bytes(b"P5\n10 10\n255\nshort")
        assert "map.pgm is not as limslam writes it" in refused("export", damaged, "--csv")
