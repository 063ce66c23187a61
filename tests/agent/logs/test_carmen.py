"""Recorded logs: CARMEN's rules and refusals, the project's own log.npz, and which reader takes
which file.
"""

import math
import sys
from collections import Counter
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.data import data_folder, own_log, refusal

from limslam_agent import read_log
from limslam_env import RobotSpec
from limslam_env.geometry import se2


@pytest.fixture
def write(write):
    return partial(write, name="some.clf")


SIX = (-90.0, -45.0, -15.0, 15.0, 45.0, 90.0)


def scan(ranges=181, odometry=(0.0, 0.0, 0.0), laser=None, at=1.0):
    """A FLASER line; a number of ranges stands for as many readings of 2 m."""
    values = [2.0] * ranges if isinstance(ranges, int) else ranges
    words = ["FLASER", len(values), *values, *(laser or odometry), *odometry, at, "host", 0.5]
    return " ".join(map(str, words)) + "\n"


def odom(x=0.0, y=0.0, heading=0.0, at=1.0):
    return f"ODOM {x} {y} {heading} 0 0 0 {at} host 0.5\n"


def changed(column, value, count=181):
    values = [2.0] * count
    values[column] = value
    return values


# What is read


def test_events_keep_the_order_of_the_file_and_use_ipc_time(write):
    path = write(
        "# a comment\nPARAM robot_length 0.5\n",
        odom(at=10.0),
        scan(odometry=(1.0, 0.5, 0.1), at=10.2),
        "\n",
        odom(1.5, 0.5, 3.0 + 2.0 * math.pi, at=10.1),
        "RLASER 0 1 2 3\n",
        scan(odometry=(2.0, 0.5, -4.0), at=10.4),
    )
    log = read_log(path, SIX, 3.0)
    assert_array_equal(log.time, [10.0, 10.2, 10.1, 10.4])
    assert_array_equal(log.has_scan, [False, True, False, True])
    expected = np.array([[0.0, 0, 0], [1, 0.5, 0.1], [1.5, 0.5, 3], [2, 0.5, 2 * math.pi - 4]])
    assert_allclose(log.odometry, expected)
    assert_array_equal(log.ranges[:, 0], np.float32([3.0, 2.0, 3.0, 2.0]))
    assert_array_equal(log.start_pose, np.zeros(3))


@pytest.mark.parametrize(("count", "last"), [(180, 89.0), (181, 90.0), (360, 89.5), (361, 90.0)])
def test_beam_layout_follows_from_the_count(write, count, last):
    # Readings that tell which beam they came from.
    path = write(scan([0.5 + 0.001 * i for i in range(count)]))
    log = read_log(path, (-90.0, -45.2, 0.0, 45.0, 90.0), 3.0)
    quarter = count // 4
    numbers = np.array([0, quarter, 2 * quarter, 3 * quarter, count - 1])
    assert_allclose(log.ranges[0], 0.5 + 0.001 * numbers, rtol=1e-6)
    directions = [-90.0, -45.0, 0.0, 45.0, last]
    assert_allclose(np.degrees(log.robot.beam_angles), directions, atol=1e-9)


def test_beams_keep_the_order_asked_for_and_fill_their_sides(write):
    values = changed(181 - 1, 1.0)
    values[0] = 0.5
    robot = (log := read_log(write(scan(values)), (90.0, 18.0, 21.0, -54.0, -90.0), 5.0)).robot
    assert [beam.side for beam in robot.beams] == ["left", "none", "left", "right", "right"]
    assert_array_equal(log.ranges[0], np.float32([1.0, 2.0, 2.0, 2.0, 0.5]))
    limits = {(beam.x, beam.y, beam.min_range, beam.max_range) for beam in robot.beams}
    assert limits == {(0.0, 0.0, 0.02, 5.0)}
    assert robot.radius == 0.2


@pytest.mark.parametrize(
    ("top", "cap"),
    [(3.0, 3.0), (1e6, 3.0), (81.91, 100.0), (81.83, 100.0), (8.191, 20.0), (8.187, 8.19)],
)
def test_a_reading_past_the_cap_or_at_the_lasers_maximum_is_nothing_seen(write, top, cap):
    log = read_log(write(scan(changed(0, top))), SIX, cap)
    assert_array_equal(log.ranges[0], np.float32([cap, 2.0, 2.0, 2.0, 2.0, 2.0]))


def test_the_laser_sits_where_its_pose_lies_on_the_odometrys(write):
    mount = np.array([0.2, -0.05, math.radians(90.0)])
    poses = np.outer(np.arange(5.0), [0.3, -0.1, 0.7])
    lines = [scan(odometry=pose, laser=tuple(se2.compose(pose, mount))) for pose in poses]
    beams = read_log(write(*lines), (-90.0, 0.0), 3.0).robot.beams
    assert_allclose([(b.x, b.y) for b in beams], [[0.2, -0.05]] * 2, atol=1e-6)
    assert_allclose([b.angle for b in beams], [0.0, math.pi / 2], atol=1e-6)
    assert [b.side for b in beams] == ["none", "left"]
    # Poses that a mapping program has corrected are no mount.
    lines = [scan(odometry=(s, 0.0, 0.0), laser=(s, 0.1 * s, 0.01 * s)) for s in range(20)]
    beams = read_log(write(*lines), SIX, 3.0).robot.beams
    assert {(b.x, b.y) for b in beams} == {(0.0, 0.0)}
    assert_allclose(np.degrees([b.angle for b in beams]), SIX)


def test_observations_hold_the_motion_in_the_robots_own_frame(write):
    half = math.pi / 2
    path = write(
        odom(5.0, 5.0, half),
        scan(odometry=(5.0, 6.0, half)),
        scan(odometry=(4.0, 6.0, -math.pi)),
        odom(3.0, 6.0, 3.0),
    )
    observations = list(read_log(path, SIX, 3.0).observations())
    expected = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, half], [1, 0, 3 - math.pi]])
    motions = [each["odometry"] for each in observations]
    assert_allclose(motions, expected, atol=1e-12)
    assert not any("wheels" in each for each in observations)
    # Events without a scan measured nothing, which is not the same as having seen nothing.
    assert ["ranges" in each for each in observations] == [False, True, True, False]
    assert observations[1]["ranges"].dtype == np.float32


# Impossible times


def test_a_single_line_before_the_clock_was_set_is_left_out(write):
    lines = [
        odom(at=-0.958593),
        *[scan(at=1e9 + number) for number in range(12)],
        scan(at=-5.0),
        scan(at=1e9 + 12),
    ]
    log = read_log(write(*lines), SIX, 3.0)
    assert log.time.tolist() == [1e9 + number for number in range(13)]
    assert log.has_scan.all()
    assert log.ranges.shape == (13, 6)
    assert log.notes == ("2 lines with a negative time were left out",)


def test_a_clock_that_begins_below_zero_begins_at_zero(write):
    log = read_log(write(*[scan(at=-2.5 + number) for number in range(12)]), SIX, 3.0)
    assert log.time.tolist() == [float(number) for number in range(12)]
    assert log.notes == ("the times begin at -2.5 s; 2.5 s were added to all of them",)


# Other kinds of scans


def laser(kind, ranges, begin, step, tail, farthest=30.0):
    """A line whose scan says where its beams point, deg."""
    start, view, apart = (math.radians(each) for each in (begin, step * len(ranges), step))
    head = f"{kind} 0 {start:.6f} {view:.6f} {apart:.6f} {farthest} 0.01 0"
    return f"{head} {len(ranges)} {' '.join(map(str, ranges))} 2 100 200 {tail}\n"


def robot_laser(at, ranges, x, begin, step):
    pose = f"{x} 0 0"
    return laser("ROBOTLASER1", ranges, begin, step, f"{pose} {pose} 0.1 0 0.3 0.3 1 {at} host 0.5")


def raw_laser(at, ranges):
    return laser("RAWLASER1", ranges, -90.0, 1.0, f"{at} host 0.5")


def test_scans_that_describe_their_beams_are_read_after_others(write):
    numbered = [0.5 + 0.001 * beam for beam in range(181)]
    lines = [scan(numbered, (0.1 * at, 0.0, 0.0), at=float(at)) for at in range(3)]
    lines += [robot_laser(float(at), numbered, 0.1 * at, -90.0, 1.0) for at in range(3, 9)]
    log = read_log(write(*lines), (-90.0, 0.0), 3.0)
    assert log.has_scan.sum() == len(log) == 9
    assert_allclose(log.ranges, np.tile(np.float32([0.5, 0.59]), (9, 1)), rtol=1e-6)
    assert_allclose(log.odometry[:, 0], 0.1 * np.arange(9), atol=1e-12)
    assert log.notes == ()


def test_a_scan_may_have_any_beams_and_its_longest_range_is_nothing_seen(write):
    readings = [1.0, 30.0, 2.0, 4.0, 5.0]
    log = read_log(write(robot_laser(1.0, readings, 0.0, -120.0, 60.0)), (-120.0, -60.0, 120.0), 40)
    assert_array_equal(log.ranges[0], np.float32([1.0, 40.0, 5.0]))
    assert_allclose(np.degrees(log.robot.beam_angles), [-120.0, -60.0, 120.0], atol=1e-3)
    message = refusal(write(robot_laser(1.0, readings, 0.0, 0.0, 0.0)))
    assert ": line 1: 5 beams in steps of 0 rad are no scan" in message
    many = robot_laser(1.0, readings, 0.0, 0.0, 1.0).replace(" 5 1.0 30.0", " 999999999 1.0 30.0")
    assert "a scan has 999999999 beams" in refusal(write(many))
    cut = robot_laser(1.0, readings, 0.0, -120.0, 60.0).replace(" 2 100 200", " 3 100 200")
    assert "ROBOTLASER1 has " in refusal(write(cut), (0.0,), 5.0)


def test_scans_without_a_pose_take_that_of_odometry(write):
    numbered = [0.5 + 0.001 * beam for beam in range(181)]
    lines = [odom(0.1 * at, at=10.0 + at) for at in range(5)]
    scans = [raw_laser(9.5 + at, numbered) for at in range(6)]
    log = read_log(
        write(*[each for both in zip(scans[:-1], lines, strict=True) for each in both], scans[-1]),
        (0.0,),
    )
    assert log.has_scan.tolist() == [False, *[True, False] * 4]
    assert_allclose(log.odometry[:, 0], 0.05 * np.arange(9), atol=1e-9)
    assert_allclose(log.ranges[log.has_scan], 0.59, rtol=1e-6)
    assert log.notes == ("2 scans before or after all odometry left out",)


def test_scans_that_repeat_others_without_their_pose_are_left_out(write):
    lines = [each for at in range(4) for each in (raw_laser(at, [2.0] * 181), scan(at=float(at)))]
    log = read_log(write(*lines), SIX, 3.0)
    assert (len(log), log.notes) == (4, ())


def test_lines_that_are_not_read_are_counted_by_kind(write):
    others = ["RLASER 1 2 3\n"] * 3 + ["GPS 1\n"] + ["PARAM a b\n", "SYNC 1\n", "# note\n"]
    log = read_log(write(*others, scan()), SIX, 3.0)
    (note,) = log.notes
    assert note == "lines of kinds that are not read were left out: 3 RLASER, 1 GPS"
    message = refusal(write(*others, odom()))
    assert message.endswith(note)
    assert "has no scan" in message


# What is refused


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (scan(changed(45, "1.2.3")), "range 46 is not a number: '1.2.3'"),
        (scan(at="nan"), "time is nan"),
        (odom(at="soon"), "time is not a number: 'soon'"),
        (scan().replace(" host", ""), "FLASER has 191 fields where 192"),
        ("FLASER many 1.0\n", "not followed by the number of beams"),
        (scan(541), "541 beams"),
        (scan(180), "180 beams after scans of 181"),
    ],
)
def test_a_bad_line_is_refused_with_its_number(write, line, words):
    message = refusal(write("# first\n", scan(), odom(), line, scan()))
    assert ": line 4: " in message
    assert words in message


@pytest.mark.parametrize("kept", [3, 700, -9])
def test_a_last_line_that_is_cut_is_refused(write, kept):
    message = refusal(write(odom(), scan(), scan()[:kept]))
    assert ": line 3: cut short: " in message


def test_a_log_without_odometry_is_refused(write):
    ranges = " ".join(["2.0"] * 181)
    for lines in (
        [f"RAWLASER1 0 -1.5708 3.14159 0.0174533 80 0.01 0 181 {ranges} 0 1.0 host 0.5\n"],
        [f"FLASER 181 {ranges}\n"],
        [f"FLASER 181 {ranges} 1.0 host 0.5\n"],
        [f"FLASER 181 {ranges} 0 0 0 1.0 host 0.5\n"],
        ["# nothing else\n"],
        [],
    ):
        assert "has no odometry" in refusal(write(*lines))
    assert ": line 2: has no odometry" in refusal(
        write("#\n", f"FLASER 181 {ranges} 1.0 host 0.5\n")
    )


# The project's own log


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_our_own_log_comes_back_as_it_was(tmp_path, save):
    arrays = own_log()
    save(tmp_path / "log.npz", **arrays)
    log = read_log(tmp_path / "log.npz")
    assert log.robot == RobotSpec()
    assert log.odometry is None
    assert log.has_scan.all()
    for name in ("time", "ranges", "wheels", "true_pose", "start_pose"):
        assert_array_equal(getattr(log, name), arrays[name])
    for name in ("ranges", "wheels"):
        observed = np.array([each[name] for each in log.observations()])
        assert observed.dtype == np.float32
        assert_array_equal(observed, arrays[name])


@pytest.mark.parametrize("name", sorted(own_log()))
def test_our_own_log_without_one_of_its_arrays_is_refused(tmp_path, name):
    arrays = own_log()
    del arrays[name]
    np.savez(tmp_path / "log.npz", **arrays)
    assert f"has no {name}" in refusal(tmp_path / "log.npz")


def with_nan(array):
    array = np.array(array, dtype=float)
    array[2] = np.nan
    return array


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("ranges", lambda a: a[:, :5], "ranges has shape (4, 5), not (4, 6)"),
        ("wall_seen", lambda a: a.T, "wall_seen has shape (6, 4), not (4, 6)"),
        ("time", with_nan, "time holds something that is not a finite number in row 2"),
        ("wheels", lambda a: a.astype(object), "cut short or damaged"),
        ("robot", lambda _: np.array("{}"), "robot: not a robot"),
    ],
)
def test_our_own_log_with_something_wrong_in_it_is_refused(tmp_path, name, change, words):
    arrays = own_log()
    arrays[name] = change(arrays[name])
    np.savez(tmp_path / "log.npz", **arrays)
    assert words in refusal(tmp_path / "log.npz")


# Which reader


def test_a_log_is_opened_by_what_it_is(write, tmp_path):
    np.savez(tmp_path / "log.npz", **own_log())
    for fixed, choice in (("beams", {"beams_deg": SIX}), ("largest range", {"max_range": 3.0})):
        words = f"the log fixes its {fixed}, which cannot be chosen"
        assert words in refusal(tmp_path / "log.npz", **choice)
    ours = (tmp_path / "log.npz").rename(tmp_path / "ours.clf")
    assert read_log(ours).wheels is not None
    theirs = read_log(write(scan(), name="theirs.txt")).robot
    assert_allclose(np.degrees(theirs.beam_angles), SIX)
    assert set(theirs.max_ranges) == {3.0}
    chosen = read_log(write(scan()), (0.0, 30.0), 5.0).robot
    assert_allclose(np.degrees(chosen.beam_angles), [0.0, 30.0])
    assert set(chosen.max_ranges) == {5.0}


# Real logs


@pytest.mark.parametrize(
    ("name", "events", "scans", "seconds", "metres"),
    [
        ("fr079/fr079_raw.clf.gz", 4934, 4791, 1061.5, 392.9),
        ("csail/mit-csail.clf.gz", 1988, 1988, 424.0, 373.6),
    ],
)
def test_a_real_log_is_read_whole_and_with_little_work(name, events, scans, seconds, metres):
    path = data_folder() / name
    calls = Counter()
    before = sys.getprofile()
    sys.setprofile(lambda _frame, event, _argument: calls.update([event]))
    try:
        log = read_log(path, (-90.0, -54.0, -18.0, 18.0, 54.0, 90.0), 5.0)
    finally:
        sys.setprofile(before)
    assert (len(log), int(log.has_scan.sum())) == (events, scans)
    assert np.ptp(log.time) == pytest.approx(seconds, abs=0.1)
    driven = np.hypot(*np.diff(log.odometry[:, :2], axis=0).T).sum()
    assert driven == pytest.approx(metres, abs=0.1)
    assert np.all(log.ranges[~log.has_scan] == 5.0)
    assert 0.02 < np.mean(log.ranges[log.has_scan] == 5.0) < 0.5
    # 67 calls for each event, which take a tenth of a millisecond; a call for each value of a scan
    # would make 360.
    assert calls["call"] + calls["c_call"] < 130 * events
