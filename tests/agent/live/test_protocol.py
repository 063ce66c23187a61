"""Messages become lines and come back, and no line but a message is read as one."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.markdown import ROOT, blocks

from limslam_agent.live.protocol import (
    LONGEST_LINE,
    MAX_BEAMS,
    NOTHING_SEEN,
    VERSION,
    BadLineError,
    Greeting,
    Heartbeat,
    Hello,
    Speeds,
    Stop,
    Telemetry,
    checksum,
    decode,
    difference,
    encode,
)
from limslam_agent.live.transports import LineBuffer

U32, I32, I16 = st.integers(0, 2**32 - 1), st.integers(-(2**31), 2**31 - 1), st.integers(-(2**15), 2**15 - 1)
AMOUNT = st.integers(1, 65535)
NAMES = st.text("abcXYZ019_.-", min_size=1, max_size=24)
RANGES = st.lists(st.none() | st.integers(0, NOTHING_SEEN), min_size=1, max_size=MAX_BEAMS).map(tuple)
HELLOS = st.builds(
    Hello, version=st.integers(0, 255), boot=U32, name=NAMES, beams=st.integers(1, MAX_BEAMS),
    nm_per_tick=st.integers(1, 2**32 - 1), period_ms=AMOUNT, watchdog_ms=AMOUNT,
)  # fmt: skip
TELEMETRY = st.builds(
    Telemetry, seq=U32, time_ms=U32, left=I32, right=I32, ack=U32, stopped=st.integers(0, 1), ranges=RANGES
)
COMMANDS = (
    st.builds(Greeting, version=st.integers(0, 255), seq=U32)
    | st.builds(Speeds, seq=U32, answers=U32, left=I16, right=I16)
    | st.builds(Heartbeat, seq=U32)
    | st.builds(Stop, seq=U32)
)

# A test must not fail because the machine is busy.
AT_ANY_SPEED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])


@AT_ANY_SPEED
@given(HELLOS | TELEMETRY | COMMANDS)
def test_a_message_comes_back_from_its_line(message):
    line = encode(message)
    assert len(line) <= LONGEST_LINE
    assert line.isascii()
    assert line.count(b"\n") == 1
    assert decode(line) == decode(line.rstrip()) == decode(line.replace(b"\n", b"\r\n")) == message


def test_the_lines_of_the_page_are_those_of_the_protocol():
    assert checksum(b"123456789") == 0x29B1  # by the catalogue of CRC-16/CCITT-FALSE
    page = ROOT / "docs" / "live.md"
    (block,) = (block for block in blocks(page) if block.text.startswith("H,1,"))
    messages = [decode(line.encode()) for line in block.text.splitlines()]
    assert messages[:2] == [Hello(VERSION, 2833961172, "esp32-tof", 6, 141800, 50, 300), Greeting(VERSION, 0)]
    assert messages[4] == Telemetry(1, 5170, 31, 33, 1, 0, (811, None, NOTHING_SEEN, 1193, 639, 587))
    assert messages[5:] == [Speeds(2, 1, 100, 96), Heartbeat(3), Stop(4)]


@AT_ANY_SPEED
@given(st.binary(max_size=80) | TELEMETRY.map(encode), st.data())
def test_no_damaged_line_is_a_message(line, data):
    place = data.draw(st.integers(0, max(len(line) - 2, 0)))
    damaged = line[:place] + bytes([(line[place] if line else 0) ^ data.draw(st.integers(1, 255))]) + line[place + 1 :]
    with pytest.raises(BadLineError):
        decode(damaged.replace(b"\n", b"").replace(b"\r", b"") + b"?")
    if line.startswith(b"S,"):
        with pytest.raises(BadLineError):
            decode(damaged)


@pytest.mark.parametrize(
    "body",
    [
        "", "S", "X", "X,", "X,1,2", "X,1.0", "X, 1", "X,+1", "X,-1", "X,4294967296", "X,00000000001", "x,1", "V,1,2,3",
        "V,1,2,40000,0", "Z,1", "H,1,2,,6,1,1,1", "H,1,2,a b,6,1,1,1", "H,1,2,a,0,1,1,1", "H,1,2,a,65,1,1,1",
        "S,1,1,1,1,1,2,5", "S,1,1,1,1,1,0", "S,1,1,1,1,1,0,", "S,1,1,1,1,1,0,65536", "S,1,1,1,1,1,0,--",
        "S,1,1,1,1,1,0" + ",1" * (MAX_BEAMS + 1), "X,\u0661",
    ],
)  # fmt: skip
def test_a_right_checksum_does_not_make_a_message(body):
    raw = body.encode()
    with pytest.raises(BadLineError):
        decode(raw + b"*%04X\n" % checksum(raw))


@pytest.mark.parametrize(
    "message",
    [Stop(-1), Stop(2**32), Speeds(1, 1, 40000, 0), Hello(1, 1, "a b", 6, 1, 1, 1), Telemetry(1, 1, 1, 1, 1, 0, ())],
)
def test_what_does_not_fit_is_not_sent(message):
    with pytest.raises(BadLineError):
        encode(message)


def test_counters_overflow_and_step_back():
    assert difference(3, 2**32 - 2) == 5
    assert difference(2**32 - 2, 3) == -5
    assert difference(-(2**31), 2**31 - 1) == 1


@AT_ANY_SPEED
@given(st.lists(st.binary(max_size=30), max_size=20), st.integers(1, 7))
def test_lines_do_not_depend_on_how_their_bytes_arrive(parts, size):
    text = b"\n".join(parts) + b"\n"
    piecewise, at_once = LineBuffer(), LineBuffer()
    found = [line for start in range(0, len(text), size) for line in piecewise.add(text[start : start + size])]
    assert found == at_once.add(text)
    assert all(b"\n" not in line and line for line in found)
