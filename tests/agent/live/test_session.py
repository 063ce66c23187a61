"""Sessions with an emulated robot in this process: lost, late, doubled and damaged lines, and robots that vanish."""

import numpy as np
import pytest
from support.live import Faults, Wire, emulated, session_with

from limslam_agent import replay_log
from limslam_agent.live.link import NoRobotError
from limslam_agent.live.protocol import Greeting, Heartbeat, Speeds, Stop, decode
from limslam_agent.live.session import BY_HAND, OUT_OF_TIME
from limslam_env.geometry import se2

FIGURES = ("packets_lost", "packets_late", "packets_doubled", "packets_implausible", "lines_bad", "watchdog_stops")


class Drive:
    """A policy that always drives at the same wheel speeds."""

    stop_reason, plan = None, np.zeros((0, 2))

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
    """Distances (n,), m, between the poses that are estimated from the log of a session and the true poses."""
    replay = replay_log(session.recording.log(), session.agent.config)
    true = np.array(wire.true)
    times = replay.log.time - replay.log.time[-1] + 1e-3 * session.recording._origin[0].time_ms  # of the robot's clock
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
    assert all(figures[name] > 3 for name in ("packets_lost", "packets_late", "packets_doubled", "lines_bad"))
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
        assert wire.emulator._firmware.speeds(0) == (0, 0)
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
        session.is_paused = 3.0 < session.recording.newest.time < 6.0

    session = session_with(wire, policy=Drive(0.3, 0.3), watch=watch)
    assert session.drive(8.0, 5.0) == OUT_OF_TIME
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
    """A session with a robot whose cable is pulled, and that gets an order 0.2 s after that; and the wire."""
    wire = Wire(emulated())

    def obey(session):
        wire.is_cut = wire.clock() > seconds
        if wire.clock() > seconds + 0.2:
            order(session)

    return session_with(wire, policy=Drive(0.3, 0.3), obey=obey), wire


def test_a_session_ends_when_it_is_asked_to_while_the_robot_is_silent():
    session, wire = silent_from(3.0, lambda session: setattr(session, "asked_to_end", "somebody said so"))
    assert session.drive(60.0, 30.0) == "somebody said so"
    assert wire.clock() < 6.0
    assert isinstance(decode(wire.sent[-1]), Stop)
