"""``limslam live --ros2`` with robots, bags and listeners in other processes. Skipped where there
is no ROS 2.
"""

import json
import math
import time
from pathlib import Path

import numpy as np
import pytest
from support import ros2
from support.command_line import limslam
from support.ros2 import Listener, start, wait_for

from limslam_agent import read_log
from limslam_agent.live.ros2.node import PACKAGES
from limslam_agent.output.finished_run import read_run
from limslam_env.geometry import se2

for package in PACKAGES:
    pytest.importorskip(package, reason=f'needs ROS 2 ({package}): pip install "limslam[ros2]"')

# Libraries that rclpy imports are older than Python.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

BEAMS = [f"beam_{number}" for number in range(6)]
RANGES = ("-p", f"range_topics:=[{','.join(BEAMS)}]")
LIVE = ("-m", "limslam_agent", "live", "--ros2", "--robot", "paper", "--preset", "consistent")
TOPICS = {
    "map": "nav_msgs/msg/OccupancyGrid",
    "walls": "visualization_msgs/msg/MarkerArray",
    "pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "map_to_odom": "geometry_msgs/msg/TransformStamped",
    "status": "diagnostic_msgs/msg/DiagnosticArray",
    "cmd_vel": "geometry_msgs/msg/Twist",
}


@pytest.fixture
def processes():
    """Starts programs, and ends them after the test."""
    running = []

    def begin(*words):
        running.append(start(*words))
        return running[-1]

    yield begin
    for process in running:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.fixture
def listener():
    found = Listener(TOPICS, is_kept=("map", "walls"))
    yield found
    found.close()


def is_driving(listener):
    return any(each.linear.x or each.angular.z for each in listener.heard["cmd_vel"][-1:])


def state_of(listener):
    values = listener.heard["status"][-1].status[0].values
    return {each.key: each.value for each in values}["state"]


def finished(process, seconds=120.0):
    """What a session has printed, after it has ended well."""
    wait_for(lambda: process.poll() is not None, seconds=seconds)
    said = process.stdout.read()
    assert process.returncode == 0, said
    return said


def test_a_robot_in_another_process_explores_pauses_and_drives_home(processes, listener, tmp_path):
    truth = tmp_path / "truth.txt"
    folder = tmp_path / "room"
    robot = ("--speed", 0, "--truth", truth)
    processes("-m", "limslam_agent.live.emulator", "--ros2", *robot)
    live = processes(
        *LIVE, "--out", folder, "--", "--ros-args", *RANGES, "-p", "use_sim_time:=true"
    )
    wait_for(lambda: len(listener.heard["pose"]) > 150, live)
    wait_for(lambda: is_driving(listener), live)
    resume = listener.publisher("std_msgs/msg/Bool", "explore/resume")
    home = listener.publisher("std_msgs/msg/Bool", "explore/return_home")
    from std_msgs.msg import Bool

    wait_for(lambda: resume.get_subscription_count() and home.get_subscription_count(), live)
    resume.publish(Bool(data=False))
    wait_for(lambda: listener.heard["status"] and state_of(listener) == "paused", live)
    wait_for(lambda: not is_driving(listener), live)
    commands = len(listener.heard["cmd_vel"])
    poses = len(listener.heard["pose"])
    wait_for(lambda: len(listener.heard["pose"]) > poses + 20, live)
    assert len(listener.heard["cmd_vel"]) <= commands + 1
    resume.publish(Bool(data=True))
    wait_for(lambda: state_of(listener) == "exploring" and is_driving(listener), live)
    home.publish(Bool(data=True))
    assert "is at its start" in finished(live)

    result = json.loads((folder / "result.json").read_text())["metrics"]
    assert result["stop_reason"] == "asked to drive home; the robot is at its start"
    assert (result["packets_implausible"], result["lines_bad"]) == (0, 0)
    run = read_run(folder)
    assert len(run.segments) >= 2
    true = np.loadtxt(truth)[:, 1:]
    assert math.hypot(*(true[-1] - true[0])[:2]) < 0.25
    check_messages(listener, run)


def check_messages(listener, run):
    heard = listener.heard
    grid = heard["map"][-1]
    assert grid.header.frame_id == "map"
    assert (len(grid.data), set(grid.data)) == (grid.info.width * grid.info.height, {-1, 0, 100})
    (marker,) = heard["walls"][-1].markers
    assert len(marker.points) >= 4
    pose = heard["pose"][-1]
    transform = heard["map_to_odom"][-1]
    assert pose.pose.covariance[0] > 0.0
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "odom")
    assert math.hypot(pose.pose.pose.position.x, pose.pose.pose.position.y) < 0.2
    assert heard["status"][-1].status[0].message.startswith(("ok", "unsure"))
    assert (heard["cmd_vel"][-1].linear.x, heard["cmd_vel"][-1].angular.z) == (0.0, 0.0)
    assert run.title == "live ros2, consistent"


def test_a_scan_that_ends_stops_the_wheels_and_ends_the_session(processes, listener, tmp_path):
    from limslam_agent.live.ros2.node import make
    from limslam_agent.output.formats.ros_builder import MessageBuilder

    build = MessageBuilder(make)
    folder = tmp_path / "room"
    odom = listener.publisher("nav_msgs/msg/Odometry", "odom")
    scan = listener.publisher("sensor_msgs/msg/LaserScan", "scan")
    live = processes(*LIVE, "--patience", 10, "--out", folder)
    step = 2.0 * math.pi / 72

    def drives_after_another_scan():
        at = time.time()
        odom.publish(build.odometry(at, ("odom", "base_link"), np.zeros(3), np.zeros(3)))
        scan.publish(
            make(
                "sensor_msgs/msg/LaserScan",
                header=build.header(at - 0.02, "laser"),
                angle_min=-math.pi,
                angle_increment=step,
                range_min=0.1,
                range_max=3.5,
                ranges=[1.2] * 72,
            )
        )
        return is_driving(listener)

    wait_for(drives_after_another_scan, live, seconds=180.0)
    wait_for(lambda: not is_driving(listener), live)
    finished(live)
    metrics = json.loads((folder / "result.json").read_text())["metrics"]
    assert metrics["stop_reason"] == "the robot has sent nothing new for 10 s"
    assert read_log(folder / "log.npz").robot.beams[0].x == 0.0


def test_a_bag_that_is_played_gives_the_map_of_its_run(processes, listener, tmp_path):
    pytest.importorskip("rosbags", reason="needs the extra ros (rosbags)")
    run = tmp_path / "run"
    bag = tmp_path / "bag"
    folder = tmp_path / "room"
    told = ("--noise", 0.02, "--seed", 4, "--max-time", 40, "--preset", "consistent", "--out", run)
    assert limslam("run", *told).returncode == 0
    assert limslam("export", run, "--bag", "--out", tmp_path).returncode == 0
    processes(Path(ros2.__file__), bag, ros2.PACE)
    live = processes(
        *LIVE,
        "--patience",
        10,
        "--out",
        folder,
        "--",
        "--ros-args",
        *RANGES,
        "-p",
        "explore:=false",
    )
    finished(live)
    assert not any(each.linear.x or each.angular.z for each in listener.heard["cmd_vel"])
    original = read_log(run / "log.npz")
    heard = read_log(folder / "log.npz")
    # Messages of the beginning are lost, since topics are found one after the other, and a busy
    # computer loses more: the first row is the one from which all that was heard agrees best.
    since = np.round(heard.time / 0.1).astype(int)
    first = min(
        range(len(original) - since[-1]),
        key=lambda row: np.nansum(np.abs(original.ranges[row + since] - heard.ranges)),
    )
    rows = first + since
    assert 300 < len(heard) <= len(original)
    is_there = np.isfinite(heard.ranges)
    assert is_there.mean() > 0.8
    np.testing.assert_allclose(heard.ranges[is_there], original.ranges[rows][is_there], atol=6e-4)
    np.testing.assert_allclose(
        np.cumsum(heard.wheels, axis=0),
        (sums := np.cumsum(original.wheels, axis=0))[rows] - sums[first],
        atol=1e-4,
    )
    true = original.true_pose[rows]
    estimated = read_run(folder).estimated[0]
    errors = estimated - se2.between(np.broadcast_to(true[0], true.shape), true)
    assert np.sqrt(np.mean(np.sum(errors[:, :2] ** 2, axis=1))) < 0.1
