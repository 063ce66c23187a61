"""Warnings about logs in other units, sensors that see less far than was told, and maps without
walls.
"""

import functools
from dataclasses import replace

import numpy as np
import pytest
from support.command_line import limslam, refused
from support.corridors import SIX_BEAMS, corridor_log
from support.drives import ROBOT, along, drive, room

from limslam_agent import preset, read_log, replay_log
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.logs.table_options import TableOptions
from limslam_agent.replay.checks import log_warnings, map_warnings
from limslam_agent.replay.misreading import misread


def written(tmp_path, right="0.8", left="2.9", period=0.1, step=0.025, count=60, beams=(-90, 90)):
    """A log of a straight drive between two walls, with the readings as text."""
    rows = [f"{period * row:.9g},{step * row:.4f},0,0,{right},{left}" for row in range(count)]
    path = tmp_path / "drive.csv"
    path.write_text(
        "\n".join([f"t,x,y,theta,r_{beams[0]},r_{beams[1]}", *rows]) + "\n", encoding="utf-8"
    )
    return path


def test_a_plausible_log_gives_no_warning(tmp_path):
    log = read_log(written(tmp_path))
    assert log_warnings(log) == []
    assert map_warnings(replay_log(log, preset("consistent"))) == []


def test_ranges_in_millimetres_are_noticed(tmp_path):
    (warning,) = log_warnings(read_log(written(tmp_path, "800", "2900")))
    assert warning.startswith(
        "100.0% of the readings saw nothing up to 3 m: are the ranges in metres?"
    )


def test_readings_that_jump_to_0_saw_nothing(tmp_path):
    path = written(tmp_path, "0.8", "2.9")
    lines = path.read_text(encoding="utf-8").splitlines()
    for row in range(5, 60, 8):
        lines[row] = lines[row].replace("2.9", "0")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    (warning,) = log_warnings(read_log(path))
    assert warning == (
        "6% of the readings are 0: they begin where the readings end near the longest range, so "
        "they count as 'nothing seen'; --missing not-measured leaves them out"
    )
    told = read_log(path, missing="nothing")
    assert log_warnings(told) == []
    np.testing.assert_array_equal(told.ranges, read_log(path).ranges)


@pytest.mark.parametrize("number", ["0.3", "2.95"])
def test_a_number_that_stands_in_place_of_nothing_seen_is_noticed(tmp_path, number):
    path = written(tmp_path, "0.8", "2.9", count=600)
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    for row, text in enumerate(rows):
        left = number if row % 40 > 20 else f"{2.5 + 0.01 * (row % 40):.3f}"
        rows[row] = text.replace("0.8,2.9", f"{0.8 + 0.001 * row:.3f},{left}")
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    log = read_log(path)
    assert f"of the readings are {number} m: they begin where" in log.readings_notes[0]
    assert (log.ranges[:, 1] == 3.0).sum() == 285


def test_of_a_beam_that_is_always_missing_nothing_is_known(tmp_path):
    path = written(tmp_path, "2.9", "-1")
    (warning,) = log_warnings(read_log(path))
    assert warning.startswith("50% of the readings are missing (nan, empty or negative): no other")
    assert warning.endswith("--missing nothing takes them for 'nothing seen'")
    whole = read_log(path, missing="nothing")
    assert log_warnings(whole) == []
    np.testing.assert_array_equal(whole.ranges, read_log(written(tmp_path, "2.9", "inf")).ranges)


@pytest.mark.parametrize(
    ("period", "said"),
    [(100.0, "the median time between two events is 100 s"), (-0.1, "the times never rise")],
)
def test_clocks_that_are_wrong_are_noticed(tmp_path, period, said):
    path = written(tmp_path, period=period)
    (warning,) = log_warnings(read_log(path, table=TableOptions(time_unit="s")))
    assert warning.startswith(said)


def test_a_sensor_that_sees_less_far_than_was_told_is_noticed_with_both_numbers(tmp_path):
    path = written(tmp_path, "1.93", "inf")
    (warning,) = log_warnings(read_log(path))
    assert "the longest range is 3 m, but the largest reading of a wall is 1.93 m" in warning
    assert "--max-range 2 sets another longest range" in warning
    assert log_warnings(read_log(path, None, 2.0)) == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"step": 0.00002}, "drove only 0.00 m by odometry. Is the odometry in metres?"),
        ({"beams": (0, 180)}, "no beam looks to the left or the right"),
        ({"right": "nan", "left": "nan"}, "the log has no readings"),
        ({"right": "0.0008", "left": "0.0029"}, "are the ranges in metres? --range-unit converts"),
    ],
)
def test_a_map_without_walls_is_explained(tmp_path, changes, words):
    (warning,) = map_warnings(
        replay_log(read_log(written(tmp_path, **changes)), preset("consistent"))
    )
    assert warning.startswith("the map has 0 walls: ")
    assert words in warning


def test_the_command_warns_on_standard_error_and_succeeds(tmp_path):
    finished = limslam("replay", written(tmp_path, "800", "2900"), "--out", tmp_path / "out")
    assert finished.returncode == 0
    warnings = finished.stderr.splitlines()
    assert [line.startswith("limslam: warning: ") for line in warnings] == [True, True]
    assert "are the ranges in metres?" in warnings[0]
    assert "the map has 0 walls" in warnings[1]
    assert (tmp_path / "out" / "result.json").is_file()


@pytest.fixture(scope="module")
def laps():
    """Two laps of a corridor, by odometry poses."""
    data, truth = corridor_log(laps=2)
    everywhere = np.ones(len(data.time), dtype=bool)
    return RecordedLog(
        SIX_BEAMS, data.time, data.ranges.astype(np.float32), everywhere, truth[0], data.odometry
    )


@pytest.mark.parametrize(
    ("factors", "order", "said"),
    [
        ((1.0, 1.0, 1.0), 1, ""),
        ((1.0, 1.0, 1.0), -1, "with left and right exchanged"),
        ((1.0, 1.0, 180.0 / np.pi), 1, "is its heading in radians?"),
        ((300.0, 300.0, 1.0), 1, "is odometry in metres, and are the times in seconds?"),
        ((1e-3, 1e-3, 1.0), 1, "is odometry missing, or not in metres?"),
    ],
)
def test_a_log_that_is_read_in_a_wrong_way_is_noticed(laps, factors, order, said):
    read = replace(
        laps, odometry=laps.odometry * np.array(factors), ranges=laps.ranges[:, ::order].copy()
    )
    warnings = log_warnings(read, misread(read))
    assert len(warnings) == bool(said)
    assert all(said in warning for warning in warnings)


@pytest.mark.parametrize(
    ("factors", "order", "header", "said"),
    [
        ((1.0, 1.0, -1.0), 1, "x_mm,y,theta,t", "--columns x_mm,y,-theta,t reads the table so"),
        ((1.0, -1.0, 1.0), 1, "t,x,-y,yaw", "--columns t,x,y,yaw reads the table so"),
        ((1.0, 1.0, 1.0), -1, "t,x,y,theta", "--columns t,x,-y,-theta reads the table so"),
        ((1.0, 1.0, -1.0), 1, "t,x,y,qx,qy,qz,qw", "does the heading of odometry count clockwise?"),
    ],
)
def test_what_mends_a_table_of_poses_is_said_in_its_own_columns(laps, factors, order, header, said):
    odometry = laps.odometry * np.array(factors)
    ranges = laps.ranges[:, ::order].copy()
    found = misread(
        replace(laps, odometry=odometry, ranges=ranges, header=tuple(header.split(",")))
    )
    assert found is not None
    assert found.words.endswith(said)


@functools.cache
def rounds():
    """Ranges and wheel travel of three rounds through a ring of corridors."""
    walls = np.vstack((room(-0.5, -0.5, 3.5, 2.5), room(0.5, 0.5, 2.5, 1.5)))
    lap = [(0.0, 0.0), (3.0, 0.0), (3.0, 2.0), (0.0, 2.0)]
    observations, _ = drive(walls, np.zeros(3), along([*lap, *lap, *lap, (0.0, 0.0)]), noise=0.01)
    return (
        np.array([each["ranges"] for each in observations]),
        np.array([each["wheels"] for each in observations], dtype=float),
    )


def wheel_log(change):
    """A log of three rounds, with the wheels changed."""
    ranges, wheels = rounds()
    count = len(ranges)
    scans = np.ones(count, dtype=bool)
    return RecordedLog(
        ROBOT,
        0.1 * np.arange(count),
        ranges.copy(),
        scans,
        np.zeros(3),
        wheels=wheels @ change,
        header=("left", "right", "-", "t", "r_90"),
    )


@pytest.mark.parametrize(
    ("change", "question"),
    [
        (
            [[0, 0], [0, 0]],
            (
                "the wheels never move: are the encoders connected, and are left and right their "
                "columns?"
            ),
        ),
        ([[0, 0], [0, 1]], " m: is its encoder connected, and is left its column?"),
    ],
)
def test_wheels_that_never_move_are_noticed(change, question):
    found = log_warnings(wheel_log(np.array(change, dtype=float)))
    assert found[0].endswith(question)


WHEELS = "left,right,-,t,r_90"


@pytest.mark.parametrize(
    ("change", "header", "said"),
    [
        (
            [[1, 0], [0, -1]],
            WHEELS,
            "the right wheel counts the other way: --columns left,-right,-,t,r_90 reads",
        ),
        (
            [[-1, 0], [0, 1]],
            WHEELS,
            "the left wheel counts the other way: --columns -left,right,-,t,r_90 reads",
        ),
        (
            [[-1, 0], [0, -1]],
            WHEELS,
            "both wheels count the other way: --columns -left,-right,-,t,r_90 reads",
        ),
        (
            [[0, 1], [1, 0]],
            WHEELS,
            "exchanged, of the wheels or of the beams: --columns right,left,-,t,r_90 reads",
        ),
        ([[0, -1], [1, 0]], WHEELS, "--columns right,-left,-,t,r_90 reads"),
        ([[0, 1], [-1, 0]], WHEELS, "--columns -right,left,-,t,r_90 reads"),
        ([[0, -1], [-1, 0]], WHEELS, "count the other way: --columns -right,-left,-,t,r_90 reads"),
        (
            [[2, 0], [0, 2]],
            WHEELS,
            "0.5 times as far as the log was read: --metres-per-tick 0.0005",
        ),
        (
            [[0.5, 0], [0, 0.5]],
            WHEELS,
            "2 times as far as the log was read: --metres-per-tick 0.002",
        ),
        ([[0, 1], [1, 0]], "distance,angle_deg", "--columns distance,-angle_deg reads the table"),
        ([[-1, 0], [0, -1]], "v,omega", "--columns -v,-omega reads the table so"),
        ([[0, -1], [-1, 0]], "v,omega", "--columns -v,omega reads the table so"),
        ([[1, 0], [0, -1]], "-left_m_s,right_m_s", "--columns -left_m_s,-right_m_s reads"),
        ([[-1, 0], [0, 1]], "-left_m_s,right_m_s", "--columns left_m_s,right_m_s reads"),
        ([[2, 0], [0, 2]], "left_m_s,right_m_s", "or of the speed in another unit?"),
        ([[1, 0], [0, -1]], "", "the right wheel counts the other way"),
    ],
)
def test_wheels_that_are_read_in_a_wrong_way_are_certain_and_mended(change, header, said):
    log = wheel_log(np.array(change, dtype=float))
    found = misread(replace(log, header=tuple(header.split(",") if header else ())), 0.001)
    assert found is not None
    assert found.is_certain
    assert said in found.words
    assert ("--columns" in found.words) == ("--columns" in said)


@pytest.mark.parametrize("factor", [2.0 / 3.0, 4.0 / 3.0])
def test_an_axle_that_is_wrong_by_a_third_is_named_with_the_right_one(factor):
    log = wheel_log(np.eye(2))
    found = misread(replace(log, robot=replace(log.robot, axle=factor * log.robot.axle)))
    assert found is not None
    option, value = found.words.partition("--axle ")[1:]
    assert option
    assert float(value.split()[0]) == pytest.approx(ROBOT.axle, rel=0.03)


def test_what_mends_a_log_is_said_rather_than_what_is_only_possible():
    log = wheel_log(np.array([[0, 1], [1, 0]], dtype=float))
    found = misread(replace(log, header=("left", "right", "t", "r_90")), 0.001)
    ahead = replace(log, wheels=np.abs(log.wheels))
    assert log_warnings(ahead)[-1].startswith("no wheel ever turns backwards")
    assert log_warnings(ahead, found)[-1] == found.words


def test_with_a_measured_heading_the_axle_does_not_matter():
    log = wheel_log(np.eye(2))
    left, right = log.wheels.T
    yaw = np.cumsum((right - left) / log.robot.axle)
    measured = replace(log, robot=replace(log.robot, axle=1.5 * log.robot.axle), yaw=yaw)
    assert misread(measured) is None
    halved = misread(replace(measured, wheels=0.5 * log.wheels))
    assert halved is not None
    assert "2 times as far" in halved.words


@pytest.mark.parametrize("sizes", [[1.0, 1.0], [1.05, 1.0], [0.96, 0.96]])
def test_wheels_of_slightly_other_sizes_are_not_misread(sizes):
    assert misread(wheel_log(np.diag(sizes))) is None


def test_a_straight_drive_along_walls_says_nothing_about_the_wheels():
    walls = np.array([[-5.0, -0.6, 25.0, -0.6], [-5.0, 0.6, 25.0, 0.6]])
    observations, _ = drive(walls, np.zeros(3), along([(0.0, 0.0), (15.0, 0.0)]), noise=0.01)
    ranges, wheels = (
        np.array([each[name] for each in observations], dtype=float)
        for name in ("ranges", "wheels")
    )
    scans = np.ones(len(ranges), dtype=bool)
    log = RecordedLog(ROBOT, 0.1 * np.arange(len(ranges)), ranges, scans, wheels=2.0 * wheels)
    assert misread(log) is None


def written_wheels(path, log, rows=None):
    """A table of the first rows of a wheel log in metres, for each step."""
    names = [f"r_{angle:g}" for angle in np.round(np.degrees(log.robot.beam_angles), 1)]
    columns = np.column_stack((log.time, log.wheels, log.ranges))
    header = ",".join(["t", "left", "right", *names])
    np.savetxt(path, columns[:rows], "%.4f", ",", header=header, comments="")
    return path


def test_a_fault_of_the_axle_is_certain_where_few_stretches_turn():
    log = replace(wheel_log(np.eye(2)), robot=replace(ROBOT, axle=1.5 * ROBOT.axle))
    found = misread(log)
    assert found is not None
    assert found.is_certain


def test_a_heading_is_turned_as_the_wheels_of_each_reading_turn():
    log = wheel_log(np.array([[0.0, 1.0], [1.0, 0.0]]))
    left, right = log.wheels.T
    found = misread(replace(log, yaw=np.cumsum((right - left) / log.robot.axle)))
    assert found is not None
    assert "left and right are exchanged" in found.words


def test_the_command_stops_at_wheels_that_are_certainly_misread(tmp_path):
    path = written_wheels(tmp_path / "log.csv", wheel_log(np.diag([1.0, -1.0])), 450)
    command = ("replay", path, "--robot", "paper", "--preset", "paper", "--noise", "0.01")
    message = refused(*command, "--out", tmp_path / "out")
    assert message.startswith(f"{path}: the ranges fit the wheels far better if the right wheel")
    assert not (tmp_path / "out").exists()
    finished = limslam(*command, "--as-read", "--out", tmp_path / "out")
    assert finished.returncode == 0
    assert "the right wheel counts the other way" in finished.stderr
    columns = message.partition("--columns ")[2].split()[0]
    mended = limslam(*command, "--columns", columns, "--dry-run")
    assert mended.returncode == 0
    assert "far better" not in mended.stderr


def test_the_named_axle_mends_a_table(tmp_path):
    log = wheel_log(np.eye(2))
    robot = tmp_path / "robot.toml"
    robot.write_text(f"radius = {ROBOT.radius}\naxle = {1.5 * ROBOT.axle}\n", encoding="utf-8")
    path = written_wheels(tmp_path / "log.csv", log)
    command = ("replay", path, "--robot", robot, "--preset", "odometry", "--noise", "0.01")
    assert "--axle 0.16" in limslam(*command, "--out", tmp_path / "wrong").stderr
    mended = limslam(*command, "--axle", ROBOT.axle, "--out", tmp_path / "mended")
    assert mended.returncode == 0
    assert "--axle" not in mended.stderr
    assert refused("replay", path, "--axle", "0.1").startswith("--axle changes the robot")
    assert refused(*command, "--axle", "-1").startswith("--axle: ")


@pytest.mark.parametrize(
    ("reading", "words"),
    [
        (0.4, "says 0.4 in all of its {} readings"),
        (np.inf, "says nothing was seen in all of its {} readings"),
        (np.nan, "has no reading"),
    ],
)
def test_a_beam_that_always_says_the_same_or_nothing_is_named(reading, words):
    log = wheel_log(np.eye(2))
    log.ranges[:, 0] = reading
    (warning,) = [found for found in log_warnings(log) if "sensor connected" in found]
    assert warning.startswith(
        f"the beam at 90 deg {words.format(len(log))}: is its sensor connected?"
    )
    assert "--beams=45,15,-15,-45,-90 leaves it out" in warning


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda wheels: wheels * (-1.0) ** np.arange(len(wheels))[:, None],
            "Then leave out --accumulated",
        ),
        (np.abs, "no wheel ever turns backwards: if the robot has turned on the spot"),
    ],
)
def test_counts_without_a_sum_or_without_a_direction_are_noticed(change, words):
    log = wheel_log(np.eye(2))
    assert log.wheels is not None
    assert not any(words in line for line in log_warnings(log))
    warnings = log_warnings(replace(log, wheels=change(log.wheels)))
    assert any(words in line for line in warnings)


def test_exchanged_beams_are_mended_without_a_mirror_image():
    log = wheel_log(np.array([[0.0, 1.0], [1.0, 0.0]]))
    names = [f"r_{angle:g}" for angle in np.degrees(log.robot.beam_angles).round(1)]
    found = misread(replace(log, header=("t", "left", "right", *names)), 0.001)
    assert found is not None
    mirrored = ",".join(name.replace("r_", "r_-").replace("--", "") for name in names)
    assert f", and --columns t,left,right,{mirrored} if it is the beams" in found.words


def test_wheels_that_are_faster_than_the_robot_are_noticed():
    (warning,) = log_warnings(wheel_log(4.0 * np.eye(2)))
    assert (
        "but the robot's max_wheel_speed is 0.3 m/s: are left and right travel, not speeds"
        in warning
    )
    assert warning.endswith("If the robot is so fast, set max_wheel_speed in its file")


def test_a_gap_in_a_wheel_log_is_named_with_its_times():
    log = wheel_log(np.eye(2))
    first = 100
    last = 200
    wheels = log.wheels.copy()
    wheels[last] = wheels[first + 1 : last + 1].sum(axis=0)
    kept = np.r_[: first + 1, last : len(log)]
    gapped = replace(
        log,
        time=log.time[kept],
        ranges=log.ranges[kept],
        has_scan=log.has_scan[kept],
        wheels=wheels[kept],
    )
    (warning,) = [found for found in log_warnings(gapped) if "wheel travels" in found]
    assert (
        f"{np.abs(wheels[last]).max():.1f} m between 10.0 s and 20.0 s: what the robot did"
        in warning
    )
