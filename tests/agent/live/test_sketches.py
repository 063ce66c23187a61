"""The sketches for robots compile against stand-ins for the libraries that they need. They were not run on hardware."""

import shutil
import subprocess

import pytest
from support.markdown import ROOT

from limslam_agent.cli.settings import robot_named
from limslam_env.robots import e_puck

EXAMPLES = ROOT / "examples" / "live"
# What the sketches use of each library, with the types of that library.
ARDUINO = """
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#define IRAM_ATTR
enum { LOW, HIGH, INPUT, OUTPUT, CHANGE };
template <class T> T constrain(T x, T low, T high) { return x < low ? low : x > high ? high : x; }
int digitalRead(uint8_t); void digitalWrite(uint8_t, uint8_t); void pinMode(uint8_t, uint8_t);
void analogWrite(uint8_t, int); uint8_t digitalPinToInterrupt(uint8_t);
void attachInterrupt(uint8_t, void (*)(), int);
unsigned long millis(); void delay(uint32_t); uint32_t esp_random();
struct Port { void begin(unsigned long); int available(); int read(); size_t write(const uint8_t *, size_t); };
extern Port Serial;
"""
LIBRARIES = {
    "Arduino.h": ARDUINO,
    "Wire.h": "struct TwoWire { bool begin(); bool setClock(uint32_t); }; extern TwoWire Wire;",
    "VL53L0X.h": """
        struct VL53L0X {
            enum regAddr { RESULT_INTERRUPT_STATUS = 0x13 };
            bool init(bool io_2v8 = true); void setAddress(uint8_t); void setTimeout(uint16_t);
            uint8_t readReg(uint8_t);
            bool setMeasurementTimingBudget(uint32_t); void startContinuous(uint32_t period_ms = 0);
            uint16_t readRangeContinuousMillimeters(); bool timeoutOccurred();
        };""",
    "WiFi.h": """
        struct IPAddress { IPAddress(uint8_t, uint8_t, uint8_t, uint8_t); };
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
def compiles(tmp_path):
    if not EXAMPLES.is_dir():
        pytest.skip("the examples do not travel with the tests: run them in a checkout")
    for name, text in LIBRARIES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text + "\n", encoding="utf-8")

    def compile_with(compiler, *options):
        if shutil.which(compiler) is None:
            pytest.skip(f"there is no {compiler}")
        folders = ["-I", tmp_path, "-I", EXAMPLES]
        return subprocess.run(
            [compiler, "-fsyntax-only", "-Wall", "-Wextra", "-Werror", *folders, *options],
            capture_output=True, text=True, check=False,
        ).stderr  # fmt: skip

    return compile_with


@pytest.mark.parametrize("told", [(), ('-DUSE_WIFI="network","password"',)], ids=["serial", "wifi"])
def test_the_sketch_for_an_esp32(compiles, told):
    sketch = EXAMPLES / "esp32_tof" / "esp32_tof.ino"
    assert compiles("g++", *told, "-include", "Arduino.h", "-x", "c++", sketch) == ""


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
