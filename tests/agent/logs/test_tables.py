"""Logs as text tables, of poses and of wheel travel: headers, units, and one line for every
fault.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.data import data_folder, refusal

from limslam_agent import read_log
from limslam_agent.logs.table_options import TableOptions
from limslam_env import RobotSpec
from limslam_env.interface import beams_on_rim

HEAD = "t,x,y,theta,r_-90,r_0,r_90\n"


AHEAD = "t,left,right,r_0\n"
ONE_BEAM = TableOptions(RobotSpec(beams=beams_on_rim((0.0,), 0.1)))


def degrees(log):
    return np.degrees([beam.angle for beam in log.robot.beams])


# What is read


def test_a_row_is_an_event(write):
    path = write(HEAD + "0.0,1.0,2.0,3.0,0.5,1.5,2.5\n0.2,1.5,2.0,3.5,0.6,1.6,2.6\n")
    log = read_log(path)
    assert_array_equal(log.time, [0.0, 0.2])
    assert_allclose(log.odometry, [[1.0, 2.0, 3.0], [1.5, 2.0, 3.5 - 2 * math.pi]])
    assert_array_equal(log.ranges, np.float32([[0.5, 1.5, 2.5], [0.6, 1.6, 2.6]]))
    assert_allclose(degrees(log), [-90.0, 0.0, 90.0])
    assert [beam.side for beam in log.robot.beams] == ["right", "none", "left"]
    assert {beam.max_range for beam in log.robot.beams} == {3.0}
    assert_array_equal(log.start_pose, np.zeros(3))
    assert log.robot.control_period == pytest.approx(0.2)
    assert log.has_scan.all()


def test_a_dash_says_that_there_was_no_scan(write):
    rows = "0,0,0,0,-,-,-\n0.1,0.1,0,0,1,1,1\n0.2,0.2,0,0,-\n"
    log = read_log(write(HEAD + rows))
    assert_array_equal(log.has_scan, [False, True, False])
    assert_array_equal(log.ranges[0], [3.0, 3.0, 3.0])
    assert ["ranges" in each for each in log.observations()] == [False, True, False]


@pytest.mark.parametrize(
    "head",
    [
        "t,x,y,theta,r_-90,r_0,r_+90",
        "T, X, Y, Yaw, R_-90, R_0, R_90.0",
        "time;odom_x;odom_y;odom_yaw;r[-90];r[0];r[90]",
        "# t x y yaw r_right r_front r_left  (s m m rad m; beams at -90, 0, 90 deg)",
        "t\tx\ty\ttheta\tr_270\tr_0\tr_90",
        "# recorded on a Tuesday\n\nt,x,y,theta,r_-90,r_0,r_90",
    ],
)
def test_headers_may_be_written_in_many_ways(write, head):
    names = head.splitlines()[-1].partition("(")[0]
    mark = next((each for each in ",;\t" if each in names), " ")
    log = read_log(
        write(
            head, "\n", mark.join(("0", "0", "0", "0", "0.5", "1.0", "1.5")), "\n", name="log.txt"
        )
    )
    assert_allclose(degrees(log), [-90.0, 0.0, 90.0])
    assert_array_equal(log.ranges[0], np.float32([0.5, 1.0, 1.5]))


def test_dots_stand_for_the_beams_between(write):
    path = write("t x y theta r[-90] r[-60] ... r[90]\n0 0 0 0 1 2 3 4 5 6 7\n")
    log = read_log(path, None, 10.0)
    assert_allclose(degrees(log), np.arange(-90.0, 91.0, 30.0))
    assert_array_equal(log.ranges[0], np.arange(1.0, 8.0))


def test_beams_can_be_chosen_and_are_six_of_many(write):
    names = ",".join(f"r_{angle}" for angle in range(-90, 91, 5))
    path = write(f"t,x,y,theta,{names}\n0,0,0,0{',1' * 37}\n")
    assert_allclose(degrees(read_log(path)), [-90.0, -45.0, -15.0, 15.0, 45.0, 90.0])
    assert_allclose(degrees(read_log(path, (30.5, -30.0))), [30.0, -30.0])
    many = "no beam within 1 deg of 32 deg: the log's beams are from -90 to 90 deg"
    assert many in refusal(path, (32.0,))
    few = "no beam within 1 deg of 45 deg: the log's beams are at -90, 0, 90 deg"
    assert few in refusal(write(HEAD, "0,0,0,0,1,1,1\n"), (45.0,))


# What is refused


@pytest.mark.parametrize(
    ("row", "words"),
    [
        (
            "0.2,0,0,0,1,1",
            "6 columns where the header names 7, in '0.2,0,0,0,1,1'. 1 of 3 lines cannot be read",
        ),
        (
            "0,2,0,0,1,5,0,1,1,1,1",
            "11 columns where the header names 7: if commas are decimal marks here, separate the",
        ),
        ("nan,0,0,0,1,1,1", "t is nan, not a finite number"),
        ("soon,0,0,0,1,1,1", "t is not a number, and no time such as 2026-11-28 14:03:05.25: "),
        ("0.2,inf,0,0,1,1,1", "x is inf"),
        ("0.2,0,0,0,1,1.5.2,1", "a range is not a number: '1.5.2'; an empty field or nan is no"),
        ("-2.0,0,0,0,1,1,1", "the time steps back by 2.0 s"),
    ],
)
def test_a_bad_row_is_refused_with_its_line(write, row, words):
    path = write(HEAD, f"0,0,0,0,1,1,1\n{row}\n0.3,0,0,0,1,1,1\n")
    assert f"line 3: {words}" in refusal(path)


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ("t,x,y,r_0", "no column with the heading (theta, yaw): found t,x,y,r_0"),
        ("t,x,y,theta", "no column with a range (r_90, range_front): found t,x,y,theta"),
        ("t,x,y,theta,r_0,r_somewhere", "the header does not say where r_0,r_somewhere point"),
        ("t,x,y,theta,r_0,r_999", "the header names a beam at 999 deg, which is not within 360"),
        ("t,x,y,theta,r_0,r_front", "the header names the beam at 0 deg twice"),
        ("t,x,y,theta,r_0,r_20,...,r_90", "line 1: '...' cannot go from 20 to 90 deg in steps of"),
        ("t,x,y,theta,r_0,...,r_9,...,r_90", "'...' must stand between two ranges and the last"),
    ],
)
def test_a_bad_header_is_refused(write, head, words):
    assert words in refusal(write(f"{head}\n0,0,0,0,1,1,1\n"))


# Which reader


@pytest.mark.parametrize("word", ["null", " out of range ", "--"])
def test_a_word_in_place_of_a_range_is_no_reading(write, word):
    log = read_log(write(f"{HEAD}0,0,0,0,1,{word},1\n0.1,0,0,0,1,1,1\n"))
    assert_array_equal(log.reported, [[1.0, np.nan, 1.0], [1.0, 1.0, 1.0]])
    assert not any("damaged" in note for note in log.notes)


def test_a_line_that_a_radio_repeats_counts_once(write):
    lines = [f"{0.1 * row:.1f},0.01,0.02,{1.0 + 0.01 * row:.2f}\n" for row in range(20)]
    once = read_log(write(AHEAD, *lines), table=ONE_BEAM)
    log = read_log(write(AHEAD, *(line for line in lines for _ in range(2))), table=ONE_BEAM)
    assert_array_equal(log.wheels, once.wheels)
    assert_array_equal(log.time, once.time)
    assert log.notes == ("20 lines repeated the line before, and count once",)


def test_counters_of_a_board_that_was_switched_on_again_count_from_there(write):
    ticks = [*range(1000, 3000, 100), 10, 110, 210]
    rows = (f"{0.1 * row:.1f},{count},{count},1.5\n" for row, count in enumerate(ticks))
    options = replace(ONE_BEAM, metres_per_tick=1e-4, accumulated=True)
    log = read_log(write(AHEAD, *rows), table=options)
    assert_allclose(log.wheels[:, 0], [0.0, *[0.01] * 19, 0.001, 0.01, 0.01])
    (note,) = log.notes
    assert note.startswith("the log begins again at 2.0 s, as of a board that was switched on")


@pytest.mark.parametrize("header_again", ["", f"boot: 0x13\n{AHEAD}"])
@pytest.mark.parametrize("first_time", [0.0, 0.1])
def test_a_second_drive_in_a_file_follows_the_first_one(write, header_again, first_time):
    rows = [f"{first_time + 0.1 * row:.1f},{100 * row},{100 * row},1.5\n" for row in range(40)]
    options = replace(ONE_BEAM, metres_per_tick=1e-4, accumulated=True)
    log = read_log(write(AHEAD, *rows, header_again, *rows), table=options)
    assert_allclose(np.diff(log.time), 0.1, atol=1e-9)
    assert_allclose(log.wheels[:, 0], [0.0, *[0.01] * 39, 0.0, *[0.01] * 39])
    assert log.notes[-1].startswith("the log begins again at 4.")


@pytest.mark.parametrize(("unit", "ended"), [("us", 5.0), ("ms", 60.0), ("ms", 65.5)])
def test_a_clock_that_begins_again_is_not_taken_for_a_full_one(write, unit, ended):
    each = {"us": 1e6, "ms": 1e3}[unit]
    times = [*np.arange(0.0, ended, 0.1), *np.arange(0.0, ended, 0.1)]
    rows = [f"{each * time:.0f},0.01,0.01,1.5\n" for time in times]
    log = read_log(write(AHEAD, *rows), table=replace(ONE_BEAM, time_unit=unit))
    assert_allclose(np.diff(log.time), 0.1, atol=1e-9)
    assert log.notes[-1].startswith("the log begins again at ")


@pytest.mark.parametrize("field", ["", "4:"])
def test_a_damaged_time_does_not_change_the_unit_of_the_others(write, field):
    rows = [f"0.01,0.01,1.5,{100 * row}\n" for row in range(60)]
    rows.insert(30, f"0.01,0.01,1.5,{field}\n")
    options = replace(ONE_BEAM, time_unit="ms")
    log = read_log(write("left,right,r_0,t\n", *rows), table=options)
    assert_allclose(log.time, 0.1 * np.arange(60), atol=1e-9)


def test_a_sparse_heading_goes_on_where_a_log_begins_again(write):
    turn = 0.02 / ONE_BEAM.robot.axle
    yaw = [f"{turn * row:.6f}" if row % 4 == 2 else "" for row in range(120)]
    rows = [f"{0.1 * row:.1f},-0.01,0.01,{yaw[row]},1.5\n" for row in range(120)]
    log = read_log(write("t,left,right,yaw,r_0\n", *rows, *rows), table=ONE_BEAM)
    known = np.unwrap(log.yaw[np.isfinite(log.yaw)])
    assert len(known) == 60
    assert_allclose(np.delete(np.diff(known), 29), 4.0 * turn, atol=1e-5)
    assert np.diff(known)[29] == pytest.approx(0.0, abs=1e-9)


def test_rows_of_a_clock_of_whole_seconds_are_evenly_apart(write):
    rows = (f"14:03:{5 + row // 10:02d},0.01,0.01,1.{row}\n" for row in range(7, 405))
    log = read_log(write(AHEAD, *rows), table=ONE_BEAM)
    assert_allclose(np.diff(log.time), 0.1, atol=1e-9)
    assert log.notes == ("9.7 rows on average have the same time: they are taken evenly apart",)


def test_a_clock_of_the_day_goes_on_after_midnight(write):
    rows = [f"23:59:{58.0 + 0.1 * row:.1f},0,0,1.5\n" for row in range(20)]
    rows += [f"00:00:0{0.1 * row:.1f},0,0,1.5\n" for row in range(20)]
    log = read_log(write(AHEAD, *rows), table=ONE_BEAM)
    assert_allclose(np.diff(log.time), 0.1, atol=1e-9)
    assert log.notes == ()


@pytest.mark.parametrize("place", [20, 40])
def test_a_card_that_lost_its_power_leaves_zeros_that_are_skipped(write, place):
    rows = [f"{0.1 * row:.1f},0.01,0.01,1.{row}\n" for row in range(40)]
    rows.insert(place, "\0" * 100 + "\n")
    log = read_log(write(AHEAD, *rows), table=ONE_BEAM)
    assert len(log) == 40
    assert log.notes == ()


@pytest.mark.parametrize("names", ["left,right", "x,y,theta"])
def test_rows_of_two_robots_in_turn_are_refused(write, names):
    row = "{0},{1},{1},0,1.0\n" if names[0] == "x" else "{0},{1},{1},1.0\n"
    rows = (row.format(0.05 * line, 5 * (line % 2) + 0.01 * line) for line in range(40))
    options = replace(ONE_BEAM, accumulated=True)
    message = refusal(write(f"t,{names},r_0\n", *rows), table=options)
    assert "as if the rows were those of 2 robots: write a log for each robot" in message


@pytest.mark.parametrize("day", ["28.11.2026", "2026-11-28"])
def test_a_day_may_stand_before_the_time_of_the_day(write, day):
    rows = [f"{day} 12:03:0{0.1 * row:.1f},0,0,1.5\n" for row in range(20)]
    log = read_log(write(AHEAD, *rows), table=ONE_BEAM)
    assert_allclose(log.time, 1795867380.0 + 0.1 * np.arange(20))


def test_empty_fields_at_either_end_of_a_line_stay_with_tabs(write):
    rows = "".join(
        f"{end},{0.1 * row:.1f},0.01,0.01,{end},1.2,{end},{end}\n"
        for row, end in enumerate(["1.5", "", "", "1.4", ""] * 4)
    )
    names = "r_90,t,left,right,r_45,r_0,r_-45,r_-90"
    robot = TableOptions(RobotSpec(beams=beams_on_rim((90.0, 45.0, 0.0, -45.0, -90.0), 0.1)))
    chosen = replace(robot, columns=tuple(names.split(",")))
    expected = read_log(write(names, "\n", rows), table=robot)
    tabs = f"{names}\n{rows}".replace(",", "\t")
    for text, options in (
        (tabs, robot),
        (tabs, chosen),
        (rows.replace(",", "\t"), chosen),
        (tabs.replace("\t", " \t ").replace("\n", "\t\r\n", 1), robot),
    ):
        log = read_log(write(text), table=options)
        assert_array_equal(log.reported, expected.reported)
        assert log.notes == expected.notes


def test_an_index_without_a_name_is_a_column_that_is_not_used(write):
    rows = (f"{row}\t{0.1 * row:.1f}\t0.01\t0.01\t1.2\n" for row in range(20))
    log = read_log(write("\tt\tleft\tright\tr_0\n", *rows), table=ONE_BEAM)
    assert_allclose(log.time, 0.1 * np.arange(20))
    assert log.notes == ()


# Real logs


@pytest.mark.parametrize(
    ("name", "raw"),
    [("fr079/fr079_13beam", "fr079/fr079_raw"), ("csail/csail_13beam", "csail/mit-csail")],
)
def test_the_text_of_a_real_log_agrees_with_the_log(name, raw):
    angles = tuple(np.arange(-90.0, 91.0, 15.0).tolist())
    text = read_log(data_folder() / f"{name}.csv.gz", None, 5.0)
    log = read_log(data_folder() / f"{raw}.clf.gz", angles, 5.0)
    assert_allclose(degrees(text), angles)
    assert_array_equal(text.has_scan, log.has_scan)
    assert_allclose(text.ranges, log.ranges, atol=1e-6)
    assert_allclose(text.odometry[:, :2], log.odometry[:, :2], atol=1e-5)
    assert_allclose(text.time, log.time, atol=1e-6)


ROBOT = RobotSpec(
    radius=0.06, axle=0.115, beams=beams_on_rim((90.0, 54.0, -54.0, -90.0), 0.06, max_range=2.0)
)
WHEELS = "t,left,right,r_90,r_54,r_-90\n"
METRES = "0.0,0.5,0.5,1.0,1.5,2.5\n0.1,0.01,0.02,1.1,inf,0.6\n0.2,0.03,0.01,1.2,nan,0.7\n"
# The same drive by counters of 0.001 m a tick.
TICKS = "0,400,500,1000,1500,2500\n100,410,520,1100,8190,600\n200,440,530,1200,nan,700\n"
TICK_OPTIONS = TableOptions(ROBOT, 0.001, accumulated=True, range_unit="mm", time_unit="ms")


def test_a_row_is_the_travel_since_the_row_before(write):
    log = read_log(write(WHEELS, METRES), table=TableOptions(ROBOT))
    assert_allclose(log.wheels, [[0.0, 0.0], [0.01, 0.02], [0.03, 0.01]])
    assert log.odometry is None
    assert_array_equal(
        log.ranges, np.float32([[1.0, 1.5, 2.0], [1.1, 2.0, 0.6], [1.2, math.nan, 0.7]])
    )
    assert (log.robot.axle, log.robot.radius) == (0.115, 0.06)
    assert log.robot.control_period == pytest.approx(0.1)


def test_a_table_of_poses_takes_the_places_of_the_beams_from_the_robot(write):
    path = write("t,x,y,theta,r_90,r_-54\n0,0,0,0,1000,1500\n100,0.1,0,0,1000,1500\n")
    log = read_log(path, table=TableOptions(ROBOT, range_unit="mm", time_unit="ms"))
    assert log.robot.beams == (ROBOT.beams[0], ROBOT.beams[2])
    assert log.robot.radius == 0.06
    assert_allclose(log.ranges[0], [1.0, 1.5])
    assert_allclose(log.time, [0.0, 0.1])


@pytest.mark.parametrize(
    ("text", "changes", "words"),
    [
        (WHEELS + METRES, {"robot": None}, "a table of wheel travel needs --robot FILE"),
        ("t,left,right,r_0\n0,0,0,1\n", {}, "no beam within 1 deg of 0 deg: the robot's beams are"),
        ("t,left,r_0\n0,0,1\n", {}, "no column with right beside left: found t,left,r_0"),
        (WHEELS + "0,0,0,1,1,1,7\n", {}, "or begin it with #; or --columns names the columns in"),
        (WHEELS + "0,0,0,1,1,1\n-5,0,0,1,1,1\n", {}, "steps back by 5.0 s, as in 1 row of 2: sort"),
        (WHEELS + METRES, {"metres_per_tick": 100.0}, "a wheel travels 2 m in 0.1 s at time 0.1 s"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_in_one_line(write, text, changes, words):
    assert words in refusal(write(text), table=replace(TableOptions(ROBOT), **changes))


@pytest.mark.parametrize(("unit", "begin"), [("us", 2**32 - 150_000), ("ms", 2**32 - 150)])
def test_a_clock_of_32_bits_is_continued_where_it_begins_again(write, unit, begin):
    step = {"us": 100_000, "ms": 100}[unit]
    rows = "".join(f"{(begin + row * step) % 2**32},0,0,1,1,1\n" for row in range(5))
    log = read_log(write(WHEELS + rows), table=TableOptions(ROBOT, time_unit=unit))
    assert_allclose(np.diff(log.time), 0.1, atol=1e-6)


@pytest.mark.parametrize(("bits", "has_sign"), [(16, False), (16, True), (12, False), (32, True)])
def test_a_counter_is_continued_where_it_begins_again(write, bits, has_sign):
    low = -(2 ** (bits - 1)) if has_sign else 0
    counts = 2**bits - 1000 + np.arange(0, 400 * 200, 200)
    wrapped = (counts - low) % 2**bits + low
    right = 2 * low + 2**bits - 1 - wrapped
    log = counted(write, 0.1 * np.arange(400), wrapped, right, 1e-4)
    assert_allclose(log.wheels[1:], [[0.02, -0.02]] * 399)


def counted(write, time, left, right, metres_per_tick):
    """The log of a table of counters."""
    rows = (
        f"{row[0]:.1f},{row[1]},{row[2]},1,1,1\n" for row in zip(time, left, right, strict=True)
    )
    options = TableOptions(ROBOT, metres_per_tick, accumulated=True)
    return read_log(write(WHEELS, *rows), table=options)


def test_a_counter_that_begins_again_elsewhere_may_begin_again_in_a_pause(write):
    counts = np.array([*range(0, 9000, 90), 10500]) % 4096
    log = counted(write, [*range(100), 150], counts, counts, 1e-3)
    assert_allclose(log.wheels[-2:, 0], [0.09, 1.59])


def test_counters_that_pass_0_in_a_gap_are_read(write):
    counts = [-60, -40, -20, 40]
    log = counted(write, [0, 0.1, 0.2, 0.5], counts, counts, 1e-3)
    assert_allclose(log.wheels[:, 0], [0.0, 0.02, 0.02, 0.06])


NAMES = "millis;encL;encR;IR1;IR2;IR3"


@pytest.mark.parametrize("head", [f"{NAMES}\n", f"# my robot\n{NAMES}\n", ""])
def test_columns_can_be_named_in_place_of_the_header(write, head):
    ticks = read_log(write(WHEELS, TICKS), table=TICK_OPTIONS)
    path = write(head, TICKS.replace(",", ";"), name="named.log")
    for ranges in ("r_90,r_54,r_-90", "-,r_54,r_-90"):
        columns = ("t", "left", "right", *ranges.split(","))
        log = read_log(path, table=replace(TICK_OPTIONS, columns=columns))
        assert_array_equal(log.ranges, ticks.ranges[:, ranges.startswith("-") :])
        assert_array_equal(log.wheels, ticks.wheels)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ("", "--columns: '' is no name of a column; it names t,left,right,r_90,"),
        ("-", "--columns has no column with the time of each row (t) and no column with"),
        ("t,left,r_90", "--columns has no column with right beside left"),
        ("t,left,right", "--columns has no column with a range"),
        ("t,left,right,battery", "--columns: 'battery' is no name of a column"),
        ("t,left,right,r_90,r_90", "--columns names the beam at 90 deg twice"),
        ("t,left,right,r_0", "no beam within 1 deg of 0 deg: the robot's beams are at"),
        ("t,left,right,r_90,r_54", "line 2: 6 columns where --columns names 5"),
    ],
)
def test_columns_that_do_not_fit_are_refused(write, columns, words):
    options = replace(TICK_OPTIONS, columns=tuple(columns.split(",")))
    assert words in refusal(write(WHEELS, TICKS), table=options)


@pytest.mark.parametrize(
    "rows",
    [
        "9000,400,500,1,1,1\n100,9410,9510,1,1,1\n",
        # Late enough that a robot could have driven as far since it was switched on
        "30000,8000,8000,1,1,1\n25000,8020,8020,1,1,1\n",
        "9000,400,500,1,1,1\n4000,410,510,1,1,1\n",
        # Stamps of a calendar begin nowhere.
        "1764000009000,4000,4000,1,1,1\n1764000001000,0,0,1,1,1\n",
    ],
)
def test_a_clock_that_steps_back_without_its_counters_is_refused(write, rows):
    assert "line 3: the time steps back by " in refusal(write(WHEELS, rows), table=TICK_OPTIONS)


def test_zones_report_the_distance_along_the_axis_of_their_sensor(write):
    off = np.array([16.875, 5.625, -5.625, -16.875])
    zones = [axis + each for axis in (90.0, -90.0) for each in off]
    names = ",".join(f"r_{zone:g}" for zone in zones)
    path = write(f"t,x,y,theta,{names}\n0,0,0,0{',1000' * len(zones)}\n")
    options = TableOptions(range_unit="mm", zone_axes=(90.0, -90.0))
    ranges = read_log(path, table=options).ranges[0]
    assert_allclose(ranges, np.tile(1.0 / np.cos(np.radians(off)), 2), rtol=1e-6)
    assert "no axis lies within 45 deg" in refusal(path, table=replace(options, zone_axes=(90.0,)))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"metres_per_tick": 0.0}, "--metres-per-tick must be a number above 0, not 0"),
        ({"range_unit": "inch"}, "--range-unit must be one of m, cm, mm, in, not 'inch'"),
        ({"zone_axes": (90.0, math.inf)}, "--zone-axes must be directions in degrees"),
    ],
)
def test_impossible_units_are_refused(wrong, words):
    with pytest.raises(ValueError, match=words):
        TableOptions(**wrong)
