"""Tables as other programs write them: forms of the odometry, units, headings beside wheels, text
before the table, and damaged lines. Each is compared with the same drive as metres and seconds.
"""

import gzip
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.command_line import limslam, refused
from support.data import refusal

from limslam_agent import read_log
from limslam_agent.logs.table_options import TableOptions
from limslam_env import RobotSpec
from limslam_env.geometry import se2
from limslam_env.interface import beams_on_rim

DIRECTIONS = (90.0, 45.0, -45.0, -90.0)
ROBOT = RobotSpec(radius=0.06, axle=0.12, beams=beams_on_rim(DIRECTIONS, 0.06, max_range=2.0))
COUNT = 120
PERIOD = 0.1
WHEEL_RADIUS = 0.03
STEPS = np.arange(COUNT)
TIME = PERIOD * STEPS
LEFT = np.where(STEPS == 0, 0.0, 0.012 + 0.008 * np.sin(0.05 * STEPS))
RIGHT = np.where(STEPS == 0, 0.0, 0.012 - 0.010 * np.cos(0.03 * STEPS))
WHEELS = np.column_stack((LEFT, RIGHT))
TURN = (RIGHT - LEFT) / ROBOT.axle
FORWARD = 0.5 * (LEFT + RIGHT)
POSES = np.vstack((np.zeros(3), se2.driven(WHEELS[1:], ROBOT.axle, np.zeros(3))))
RANGES = 1.0 + 0.1 * np.sin(np.outer(STEPS, [0.1, 0.2, 0.3, 0.4]))
NAMED = ("r_90", "r_45", "r_-45", "r_-90")


HEADING = POSES[:, 2]
TRAVEL = {"left": LEFT, "right": RIGHT}
PLACE = {"x": POSES[:, 0], "y": POSES[:, 1]}
CLOCKS = {"t", "t_ms", "time_us", "timestamp", "millis"}


def table(columns, ranges=NAMED, *, metres=1.0):
    """A table of columns by their names, with the times and ranges of the drive, as text."""
    columns = columns if CLOCKS & columns.keys() else {"t": TIME, **columns}
    header = ",".join([*columns, *ranges])
    numbers = np.column_stack([*columns.values(), RANGES / metres])
    rows = [",".join(f"{value:.9g}" for value in row) for row in numbers.tolist()]
    return "\n".join([header, *rows]) + "\n"


SPEEDS = WHEELS / PERIOD
TICKS = np.cumsum(WHEELS, axis=0) / 0.0001


@pytest.mark.parametrize(
    ("columns", "options"),
    [
        ({"right": RIGHT, "left": LEFT}, {}),
        ({"right_ticks": RIGHT, "enc_left": LEFT, "t": TIME}, {}),
        ({"left": LEFT, "right_count": RIGHT, "t": TIME}, {}),
        ({"left [mm]": 1e3 * LEFT, "right [mm]": 1e3 * RIGHT, "millis": 1e3 * TIME}, {}),
        (
            {"time_us": 1e6 * TIME, "encL": TICKS[:, 0], "encR": TICKS[:, 1]},
            {"metres_per_tick": 0.0001, "accumulated": True},
        ),
        ({"left_m_s": SPEEDS[:, 0], "right_m_s": SPEEDS[:, 1]}, {}),
        ({"left_speed_mm_s": 1e3 * SPEEDS[:, 0], "vr_mm_s": 1e3 * SPEEDS[:, 1]}, {}),
        (
            {
                "wl": SPEEDS[:, 0] / WHEEL_RADIUS,
                "wr": SPEEDS[:, 1] / WHEEL_RADIUS,
            },
            {"wheel_radius": WHEEL_RADIUS},
        ),
        (
            {
                "left_rpm": SPEEDS[:, 0] / WHEEL_RADIUS * 30.0 / math.pi,
                "right_rpm": SPEEDS[:, 1] / WHEEL_RADIUS * 30.0 / math.pi,
            },
            {"wheel_radius": WHEEL_RADIUS},
        ),
        (
            {
                "left_wheel_joint_rad": np.cumsum(LEFT) / WHEEL_RADIUS,
                "right_wheel_joint_rad": np.cumsum(RIGHT) / WHEEL_RADIUS,
            },
            {"wheel_radius": WHEEL_RADIUS, "accumulated": True},
        ),
        ({"v": FORWARD / PERIOD, "omega": TURN / PERIOD}, {}),
        (
            {"speed [cm/s]": 100 * FORWARD / PERIOD, "gz_dps": np.degrees(TURN) * 10},
            {},
        ),
        ({"distance": FORWARD, "angle": TURN}, {}),
        (
            {
                "distance [mm]": 1e3 * np.cumsum(FORWARD),
                "angle [deg]": np.degrees(np.cumsum(TURN)),
            },
            {"accumulated": True},
        ),
        (
            {"distance": 100 * FORWARD, "yaw": np.degrees(HEADING)},
            {"position_unit": "cm", "angle_unit": "deg"},
        ),
    ],
)
def test_every_form_of_odometry_gives_the_travel_of_the_wheels(write, columns, options):
    log = read_log(write(table(columns)), table=TableOptions(ROBOT, **options))
    assert_allclose(log.wheels[1:], WHEELS[1:], atol=2e-7)
    assert_allclose(log.time, TIME, atol=1e-9)
    assert_allclose(log.ranges, RANGES, atol=1e-6)
    assert log.notes == ()


@pytest.mark.parametrize(
    "columns",
    [
        {"v": FORWARD / PERIOD, "omega": TURN / PERIOD},
        {"theta": HEADING, "y": POSES[:, 1], "x": POSES[:, 0]},
        {"angle_deg": np.degrees(HEADING), **PLACE},
        {
            "stateEstimate.x": POSES[:, 0],
            "stateEstimate.y": POSES[:, 1],
            "stabilizer.yaw": np.degrees(HEADING),
        },
        {
            "field.pose.pose.position.x": POSES[:, 0],
            "field.pose.pose.position.y": POSES[:, 1],
            "field.pose.pose.orientation.x": 0.0 * TIME,
            "field.pose.pose.orientation.y": 0.0 * TIME,
            "field.pose.pose.orientation.z": np.sin(0.5 * HEADING),
            "field.pose.pose.orientation.w": np.cos(0.5 * HEADING),
        },
        {"x_mm": 1e3 * POSES[:, 0], "y_mm": 1e3 * POSES[:, 1], "yaw": HEADING},
    ],
)
def test_every_form_of_odometry_gives_the_poses_where_no_robot_is_described(write, columns):
    log = read_log(write(table(columns)))
    moved = se2.between(log.odometry[:1], log.odometry)
    assert_allclose(moved, POSES, atol=1e-5)


def test_wheels_go_before_poses_where_the_robot_is_described(write):
    columns = {**TRAVEL, "x": 0 * TIME, "y": 0 * TIME}
    path = write(table({**columns, "theta": 0 * TIME}))
    log = read_log(path, table=TableOptions(ROBOT))
    assert_allclose(log.wheels[1:], WHEELS[1:])
    assert log.yaw is None  # programs calculate theta from the wheels
    assert log.notes == ("3 columns are not used: x, y, theta",)
    poses = read_log(path)
    assert poses.wheels is None
    assert poses.notes == ("2 columns are not used: left, right",)


@pytest.mark.parametrize(
    "columns",
    [
        {"left_speed": SPEEDS[:, 0], "right_speed": SPEEDS[:, 1]},
        {"distance": FORWARD, "angle": TURN},
    ],
)
def test_a_row_that_comes_late_stands_in_its_order(write, columns):
    head, *rows = table(columns).splitlines()
    for late in (10, 30, 32):
        rows[late - 1], rows[late] = rows[late], rows[late - 1]
    log = read_log(write("\n".join([head, *rows])), table=TableOptions(ROBOT))
    assert_allclose(log.wheels[1:], WHEELS[1:], atol=2e-7)
    assert_allclose(log.time, TIME, atol=1e-9)
    assert_allclose(log.ranges, RANGES, atol=1e-6)


def test_options_of_ticks_are_not_used_for_speeds(write):
    path = write(table({"left_speed": SPEEDS[:, 0], "right_speed": SPEEDS[:, 1]}))
    log = read_log(path, table=TableOptions(ROBOT, 0.0005, accumulated=True))
    assert_allclose(log.wheels[1:], WHEELS[1:], atol=2e-7)
    (note,) = log.notes
    assert "--metres-per-tick and --accumulated are not used" in note


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"wl": SPEEDS[:, 0], "wr": SPEEDS[:, 1]}, "--wheel-radius says the radius"),
        (
            {"left": np.cumsum(LEFT), "right": np.cumsum(RIGHT)},
            "They look like counters: --accumulated",
        ),
        (
            {"distance": 1e3 * FORWARD, "angle": TURN},
            "Is the distance in metres, since the row before? --position-unit",
        ),
        ({"left_speed": 1e3 * LEFT, "right_speed": 1e3 * RIGHT}, "as in left_mm_s"),
    ],
)
def test_a_table_with_another_meaning_asks_for_the_option_that_says_it(write, columns, words):
    path = write(table(columns))
    assert words in refusal(path, table=TableOptions(ROBOT))


def test_a_quaternion_of_zeros_says_no_heading(write):
    zeros = dict.fromkeys(("qx", "qy", "qz", "qw"), np.zeros(COUNT))
    path = write(table({**PLACE, **zeros}))
    assert "row 0 is no rotation" in refusal(path)


# Units


@pytest.mark.parametrize(("unit", "seconds"), [("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)])
def test_the_unit_of_times_is_found_from_the_spacing_of_the_rows(write, unit, seconds):
    columns = {"timestamp": np.round(TIME / seconds), **TRAVEL}
    log = read_log(write(table(columns)), table=TableOptions(ROBOT))
    assert_allclose(log.time, TIME, atol=1e-9)
    assert log.notes[0].startswith(f"the times are read in {unit}, since the rows are")


@pytest.mark.parametrize(
    "clock",
    [
        *("2026-11-28T{}", "2026-11-28 {}", "2026-11-28T{}Z", "{}"),
        *("28/11/2026 {}", "1/28/2026 {} PM", "28.11.2026 {}", "{} am"),
    ],
)
def test_times_of_the_calendar_are_read(write, clock):
    times = [clock.format(f"12:00:{second:04.1f}") for second in np.arange(0, 50, 0.5)]
    rows = (f"{time},{row},0,0,1\n" for row, time in enumerate(times))
    log = read_log(write("time,x,y,theta,r_0\n", *rows))
    assert_allclose(np.diff(log.time), 0.5, atol=1e-6)


def test_a_unit_in_a_name_and_an_option_that_disagree_are_refused(write):
    path = write(table({"t_ms": 1e3 * TIME, **TRAVEL}))
    message = refusal(path, table=TableOptions(ROBOT, time_unit="s"))
    assert "the column 't_ms' is in ms by its name, but --time-unit says s" in message
    assert_allclose(read_log(path, table=TableOptions(ROBOT, time_unit="ms")).time, TIME, atol=1e-9)


def test_headings_in_degrees_are_noticed(write):
    heading = np.linspace(0.0, 720.0, COUNT) % 360.0
    columns = {**PLACE, "yaw": heading}
    path = write(table(columns))
    log = read_log(path)
    turned = se2.wrap_angle(log.odometry[:, 2] - np.radians(heading))
    assert_allclose(turned, 0.0, atol=1e-6)
    (note,) = log.notes
    assert note.startswith("the column yaw is read in deg")
    assert "--angle-unit" in note
    assert read_log(path, table=TableOptions(angle_unit="deg")).notes == ()


@pytest.mark.parametrize("per_second", ["left_ticks_per_s", "left [counts/s]"])
def test_ticks_a_second_are_speeds_of_wheels(write, per_second):
    ticks = SPEEDS / 0.001
    columns = {per_second: ticks[:, 0], per_second.replace("left", "right"): ticks[:, 1]}
    log = read_log(write(table(columns)), table=TableOptions(ROBOT, 0.001))
    assert_allclose(log.wheels[1:], WHEELS[1:], atol=2e-7)
    assert log.notes == ()


def test_a_unit_may_stand_behind_each_number(write):
    header, *rows = table(TRAVEL, metres=0.0254).splitlines()
    cells = [row.split(",") for row in rows]
    lines = [f"{t} s,{left},{right},{' in,'.join(rest)}in" for t, left, right, *rest in cells]
    log = read_log(write("\n".join([header, *lines])), table=TableOptions(ROBOT))
    assert_allclose(log.ranges, RANGES, atol=1e-6)
    assert_allclose(log.time, TIME)
    assert log.notes == ()


def test_a_rate_takes_the_place_of_times(write):
    lines = [line.partition(",")[2] for line in table(TRAVEL).splitlines()]
    path = write("\n".join(lines))
    assert refusal(path, table=TableOptions(ROBOT)).endswith(
        "--rate says how many rows there are in a second"
    )
    log = read_log(path, table=TableOptions(ROBOT, rate=10.0))
    assert_allclose(log.time, TIME)
    assert_allclose(log.wheels[1:], WHEELS[1:])
    assert log.header[0] == "left"


def test_seconds_and_nanoseconds_are_one_time(write):
    columns = {"header.stamp.secs": np.floor(TIME), "header.stamp.nsecs": 1e9 * (TIME % 1.0)}
    text = table({"t": TIME, **TRAVEL})
    rows = [line.partition(",")[2] for line in text.splitlines()[1:]]
    stamps = np.column_stack(list(columns.values())).tolist()
    lines = [f"{s:.0f},{ns:.0f},{row}" for (s, ns), row in zip(stamps, rows, strict=True)]
    names = ",".join([*columns, text.splitlines()[0].partition(",")[2]])
    log = read_log(write("\n".join([names, *lines])), table=TableOptions(ROBOT))
    assert_allclose(log.time, TIME, atol=1e-8)
    assert log.notes == ()


# Names beside the values


def labelled(form):
    """The table of the drive with names beside the values."""
    names, *rows = [line.split(",") for line in table(TRAVEL).splitlines()]
    records = [dict(zip(names, row, strict=True)) for row in rows]
    if form == "json":
        nested = [
            {"pose": {}, "ranges": [float(record.pop(name)) for name in NAMED], **record}
            for record in records
        ]
        return "[" + ",".join(map(json.dumps, nested)) + "]"
    if form == "python":
        return "\n".join(str(record | {"voltage": None}) for record in records)
    if form == "json lines":
        return "\n".join(map(json.dumps, records))
    return "\n".join(
        form[1].join(f"{name}{form[0]}{value}" for name, value in record.items())
        for record in records
    )


@pytest.mark.parametrize(
    "form", [(":", " "), (":", ","), ("=", "\t"), (": ", ", "), "json lines", "json", "python"]
)
def test_names_may_stand_beside_the_values(write, form):
    log = read_log(write(labelled(form), name="drive.txt"), table=TableOptions(ROBOT))
    assert_allclose(log.wheels[1:], WHEELS[1:])
    assert_allclose(log.time, TIME)
    assert_allclose(log.ranges, RANGES, atol=1e-6)


@pytest.mark.parametrize("form", [',"[{}]"', ',"({})"', ";[{}]"])
def test_a_scan_may_stand_in_one_field(write, form):
    numbers = np.column_stack([TIME, POSES]).tolist()
    mark = form[0]
    rows = [
        mark.join(f"{value:.9g}" for value in row)
        + form.format(" ".join(f"{value:.6f}," for value in scan).strip(","))
        for row, scan in zip(numbers, RANGES.tolist(), strict=True)
    ]
    rows[0] = rows[0].replace(f"{RANGES[0, 0]:.6f}", "inf")
    names = mark.join(("t", "x", "y", "theta", "ranges"))
    log = read_log(write("\n".join([names, *rows])), table=TableOptions(ROBOT))
    assert_allclose(log.ranges[1:], RANGES[1:], atol=1e-6)
    assert len(log.notes) == 1  # the beams are those of the robot


def test_the_clock_of_a_serial_monitor_is_a_time(write):
    lines = labelled((":", " ")).splitlines()
    clock = [f"14:03:{5 + seconds:06.3f} -> " for seconds in TIME.tolist()]
    rows = [now + line.partition(" ")[2] for now, line in zip(clock, lines, strict=True)]
    log = read_log(write("\n".join(rows), name="drive.txt"), table=TableOptions(ROBOT))
    assert_allclose(np.diff(log.time), PERIOD, atol=1e-6)
    assert_allclose(log.wheels[1:], WHEELS[1:])


def test_a_first_line_that_is_cut_does_not_name_the_columns(write):
    text = labelled((":", " "))
    log = read_log(write(text[text.index("ft:") :]), table=TableOptions(ROBOT))
    assert_allclose(log.time, TIME[1:])
    assert log.notes[0].startswith("1 damaged line was left out")


# A heading beside wheels


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("name", "column", "role"),
    [
        ("yaw", se2.wrap_angle(HEADING + 2.0), "yaw"),
        ("imu_yaw", np.degrees(se2.wrap_angle(HEADING + 2.0)), "yaw"),
        ("heading", np.degrees(HEADING), "yaw"),
        ("gyro_z", TURN / PERIOD, "gyro_z"),
        ("gz", np.degrees(TURN / PERIOD), "gyro_z"),
    ],
)
def test_a_heading_beside_wheels_is_read_in_its_unit_and_counter_clockwise(
    write, name, column, role, sign
):
    column = sign * column % 360.0 if name == "heading" else sign * column
    path = write(table({"left": LEFT, name: column, "right": RIGHT}))
    log = read_log(path, table=TableOptions(ROBOT))
    assert_allclose(se2.wrap_angle(np.diff(log.yaw)), TURN[1:], atol=1e-6)
    assert len(log.notes) == (sign < 0.0)
    if sign < 0.0:
        assert "in --columns says, or left and right are exchanged" in log.notes[0]
        chosen = ("t", "left", f"-{role}", "right", *NAMED)
        said = read_log(path, table=TableOptions(ROBOT, columns=chosen))
        assert_allclose(said.yaw, log.yaw)
        assert said.notes == ()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_heading_that_was_calculated_from_the_wheels_is_no_measurement(write, sign):
    rows = np.arange(1200)
    turned = np.degrees(sign * np.cumsum(np.full(1200, 0.003 / ROBOT.axle)))
    slip = 3.0 * (rows > 600)
    for yaw, notes in ((turned, ["never differs from that of the wheels"]), (turned - slip, [])):
        lines = (f"{0.1 * row:.1f},0.01,0.013,{yaw[row]:.1f},1.0\n" for row in rows)
        path = write("t,left,right,yaw,r_90\n", *lines)
        log = read_log(path, table=TableOptions(ROBOT, angle_unit="deg"))
        assert (log.yaw is None) == bool(notes)
        assert all(words in log.notes[0] for words in notes)


def test_a_heading_may_be_missing_in_some_rows(write):
    yaw = np.where(STEPS == 4, np.nan, HEADING)
    path = write(table({**TRAVEL, "yaw": yaw}).replace("nan", ""))
    log = read_log(path, table=TableOptions(ROBOT))
    assert_array_equal(np.isnan(log.yaw), STEPS == 4)


# Directions


@pytest.mark.parametrize(
    ("names", "beams_deg"),
    [
        (("r1", "r2", "r3", "r4"), DIRECTIONS),
        (("d0", "d1", "d2", "d3"), DIRECTIONS),
        (("sonar_1", "sonar_2", "sonar_3", "sonar_4"), DIRECTIONS),
        (("tof_left", "tof_fl", "tof_fr", "tof_right2"), (90.0, 20.0, -20.0, -90.0)),
    ],
)
def test_ranges_without_a_direction_are_the_beams_of_the_robot_in_its_order(
    write, names, beams_deg
):
    robot = RobotSpec(beams=beams_on_rim(beams_deg, 0.1, max_range=2.0))
    path = write(table(TRAVEL, names))
    log = read_log(path, table=TableOptions(robot))
    assert_allclose(np.degrees(log.robot.beam_angles), beams_deg)
    (note,) = log.notes
    assert note.startswith(f"the ranges are taken as the robot's beams, deg: {names[0]} 90")


def test_ranges_without_a_direction_need_a_robot_of_as_many_beams(write):
    path = write(table({"x": TIME, "y": TIME, "theta": TIME}, ("r1", "r2", "r3", "r4")))
    assert "does not say where r1,r2,r3,r4 point" in refusal(path)
    robot = RobotSpec()
    assert "the robot has 6 beams, not 4" in refusal(path, table=TableOptions(robot))


def test_sides_alone_are_ranges_beside_other_wheels(write):
    robot = RobotSpec(beams=beams_on_rim((90.0, 0.0, 180.0, -90.0), 0.1, max_range=2.0))
    names = ("left", "front", "back", "right")
    path = write(table({"enc_l": LEFT, "enc_r": RIGHT}, names, metres=0.001))
    log = read_log(path, table=TableOptions(robot, range_unit="mm"))
    assert_allclose(log.wheels[1:], WHEELS[1:])
    assert_allclose(log.ranges, RANGES, atol=1e-6)
    assert_allclose(np.degrees(log.robot.beam_angles), [90.0, 0.0, 180.0, -90.0])


# What is missing


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ("left,right,r_90", "no column with the time of each row (t): found left,right,r_90"),
        ("clk,left,right,r_90", "--columns t,left,right,r_90 says that clk is the time"),
        ("t,right,r_90", "no column with left beside right: found t,right,r_90"),
        ("t,x,y,r_90", "no column with the heading"),
        ("t,v,r_90", "no column with the turn (omega, angle, yaw)"),
        ("t,left,right,A0", "no column with a range"),
        ("t,left,right,ir_90_V", "ir_90_V is a voltage by its name"),
        ("t,left,right,sensor,range_mm", "has one column of ranges, range_mm, and says no"),
        ("t,left_ticks,right_speed,r_90", "no column with both wheels in one unit"),
    ],
)
def test_what_is_missing_is_named_alone(write, names, words):
    row = ",".join(["1"] * len(names.split(",")))
    assert words in refusal(write(f"{names}\n{row}\n"), table=TableOptions(ROBOT))


def test_a_table_without_a_header_gets_a_line_to_copy(write):
    text = table(TRAVEL).split("\n", 1)[1]
    path = write(text, name="some.txt")
    message = refusal(path, table=TableOptions(ROBOT))
    copied = "t,left,right,r_90,r_45,r_-45,r_-90"
    assert f"has no header for 7 columns: --columns {copied} names them" in message
    log = read_log(path, table=TableOptions(ROBOT, columns=tuple(copied.split(","))))
    assert_allclose(log.wheels[1:], WHEELS[1:])
    assert len(log) == COUNT


# Text that is no table


PLAIN = table(TRAVEL)
BOOT = "ets Jun  8 2016 00:22:57\n\nrst:0x1 (POWERON_RESET),boot:0x13 (SPI)\nVL53L0X init ok\n"


@pytest.mark.parametrize(
    "content",
    [
        PLAIN.encode("utf-16"),
        PLAIN.encode("utf-8-sig"),
        ("\ufeff" + PLAIN).encode("utf-16-be"),
        gzip.compress(PLAIN.encode("utf-16")),
        PLAIN.replace("\n", "\r\n").encode(),
        PLAIN.replace("\n", "\r").encode(),
        PLAIN.replace(",", " \t ").encode(),
        "\n".join(f"14:00:01.250 -> {line}" for line in PLAIN.splitlines()).encode(),
    ],
)
def test_encodings_and_line_ends_do_not_matter(write, content):
    log = read_log(write(content), table=TableOptions(ROBOT))
    assert_allclose(log.wheels[1:], WHEELS[1:])
    assert (len(log), log.notes) == (COUNT, ())


def test_text_before_the_header_is_skipped_and_counted(write):
    log = read_log(write(BOOT, PLAIN, name="some.txt"), table=TableOptions(ROBOT))
    assert log.notes == ("3 lines of text before the table were skipped",)
    assert len(log) == COUNT
    columns = ("t", "left", "right", *NAMED)
    chosen = read_log(write(BOOT, PLAIN), table=TableOptions(ROBOT, columns=columns))
    assert (len(chosen), chosen.notes) == (COUNT, log.notes)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        ("4.9,0.0", "2 columns where the header names 7, in '4.9,0.0'"),
        ("WiFi: connected", "1 column where the header names 7, in 'WiFi: connected'"),
        ("4.9,0.01,0.0x1,1,1,1,1", "right is not a number: '0.0x1'"),
        ("4.9,nan,0.01,1,1,1,1", "left is nan, not a finite number"),
        ("4.9,0.01,0.01,1,1,1,1.5.2", "a range is not a number: '1.5.2'"),
        ("490000,0.01,0.01,1,1,1,1", "its time or its motion is impossible"),
        ("-490,0.01,0.01,1,1,1,1", "its time or its motion is impossible"),
        ("4.9,812,0.01,1,1,1,1", "its time or its motion is impossible"),
    ],
)
def test_a_damaged_line_is_left_out_and_named(write, damage, words):
    log = read_log(write(with_lines({50: damage})), table=TableOptions(ROBOT))
    assert len(log) == COUNT - 1
    assert_allclose(log.wheels[1:49], WHEELS[1:49])
    note, gap = log.notes
    assert note.startswith("1 damaged line was left out: line 51: ")
    assert words in note
    assert gap.startswith("1 wheel report is missing")


def with_lines(changed):
    """The plain table with other texts in some of its lines."""
    lines = PLAIN.splitlines()
    return "".join(f"{changed.get(row, line)}\n" for row, line in enumerate(lines))


def test_a_counter_that_jumps_for_one_row_is_a_damaged_line(write):
    ticks = np.round(TICKS)
    ticks[60, 0] += 2e6
    path = write(table({"left": ticks[:, 0], "right": ticks[:, 1]}))
    log = read_log(path, table=TableOptions(ROBOT, 0.0001, accumulated=True))
    assert len(log) == COUNT - 1
    assert_allclose(log.wheels.sum(axis=0), WHEELS[1:].sum(axis=0), atol=2e-4)
    assert "line 62: its time or its motion is impossible" in log.notes[0]


def test_a_last_line_that_was_cut_is_left_out_of_a_short_table(write):
    lines = PLAIN.splitlines()[:8]
    log = read_log(write("\n".join([*lines, "0.7,0.0"])), table=TableOptions(ROBOT))
    assert len(log) == 7
    assert log.notes[0].startswith("1 damaged line was left out: line 9: 2 columns")


def test_more_damaged_lines_than_one_in_twenty_are_refused_with_the_first(write):
    lost = dict.fromkeys(range(10, 17), "lost packet")
    message = refusal(write(with_lines(lost)), table=TableOptions(ROBOT))
    assert "line 11: 1 column where the header names 7, in 'lost packet'" in message
    assert "7 of 120 lines cannot be read as rows of the table" in message
    del lost[10]
    log = read_log(write(with_lines(lost)), table=TableOptions(ROBOT))
    assert log.notes[0].startswith("6 damaged lines were left out: the first is line 12: ")


# The command


def test_a_dry_run_says_how_each_column_is_read_and_stops(write):
    columns = {
        "millis": 1e3 * TIME,
        "encL": TICKS[:, 0],
        "encR": TICKS[:, 1],
        "battery": 0 * TIME + 7.4,
        "yaw": np.degrees(HEADING),
    }
    write(
        "radius = 0.06\naxle = 0.12\nbeams_deg = [90, 45, -45, -90]\nmax_range = 2.0\n",
        name="robot.toml",
    )
    path = write(table(columns, metres=0.001))
    units = ("--metres-per-tick", "0.0001", "--accumulated", "--range-unit", "mm")
    folder = path.parent
    finished = limslam("replay", path, "--robot", "robot.toml", *units, "--dry-run", cwd=folder)
    assert finished.returncode == 0, finished.stderr
    for line in (
        "column      millis -> time, ms",
        "column      encL -> left wheel, 0.0001 m for each 1",
        "column      yaw -> heading, deg",
        "column      r_-45 -> range at -45 deg, mm",
        "column      battery -> not used",
        "events      120 in 11.9 s, 10 a second, 120 with ranges",
        "row 1       0.000 s; left 0.0000 m, right 0.0000 m",
        "row 2       0.100 s; left 0.0124 m, right 0.0020 m",
    ):
        assert line in finished.stdout
    assert "1 column is not used: battery" in finished.stderr
    assert not (folder / "runs").exists()


def test_a_wrong_column_ends_the_command_with_one_line(write):
    path = write(PLAIN)
    columns = ("--robot", "paper", "--columns", "t,left,-rihgt,r_90")
    words = "--columns: '-rihgt' is no name of a column"
    assert words in refused("replay", path, *columns, cwd=path.parent)


@pytest.mark.parametrize("has_scan", [True, False])
def test_rows_without_a_header_that_end_with_a_separator_are_all_read(write, has_scan):
    _, *rows = PLAIN.splitlines()
    rows[0] = rows[0] if has_scan else "0,0,0,-"
    path = write(*(f"{row},\n" for row in rows))
    log = read_log(path, table=TableOptions(ROBOT, columns=("t", "left", "right", *NAMED)))
    assert len(log) == COUNT
    assert log.has_scan[0] == has_scan
    assert not log.notes


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("column", ["left", "gyro_z", "qw"])
def test_numbers_that_overflow_raise_no_warning(write, column):
    huge = np.where(STEPS % 2, 1.7e308, -1.7e308)
    columns = {**TRAVEL, "qx": TIME, "qy": TIME, "qz": TIME}
    path = write(table({**columns, column: huge}))
    options = TableOptions(ROBOT, accumulated=True)
    if column == "left":
        assert "a wheel travels inf m" in refusal(path, table=options)
    else:
        assert len(read_log(path, table=options)) == COUNT


ONE_BEAM = TableOptions(RobotSpec(beams=beams_on_rim((0.0,), 0.1)))


@pytest.mark.parametrize("name", ["distance", "dist_cm"])
def test_a_distance_beside_wheels_is_a_range(write, name):
    log = read_log(write(f"t,left,right,{name}\n0,0,0,1\n0.1,0,0,1\n"), table=ONE_BEAM)
    assert any("the ranges are taken as the robot's beams" in note for note in log.notes)
    assert_array_equal(log.reported[:, 0], [1.0, 1.0] if name == "distance" else [0.01, 0.01])


@pytest.mark.parametrize("names", ["servo_deg,dist_mm", "angle,distance"])
def test_a_sensor_that_turns_is_refused_with_what_helps(write, names):
    words = refusal(write(f"t,left,right,{names}\n0,0,0,90,1\n0.1,0,0,91,1\n"), table=ONE_BEAM)
    assert f"the column {names.split(',')[0]} turns a sensor: the table needs a column" in words


def test_turns_a_minute_may_stand_before_the_wheel(write):
    table = replace(ONE_BEAM, wheel_radius=0.03)
    names = ("rpm_left,rpm_right", "left_rpm,right_rpm")
    logs = [read_log(write(f"t,{each},r_0\n0,5,5,1\n0.1,5,5,1\n"), table=table) for each in names]
    assert_array_equal(logs[0].wheels, logs[1].wheels)
