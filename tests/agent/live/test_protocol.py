"""The line protocol of live robots: its lines, and the C code for firmware beside the Python of the
host.
"""

import ctypes
import random
import re
import shutil
import subprocess

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from support.command_line import limslam
from support.esp32 import run_sketch
from support.markdown import ROOT, blocks

from limslam_agent.live.firmware import Firmware
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
from limslam_agent.logs.log_reader import read_log
from limslam_agent.logs.table_options import TableOptions
from limslam_agent.robot_file import robot_named
from limslam_env.robots import e_puck

U32 = st.integers(0, 2**32 - 1)
I32 = st.integers(-(2**31), 2**31 - 1)
I16 = st.integers(-(2**15), 2**15 - 1)
AMOUNT = st.integers(1, 65535)
NAMES = st.text("abcXYZ019_.-", min_size=1, max_size=24)
RANGES = st.lists(st.none() | st.integers(0, NOTHING_SEEN), min_size=1, max_size=MAX_BEAMS).map(
    tuple
)
HELLOS = st.builds(
    Hello,
    version=st.integers(0, 255),
    boot=U32,
    name=NAMES,
    beams=st.integers(1, MAX_BEAMS),
    nm_per_tick=st.integers(1, 2**32 - 1),
    period_ms=AMOUNT,
    watchdog_ms=AMOUNT,
) | st.builds(Hello, st.just(VERSION), U32, NAMES, st.just(6), st.just(1), AMOUNT, AMOUNT, NAMES)
TELEMETRY = st.builds(
    Telemetry,
    seq=U32,
    time_ms=U32,
    left=I32,
    right=I32,
    ack=U32,
    stopped=st.integers(0, 1),
    ranges=RANGES,
    yaw=st.none() | I32,
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
@example(Telemetry(0, 0, 0, 0, 0, 0, (None,), yaw=-(1 << 31)))
def test_a_message_comes_back_from_its_line(message):
    line = encode(message)
    assert len(line) <= LONGEST_LINE
    assert line.isascii()
    assert line.count(b"\n") == 1
    assert decode(line) == decode(line.rstrip()) == decode(line.replace(b"\n", b"\r\n")) == message


def test_the_lines_of_the_page_are_those_of_the_protocol():
    assert checksum(b"123456789") == 0x29B1  # by the catalogue of CRC-16/CCITT-FALSE
    page = ROOT / "docs" / "live.md"
    (block,) = (block for block in blocks(page) if block.text.startswith("H,2,"))
    messages = [decode(line.encode()) for line in block.text.splitlines()]
    assert messages[:2] == [
        Hello(VERSION, 2833961172, "esp32-tof", 6, 141800, 50, 300),
        Greeting(VERSION, 0),
    ]
    assert messages[4] == Telemetry(
        1, 5170, 31, 33, 1, 0, (811, None, NOTHING_SEEN, 1193, 639, 587)
    )
    heading = Telemetry(2, 5220, 64, 66, 2, 0, (811, None, NOTHING_SEEN, 1193, 639, 587), yaw=3437)
    assert messages[5:] == [Speeds(2, 1, 100, 96), Heartbeat(3), heading, Stop(4)]


@AT_ANY_SPEED
@given(st.binary(max_size=80) | TELEMETRY.map(encode), st.data())
def test_no_damaged_line_is_a_message(line, data):
    place = data.draw(st.integers(0, max(len(line) - 2, 0)))
    damaged = (
        line[:place]
        + bytes([(line[place] if line else 0) ^ data.draw(st.integers(1, 255))])
        + line[place + 1 :]
    )
    with pytest.raises(BadLineError):
        decode(damaged.replace(b"\n", b"").replace(b"\r", b"") + b"?")
    if line.startswith((b"S,", b"T,")):
        with pytest.raises(BadLineError):
            decode(damaged)


@pytest.mark.parametrize(
    "body",
    [
        "",
        "S",
        "X",
        "X,",
        "X,1,2",
        "X,1.0",
        "X, 1",
        "X,+1",
        "X,-1",
        "X,4294967296",
        "X,00000000001",
        "x,1",
        "V,1,2,3",
        "V,1,2,40000,0",
        "T,0,0,0,0,0,0,5",
        "T,0,0,0,0,0,0,-,500",
        "T,0,0,0,0,0,0,2147483648,500",
        "Z,1",
        "H,1,2,,6,1,1,1",
        "H,1,2,a b,6,1,1,1",
        "H,1,2,a,6,1,1,1,word",
        "H,2,2,a,6,1,1,1,",
        "H,2,2,a,6,1,1,1,a word",
        "H,2,2,a,6,1,1,1,word,word",
        "H,1,2,a,0,1,1,1",
        "H,1,2,a,65,1,1,1",
        "S,1,1,1,1,1,2,5",
        "S,1,1,1,1,1,0",
        "S,1,1,1,1,1,0,",
        "S,1,1,1,1,1,0,65536",
        "S,1,1,1,1,1,0,--",
        "S,1,1,1,1,1,0" + ",1" * (MAX_BEAMS + 1),
        "X,\u0661",
    ],
)
def test_a_right_checksum_does_not_make_a_message(body):
    raw = body.encode()
    with pytest.raises(BadLineError):
        decode(raw + b"*%04X\n" % checksum(raw))


@pytest.mark.parametrize(
    "message",
    [
        Stop(-1),
        Stop(2**32),
        Speeds(1, 1, 40000, 0),
        Hello(1, 1, "a b", 6, 1, 1, 1),
        Hello(1, 1, "a", 6, 1, 1, 1, "version-1-has-no-token"),
        Hello(2, 1, "a", 6, 1, 1, 1, "not,a,word"),
        Telemetry(1, 1, 1, 1, 1, 0, ()),
    ],
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
    piecewise = LineBuffer()
    at_once = LineBuffer()
    found = [
        line
        for start in range(0, len(text), size)
        for line in piecewise.add(text[start : start + size])
    ]
    assert found == at_once.add(text)
    assert all(b"\n" not in line and line for line in found)


SOURCES = ROOT / "examples" / "live"
FLAGS = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
NO_READING = NOTHING_SEEN + 1


class CHello(ctypes.Structure):
    _fields_ = [
        ("boot", ctypes.c_uint32),
        ("name", ctypes.c_char_p),
        ("beams", ctypes.c_uint8),
        ("nm_per_tick", ctypes.c_uint32),
        ("period_ms", ctypes.c_uint16),
        ("watchdog_ms", ctypes.c_uint16),
        ("token", ctypes.c_char_p),
    ]


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    if not SOURCES.is_dir():
        pytest.skip("the examples do not travel with the tests: run them in a checkout")
    path = tmp_path_factory.mktemp("c") / "link.so"
    subprocess.run(
        [compiler, *FLAGS, "-shared", "-fPIC", "-o", path, SOURCES / "limslam_link.c"], check=True
    )
    loaded = ctypes.CDLL(str(path))
    loaded.limslam_collect.restype = ctypes.c_char_p
    loaded.limslam_collect.argtypes = [ctypes.c_void_p, ctypes.c_char]
    loaded.limslam_say.restype = ctypes.c_size_t
    loaded.limslam_say.argtypes = [
        ctypes.c_void_p,
        ctypes.c_uint32,
        ctypes.c_int32,
        ctypes.c_int32,
        ctypes.c_void_p,
        ctypes.c_char_p,
        ctypes.c_size_t,
    ]
    loaded.limslam_say_heading.restype = ctypes.c_size_t
    loaded.limslam_say_heading.argtypes = [
        *loaded.limslam_say.argtypes[:4],
        ctypes.c_int32,
        *loaded.limslam_say.argtypes[4:],
    ]
    loaded.limslam_hear.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_uint32]
    loaded.limslam_speeds.argtypes = [
        ctypes.c_void_p,
        ctypes.c_uint32,
        ctypes.c_void_p,
        ctypes.c_void_p,
    ]
    loaded.limslam_start.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    loaded.limslam_checksum.restype = ctypes.c_uint16
    loaded.limslam_checksum.argtypes = [ctypes.c_char_p, ctypes.c_size_t]
    return loaded


class Robot:
    """The C code with the methods of the Python firmware."""

    def __init__(self, library, hello):
        self._library = library
        self._hello = CHello(
            hello.boot,
            hello.name.encode(),
            hello.beams,
            *(getattr(hello, name) for name in ("nm_per_tick", "period_ms", "watchdog_ms")),
            None if hello.token is None else hello.token.encode(),
        )
        self._link = ctypes.create_string_buffer(256)
        library.limslam_start(self._link, ctypes.byref(self._hello))

    def hear(self, line, now):
        return bool(self._library.limslam_hear(self._link, line.rstrip(b"\n"), now))

    def speeds(self, now):
        left = ctypes.c_int16()
        right = ctypes.c_int16()
        self._library.limslam_speeds(self._link, now, ctypes.byref(left), ctypes.byref(right))
        return left.value, right.value

    def say(self, now, ticks, ranges, yaw=None, size=640):
        listed = (ctypes.c_uint32 * len(ranges))(
            *(NO_READING if each is None else each for each in ranges)
        )
        text = ctypes.create_string_buffer(b"?" * size, size + 1)
        if yaw is None:
            length = self._library.limslam_say(self._link, now, *ticks, listed, text, size)
        else:
            length = self._library.limslam_say_heading(
                self._link, now, *ticks, yaw, listed, text, size
            )
        assert text.raw[size:] == b"\0"  # nothing was written behind the end
        assert len(text.value) == length
        return text.value.splitlines(keepends=True)


def hello_of(generator):
    name = "".join(generator.choice("abcXYZ0129_.-") for _ in range(generator.randint(1, 24)))
    return Hello(
        VERSION,
        generator.getrandbits(32),
        name,
        generator.randint(1, MAX_BEAMS),
        generator.randint(1, 2**32 - 1),
        generator.randint(1, 200),
        generator.randint(1, 2000),
        generator.choice([None, "word", name]),
    )


def some_line(generator, seq):
    """A line that a host may send, often damaged."""
    command = generator.choice(
        [
            Speeds(
                seq,
                generator.getrandbits(32),
                generator.randint(-32768, 32767),
                generator.randint(-300, 300),
            ),
            Speeds(seq, seq, 100, 120),
            Heartbeat(seq),
            Stop(seq),
            Greeting(1, seq),
            Hello(1, 2, "a", 3, 4, 5, 6),
            Telemetry(1, 2, 3, 4, 5, 0, (6,)),
        ]
    )
    line = bytearray(encode(command))
    kind = generator.random()
    if kind < 0.2:
        line[generator.randrange(len(line) - 1)] ^= 1 << generator.randrange(8)
    elif kind < 0.3:
        del line[generator.randrange(len(line) - 1)]
    elif kind < 0.4:
        body = bytes(
            generator.choice(b"QVPXHS,0123456789-+ .") for _ in range(generator.randint(0, 40))
        )
        line = bytearray(b"%s*%04X\n" % (body, checksum(body)))
    elif kind < 0.5:  # a number of a right line is another one, with a right checksum
        words = bytes(line).partition(b"*")[0].split(b",")
        strange = [
            b"",
            b"-0",
            b"007",
            b"4294967296",
            b"-32769",
            b"99999999999",
            b"1e3",
            b"-",
            b"2147483648",
        ]
        words[generator.randrange(1, len(words))] = generator.choice(strange)
        body = b",".join(words)
        line = bytearray(b"%s*%04X\n" % (body, checksum(body)))
    return bytes(line).replace(b"\0", b"\1")


@pytest.mark.parametrize("seed", range(5))
def test_both_say_the_same_and_turn_the_wheels_alike_whatever_they_hear(library, seed):
    generator = random.Random(seed)  # noqa: S311 (no secret)
    hello = hello_of(generator)
    robots = Firmware(hello), Robot(library, hello)
    now = generator.choice([0, 2**32 - 3000])
    seq = generator.getrandbits(32)
    heard = 0
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
        yaw = generator.choice([None, generator.randint(-(2**31), 2**31 - 1)])
        said = [robot.say(now, ticks, ranges, yaw) for robot in robots]
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


EXAMPLES = ROOT / "examples" / "live"
# What the sketches use of each library, with the types of that library.
ARDUINO = """
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#define IRAM_ATTR
enum { LOW, HIGH, INPUT, OUTPUT, CHANGE };
template <class T> T constrain(T x, T low, T high) { return x < low ? low : x > high ? high : x; }
int digitalRead(uint8_t); void digitalWrite(uint8_t, uint8_t); void pinMode(uint8_t, uint8_t);
void analogWrite(uint8_t, int); uint8_t digitalPinToInterrupt(uint8_t);
void attachInterrupt(uint8_t, void (*)(), int);
unsigned long millis(); void delay(uint32_t); uint32_t esp_random();
struct Port {
    void begin(unsigned long); int available(); int read(); size_t write(const uint8_t *, size_t);
    size_t println(const char *);
};
extern Port Serial;
"""
LIBRARIES = {
    "Arduino.h": ARDUINO,
    "Wire.h": """
        struct TwoWire {
            bool begin(); bool setClock(uint32_t); void beginTransmission(uint8_t);
            size_t write(uint8_t); uint8_t endTransmission(bool stop = true);
            uint8_t requestFrom(uint8_t, uint8_t); int read();
        };
        extern TwoWire Wire;""",
    "SPI.h": "struct SPIClass { void begin(int8_t, int8_t, int8_t, int8_t); }; extern SPIClass SPI;",
    "SD.h": """
        #define FILE_WRITE "w"
        struct File { FILE *file; size_t write(const uint8_t *, size_t); void flush(); };
        struct SDFS { bool begin(uint8_t); bool exists(const char *); File open(const char *, const char *); };
        extern SDFS SD;""",
    "VL53L0X.h": """
        struct VL53L0X {
            enum regAddr { RESULT_INTERRUPT_STATUS = 0x13 };
            bool init(bool io_2v8 = true); void setAddress(uint8_t); void setTimeout(uint16_t);
            uint8_t readReg(uint8_t);
            bool setMeasurementTimingBudget(uint32_t); void startContinuous(uint32_t period_ms = 0);
            uint16_t readRangeContinuousMillimeters(); bool timeoutOccurred();
        };""",
    "WiFi.h": """
        struct IPAddress {
            IPAddress(uint8_t, uint8_t, uint8_t, uint8_t); bool operator==(const IPAddress &) const;
        };
        enum wl_status_t { WL_CONNECTED = 3 };
        struct WiFiClass { wl_status_t begin(const char *, const char *); wl_status_t status(); bool setSleep(bool); };
        extern WiFiClass WiFi;""",
    "WiFiUdp.h": """
        struct WiFiUDP {
            uint8_t begin(uint16_t); int parsePacket(); int available(); int read(); IPAddress remoteIP();
            int beginPacket(IPAddress, uint16_t); size_t write(const uint8_t *, size_t); int endPacket();
        };""",
    "a_d/advance_ad_scan/e_ad_conv.h": "#define ALL_ADC 1\nvoid e_init_ad_scan(unsigned char);",
    "a_d/advance_ad_scan/e_prox.h": """
        void e_calibrate_ir(); int e_get_prox(unsigned int); int e_get_calibrated_prox(unsigned int);
        int e_get_ambient_light(unsigned int);""",
    "motor_led/advance_one_timer/e_agenda.h": """
        void e_activate_agenda(void (*)(void), int); void e_start_agendas_processing(void);""",
    "motor_led/advance_one_timer/e_motors.h": """
        void e_init_motors(void); void e_set_speed_left(int); void e_set_speed_right(int);
        int e_get_steps_left(void); int e_get_steps_right(void);""",
    "motor_led/e_init_port.h": "void e_init_port(void);",
    "uart/e_uart_char.h": """
        void e_init_uart1(void); int e_ischar_uart1(void); int e_getchar_uart1(char *);
        void e_send_uart1_char(const char *, int); int e_uart1_sending(void);""",
}


@pytest.fixture
def stand_ins(tmp_path):
    """A folder with headers in place of those of the libraries."""
    if not EXAMPLES.is_dir():
        pytest.skip("the examples do not travel with the tests: run them in a checkout")
    for name, text in LIBRARIES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text + "\n", encoding="utf-8")
    return tmp_path


@pytest.fixture
def compiles(stand_ins):
    def compile_with(compiler, *options):
        if shutil.which(compiler) is None:
            pytest.skip(f"there is no {compiler}")
        folders = ["-I", stand_ins, "-I", EXAMPLES]
        return subprocess.run(
            [compiler, "-fsyntax-only", "-Wall", "-Wextra", "-Werror", *folders, *options],
            capture_output=True,
            text=True,
            check=False,
        ).stderr

    return compile_with


WIFI = '-DUSE_WIFI="network","password"'


@pytest.mark.parametrize(
    "told",
    [
        *[(), (WIFI,), ("-DGYRO",), ("-DWRITE_CSV",), ("-DCARD",)],
        *[(WIFI, "-DWRITE_CSV", "-DGYRO"), ("-DCARD", "-DGYRO")],
    ],
    ids=" ".join,
)
def test_the_sketch_for_an_esp32(compiles, told):
    sketch = EXAMPLES / "esp32_tof" / "esp32_tof.ino"
    assert compiles("g++", *told, "-include", "Arduino.h", "-x", "c++", sketch) == ""


DRIVE = [(70, 72, 1.0, 500 + row, 600, 8190, 8190, NO_READING, 400) for row in range(250)]
DRIVE[3] = (-140, -144, -2.0, 503, 600, 8190, 8190, 777, 400)
BOOT = "ets Jul 29 2019 12:21:46\n\nrst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)\n"


@pytest.mark.parametrize(
    "told", [("-DWRITE_CSV",), ("-DWRITE_CSV", "-DGYRO"), ("-DCARD",)], ids=" ".join
)
def test_the_log_that_the_sketch_for_an_esp32_writes(stand_ins, told):
    if shutil.which("g++") is None:
        pytest.skip("there is no g++")
    for name in ("log0.csv", "log1.csv"):
        (stand_ins / name).write_text("an older log\n", encoding="utf-8")
    folder = EXAMPLES / "esp32_tof"
    log = stand_ins / "log2.csv"
    written = run_sketch(folder / "esp32_tof.ino", stand_ins, DRIVE, *told)
    if told == ("-DCARD",):
        assert set(written.splitlines()) == {"no card"}
        assert (stand_ins / "log0.csv").read_text(encoding="utf-8") == "an older log\n"
    else:
        log.write_text(BOOT + written, encoding="utf-8")
    size = re.search(r"NM_PER_TICK = (\d+);", (folder / "esp32_tof.ino").read_text("utf-8"))
    metres = int(size[1]) * 1e-9
    options = ["--metres-per-tick", metres, "--accumulated", "--dry-run"]
    shown = limslam("replay", log, "--robot", folder / "esp32_tof.toml", *options)
    assert shown.returncode == 0, shown.stderr
    for column in (
        "time_ms -> time, ms",
        f"left_ticks -> left wheel, {metres:g} m for each 1",
        f"right_ticks -> right wheel, {metres:g} m for each 1",
        "r_-45_mm -> range at -45 deg, mm",
    ):
        assert f"column      {column}\n" in shown.stdout
    assert ("column      yaw_deg -> heading, deg\n" in shown.stdout) == ("-DGYRO" in told)
    assert "events      250 in 12.4 s, 20 a second, 250 with ranges\n" in shown.stdout

    robot = robot_named(str(folder / "esp32_tof.toml"))
    table = TableOptions(robot, metres_per_tick=metres, accumulated=True)
    read = read_log(log, table=table)
    np.testing.assert_allclose(np.diff(read.time), 0.05)
    np.testing.assert_allclose(
        read.wheels[1:], [[metres * each for each in row[:2]] for row in DRIVE[1:]]
    )
    ranges = [[1e-3 * mm if mm < NO_READING else np.nan for mm in row[3:]] for row in DRIVE]
    np.testing.assert_allclose(read.reported, ranges)
    if "-DGYRO" in told:  # the error of 3 deg/s at rest is gone
        turned = np.degrees(read.yaw[-1] - read.yaw[0])
        assert turned == pytest.approx(sum(row[2] for row in DRIVE[1:]) * 0.05, abs=0.2)


def test_the_program_for_an_e_puck(compiles):
    told = ("-std=c99", "-pedantic", "-Wno-strict-prototypes")
    assert compiles("gcc", *told, EXAMPLES / "epuck" / "epuck.c") == ""
    assert len(e_puck().beams) == 8


def test_the_description_of_the_robot_fits_its_sketch():
    described = EXAMPLES / "esp32_tof" / "esp32_tof.toml"
    if not described.is_file():
        pytest.skip("the examples do not travel with the tests: run them in a checkout")
    assert len(robot_named(str(described)).beams) == 6
    assert "BEAMS = 6" in (EXAMPLES / "esp32_tof" / "esp32_tof.ino").read_text(encoding="utf-8")
