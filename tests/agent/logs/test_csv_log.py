"""Logs as text: the header and its variants, what means "nothing seen", and one line for every fault."""

import math

import numpy as np
import pytest
from support.data import data_folder, refusal

from limslam_agent import read_log

HEAD = "t,x,y,theta,r_-90,r_0,r_90\n"


@pytest.fixture
def write(tmp_path):
    def _write(text, name="some.csv"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return _write


def degrees(log):
    return np.degrees([beam.angle for beam in log.robot.beams])


# What is read


def test_a_row_is_an_event(write):
    path = write(HEAD + "0.0,1.0,2.0,3.0,0.5,1.5,2.5\n0.2,1.5,2.0,3.5,0.6,1.6,2.6\n")
    log = read_log(path)
    np.testing.assert_array_equal(log.time, [0.0, 0.2])
    np.testing.assert_allclose(log.odometry, [[1.0, 2.0, 3.0], [1.5, 2.0, 3.5 - 2 * math.pi]])
    np.testing.assert_array_equal(log.ranges, np.float32([[0.5, 1.5, 2.5], [0.6, 1.6, 2.6]]))
    np.testing.assert_allclose(degrees(log), [-90.0, 0.0, 90.0])
    assert [beam.side for beam in log.robot.beams] == ["right", "none", "left"]
    assert {beam.max_range for beam in log.robot.beams} == {3.0}
    np.testing.assert_array_equal(log.start_pose, np.zeros(3))
    assert log.robot.control_period == pytest.approx(0.2)
    assert log.has_scan.all()


@pytest.mark.parametrize("nothing", ["inf", "Inf", "+inf", "3.0", "81.91", "1e9"])
def test_what_means_that_nothing_was_seen(write, nothing):
    log = read_log(write(f"{HEAD}0,0,0,0,1,{nothing},1\n"))
    np.testing.assert_array_equal(log.ranges[0], [1.0, 3.0, 1.0])
    assert log.has_scan[0]


def test_a_dash_says_that_there_was_no_scan(write):
    rows = "0,0,0,0,-,-,-\n0.1,0.1,0,0,1,1,1\n0.2,0.2,0,0,-\n"
    log = read_log(write(HEAD + rows))
    np.testing.assert_array_equal(log.has_scan, [False, True, False])
    np.testing.assert_array_equal(log.ranges[0], [3.0, 3.0, 3.0])
    assert ["ranges" in each for each in log.observations()] == [False, True, False]


@pytest.mark.parametrize(
    "head",
    [
        "t,x,y,theta,r_-90,r_0,r_+90",
        "T, X, Y, Yaw, R_-90, R_0, R_90.0",
        "time;odom_x;odom_y;odom_yaw;r[-90];r[0];r[90]",
        "# t x y yaw r_right r_front r_left  (s m m rad m; beams at -90, 0, 90 deg)",
        "#t odom_x odom_y odom_theta r[-90] ... r[0] ... r[90]",
        "t\tx\ty\ttheta\tr_270\tr_0\tr_90",
        "# recorded on a Tuesday\n\nt,x,y,theta,r_-90,r_0,r_90",
        "\ufefft,x,y,theta,r_-90,r_0,r_90",
    ],
)
def test_headers_may_be_written_in_many_ways(write, head):
    if head.count("...") == 2:
        assert "'...' must stand between two ranges and the last one" in refusal(write(head + "\n"))
        return
    names = head.splitlines()[-1]
    mark = next((each for each in ",;\t" if each in names.partition("(")[0]), " ")
    path = write(head + "\n" + mark.join(["0", "0", "0", "0", "0.5", "1.0", "1.5"]) + "\n", "log.txt")
    log = read_log(path)
    np.testing.assert_allclose(degrees(log), [-90.0, 0.0, 90.0])
    np.testing.assert_array_equal(log.ranges[0], np.float32([0.5, 1.0, 1.5]))


def test_dots_stand_for_the_beams_between(write):
    path = write("t x y theta r[-90] r[-60] ... r[90]\n0 0 0 0 1 2 3 4 5 6 7\n")
    log = read_log(path, None, 10.0)
    np.testing.assert_allclose(degrees(log), np.arange(-90.0, 91.0, 30.0))
    np.testing.assert_array_equal(log.ranges[0], np.arange(1.0, 8.0))


def test_beams_can_be_chosen_and_are_six_of_many(write):
    angles = range(-90, 91, 5)
    text = "t,x,y,theta," + ",".join(f"r_{angle}" for angle in angles) + "\n0,0,0,0," + ",".join("1" * 37) + "\n"
    path = write(text)
    np.testing.assert_allclose(degrees(read_log(path)), [-90.0, -45.0, -15.0, 15.0, 45.0, 90.0])
    np.testing.assert_allclose(degrees(read_log(path, (30.5, -30.0))), [30.0, -30.0])
    assert "no beam within 1 deg of 32 deg: the log's beams are from -90 to 90 deg" in refusal(path, (32.0,))
    few = write(HEAD + "0,0,0,0,1,1,1\n", "few.csv")
    assert "no beam within 1 deg of 45 deg: the log's beams are at -90, 0, 90 deg" in refusal(few, (45.0,))


# What is refused


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("0.2,0,0,0,1,1", "line 3: 6 columns where the header names 7: delete the line"),
        (
            "0,2,0,0,1,5,0,1,1,1,1",
            "line 3: 11 columns where the header names 7: if commas are decimal marks here, separate the columns by",
        ),
        ("nan,0,0,0,1,1,1", "line 3: t is nan, not a finite number"),
        ("0.2,inf,0,0,1,1,1", "line 3: x is inf"),
        ("0.2,0,0,0,1,far,1", "line 3: a range is not a number: 'far'; an empty field or nan is no reading"),
        ("-2.0,0,0,0,1,1,1", "line 3: the time steps back by 2.0 s"),
        ("0.2,1e4,0,0,1,1,1", "odometry jumps by 1e+04 m in row 1"),
    ],
)
def test_a_bad_row_is_refused_with_its_line(write, row, words):
    assert words in refusal(write(f"{HEAD}0,0,0,0,1,1,1\n{row}\n0.3,0,0,0,1,1,1\n"))


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ("t,x,y,r_0", "line 1: the header must be t,x,y,theta,r_<deg>,... or t,left,right,r_<deg>,..., not"),
        ("t,x,y,theta", "line 1: the header names no ranges"),
        ("t,x,y,theta,r_0,battery", "line 1: the column 'battery' is not a range"),
        ("t,x,y,theta,r_0,r_somewhere", "line 1: the column 'r_somewhere': 'somewhere' is no direction"),
        ("t,x,y,theta,r_0,r_999", "line 1: the column 'r_999': 999 is not within 360 deg"),
        ("t,x,y,theta,r_0,r_front", "line 1: the header names the beam at 0 deg twice"),
        ("t,x,y,theta,r_0,r_20,...,r_90", "line 1: '...' cannot go from 20 to 90 deg in steps of 20"),
    ],
)
def test_a_bad_header_is_refused(write, head, words):
    assert words in refusal(write(f"{head}\n0,0,0,0,1,1,1\n"))


# Which reader


def test_other_texts_are_no_tables(write):
    assert "has no odometry: no ODOM or FLASER line of CARMEN, nor, as a table" in refusal(
        write("# a note\n", "carmen.log")
    )


# Real logs


@pytest.mark.parametrize(
    ("name", "events", "scans"), [("fr079/fr079_13beam", 4934, 4791), ("csail/csail_13beam", 1988, 1988)]
)
def test_the_text_of_a_real_log_agrees_with_the_log(name, events, scans):
    folder = data_folder()
    text = read_log(folder / f"{name}.csv.gz", None, 5.0)
    raw = {"fr079/fr079_13beam": "fr079/fr079_raw.clf.gz", "csail/csail_13beam": "csail/mit-csail.clf.gz"}[name]
    angles = tuple(np.arange(-90.0, 91.0, 15.0).tolist())
    log = read_log(folder / raw, angles, 5.0)
    assert (len(text), int(text.has_scan.sum())) == (events, scans)
    np.testing.assert_allclose(degrees(text), angles)
    np.testing.assert_array_equal(text.has_scan, log.has_scan)
    np.testing.assert_allclose(text.ranges, log.ranges, atol=1e-6)
    np.testing.assert_allclose(text.odometry[:, :2], log.odometry[:, :2], atol=1e-5)
    np.testing.assert_allclose(text.time, log.time, atol=1e-6)
