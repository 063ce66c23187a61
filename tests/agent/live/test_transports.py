"""Which sender of datagrams is the robot that is driven."""

import random
import re
import socket
import sys
import threading
from contextlib import ExitStack, closing

import pytest

from limslam_agent.live.link import Link, NoRobotError
from limslam_agent.live.protocol import Hello, Stop, Telemetry, encode
from limslam_agent.live.transports import SILENT_AFTER, Seat, UdpTransport

WORD = "our-word"
FIRST = ("127.0.0.1", 5001)
SECOND = ("127.0.0.1", 5002)
FAR = ("192.168.1.7", 5001)


def hello(name="paper", boot=7, version=2, token=None):
    return encode(Hello(version, boot, name, 6, 1000, 100, 500, token))


TELEMETRY = encode(Telemetry(0, 0, 0, 0, 0, 0, (500,) * 6))


class Told(list):
    """The lines that a seat has reported."""

    def seat(self, token=None):
        return Seat(token, self.append)


@pytest.mark.parametrize(
    "line", [b"H,", b"H,2,7,paper,6,1000,100,500*0000", TELEMETRY, b"", encode(Stop(1))]
)
def test_only_a_whole_hello_takes_the_seat(line):
    seat = Told().seat()
    assert not seat.admits([line], SECOND)
    assert seat.robot is None
    assert seat.admits([hello()], FIRST)
    assert not seat.admits([line], SECOND)
    assert seat.admits([TELEMETRY], FIRST)


def test_the_seat_is_that_of_a_name_for_the_whole_session():
    told = Told()
    seat = told.seat()
    assert seat.admits([hello("first")], FIRST)
    for seconds in (0.0, 10.0 * SILENT_AFTER):
        seat.listened(seconds)
        assert not seat.admits([hello("second")], SECOND)
        assert not seat.admits([TELEMETRY], SECOND)
    assert seat.robot == FIRST
    assert told == [
        "the robot second at 127.0.0.1 is not driven: the session is with the robot first"
    ]


@pytest.mark.parametrize("boot", [7, 8])
def test_a_robot_comes_back_from_another_address_once_it_was_silent(boot):
    seat = Told().seat()
    assert seat.admits([hello(boot=7)], FIRST)
    seat.listened(0.9 * SILENT_AFTER)
    assert not seat.admits([hello(boot=boot)], SECOND)
    assert seat.admits([TELEMETRY], FIRST)  # which ends the silence
    seat.listened(0.9 * SILENT_AFTER)
    assert not seat.admits([hello(boot=boot)], SECOND)
    seat.listened(0.2 * SILENT_AFTER)
    assert not seat.admits([TELEMETRY], SECOND)
    assert seat.admits([hello(boot=boot), TELEMETRY], SECOND)
    assert not seat.admits([TELEMETRY], FIRST)


def test_an_address_that_another_robot_has_taken_over_is_no_longer_the_robots():
    seat = Told().seat()
    assert seat.admits([hello("first")], FIRST)
    assert not seat.admits([hello("second")], FIRST)
    assert seat.robot is None
    assert seat.admits([hello("first")], SECOND)


def test_a_token_is_asked_of_all_but_old_robots_of_this_computer():
    told = Told()
    seat = told.seat(WORD)
    assert not seat.admits([hello()], FIRST)
    assert not seat.admits([hello(token=WORD * 2)], FAR)
    assert not seat.admits([hello(version=1)], FAR)
    assert seat.robot is None
    assert [line.partition(": ")[2] for line in told] == [
        "it has not said the token of --token",
        "it has not said the token of --token",
        "a robot in a network needs version 2 of the protocol",
    ]
    assert seat.admits([hello(token=WORD)], FAR)
    assert told.seat(WORD).admits([hello(version=1)], FIRST)
    assert told.seat().admits([hello(token=WORD)], FAR)
    assert not told.seat().admits([hello(version=1)], FAR)


def test_a_crowd_of_refused_robots_does_not_fill_the_screen():
    told = Told()
    seat = told.seat()
    assert seat.admits([hello()], FIRST)
    for number in range(1000):
        assert not seat.admits([hello(f"robot-{number}")], SECOND)
        assert not seat.admits([hello("robot-0")], SECOND)
    assert 1 < len(told) <= 20


@pytest.fixture
def network():
    """A host, a robot and a stranger on this computer."""
    with ExitStack() as opened:
        transport = opened.enter_context(closing(UdpTransport(0)))
        ends = [
            opened.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2)
        ]
        for end in ends:
            end.connect(("127.0.0.1", transport.port))
            end.settimeout(5.0)
        yield transport, *ends


def received(end):
    """What an end of a connection has got and not yet read."""
    end.settimeout(0.0)
    found = []
    try:
        while True:
            found.append(end.recv(1000))
    except BlockingIOError:
        return found


def until(transport, line):
    """Listen until a line comes, and all that has come with it."""
    lines = []
    while line.rstrip() not in lines:
        lines += transport.receive(1.0)
    return lines


def test_a_second_robot_does_not_take_the_place_of_the_first(network):
    transport, robot, stranger = network
    for end in (robot, stranger):
        end.send(hello())
    assert until(transport, hello()) == [hello().rstrip()]
    transport.send(encode(Stop(1)))
    assert robot.recv(100) == encode(Stop(1))
    assert received(stranger) == []


def test_20000_datagrams_of_a_stranger_neither_reach_the_host_nor_get_its_stops(network):
    transport, robot, stranger = network
    generator = random.Random(1)  # noqa: S311 (no secret)
    robot.send(hello())
    until(transport, hello())
    kinds = (
        lambda: generator.randbytes(generator.randrange(1, 600)),
        lambda: b"H," + generator.randbytes(generator.randrange(60)),
        lambda: hello(f"robot-{generator.randrange(1000)}"),
        lambda: hello(boot=generator.getrandbits(32)),
        lambda: TELEMETRY,
        lambda: b"\n" * 5000,
        lambda: b"H,\n" * 2000,
    )
    for number in range(200):
        for _ in range(100):
            stranger.send(generator.choice(kinds)())
            lines = transport.receive(0.0)
            assert lines == []
        line = encode(Telemetry(number, number, 0, 0, 0, 0, (500,) * 6))
        robot.send(line)
        assert until(transport, line) == [line.rstrip()]
        transport.send(encode(Stop(number)))
        assert robot.recv(100) == encode(Stop(number))
    assert received(stranger) == []


def test_a_flood_does_not_keep_the_host_from_its_work(network):
    transport, robot, stranger = network
    robot.send(hello())
    until(transport, hello())
    is_over = threading.Event()

    def flood():
        while not is_over.is_set():
            stranger.send(b"x" * 40)

    floods = [threading.Thread(target=flood) for _ in range(2)]
    for each in floods:
        each.start()
    try:
        for number in range(50):  # each of these comes back although the flood goes on
            assert transport.receive(0.0) == []
            transport.send(encode(Stop(number)))
    finally:
        is_over.set()
        for each in floods:
            each.join()
    assert [encode(Stop(number)) for number in range(50)] == received(robot)


def test_hellos_that_are_no_hellos_do_not_keep_the_robot_out(network):
    transport, robot, stranger = network
    link = Link(transport)
    stranger.send(b"H,")
    stranger.send(b"H,1,7,paper,6,1000,100,500*0000")
    robot.send(hello())
    assert link.first_hello(10.0).boot == 7
    link.send(Stop(1))
    assert encode(Stop(1)) in received(robot)
    assert received(stranger) == []


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has 127.0.0.2 without setting it")
def test_a_host_hears_only_the_address_at_which_it_listens():
    with (
        closing(UdpTransport(0)) as own,
        closing(UdpTransport(0, "127.0.0.2")) as other,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot,
    ):
        for transport in (own, other):
            robot.sendto(hello(), ("127.0.0.2", transport.port))
        assert until(other, hello()) == [hello().rstrip()]
        assert own.receive(0.0) == []
    with pytest.raises(ValueError, match="'::1' is not an IPv4 address"):
        UdpTransport(0, "::1")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (b"H,2,5,my robot,6,100000,100,500*2052\n", "'my robot' is not a name"),
        (b"H,2,5,toy,6,100000,100,500\n", "it must end with *"),
        (b"\xff\x00" * 400 + b"\n", "it has more than 512 bytes"),
    ],
)
def test_what_is_wrong_with_a_line_is_said_while_no_robot_answers(line, words):
    with (
        closing(UdpTransport(0)) as transport,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot,
    ):
        robot.sendto(line, ("127.0.0.1", transport.port))
        with pytest.raises(NoRobotError, match=re.escape(words)) as refused:
            Link(transport).first_hello(0.1)
    assert "1 line not readable" in str(refused.value)
