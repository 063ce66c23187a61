"""ROS bags: which topics are used, where beams point, how times meet, and how every fault is
refused in one line.
"""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support import bags
from support.bags import KINDS, Message, distance, fixed, odometry, scan, storage_of, write_bag
from support.command_line import refused
from support.data import data_folder, refusal

from limslam_agent import read_log
from limslam_agent.logs.directions import direction_of
from limslam_env.geometry import se2

FIVE = [1.0, 2.0, 2.5, 1.5, 0.5]


def drive(scans=10, **changes):
    """A robot that drives ahead at 1 m/s and looks about five times a turn's half."""
    said = [odometry(10.0 + 0.1 * step, 0.1 * step) for step in range(scans + 1)]
    seen = [scan(10.05 + 0.1 * step, FIVE, **changes) for step in range(scans)]
    return sorted(said + seen, key=lambda message: message.at)


def four_ranges(at, values=(0.5, 1.0, 1.5, 2.0), names=("front", "left", "back", "right")):
    return [
        distance(at, value, f"/range/{name}") for value, name in zip(values, names, strict=True)
    ]


def degrees(log):
    return np.degrees([each.angle for each in log.robot.beams])


# What is read


@pytest.mark.parametrize("kind", KINDS)
def test_scans_and_odometry_are_brought_together_in_every_kind_of_bag(tmp_path, kind):
    log = read_log(write_bag(tmp_path, drive(), kind))
    assert len(log) == 10
    assert log.has_scan.all()
    assert_allclose(log.time, 10.05 + 0.1 * np.arange(10), atol=1e-6)
    assert_allclose(log.odometry[:, 0], 0.05 + 0.1 * np.arange(10), atol=1e-6)
    assert_allclose(log.ranges, np.tile(np.float32(FIVE), (10, 1)))
    assert_allclose(degrees(log), [-90.0, -45.0, 0.0, 45.0, 90.0], atol=1e-4)
    assert_array_equal(log.start_pose, np.zeros(3))
    assert log.robot.control_period == pytest.approx(0.1, abs=1e-6)
    assert {each.max_range for each in log.robot.beams} == {3.0}
    assert {each.min_range for each in log.robot.beams} == {0.05}


def rich_drive(ranges, first, step):
    """A robot that drives ahead for 4 s and looks in directions from ``first`` on, deg."""
    beams = {"angle_min": math.radians(first), "angle_increment": math.radians(step)}
    return [
        each
        for row in range(5)
        for each in (odometry(10 + row, 0.1 * row), scan(10 + row, ranges, **beams))
    ]


def test_a_rich_laser_gives_six_beams_and_those_asked_for(tmp_path):
    ranges = [0.5 + 0.005 * index for index in range(360)]
    path = write_bag(tmp_path, rich_drive(ranges, 0.0, 1.0))
    log = read_log(path)
    assert_allclose(degrees(log), [-90.0, -45.0, -15.0, 15.0, 45.0, 90.0], atol=1e-4)
    expected = [ranges[index] for index in (270, 315, 345, 15, 45, 90)]
    assert_allclose(log.ranges[0], expected, rtol=1e-6)
    asked = read_log(path, (180.0, 0.4))
    assert_allclose(asked.ranges[0], [1.4, 0.5], rtol=1e-6)
    assert "0 deg and 0.3 deg are the same beam" in refusal(path, (0.0, 0.3))
    assert "finite number, not nan" in refusal(path, (math.nan,))
    assert "at least one beam" in refusal(path, ())


@pytest.mark.parametrize(
    ("first", "step", "count", "expected"),
    [
        (-170.0, 10.0, 36, [-90.0, -50.0, -20.0, 10.0, 40.0, 90.0]),
        (-30.0, 1.0, 61, [-30.0, -15.0, 15.0, 30.0]),
    ],
)
def test_a_laser_without_the_usual_directions_gives_the_nearest(
    tmp_path, first, step, count, expected
):
    log = read_log(write_bag(tmp_path, rich_drive([1.0] * count, first, step)))
    assert_allclose(degrees(log), expected, atol=1e-3)


def test_where_the_laser_is_mounted_comes_from_tf_static(tmp_path):
    mounts = fixed(
        ("base_link", "plate", 0.1, 0.0, math.pi / 2, 0.0), ("plate", "laser", 0.2, 0.0, 0.0, 0.0)
    )
    log = read_log(write_bag(tmp_path, [mounts, *drive()]))
    assert_allclose([(b.x, b.y) for b in log.robot.beams], [[0.1, 0.2]] * 5, atol=1e-6)
    turned = np.radians(degrees(log) - [0.0, 45.0, 90.0, 135.0, 180.0])
    assert_allclose(np.cos(turned), 1.0, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_range_topics_are_gathered_into_events(tmp_path, kind):
    messages = [odometry(10.0 + 0.2 * step, 0.2 * step) for step in range(8)]
    for step in range(10):
        at = 10.1 + 0.1 * step
        messages += [*four_ranges(at), distance(at, 1.0, "/range/zrange")]
    log = read_log(write_bag(tmp_path, messages, kind))
    by_direction = dict(zip(degrees(log).round().tolist(), log.ranges[0].tolist(), strict=True))
    assert by_direction == {0.0: 0.5, 90.0: 1.0, 180.0: 1.5, -90.0: 2.0}
    assert len(log) == 10
    assert {b.min_range for b in log.robot.beams} == {0.04}


def test_range_topics_may_be_given_with_their_directions(tmp_path):
    messages = []
    for at in (10.0, 11.0, 12.0):
        messages += [odometry(at, 0.1 * at), *four_ranges(at, names=("a", "b", "c", "left"))]
    path = write_bag(tmp_path, messages)
    words = "where /range/a points is unknown: set it with --topics /range/a:DEGREES"
    assert words in refusal(path)
    log = read_log(path, None, None, {"range/c": 30.0, "range/left": None})
    assert_allclose(degrees(log), [30.0, 90.0])
    assert_allclose(log.ranges[0], [1.5, 2.0])


def test_the_slowest_sensor_sets_the_pace_and_incomplete_events_are_left_out(tmp_path):
    messages = [odometry(10.0 + 0.5 * step, 0.1 * step) for step in range(20)]
    heard = (*range(20), *range(28, 50))
    messages += [distance(10.0 + 0.1 * step, 1.0 + 0.01 * step, "/left") for step in heard]
    messages += [distance(10.02 + 0.4 * step, 2.0, "/right") for step in range(12)]
    log = read_log(write_bag(tmp_path, messages))
    kept = np.array([0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 11])  # at 12.42 s the left is silent since 11.9
    assert_allclose(log.time, 10.02 + 0.4 * kept, atol=1e-6)
    left = degrees(log).tolist().index(90.0)
    assert_allclose(log.ranges[1, left], 1.04, rtol=1e-6)


def test_two_scanners_are_put_together_when_both_are_asked_for(tmp_path):
    frames = (("laser", 0.2, 0.0), ("behind", -0.2, math.pi))
    messages = [fixed(*(("base_link", frame, x, 0.0, yaw, 0.0) for frame, x, yaw in frames))]
    messages += drive()
    for step in range(10):
        messages.append(scan(10.06 + 0.1 * step, [0.3, 0.4, 0.6], "/rear", frame="behind"))
    path = write_bag(tmp_path, messages)
    log = read_log(path, (0.0, 180.0, 45.0), None, {"scan": None, "rear": None})
    assert_allclose(log.ranges[0], [2.5, 0.4, 1.5], rtol=1e-6)
    assert_allclose([b.x for b in log.robot.beams], [0.2, -0.2, 0.2], atol=1e-6)
    assert "has 2 LaserScan topics, /rear, /scan: choose with --topics" in refusal(path)


POSES = {
    "geometry_msgs/msg/PoseStamped": lambda x: {"pose": bags.pose(x, 0.0, 0.1 * x)},
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda x: {
        "pose": {"pose": bags.pose(x, 0.0, 0.1 * x)}
    },
    "geometry_msgs/msg/TransformStamped": lambda x: {
        "transform": {"translation": {"x": x}, "rotation": bags.rotation(0.1 * x)}
    },
}


@pytest.mark.parametrize("kind", sorted(POSES))
def test_poses_do_as_odometry_and_turn_the_short_way(tmp_path, kind):
    messages = [scan(10.5 + step, FIVE) for step in range(3)]
    for step in range(4):
        at = 10.0 + step
        fields = {"header": bags.header(at), **POSES[kind](30.0 + step)}
        messages.append(Message("/pose", kind, at, fields))
    log = read_log(write_bag(tmp_path, messages))
    assert_allclose(log.odometry[:, 0], [30.5, 31.5, 32.5])
    # 3.05, 3.15 and 3.25 rad: over the half turn.
    turned = np.array([3.05, 3.15 - 2 * math.pi, 3.25 - 2 * math.pi])
    assert_allclose(log.odometry[:, 2], turned, atol=1e-9)


def test_odometry_goes_before_poses_and_two_of_a_kind_are_refused(tmp_path):
    goal = Message("/goal", "geometry_msgs/msg/PoseStamped", 10.0, {"header": bags.header(10.0)})
    assert len(read_log(write_bag(tmp_path, [goal, *drive()]))) == 10
    two = write_bag(tmp_path, [*drive(), odometry(10.0, 0.0, topic="/wheel_odom")], name="two")
    words = "has 2 topics with poses, /odom, /wheel_odom: choose one with --topics"
    assert words in refusal(two)
    assert len(read_log(two, None, None, {"odom": None})) == 10


# Times


@pytest.mark.parametrize(("said", "seen"), [([0.0] * 4, 100.0), (range(3, 7), 1000.0)])
def test_without_stamps_or_with_clocks_that_differ_the_bags_times_are_used(tmp_path, said, seen):
    messages = [odometry(50.0 + step, 0.1 * step, stamp=said[step]) for step in range(4)]
    messages += [scan(50.5 + step, FIVE, stamp=seen + step) for step in range(3)]
    log = read_log(write_bag(tmp_path, messages))
    assert_allclose(log.time, [50.5, 51.5, 52.5])
    assert_allclose(log.odometry[:, 0], [0.05, 0.15, 0.25])


# What is refused


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (odometry(10.55, math.nan), "/odom: message 7: the position is nan, 0: not finite"),
        (
            Message("/odom", "nav_msgs/msg/Odometry", 10.55, {"header": bags.header(10.55)}),
            "0, 0, 0, 0",
        ),
        (odometry(10.55, 1e12), "the odometry in row"),
        (scan(10.6, []), "/scan: message 7: the scan has no ranges"),
        (scan(10.6, FIVE, angle_min=math.nan), "/scan: message 7: the scan's angles are invalid"),
    ],
)
def test_messages_that_make_no_sense_are_refused_with_their_number(tmp_path, bad, words):
    messages = sorted([*drive(), bad], key=lambda message: message.at)
    assert words in refusal(write_bag(tmp_path, messages))


@pytest.mark.parametrize(
    ("messages", "words"),
    [
        ([odometry(10.0, 0.0)], "has no LaserScan and no Range; it has /odom (nav_msgs/msg/Odo"),
        ([scan(10.0, FIVE)], "no transform from odom to the body; it has /scan (sensor_msgs/msg/"),
        (
            [*drive(1), distance(10.0, 1.0, "/left")],
            "has LaserScan (/scan) and Range topics (/left): choose with",
        ),
        (
            [odometry(10.0, 0.0), distance(10.0, 1.0, "/r1", frame="up_link")],
            "all of /r1 look up or down: no beam",
        ),
        (
            [
                bags.transforms(
                    "/tf", 10.0, *(("odom", body, 0, 0, 0, 0) for body in ("base_link", "other"))
                ),
                scan(10.05, FIVE),
            ],
            "has 2 transforms from a frame of odometry, odom to base_link, odom to other",
        ),
    ],
)
def test_bags_that_lack_or_offer_too_much_are_refused(tmp_path, messages, words):
    assert words in refusal(write_bag(tmp_path, messages))


@pytest.mark.parametrize(
    ("topics", "words"),
    [
        ("/front", "has no topic /front; it has /odom (nav_msgs/msg/Odometry), /scan"),
        (
            "/scan:0",
            "/scan holds sensor_msgs/msg/LaserScan: only a Range has a direction to choose",
        ),
        ("/scan:somewhere", "--topics: 'somewhere' is no direction"),
        ("/scan:999", "--topics: 999 is not within 360 deg"),
    ],
)
def test_topics_that_cannot_be_used_are_refused(tmp_path, topics, words):
    assert words in refused(
        "replay", write_bag(tmp_path, drive(2)), "--topics", topics, cwd=tmp_path
    )


# Odometry that is not whole


@pytest.mark.parametrize("kind", KINDS)
def test_odometry_may_be_a_transform(tmp_path, kind):
    seen = [each for each in drive(frame="laser") if each.topic == "/scan"]
    body = ("base_footprint", "base_link", 0.0, 0.0, 0.0, 0.0)
    for x in 0.1 * np.arange(11):
        moving = ("odom", "base_footprint", x, 0.0, 0.0, 0.0)
        corrected = ("map", "odom", 5.0, x, 1.0, 0.0)
        seen.append(bags.transforms("/tf", 10.0 + x, moving, body, corrected))
        seen.append(bags.transforms("/tf", 10.0 + x, ("base_link", "arm", x, 0.0, 0.0, 0.0)))
    seen.append(fixed(("base_link", "laser", 0.2, 0.0, math.pi / 4, 0.0)))
    log = read_log(write_bag(tmp_path, sorted(seen, key=lambda message: message.at), kind))
    assert_allclose(log.odometry[:, 0], 0.05 + 0.1 * np.arange(10), atol=1e-6)
    assert_allclose(log.odometry[:, 1:], 0.0, atol=1e-9)
    assert_allclose(degrees(log), [-45.0, 0.0, 45.0, 90.0, 135.0], atol=1e-4)
    assert {each.x for each in log.robot.beams} == {0.2}


COUNT = 80
STEADY = 0.05 * np.arange(COUNT)  # at 0.5 m/s


def long_drive(silent=(), places=STEADY, nearer=0.0):
    """A drive of 8 s without the odometry of some steps, or at other places, in which all walls
    come nearer at a speed.
    """
    heard = [step for step in range(COUNT) if step not in silent]
    said = [odometry(10.0 + 0.1 * step, places[step]) for step in heard]
    walls = [2.0, *FIVE[1:]] - 0.1 * nearer * np.arange(COUNT)[:, None]
    seen = [scan(10.05 + 0.1 * step, list(walls[step])) for step in range(COUNT - 1)]
    return sorted(said + seen, key=lambda message: message.at)


def test_scans_in_a_gap_of_odometry_are_left_out_and_named(tmp_path):
    log = read_log(write_bag(tmp_path, long_drive(silent=range(31, 60))))
    (note,) = log.notes
    assert note.startswith("30 scans without odometry were left out, from 2.9")
    assert len(log) == 79 - 30
    (found,) = log.breaks
    assert found.row == 30
    assert found.end - found.begin == pytest.approx(3.1)
    assert found.distance == pytest.approx(31 * 0.05)
    assert not found.is_jump


def test_odometry_that_is_silent_while_the_robot_stands_has_no_gap(tmp_path):
    places = 0.05 * np.concatenate((np.arange(30), np.full(31, 30), np.arange(30, 49)))
    log = read_log(write_bag(tmp_path, long_drive(range(31, 60), places), name="still"))
    assert (len(log), log.breaks, log.notes) == (COUNT - 1, (), ())
    # The readings say that the robot has moved.
    moved = long_drive(range(31, 60), places, nearer=-0.3)
    assert [each.row for each in read_log(write_bag(tmp_path, moved)).breaks] == [30]


def test_a_jump_between_two_scans_is_one_jump(tmp_path):
    places = STEADY - 3.0 * (np.arange(COUNT) >= 40)
    log = read_log(write_bag(tmp_path, long_drive(places=places)))
    (found,) = log.breaks
    assert found.is_jump
    assert found.distance == pytest.approx(2.9, abs=0.06)
    (note,) = log.notes
    assert note.startswith("1 scan without odometry was left out")
    assert max(abs(each["odometry"][0]) for each in log.observations()) < 0.06


# Files


@pytest.mark.parametrize(
    ("kind", "remedy"),
    [("ros1", "rosbag reindex"), ("mcap", "mcap recover"), ("sqlite", "ros2 bag reindex")],
)
def test_a_bag_that_is_cut_names_what_mends_it(tmp_path, kind, remedy):
    bag = write_bag(tmp_path, drive(40), kind)
    file = bag if kind == "ros1" else storage_of(bag)
    content = file.read_bytes()
    file.write_bytes(content[: len(content) * 2 // 3])
    message = refusal(bag)
    assert "cut short, damaged" in message
    assert remedy in message


def test_a_folder_without_its_metadata_names_what_writes_it(tmp_path):
    bag = write_bag(tmp_path, drive(2), "mcap")
    (bag / "metadata.yaml").unlink()
    assert refusal(bag).endswith("it has no metadata.yaml; ros2 bag reindex writes it")


def test_folders_and_missing_files_are_refused(tmp_path):
    assert refusal(tmp_path).endswith("is a folder, but not a ROS 2 bag: it has no metadata.yaml")
    (tmp_path / "log.npz").touch()
    assert refusal(tmp_path).endswith(f"; the log of this run is {tmp_path / 'log.npz'}")
    for name in ("table.xlsx", "table.ods"):
        (tmp_path / name).write_bytes(b"PK\x03\x04" + bytes(8))
        assert "is a spreadsheet, which must be saved as CSV" in refusal(tmp_path / name)
    for name in ("absent.xlsx", "absent.bag"):
        assert "No such file" in refusal(tmp_path / name)
    bag = write_bag(tmp_path, drive(2), "sqlite")
    storage_of(bag).unlink()
    assert "Some database files are missing" in refusal(bag)


# Names and rotations


@pytest.mark.parametrize(
    "case",
    [
        "/range/front -> 0",
        "rangeRight -> -90",
        "/ultrasound/rear -> 180",
        "front_left -> 45",
        "FrontRight -> -45",
        "rear_right_link -> -135",
        "range_90deg -> 90",
        "ir_m45deg -> -45",
        "minus_30_deg -> -30",
        "ir-22.5deg -> -22.5",
        "tof_l -> 90",
    ],
)
def test_directions_in_names(case):
    name, degrees = case.split(" -> ")
    assert direction_of(name) == float(degrees)


@pytest.mark.parametrize("name", ["/sonar_3", "l_sensor", "left_right", "feedback", ""])
def test_names_without_a_direction(name):
    assert direction_of(name) is None


# Real bags


@pytest.mark.parametrize(("name", "events"), [("olsson-3loop", 3816), ("olsson-demo", 3430)])
def test_a_drones_bag_agrees_with_its_numbers_as_text(name, events):
    folder = data_folder() / "crazyflie"
    bag = read_log(folder / f"{name}.bag", None, 2.0)
    text = read_log(folder / f"{name}.csv.gz", None, 2.0)
    assert len(bag) == events
    assert_allclose(degrees(bag), [-90.0, 0.0, 90.0, 180.0], atol=1e-9)
    rows = slice(-events - 1, -1)  # the text begins before the first position
    assert_array_equal(bag.ranges, text.ranges[rows])
    # The text has the position last heard of, the bag the one at that time: a drone flies 10 cm in
    # a tenth of a second.
    off = bag.odometry - text.odometry[rows]
    assert np.hypot(*off[:, :2].T).max() < 0.15
    assert np.abs(se2.wrap_angle(off[:, 2])).max() < 0.02


def test_a_drones_arrays_are_told_by_their_topics(tmp_path):
    def raw(topic, at, numbers):
        return Message(topic, bags.RAW_DATA, at, {"header": bags.header(at), "raw": numbers})

    rows = 0.1 * np.arange(5)
    ranger = [
        raw(
            "/cf/state_ranger_qxyzw",
            10.0 + x,
            [0.5, 1.0, 1.5, 2.0, 2.5, *bags.rotation(x).values()],
        )
        for x in rows
    ]
    position = [raw("/cf/state_xyzv", 10.0 + x, [x, 0.2, 0.3]) for x in rows]
    path = write_bag(tmp_path, ranger + position)
    log = read_log(path)
    expected = np.column_stack((rows, np.full(5, 0.2), rows))
    assert_allclose(log.odometry, expected, atol=1e-6)
    assert_allclose(log.ranges[0], [0.5, 1.0, 1.5, 2.0])
    assert_allclose(read_log(path, (90.0, -90.0)).ranges[0], [1.5, 0.5])
    ranger.append(raw("/cf/state_ranger_qxyzw", 10.45, [1.0]))
    short = write_bag(tmp_path, ranger + position, name="short")
    assert "/cf/state_ranger_qxyzw: message 6: " in refusal(short)
    other = write_bag(tmp_path, ranger, name="other")
    assert "has no LaserScan and no Range" in refusal(other)
