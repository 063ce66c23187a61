"""Sessions with a live robot: in this process, and as the command with a robot in another one."""

import json
import math
import os
import select
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from support.command_line import limslam
from support.live import Faults, Wire, emulated, session_with, start_emulator

from limslam_agent import read_log, replay_log, save_map
from limslam_agent.live.link import NoRobotError
from limslam_agent.live.orders import HOME, Goal, Orders
from limslam_agent.live.protocol import Greeting, Heartbeat, Speeds, Stop, checksum, decode
from limslam_agent.live.session import BY_HAND, OUT_OF_TIME
from limslam_agent.output.finished_run import read_run
from limslam_agent.places.saved_map import read_saved_map
from limslam_env.geometry import se2

FIGURES = (
    "packets_lost",
    "packets_late",
    "packets_doubled",
    "packets_implausible",
    "lines_bad",
    "watchdog_stops",
)


class Drive:
    """A policy that always drives at the same wheel speeds."""

    stop_reason = None
    plan = np.zeros((0, 2))

    def __init__(self, left, right):
        self._wheels = np.array([left, right])

    def act(self, belief):
        del belief
        return self._wheels


def driven(wire, seconds, **options):
    session = session_with(wire, **options)
    reason = session.drive(seconds, 5.0)
    return session, reason


def errors_of(session, wire):
    """Distances (n,), m, between the poses that are estimated from the log of a session and the
    true poses.
    """
    replay = replay_log(session.recording.log(), session.agent.config)
    true = np.array(wire.true)
    times = (
        replay.log.time - replay.log.time[-1] + 1e-3 * session.recording._origin[0].time_ms
    )  # of the robot's clock
    rows = np.searchsorted(true[:, 0], times - 1e-6)
    start = np.broadcast_to(true[rows[0], 1:], (len(rows), 3))
    return np.hypot(*(replay.estimated - se2.between(start, true[rows, 1:]))[:, :2].T)


def test_a_perfect_connection_loses_nothing_and_gives_the_estimate_of_a_run():
    wire = Wire(emulated())
    session, reason = driven(wire, 12.0)
    assert reason == OUT_OF_TIME
    figures = session.figures
    assert [figures[name] for name in FIGURES] == [0] * len(FIGURES)
    assert figures["period_s"] == pytest.approx(0.1)
    assert figures["loop_delay_s"] == pytest.approx(0.1)
    log = session.recording.log()
    np.testing.assert_allclose(np.diff(log.time), 0.1, atol=1e-9)
    assert log.wheels[0].tolist() == [0.0, 0.0]
    assert np.abs(log.wheels).sum() > 0.5
    assert errors_of(session, wire).max() < 0.1


BAD_WIRE = Faults(loss=0.1, late=0.1, double=0.1, damage=0.05)


def test_the_heading_of_a_robot_is_used_and_kept(tmp_path):
    wire = Wire(emulated(imu=True), Faults(loss=0.1), seed=1)
    session, _ = driven(wire, 12.0)
    (found, _) = session.agent.slam.odometry_calibrations[0]
    assert found._fields == ("size", "scale", "drift")
    log = session.recording.log()
    assert np.isfinite(log.yaw).all()
    session.recording.save(tmp_path / "log.npz")
    np.testing.assert_array_equal(read_log(tmp_path / "log.npz").yaw, log.yaw)
    assert errors_of(session, wire).max() < 0.1


def test_a_robot_of_version_1_is_driven_and_has_no_heading():
    emulator = emulated()
    emulator.firmware.hello = replace(emulator.firmware.hello, version=1)
    session, reason = driven(Wire(emulator), 3.0)
    assert reason == OUT_OF_TIME
    assert session.recording.log().yaw is None


def test_a_robot_on_a_bad_wire_knows_its_way():
    errors = []
    for seed in (3, 4, 5):
        wire = Wire(emulated(seed=seed), BAD_WIRE, seed)
        errors.append(errors_of(driven(wire, 30.0)[0], wire).max())
    assert np.median(errors) < 0.15


def test_a_lost_line_loses_no_travel_and_the_map_is_whole():
    wire = Wire(emulated(seed=3), BAD_WIRE, 3)
    session, reason = driven(wire, 30.0)
    assert reason == OUT_OF_TIME
    figures = session.figures
    assert all(
        figures[name] > 3
        for name in ("packets_lost", "packets_late", "packets_doubled", "lines_bad")
    )
    assert figures["packets_implausible"] == 0
    log = session.recording.log()
    assert (np.diff(log.time) > 0.05).all()
    # The emulated encoders have counted as much as the log holds.
    np.testing.assert_allclose(log.wheels.sum(axis=0), wire.emulator._travel, atol=0.03)
    assert len(session.agent.slam.segments) >= 4


def test_at_its_end_a_session_stops_the_wheels_whatever_the_reason():
    class Breaks(Drive):
        def act(self, belief):
            if wire.emulator.time > 2.0:
                raise self.error
            return super().act(belief)

    for error in (KeyboardInterrupt(), ValueError("broken"), SystemExit(143)):
        wire = Wire(emulated(seed=8), Faults(loss=0.3), 8)
        policy = Breaks(0.5, 0.5)
        policy.error = error
        session = session_with(wire, policy=policy)
        if isinstance(error, KeyboardInterrupt):
            assert session.drive(60.0, 5.0) == BY_HAND
        else:
            with pytest.raises(type(error)):
                session.drive(60.0, 5.0)
        assert isinstance(decode(wire.sent[-1]), Stop)
        assert wire.emulator.firmware.speeds(0) == (0, 0)
        before = wire.emulator.pose.copy()
        wire.emulator.step()
        np.testing.assert_array_equal(wire.emulator.pose, before)


def test_a_cable_that_is_pulled_stops_the_wheels_and_ends_the_session():
    wire = Wire(emulated())

    def watch(session):
        wire.is_cut = session.recording.newest.time > 3.0

    session = session_with(wire, policy=Drive(0.3, 0.3), watch=watch)
    reason = session.drive(60.0, 2.0)
    assert "nothing new for 2 s" in reason
    poses = np.array(wire.true)
    is_moving = np.hypot(*np.diff(poses[:, 1:3], axis=0).T) > 1e-6
    # The watchdog of 0.5 s has stopped the wheels.
    assert poses[1:, 0][is_moving].max() < 4.0
    after = wire.sent[-60:]
    kinds = [type(decode(line)) for line in after]
    assert Heartbeat in kinds
    assert Greeting in kinds
    assert len(session.recording) >= 30


def test_a_robot_that_is_switched_on_again_continues_the_map():
    wire = Wire(emulated(seed=1))

    def watch(session):
        if session.recording.newest.time > 3.0 and not restarted:
            restarted.append(session.recording.newest)
            wire.replace(emulated(seed=2))

    restarted = []
    session = session_with(wire, policy=Drive(0.2, 0.2), watch=watch)
    assert session.drive(6.0, 5.0) == OUT_OF_TIME
    assert session.reconnections == 1
    log = session.recording.log()
    assert (np.diff(log.time) > 0.0).all()
    # Its counters began at zero, which is no travel.
    assert np.abs(log.wheels).max() < 0.03


def test_a_robot_that_never_answers_is_refused():
    wire = Wire(emulated())
    wire.is_cut = True
    with pytest.raises(NoRobotError, match=r"no robot has answered within 30 s"):
        session_with(wire)


def test_a_paused_session_maps_and_leaves_the_wheels_to_others():
    wire = Wire(emulated())

    def watch(session):
        is_wanted = 3.0 < session.recording.newest.time < 6.0
        (session.orders.pause if is_wanted else session.orders.go_on)()

    session = session_with(wire, policy=Drive(0.3, 0.3), watch=watch)
    assert session.drive(8.0, 5.0) == OUT_OF_TIME
    assert session.orders.answers == [
        "paused: the robot maps, and its wheels stand still",
        "going on",
    ]
    assert len(session.recording) >= 80
    driven = session.recording.log().wheels[:, 0] > 0.005
    times = session.recording.log().time
    assert driven[(times > 0.5) & (times < 3.0)].all()
    assert not driven[(times > 3.5) & (times < 6.0)].any()
    assert driven[(times > 6.5) & (times < 7.9)].all()
    # One command stops the wheels, and then there is none until the session goes on.
    stops = [message for message in map(decode, wire.sent) if isinstance(message, Stop)]
    speeds = [message for message in map(decode, wire.sent) if isinstance(message, Speeds)]
    assert len(stops) <= 3
    assert len(speeds) == pytest.approx(50, abs=4)


def silent_from(seconds, order):
    """A session with a robot whose cable is pulled, and that gets an order 0.2 s after that; and
    the wire.
    """
    wire = Wire(emulated())
    orders = Orders()

    def listen():
        wire.is_cut = wire.clock() > seconds
        if wire.clock() > seconds + 0.2:
            order(orders)

    return session_with(wire, policy=Drive(0.3, 0.3), orders=orders, listen=listen), wire


def test_a_session_ends_when_it_is_asked_to_while_the_robot_is_silent():
    session, wire = silent_from(3.0, lambda orders: setattr(orders, "end", "somebody said so"))
    assert session.drive(60.0, 30.0) == "somebody said so"
    assert wire.clock() < 6.0
    assert isinstance(decode(wire.sent[-1]), Stop)


class Stops(Drive):
    """A policy that drives a bend, and stops after some steps."""

    def __init__(self, steps):
        super().__init__(0.5, 0.4)
        self._left = steps

    def act(self, belief):
        self._left -= 1
        self.stop_reason = "everything seen" if self._left <= 0 else None
        return super().act(belief) if self._left > 0 else np.zeros(2)


def given(at):
    """A session with a robot in env1 that gets orders at times, s: functions of the orders."""
    wire = Wire(emulated())
    waiting = sorted(at.items())

    def watch(session):
        while waiting and session.recording.newest.time >= waiting[0][0]:
            waiting.pop(0)[1](session.orders)
        session.states = [*getattr(session, "states", []), session.state]

    return session_with(wire, policy=Drive(0.5, 0.4), watch=watch), wire


def away_from(session, place):
    return math.dist(session.agent.mapper.poses[0, :2], place)


def test_a_robot_that_is_sent_home_drives_back_to_its_start_and_ends_there():
    session, wire = given({6.0: Orders.go_home})
    assert session.drive(60.0, 5.0) == "asked to drive home; the robot is at its start"
    assert set(session.states) == {"exploring", "driving home", "done"}
    true = np.array(wire.true)[:, 1:3]
    assert np.hypot(*(true - true[0]).T).max() > 0.4
    assert math.dist(true[-1], true[0]) < 0.2


def test_a_robot_drives_to_a_goal_waits_there_and_goes_on():
    def send(orders):
        orders.obey({"order": "goal", "x": 0.0, "y": 0.1, "map": 0})

    def arrived(orders):
        places.append((orders.is_paused, away_from(session, (0.0, 0.1))))
        orders.press("p")

    session, _ = given({6.0: Orders.pause, 7.0: send, 20.0: arrived})
    places = []
    assert session.drive(25.0, 5.0) == OUT_OF_TIME
    ((is_paused, distance),) = places
    assert is_paused
    assert distance < 0.15
    assert session.orders.answers == [
        "paused: the robot maps, and its wheels stand still",
        "driving to the goal (0.0, 0.1)",
        "the robot is at the goal (0.0, 0.1), and waits",
        "going on",
    ]
    assert away_from(session, (0.0, 0.1)) > 0.3
    assert session.states[-1] == "exploring"


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (Goal(-8.0, 3.0, 0), "the goal (-8.0, 3.0): that ground is not mapped yet"),
        (
            Goal(0.0, 0.1, 7),
            "the goal (0.0, 0.1): the robot has begun to use another map since",
        ),
    ],
)
def test_a_goal_that_cannot_be_is_refused_in_a_line_and_changes_nothing(goal, words):
    session, _ = given(
        {3.0: Orders.pause, 4.0: lambda orders: setattr(orders, "destination", goal)}
    )
    assert session.drive(6.0, 5.0) == OUT_OF_TIME
    assert session.orders.answers[1:] == [words]
    assert session.orders.is_paused
    assert session.orders.destination is None


@pytest.mark.parametrize(
    ("when", "reason"),
    [
        ("end", "everything seen"),
        ("home", "everything seen; the robot is at its start"),
        ("pause", OUT_OF_TIME),
    ],
)
def test_what_follows_an_exploration_is_chosen(when, reason):
    orders = Orders(when_explored=when)
    session = session_with(Wire(emulated()), policy=Stops(40), orders=orders)
    assert session.drive(20.0, 5.0) == reason
    assert (orders.is_paused, orders.destination == HOME) == (when == "pause", when == "home")
    if when == "pause":
        assert orders.answers == ["everything seen; the robot waits"]


def test_home_in_the_map_of_an_earlier_session_is_where_the_robot_began(tmp_path):
    first = session_with(Wire(emulated(world="env3", seed=1)))
    start = np.array([1.0, 2.0, 0.5])
    first.agent.reset(start)
    first.drive(70.0, 5.0)
    save_map(tmp_path / "first", first.agent.snapshot())
    wire = Wire(emulated(world="env3", seed=2))

    def watch(session):
        if session.agent.mapper.prior_frame is not None and away_from_start() > 0.5:
            session.orders.go_home()

    def away_from_start():
        return math.dist(wire.true[-1][1:3], wire.true[0][1:3])

    session = session_with(wire, watch=watch, prior_map=read_saved_map(tmp_path / "first"))
    reason = session.drive(120.0, 5.0)
    assert reason == "asked to drive home; the robot is at its start"
    np.testing.assert_allclose(session.agent.mapper.prior_frame, start, atol=0.2)
    assert away_from_start() < 0.25


def test_keys_pause_and_send_home_and_others_mean_nothing():
    orders = Orders()
    orders.press("x7P\x1b")
    assert orders.is_paused
    orders.press("ph")
    assert (orders.is_paused, orders.destination) == (False, HOME)


@pytest.mark.parametrize(
    "message",
    [
        {},
        {"order": "dance"},
        {"order": ["pause"]},
        {"order": "goal", "x": 1.0, "y": 2.0},
        {"order": "goal", "x": float("nan"), "y": 2.0, "map": 0},
        {"order": "goal", "x": "1", "y": 2.0, "map": 0},
        {"order": "goal", "x": 1e300, "y": 2.0, "map": 0},
    ],
)
def test_what_is_no_order_of_a_page_is_refused(message):
    orders = Orders()
    with pytest.raises(ValueError, match=r"there is no such order|of a goal must be a number"):
        orders.obey(message)
    assert (orders.is_paused, orders.destination, orders.answers) == (False, None, [])


FILES = {
    "log.npz",
    "map.json",
    "map.pgm",
    "map.yaml",
    "map.png",
    "result.json",
    "run.toml",
    "covariance_est.npz",
    "trajectory_est.tum",
    "trajectory_odometry.tum",
}


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("", 0))
        return found.getsockname()[1]


@pytest.fixture
def emulator():
    """Starts emulators, and ends them after the test."""
    running = []

    def start(*options):
        process, name = start_emulator(*options)
        running.append(process)
        return process, name

    yield start
    for process in running:
        process.kill()
        process.wait()
        process.stdout.close()


def explored(emulator, folder, *told):
    """The end of the command that drives an emulated robot."""
    port = free_port()
    emulator("--udp", port)
    return limslam("live", "--udp", port, "--preset", "consistent", "--out", folder, *told)


def policy_file(folder, *lines):
    """The name of a policy that drives ahead, with lines that each decision carries out."""
    body = "".join(f"        {line}\n" for line in lines)
    (folder / "mine.py").write_text(
        "import signal\nfrom pathlib import Path\nimport numpy as np\n"
        "class Mine:\n"
        "    stop_reason, plan, count = None, np.zeros((0, 2)), 0\n"
        "    def act(self, belief):\n"
        "        self.count += 1\n"
        f"{body}"
        "        return np.array([0.3, 0.25])\n"
    )
    return f"{folder / 'mine.py'}:Mine"


def kill_after(process, truth, seconds):
    """Kill an emulator after some time of its own, which its file of true poses shows."""

    def watch():
        while process.poll() is None:
            if truth.is_file() and len(truth.read_text().splitlines()) > 10 * seconds:
                process.kill()
            time.sleep(0.02)

    threading.Thread(target=watch, daemon=True).start()


def test_a_killed_robot_leaves_the_folder_of_a_session_with_its_map(emulator, tmp_path):
    port = free_port()
    truth = tmp_path / "truth.txt"
    folder = tmp_path / "room"
    process, _ = emulator("--udp", port, "--truth", truth)
    kill_after(process, truth, 20)
    told = ("--preset", "consistent", "--patience", 5, "--out", folder)
    finished = limslam("live", "--udp", port, *told)
    assert finished.returncode == 0, finished.stderr
    assert {path.name for path in folder.iterdir()} == FILES
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith((".", "room-"))] == []
    result = json.loads((folder / "result.json").read_text())
    metrics = result["metrics"]
    assert metrics["stop_reason"] == "the robot has sent nothing new for 5 s"
    log = read_log(folder / "log.npz")
    assert (len(log), log.true_pose) == (metrics["packets"], None)
    assert len(log) > 100
    run = read_run(folder)
    assert run.is_replay
    assert run.title == "live paper, consistent"
    assert run.true == []
    assert len(run.segments) >= 2
    # The true pose at the end of the log, in the frame of the start. The emulator counts its own
    # time.
    true = np.loadtxt(truth)
    moved = np.flatnonzero(np.hypot(*np.diff(true[:, 1:3], axis=0).T) > 0.0)
    assert np.hypot(*run.estimated[0][-1, :2]) == pytest.approx(
        np.hypot(*(true[-1] - true[moved[0]])[1:3]), abs=0.15
    )
    again = limslam("replay", "--config", folder / "run.toml", "--out", tmp_path / "again")
    assert (again.returncode, again.stderr) == (0, "")
    assert (tmp_path / "again" / "map.json").read_text() == (folder / "map.json").read_text()
    shown = limslam("show", folder, "--out", tmp_path / "room.png")
    assert (shown.returncode, shown.stderr) == (0, "")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pty")
def test_a_robot_begins_in_the_map_of_an_earlier_session(emulator, tmp_path):
    folders = [tmp_path / name for name in ("first", "second")]
    for seed, folder, told in ((1, folders[0], ()), (2, folders[1], ("--map", folders[0]))):
        port = free_port()
        emulator("--udp", port, "--world", "env3", "--seed", seed)
        done = limslam(
            *("live", "--udp", port, "--preset", "consistent", "--max-time", 70),
            *("--out", folder, *told),
        )
        assert done.returncode == 0, done.stderr
    assert "\nplace       found in the saved map after" in done.stderr
    result = json.loads((folders[1] / "result.json").read_text())
    assert result["record"]["places"][0]["event"] == "found in the saved map"
    again = limslam("replay", "--config", folders[1] / "run.toml", "--out", tmp_path / "again")
    assert again.returncode == 0, again.stderr
    name = "trajectory_est.tum"
    assert (tmp_path / "again" / name).read_text() == (folders[1] / name).read_text()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
def test_keys_of_the_terminal_pause_a_session_and_send_the_robot_home(emulator, tmp_path):
    import fcntl
    import pty
    import termios

    port = free_port()
    emulator("--udp", port, "--speed", "4")
    ours, theirs = pty.openpty()
    before = termios.tcgetattr(theirs)
    said = []
    with subprocess.Popen(
        [
            *(sys.executable, "-m", "limslam_agent", "live", "--udp", str(port)),
            *("--preset", "consistent", "--out", str(tmp_path / "room")),
        ],
        stdin=theirs,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509 (it is one call)
    ) as live:

        def answer(key, words):
            os.write(ours, key)
            while words not in (line := live.stderr.readline()):
                said.append(line)
                assert line, "".join(said)

        answer(b"", "keys  ")
        for key, words in ((b"p", "paused"), (b"p", "going on"), (b"h", "driving home")):
            answer(key, f"order       {words}")
        out, _ = live.communicate(timeout=120)
    assert live.returncode == 0
    assert "asked to drive home; the robot is at its start" in out
    assert termios.tcgetattr(theirs) == before
    os.close(ours)
    os.close(theirs)


def test_a_robot_behind_a_serial_port_is_driven_and_stopped(emulator, tmp_path):
    pytest.importorskip("serial", reason="needs the extra live (pyserial)")
    robot = tmp_path / "small.toml"
    robot.write_text(
        "radius = 0.06\naxle = 0.115\nbeams_deg = [90, 45, 0, -45, -90]\nmax_range = 2.0\n"
    )
    _, name = emulator("--pty", "--robot", robot)
    folder = tmp_path / "room"
    told = ("--preset", "consistent", "--max-time", 6, "--watch", "--out", folder)
    finished = limslam("live", "--serial", name, "--robot", robot, *told)
    assert finished.returncode == 0, finished.stderr
    assert "watch       http://127.0.0.1:" in finished.stderr
    metrics = json.loads((folder / "result.json").read_text())["metrics"]
    assert metrics["stop_reason"] == "time: the longest time of the session is over"
    assert metrics["packets"] >= 60
    assert (metrics["lines_bad"], metrics["packets_implausible"]) == (0, 0)
    assert read_log(folder / "log.npz").robot.axle == 0.115
    inspected = limslam("inspect", folder)
    assert inspected.returncode == 0, inspected.stderr
    assert "The poses equal those in the folder" in inspected.stdout
    assert (folder / "inspect.html").is_file()
    assert (
        "live small, consistent" in limslam("show", folder, "--out", tmp_path / "room.png").stdout
    )


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ((), "either --serial PORT, --udp PORT or --ros2 is needed"),
        (
            ("--udp", 9, "--serial", "x"),
            "--serial and --udp are different places: the robot is at one of them only",
        ),
        (("--udp", 0, "--policy", "tour"), "the policy 'tour' does not act on a belief"),
        (("--udp", 0, "--listen", "localhost"), "'localhost' is not an IPv4 address"),
        (("--udp", 0, "--token", "two words"), "the token 'two words' is not a name of 1 to 24"),
        (("--serial", "x", "--token", "word"), "--listen and --token are for --udp"),
        (("--udp", 70000), "a UDP port is a number up to 65535, not 70000"),
        (("--serial", "/dev/there-is-none"), "there-is-none: cannot be opened"),
        (("--udp", 0, "--patience", 0.1), "no robot has answered within 0.1 s"),
        (("--udp", 0, "--patience", -1), "--patience must be a number from 0.1 to 3600"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line_and_leaves_nothing(told, words, tmp_path):
    if "/dev/there-is-none" in told:
        pytest.importorskip("serial", reason="needs the extra live (pyserial)")
    finished = limslam("live", *told, "--out", tmp_path / "room", cwd=tmp_path)
    assert finished.returncode == 2
    # What is wrong in the command is said before the wait for a robot.
    assert ("waiting" in finished.stderr) == ("no robot has answered" in words)
    assert words in finished.stderr.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("hello", "words"),
    [
        (b"H,1,5,my-robot,6,100000,100,500", "no shipped robot is called 'my-robot'"),
        (b"H,1,5,paper,5,100000,100,500", "the robot paper has 5 beams, but its description has 6"),
        (b"H,3,5,paper,6,100000,100,500", "the robot paper speaks version 3 of the protocol"),
    ],
)
def test_a_robot_that_cannot_be_driven_is_refused(hello, words, tmp_path):

    port = free_port()
    done = threading.Event()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:

        def greet():
            while not done.wait(0.02):
                robot.sendto(b"%s*%04X\n" % (hello, checksum(hello)), ("127.0.0.1", port))

        thread = threading.Thread(target=greet)
        thread.start()
        try:
            finished = limslam("live", "--udp", port, "--out", tmp_path / "room")
        finally:
            done.set()
            thread.join()
    assert finished.returncode == 2
    assert words in finished.stderr.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


def test_a_robot_is_driven_only_if_it_says_the_token(emulator, tmp_path):
    port = free_port()
    folder = tmp_path / "room"
    told = ("--preset", "consistent", "--max-time", 3, "--token", "our-word", "--out", folder)
    emulator("--udp", port)
    refused = limslam("live", "--udp", port, *told, "--patience", 3)
    assert refused.returncode == 2
    line = "limslam: warning: the robot paper at 127.0.0.1 is not driven: it has not said the token"
    assert refused.stderr.count(line) == 1
    emulator("--udp", port, "--token", "our-word")
    driven = limslam("live", "--udp", port, *told)
    assert driven.returncode == 0, driven.stderr
    assert json.loads((folder / "result.json").read_text())["metrics"]["packets"] >= 30
    assert all("our-word" not in path.read_text("latin-1") for path in folder.iterdir())


def test_a_policy_that_fails_stops_the_robot_and_keeps_its_log(emulator, tmp_path):
    policy = policy_file(tmp_path, "np.array([0.3, 0.3]) / (self.count < 30)")
    finished = explored(emulator, tmp_path / "room", "--policy", policy)
    assert finished.returncode == 2
    assert "mine.py, line 8, in act" in finished.stderr.splitlines()[-1]
    assert not (tmp_path / "room").exists()
    assert len(read_log(tmp_path / "room-log.npz")) >= 30
    assert "room-log.npz" in finished.stderr


def test_ctrl_c_stops_the_robot_and_writes_the_folder(emulator, tmp_path):
    folder = tmp_path / "room"
    policy = policy_file(tmp_path, "if self.count == 40: signal.raise_signal(signal.SIGINT)")
    finished = explored(emulator, folder, "--policy", policy)
    assert finished.returncode == 0, finished.stderr
    assert "stopped     stopped by hand" in finished.stdout
    log = read_log(folder / "log.npz")
    assert len(log) >= 40
    # The robot has obeyed the stop, and has said so, before the session ended.
    assert np.abs(log.wheels[20:35]).min() > 0.0
    assert log.wheels[-1].tolist() == [0.0, 0.0]


IN_A_TERMINAL = """
import fcntl, os, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execv(sys.executable, [sys.executable, "-m", "limslam_agent", *sys.argv[1:]])
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGHUP")
def test_a_terminal_that_is_closed_stops_the_robot_and_keeps_its_whole_log(emulator, tmp_path):
    port = free_port()
    sign = tmp_path / "sign"
    policy = policy_file(tmp_path, f"if self.count == 40: Path({str(sign)!r}).touch()")
    emulator("--udp", port)
    ours, its = os.openpty()
    told = ("--policy", policy, "--preset", "consistent", "--out", tmp_path / "room")
    command = [sys.executable, "-c", IN_A_TERMINAL, "live", "--udp", port, *told]
    process = subprocess.Popen(
        [*map(str, command)], stdin=its, stdout=its, stderr=its, start_new_session=True
    )
    os.close(its)
    until_closed(ours, sign)
    assert process.wait(60) == 129
    log = read_log(tmp_path / "room-log.npz")
    assert len(log) >= 40
    assert np.abs(log.wheels[20:35]).min() > 0.0
    assert log.wheels[-1].tolist() == [0.0, 0.0]
    assert not (tmp_path / "room").exists()


def until_closed(terminal, sign):
    """Read what a program writes to a terminal until a file is there, and close the terminal."""
    while not sign.exists():
        if select.select([terminal], [], [], 0.02)[0]:
            os.read(terminal, 10_000)
    os.close(terminal)


@pytest.mark.parametrize("told", [("--udp", "99999"), ("--ros2", "--imu")])
def test_an_emulator_refuses_what_it_cannot_do(told):
    command = [sys.executable, "-m", "limslam_agent.live.emulator", *told]
    finished = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert finished.returncode == 2
    assert finished.stderr.startswith("emulator: ")
    assert finished.stderr.count("\n") == 1, finished.stderr
