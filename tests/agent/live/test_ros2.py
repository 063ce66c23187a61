"""Robots of ROS 2 without ROS: messages become telemetry, and the belief becomes messages."""

import math
import runpy
import sys
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from support.command_line import app, limslam

from limslam_agent.live.link import POLL, NoRobotError
from limslam_agent.live.protocol import NOTHING_SEEN, Heartbeat, Hello, Speeds, Stop
from limslam_agent.live.recording import Recording
from limslam_agent.live.ros2.headings import Headings
from limslam_agent.live.ros2.link import RosLink
from limslam_agent.live.ros2.node import IMU, ODOMETRY, PACKAGES, Event, Parameters
from limslam_agent.live.ros2.odometer import Odometer, wheel_travel
from limslam_agent.live.ros2.sensors import RangeSensors, Reading, ScanSensors, in_mm
from limslam_env import RobotSpec
from limslam_env.geometry import se2
from limslam_env.interface import beams_on_rim

ROBOT = RobotSpec()


def stamped(time, frame=""):
    seconds, rest = divmod(round(1e9 * time), 10**9)
    return SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=rest), frame_id=frame)


def odometry(x, y, heading):
    turn = SimpleNamespace(x=0.0, y=0.0, z=math.sin(0.5 * heading), w=math.cos(0.5 * heading))
    pose = SimpleNamespace(position=SimpleNamespace(x=x, y=y), orientation=turn)
    header = stamped(0.0, "wheels")
    return SimpleNamespace(header=header, child_frame_id="body", pose=SimpleNamespace(pose=pose))


def scan(ranges, *, first=-180.0, step=1.0, least=0.1, largest=3.5, time_increment=0.0):
    return SimpleNamespace(
        ranges=ranges,
        angle_min=math.radians(first),
        angle_increment=math.radians(step),
        range_min=least,
        range_max=largest,
        time_increment=time_increment,
    )


def distance(reading, least=0.05, largest=1.2):
    return SimpleNamespace(range=reading, min_range=least, max_range=largest)


class FakePorts:
    """A node without ROS. Each look for messages gives those of the next moment."""

    def __init__(self, *moments):
        self.moments = list(moments)
        self.watchdog_stops = 0
        self.time = 0.0
        self.driven = []
        self.held = 0

    def take(self, timeout):
        self.time += timeout
        return self.moments.pop(0) if self.moments else []

    def now(self):
        return self.time

    def drive(self, speed, turn_rate):
        self.driven.append((speed, turn_rate))

    def hold(self):
        self.held += 1


# Wheel travel from odometry.


@pytest.mark.parametrize(
    "wheels", [(0.1, 0.1), (0.1, 0.3), (-0.2, -0.1), (0.2, -0.2), (0.0, 0.5), (0.0, 0.0)]
)
def test_the_travel_of_wheels_comes_back_from_the_pose_that_it_leads_to(wheels):
    motion = se2.arc(*se2.wheels_to_arc(np.array(wheels), 0.16))
    np.testing.assert_allclose(wheel_travel(motion, 0.16), wheels, atol=1e-12)


def test_between_two_messages_travel_and_pose_are_interpolated_and_lost_messages_lose_no_travel():
    odometer = Odometer(ROBOT, 0.1)
    pose = np.array([3.0, -1.0, 3.0])
    wheels = np.array([0.02, 0.03])
    odometer.add_pose(10.0, pose)
    for number in range(1, 11):
        pose = se2.compose(pose, se2.arc(*se2.wheels_to_arc(wheels, ROBOT.axle)))
        if number not in {3, 4}:  # lost
            odometer.add_pose(10.0 + 0.1 * number, pose)
    end = odometer.at(11.0)
    np.testing.assert_allclose((end.left, end.right), 10 * wheels, atol=1e-9)
    np.testing.assert_allclose(end.pose, pose)
    half = odometer.at(10.55)
    np.testing.assert_allclose((half.left, half.right), 5.5 * wheels, atol=1e-9)
    assert odometer.at(11.05) is None
    assert odometer.at(9.95) is None
    assert (odometer.late, odometer.jumps) == (0, 0)


def test_late_and_doubled_odometry_is_counted_and_a_jump_is_no_travel():
    odometer = Odometer(ROBOT, 0.1)
    for time, x in (
        (1.0, 0.0),
        (1.1, 0.02),
        (1.1, 0.02),
        (1.05, 0.01),
        (1.2, 0.04),
        (1.3, -7.0),
        (1.4, -6.98),
    ):
        odometer.add_pose(time, np.array([x, 0.0, 0.0]))
    assert (odometer.late, odometer.jumps, odometer.begun) == (2, 1, 0)
    assert odometer.at(1.4).left == pytest.approx(0.06)


# Readings.


def test_readings_mean_what_rep_117_says():
    readings = [1.0, math.inf, -math.inf, math.nan, -1.0, 0.0, 0.09, 3.5, 3.6, 3.4999]
    expected = (1000, NOTHING_SEEN, 0, None, None, 0, 0, NOTHING_SEEN, NOTHING_SEEN, 3500)
    assert in_mm(readings, 0.1, 3.5) == expected
    # Drivers that leave the limits out, and readings so far away that their number has another
    # meaning.
    assert in_mm([0.0, 5.0, 65.535, math.inf], 0.0, 0.0) == (
        0,
        5000,
        NOTHING_SEEN - 1,
        NOTHING_SEEN,
    )


def test_the_beams_of_a_scan_are_picked_by_their_angles_and_begin_at_the_laser():
    sensors = ScanSensors(ROBOT, np.array([0.05, 0.0, math.radians(180.0)]))
    ranges = np.full(360, math.inf)
    # The laser looks back: its -90 deg is the left of the robot.
    ranges[90] = 0.7
    ranges[180 + 165] = 0.4
    (reading,) = sensors.add(0, 5.0, scan(ranges.tolist()))
    assert reading.ranges == (700, NOTHING_SEEN, NOTHING_SEEN, 400, NOTHING_SEEN, NOTHING_SEEN)
    assert reading.time == 5.0
    np.testing.assert_allclose(
        np.degrees(sensors.robot.beam_angles), np.degrees(ROBOT.beam_angles), atol=1e-9
    )
    np.testing.assert_allclose(sensors.robot.beam_origins, np.broadcast_to((0.05, 0.0), (6, 2)))
    assert set(sensors.robot.max_ranges) == {1.5}
    assert [beam.side for beam in sensors.robot.beams] == [beam.side for beam in ROBOT.beams]


def collected(sensors, *messages):
    """What sensors make of messages, each a number, a time and a range."""
    found = [
        each
        for number, time, reading in messages
        for each in sensors.add(number, time, distance(reading))
    ]
    return [(round(each.time, 3), each.ranges) for each in found]


@pytest.mark.parametrize(
    ("messages", "expected"),
    [
        # Times that are near belong together.
        (
            [(0, 1.00, 0.5), (2, 1.02, 0.7), (1, 1.01, math.inf)],
            [(1.01, (500, NOTHING_SEEN, 700))],
        ),
        # The message of the second topic at 1.0 s is lost, and its next one arrives before those of
        # the others.
        (
            [(0, 1.0, 0.5), (2, 1.0, 0.7), (1, 1.1, 0.6), (0, 1.1, 0.4), (2, 1.1, 0.3)],
            [(1.0, (500, None, 700)), (1.1, (400, 600, 300))],
        ),
        # Late and doubled messages are left out.
        (
            [(0, 1.1, 0.5), (0, 1.1, 0.5), (0, 1.0, 0.7), (1, 1.1, 0.4), (2, 1.12, 0.3)],
            [(1.1, (500, 400, 300))],
        ),
    ],
)
def test_ranges_of_several_topics_belong_together_if_their_times_are_near(messages, expected):
    sensors = RangeSensors(RobotSpec(beams=beams_on_rim((90.0, 0.0, -90.0), 0.1)), 0.1)
    first = [(number, 0.9, 1.0) for number in range(3)]
    assert collected(sensors, *first) == [(0.9, (1000, 1000, 1000))]
    np.testing.assert_allclose(sensors.robot.max_ranges, 1.2)
    assert collected(sensors, *messages) == expected


# Headings.


def imu(heading=None, rate=0.0):
    turn = 0.0 if heading is None else 0.5 * heading
    return SimpleNamespace(
        orientation=SimpleNamespace(x=0.0, y=0.0, z=math.sin(turn), w=math.cos(turn)),
        orientation_covariance=[-1.0 if heading is None else 0.01, *[0.0] * 8],
        angular_velocity=SimpleNamespace(x=0.0, y=0.0, z=rate),
    )


def headings_of(*messages):
    headings = Headings()
    for time, message in messages:
        headings.add(time, message)
    return headings


def test_a_heading_is_interpolated_and_counts_on_beyond_a_full_turn():
    headings = headings_of(*((0.1 * row, imu(0.5 * row)) for row in range(20)))
    assert headings.at(1.55) == pytest.approx(7.75)
    assert headings.at(1.95) is None
    assert headings.at(-0.1) is None


def test_a_rate_of_turn_is_summed_up_where_the_orientation_is_unknown():
    headings = headings_of(*((0.1 * row, imu(rate=0.4 * row)) for row in range(11)))
    assert headings.at(1.0) - headings.at(0.0) == pytest.approx(2.0)


def test_headings_that_are_late_or_far_apart_are_left_out():
    headings = headings_of(*((time, imu(time)) for time in (1.0, 1.2, 1.1, 1.2, 2.0, 2.2)))
    assert headings.at(1.1) == pytest.approx(1.1)
    assert headings.at(1.5) is None
    assert headings.at(2.1) == pytest.approx(2.1)
    headings.add(0.2, imu(0.3))
    headings.add(0.3, imu(0.3))  # the time has begun again, by less than what is kept
    assert headings.at(0.25) is None
    for time in (50.0, 50.1, 3.0, 3.1):
        headings.add(time, imu(0.3))
    assert headings.at(3.05) == pytest.approx(0.3)


@pytest.mark.parametrize("message", [imu(rate=math.nan), imu(math.nan)])
def test_a_heading_that_is_no_number_is_refused(message):
    with pytest.raises(ValueError, match="not"):
        Headings().add(1.0, message)


def test_the_heading_of_a_measurement_is_that_of_its_time():
    topics = ",".join(f"b{number}" for number in range(6)).split(",")
    moments = []
    for row in range(40):
        time = 1.0 + 0.05 * row
        readings = [Event(number, time, distance(0.5)) for number in range(6)]
        moments.append(
            [
                Event(ODOMETRY, time, odometry(0.01 * row, 0.0, 0.0)),
                Event(IMU, time + 0.02, imu(0.2 * time)),
                *readings,
            ]
        )
    parameters = Parameters(range_topics=tuple(topics), imu_topic="imu")
    link = RosLink(FakePorts(*moments), ROBOT, parameters)
    link.first_hello(1.0)
    found = []
    for _ in range(40):
        found += [each for each in link.receive(0.05) if each.yaw is not None]
    assert len(found) > 10
    for each in found:
        heading = 0.2 * (1e-3 * each.time_ms - 0.02)
        assert math.radians(1e-3 * each.yaw) % math.tau == pytest.approx(heading, abs=1e-4)


# Readings and odometry together.


def test_readings_wait_for_odometry_and_leave_in_the_order_of_their_times():
    odometer = Odometer(ROBOT, 0.1)
    assert odometer.add_reading(Reading(0.9, (1,))) == []
    odometer.add_pose(1.0, np.zeros(3))
    assert odometer.late == 1  # from before the first odometry
    for time in (1.25, 1.05, 1.15):
        assert odometer.add_reading(Reading(time, (round(100 * time),))) == []
    done = odometer.add_pose(1.2, np.array([0.02, 0.0, 0.0]))
    assert [(each.sample.time, each.ranges) for each in done] == [(1.05, (105,)), (1.15, (115,))]
    assert done[0].sample.left == pytest.approx(0.005)
    assert odometer.add_reading(Reading(1.1, (110,))) == []
    assert odometer.late == 2
    done = odometer.add_pose(1.3, np.array([0.03, 0.0, 0.0]))
    assert [each.sample.time for each in done] == [1.25]


# The connection.


def moment(time, x, reading=0.5):
    return [
        Event(ODOMETRY, time, odometry(x, 0.0, 0.0)),
        *(Event(number, time, distance(reading)) for number in range(6)),
    ]


def link_of(*moments, **parameters):
    topics = tuple(f"beam_{number}" for number in range(6))
    ports = FakePorts(*moments)
    return RosLink(
        ports, ROBOT, Parameters(range_topics=topics, **parameters), clock=ports.now
    ), ports


def test_messages_become_the_telemetry_of_a_session():
    link, ports = link_of(*(moment(5.0 + 0.1 * step, 0.02 * step) for step in range(8)))
    hello = link.first_hello(10.0)
    assert (hello.beams, hello.period_ms, hello.watchdog_ms) == (6, 100, 500)
    recording = Recording(link.robot, hello)
    packets = [*link.receive(0.02), *link.receive(0.02), *link.receive(0.02)]
    rows = [recording.add(packet) for packet in packets]
    assert [row.time for row in rows] == pytest.approx([0.1 * step for step in range(8)])
    np.testing.assert_allclose([row.left for row in rows], 0.02 * np.arange(8), atol=1e-6)
    np.testing.assert_allclose(rows[3].ranges, 0.5)
    assert (link.frames, link.newest.time) == (("wheels", "body"), pytest.approx(5.7))
    link.send(Speeds(link.next_seq(), 0, 100, 260))
    assert ports.driven == [(pytest.approx(0.18), pytest.approx(1.0))]
    link.send(Heartbeat(link.next_seq()))
    link.send(Stop(link.next_seq()))
    assert (ports.driven[1:], ports.held) == ([(0.0, 0.0)], 1)


def test_measurements_that_come_slowly_are_waited_for():
    moments = []
    for row in range(8):
        moments += [moment(5.0 + 0.1 * row, 0.0), *([[]] * 10)]
    link, _ = link_of(*moments)
    assert link.first_hello(15 * POLL).beams == 6


def test_a_clock_that_was_set_is_a_robot_that_was_switched_on_again():
    later = range(8)
    earlier = range(8)
    moments = [moment(100.0 + 0.1 * step, 0.0) for step in later] + [
        moment(1.0 + 0.1 * step, 0.0) for step in earlier
    ]
    link, ports = link_of(*moments)
    first = link.first_hello(10.0)
    messages = []
    while ports.moments:
        messages += link.receive(0.02)
    (again,) = (each for each in messages if isinstance(each, Hello))
    assert (first.boot, again.boot) == (0, 1)
    after = messages[messages.index(again) + 1 :]
    assert after
    assert all(packet.time_ms < 2000 for packet in after)


def test_messages_that_cannot_be_used_are_counted_and_named():
    broken = [Event(ODOMETRY, 5.0, odometry(math.nan, 0.0, 0.0))]
    link, _ = link_of(*([broken] * 4), *(moment(6.0 + 0.1 * step, 0.0) for step in range(6)))
    link.first_hello(10.0)
    assert link.bad_lines == 4
    link, _ = link_of(*([[*broken, *moment(5.0, 0.0)[1:]]] * 4))
    with pytest.raises(NoRobotError, match="no message could be used: the position is nan"):
        link.first_hello(1.0)


@pytest.mark.parametrize(
    ("moments", "words"),
    [
        ([], "there was no message on beam_0, beam_1, beam_2, beam_3, beam_4, beam_5, odom"),
        ([moment(1.0, 0.0)[:4]], "there was no message on beam_3, beam_4, beam_5"),
        ([moment(1.0, 0.0)[1:]], "there was no message on odom"),
        (
            [moment(1.0, 0.0), moment(1.1, 0.0)],
            "gave 2 measurements: are both stamped by the same clock",
        ),
    ],
)
def test_what_is_silent_is_named(moments, words):
    link, _ = link_of(*moments)
    with pytest.raises(NoRobotError, match=words):
        link.first_hello(0.5)


# Parameters, and what is published.


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (
            {"range_topic": ["a"]},
            "range_topic: there is no such setting; there are range_topics, scan_mount, ",
        ),
        ({"period": "fast"}, "the parameters of the node: period: must be a number, not 'fast'"),
        ({"watchdog": 0.0}, "watchdog must be a number from 0.05 to 60, not 0"),
    ],
)
def test_parameters_of_another_name_or_type_are_refused(values, words):
    with pytest.raises(ValueError, match=words):
        Parameters.of(values)


# The command line.


def test_without_ros_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "limslam_agent.live.ros2.node.find_spec",
        lambda name: None if name in PACKAGES else find_spec(name),
    )
    finished = limslam("live", "--ros2", "--robot", "paper", "--out", tmp_path / "room")
    assert finished.returncode == 2
    (line,) = finished.stderr.splitlines()
    assert "ROS 2 needs rclpy, " in line
    assert 'pip install "limslam[ros2]"' in line
    assert list(tmp_path.iterdir()) == []


def test_the_launch_file_starts_a_command_that_the_command_line_reads(monkeypatch):
    example = Path(__file__).parents[3] / "examples" / "live" / "ros2" / "limslam.launch.py"
    if not example.is_file():
        pytest.skip("the examples do not travel with the tests: run them in a checkout")
    # Stand-ins for the launch system of ROS 2: each action keeps what it is given.
    kept = SimpleNamespace(
        LaunchDescription=list,
        DeclareLaunchArgument=lambda name, default_value: (name, default_value),
        ExecuteProcess=lambda **given: given,
        LaunchConfiguration=lambda name: f"<{name}>",
    )
    for module in ("launch", "launch.actions", "launch.substitutions"):
        monkeypatch.setitem(sys.modules, module, kept)
    *arguments, process = runpy.run_path(str(example))["generate_launch_description"]()
    values = dict(arguments)
    words = [part if isinstance(part, str) else "".join(part) for part in process["cmd"]]
    for name, value in values.items():
        words = [word.replace(f"<{name}>", value) for word in words]
    assert words[:2] == ["limslam", "live"]
    command = typer.main.get_command(app).commands["live"]
    told = command.make_context("live", words[2:]).params
    assert (told["ros2"], told["robot"], told["noise"]) == (True, "paper", 0.02)
    assert told["ros_arguments"][:3] == ["--ros-args", "-r", "scan:=scan"]
