"""Warnings about logs in other units, sensors that see less far than was told, and maps without
walls.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.command_line import limslam
from support.corridors import SIX_BEAMS, corridor_log
from support.drives import ROBOT, along, drive, room

from limslam_agent import preset, read_log, replay_log
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.replay.plausibility import log_warnings, map_warnings


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
        ((1.0, 1.0, -1.0), 1, "with a heading of the other sign"),
        ((1.0, -1.0, 1.0), 1, "with y of the other sign"),
        ((1.0, 1.0, 180.0 / np.pi), 1, "is its heading in radians?"),
        ((300.0, 300.0, 1.0), 1, "is odometry in metres?"),
        ((1e-3, 1e-3, 1.0), 1, "is odometry missing, or not in metres?"),
    ],
)
def test_a_log_that_is_read_in_a_wrong_way_is_noticed(laps, factors, order, said):
    read = replace(
        laps, odometry=laps.odometry * np.array(factors), ranges=laps.ranges[:, ::order].copy()
    )
    warnings = log_warnings(read)
    assert len(warnings) == bool(said)
    assert all(said in warning for warning in warnings)


def wheel_log(change):
    """A log of wheel travel of three rounds through a ring of corridors, with the wheels
    changed.
    """
    walls = np.vstack((room(-0.5, -0.5, 3.5, 2.5), room(0.5, 0.5, 2.5, 1.5)))
    lap = [(0.0, 0.0), (3.0, 0.0), (3.0, 2.0), (0.0, 2.0)]
    observations, _ = drive(walls, np.zeros(3), along([*lap, *lap, *lap, (0.0, 0.0)]), noise=0.01)
    ranges, wheels = (
        np.array([each[name] for each in observations]) for name in ("ranges", "wheels")
    )
    count = len(observations)
    scans = np.ones(count, dtype=bool)
    return RecordedLog(
        ROBOT,
        0.1 * np.arange(count),
        ranges,
        scans,
        np.zeros(3),
        wheels=wheels.astype(float) @ change,
    )


@pytest.mark.parametrize(
    ("change", "question"),
    [
        ([[1, 0], [0, 1]], None),
        ([[0, 1], [1, 0]], "are the wheels exchanged, or the beams in the wrong order?"),
        ([[-1, 0], [0, -1]], "do the encoders of both wheels count backwards?"),
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
def test_exchanged_and_reversed_wheels_are_noticed(change, question):
    found = log_warnings(wheel_log(np.array(change, dtype=float)))
    assert not found if question is None else found[0].endswith(question)


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


def test_wheels_that_are_faster_than_the_robot_are_noticed():
    (warning,) = log_warnings(wheel_log(4.0 * np.eye(2)))
    assert (
        "but the robot's max_wheel_speed is 0.3 m/s: are left and right travel, not speeds"
        in warning
    )
    assert warning.endswith("If the robot is so fast, set max_wheel_speed in its file")


def test_a_gap_in_a_wheel_log_is_named_with_its_times():
    log = wheel_log(np.eye(2))
    first, last = 100, 200
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
