"""The C implementation for microcontrollers does what the Python one does: the same lines in, the same lines out."""

import ctypes
import random
import shutil
import subprocess

import pytest
from support.markdown import ROOT

from limslam_agent.live.firmware import Firmware
from limslam_agent.live.protocol import (
    MAX_BEAMS,
    NOTHING_SEEN,
    VERSION,
    Greeting,
    Heartbeat,
    Hello,
    Speeds,
    Stop,
    Telemetry,
    checksum,
    decode,
    encode,
)

SOURCES = ROOT / "examples" / "live"
FLAGS = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
NO_READING = NOTHING_SEEN + 1


class CHello(ctypes.Structure):
    _fields_ = [
        ("boot", ctypes.c_uint32), ("name", ctypes.c_char_p), ("beams", ctypes.c_uint8),
        ("nm_per_tick", ctypes.c_uint32), ("period_ms", ctypes.c_uint16), ("watchdog_ms", ctypes.c_uint16),
    ]  # fmt: skip


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    if not SOURCES.is_dir():
        pytest.skip("the examples do not travel with the tests: run them in a checkout")
    path = tmp_path_factory.mktemp("c") / "link.so"
    subprocess.run([compiler, *FLAGS, "-shared", "-fPIC", "-o", path, SOURCES / "limslam_link.c"], check=True)
    loaded = ctypes.CDLL(str(path))
    loaded.limslam_collect.restype = ctypes.c_char_p
    loaded.limslam_collect.argtypes = [ctypes.c_void_p, ctypes.c_char]
    loaded.limslam_say.restype = ctypes.c_size_t
    loaded.limslam_say.argtypes = [
        ctypes.c_void_p, ctypes.c_uint32, ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p, ctypes.c_char_p,
        ctypes.c_size_t,
    ]  # fmt: skip
    loaded.limslam_hear.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_uint32]
    loaded.limslam_speeds.argtypes = [ctypes.c_void_p, ctypes.c_uint32, ctypes.c_void_p, ctypes.c_void_p]
    loaded.limslam_start.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    loaded.limslam_checksum.restype = ctypes.c_uint16
    loaded.limslam_checksum.argtypes = [ctypes.c_char_p, ctypes.c_size_t]
    return loaded


class Robot:
    """The C code with the methods of the Python firmware."""

    def __init__(self, library, hello):
        self._library = library
        self._hello = CHello(hello.boot, hello.name.encode(), hello.beams, *(
            getattr(hello, name) for name in ("nm_per_tick", "period_ms", "watchdog_ms")
        ))  # fmt: skip
        self._link = ctypes.create_string_buffer(256)
        library.limslam_start(self._link, ctypes.byref(self._hello))

    def hear(self, line, now):
        return bool(self._library.limslam_hear(self._link, line.rstrip(b"\n"), now))

    def speeds(self, now):
        left, right = ctypes.c_int16(), ctypes.c_int16()
        self._library.limslam_speeds(self._link, now, ctypes.byref(left), ctypes.byref(right))
        return left.value, right.value

    def say(self, now, ticks, ranges, size=640):
        listed = (ctypes.c_uint32 * len(ranges))(*(NO_READING if each is None else each for each in ranges))
        text = ctypes.create_string_buffer(b"?" * size, size + 1)
        length = self._library.limslam_say(self._link, now, *ticks, listed, text, size)
        assert text.raw[size:] == b"\0"  # nothing was written behind the end
        assert len(text.value) == length
        return text.value.splitlines(keepends=True)


def hello_of(generator):
    name = "".join(generator.choice("abcXYZ0129_.-") for _ in range(generator.randint(1, 24)))
    return Hello(
        VERSION, generator.getrandbits(32), name, generator.randint(1, MAX_BEAMS), generator.randint(1, 2**32 - 1),
        generator.randint(1, 200), generator.randint(1, 2000),
    )  # fmt: skip


def some_line(generator, seq):
    """A line that a host may send, often damaged."""
    command = generator.choice([
        Speeds(seq, generator.getrandbits(32), generator.randint(-32768, 32767), generator.randint(-300, 300)),
        Speeds(seq, seq, 100, 120), Heartbeat(seq), Stop(seq), Greeting(1, seq),
        Hello(1, 2, "a", 3, 4, 5, 6), Telemetry(1, 2, 3, 4, 5, 0, (6,)),
    ])  # fmt: skip
    line = bytearray(encode(command))
    kind = generator.random()
    if kind < 0.2:
        line[generator.randrange(len(line) - 1)] ^= 1 << generator.randrange(8)
    elif kind < 0.3:
        del line[generator.randrange(len(line) - 1)]
    elif kind < 0.4:
        body = bytes(generator.choice(b"QVPXHS,0123456789-+ .") for _ in range(generator.randint(0, 40)))
        line = bytearray(b"%s*%04X\n" % (body, checksum(body)))
    elif kind < 0.5:  # a number of a right line is another one, with a right checksum
        words = bytes(line).partition(b"*")[0].split(b",")
        strange = [b"", b"-0", b"007", b"4294967296", b"-32769", b"99999999999", b"1e3", b"-", b"2147483648"]
        words[generator.randrange(1, len(words))] = generator.choice(strange)
        body = b",".join(words)
        line = bytearray(b"%s*%04X\n" % (body, checksum(body)))
    return bytes(line).replace(b"\0", b"\1")


@pytest.mark.parametrize("seed", range(5))
def test_both_say_the_same_and_turn_the_wheels_alike_whatever_they_hear(library, seed):
    generator = random.Random(seed)  # noqa: S311 (no secret)
    hello = hello_of(generator)
    robots = Firmware(hello), Robot(library, hello)
    now, seq, heard = generator.choice([0, 2**32 - 3000]), generator.getrandbits(32), 0
    for _ in range(400):
        now = (now + generator.choice([1, 20, 100, 100, 700, 4000])) % 2**32
        for _ in range(generator.randrange(3)):
            seq = (seq + generator.choice([1, 1, 1, 2, -3])) % 2**32
            line = some_line(generator, seq)
            answers = [robot.hear(line, now) for robot in robots]
            assert answers[0] == answers[1], line
            heard += answers[0]
        assert robots[0].speeds(now) == robots[1].speeds(now)
        ticks = generator.randint(-(2**31), 2**31 - 1), generator.randint(-(2**31), 2**31 - 1)
        ranges = tuple(generator.choice([None, 0, 95, NOTHING_SEEN]) for _ in range(hello.beams))
        said = [robot.say(now, ticks, ranges) for robot in robots]
        assert said[0] == said[1]
        assert all(isinstance(decode(line), Hello | Telemetry) for line in said[1])
    assert 100 < heard < 400


def test_a_line_for_which_there_is_no_room_is_left_out_as_a_whole(library):
    hello = Hello(1, 1, "robot", 8, 1, 100, 500)
    for size in range(1, 120):
        robot = Robot(library, hello)
        assert robot.hear(encode(Greeting(1, 5)), 0)
        lines = robot.say(10, (1, 2), (NOTHING_SEEN,) * 8, size)
        assert all(isinstance(decode(line), Hello | Telemetry) for line in lines)
    assert len(lines) == 2


def test_bytes_become_lines(library):
    reader = ctypes.create_string_buffer(1024)

    def lines_of(data):
        found = [library.limslam_collect(reader, bytes([byte])) for byte in data]
        return [line for line in found if line is not None]

    assert lines_of(b"\n\nX,1*0000\r\nV") == [b"X,1*0000"]
    assert lines_of(b",2\n") == [b"V,2"]
    assert lines_of(b"x" * 5000 + b"\nP,1\n") == [b"P,1"]
    assert lines_of(b"y" * 511 + b"\n") == [b"y" * 511]
