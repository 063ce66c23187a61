"""A board in place of an ESP32, on which the sketch of the examples runs: it drives as it is told,
in a clock of its own.
"""

import subprocess
from collections.abc import Iterable
from pathlib import Path

MACHINE = """
#include "Arduino.h"
#include SKETCH

Port Serial;
TwoWire Wire;
static uint32_t clock_ms, mm[BEAMS];
static int levels[64];
static void (*handlers[64])();
static double turn_rate_now;

unsigned long millis() { return clock_ms; }
void delay(uint32_t ms) { clock_ms += ms; }
uint32_t esp_random() { return 7; }
int digitalRead(uint8_t pin) { return levels[pin]; }
void digitalWrite(uint8_t, uint8_t) {}
void pinMode(uint8_t, uint8_t) {}
void analogWrite(uint8_t, int) {}
uint8_t digitalPinToInterrupt(uint8_t pin) { return pin; }
void attachInterrupt(uint8_t pin, void (*handler)(), int) { handlers[pin] = handler; }

void Port::begin(unsigned long) {}
int Port::available() { return 0; }
int Port::read() { return -1; }
size_t Port::write(const uint8_t *text, size_t size) { return fwrite(text, 1, size, stdout); }
size_t Port::println(const char *text) { return (size_t)printf("%s\\r\\n", text); }

/* The gyroscope: the bytes of its rate, which is off by 3 deg/s. */
static int gyro_byte;
bool TwoWire::begin() { return true; }
bool TwoWire::setClock(uint32_t) { return true; }
void TwoWire::beginTransmission(uint8_t) {}
size_t TwoWire::write(uint8_t) { return 1; }
uint8_t TwoWire::endTransmission(bool) { return 0; }
uint8_t TwoWire::requestFrom(uint8_t, uint8_t size) { gyro_byte = 0; return size; }
int TwoWire::read() {
    const int value = (int)lround(65.5 * (turn_rate_now + 3.0));
    return (gyro_byte++ == 0 ? value >> 8 : value) & 0xFF;
}

bool VL53L0X::init(bool) { return true; }
void VL53L0X::setAddress(uint8_t) {}
void VL53L0X::setTimeout(uint16_t) {}
bool VL53L0X::setMeasurementTimingBudget(uint32_t) { return true; }
void VL53L0X::startContinuous(uint32_t) {}
bool VL53L0X::timeoutOccurred() { return false; }
uint8_t VL53L0X::readReg(uint8_t) { return mm[this - sensors] == LIMSLAM_NO_READING ? 0 : 7; }
uint16_t VL53L0X::readRangeContinuousMillimeters() { return (uint16_t)mm[this - sensors]; }

#ifdef CARD
SPIClass SPI;
SDFS SD;
void SPIClass::begin(int8_t, int8_t, int8_t, int8_t) {}
bool SDFS::begin(uint8_t) { return clock_ms > 500; } /* the card is put in late */
bool SDFS::exists(const char *name) {
    FILE *file = fopen(name + 1, "r");
    if (file) fclose(file);
    return file != NULL;
}
File SDFS::open(const char *name, const char *mode) { return {fopen(name + 1, mode)}; }
size_t File::write(const uint8_t *text, size_t size) { return fwrite(text, 1, size, file); }
void File::flush() { fflush(file); }
#endif

static void turn_wheel(int side, int count) {
    for (; count != 0; count -= count > 0 ? 1 : -1) {
        levels[ENCODER_A[side]] = !levels[ENCODER_A[side]];
        levels[ENCODER_B[side]] = levels[ENCODER_A[side]] ^ (count < 0);
        handlers[ENCODER_A[side]]();
    }
}

/* Rows of the input: ticks and turn rate since the row before, ranges. */
int main() {
    int left, right;
    setup();
    uint32_t next_row = clock_ms;
    while (scanf("%d %d %lf", &left, &right, &turn_rate_now) == 3) {
        for (int i = 0; i < BEAMS; i++) if (scanf("%u", &mm[i]) != 1) return 1;
        for (; clock_ms < next_row; clock_ms++) loop();
        turn_wheel(0, left);
        turn_wheel(1, right);
        loop();
        next_row = clock_ms + PERIOD_MS;
        clock_ms++;
    }
    return 0;
}
"""


def run_sketch(
    sketch: Path, headers: Path, rows: Iterable[tuple[float, ...]], *options: str
) -> str:
    """What the sketch writes to the serial port while the robot drives.

    Parameters
    ----------
    sketch
        The sketch, beside which the folder of ``limslam_link.c`` is.
    headers
        Folder of the headers in place of those of the libraries. Files on the card are there.
    rows
        For each period: ticks of both wheels, turn rate (deg/s), and the range of each beam (mm,
        65536 without a new reading).
    options
        Options of the compiler.
    """
    machine = headers / "machine.cpp"
    link = sketch.parents[1] / "limslam_link.c"
    machine.write_text(MACHINE, encoding="utf-8")
    program = headers / "machine"
    folders = ["-I", headers, "-I", sketch.parents[1]]
    source = f'-DSKETCH="{sketch}"'
    command = ["g++", *folders, source, *options, machine, "-x", "c++", link]
    subprocess.run([*command, "-o", program], check=True)
    text = "".join(f"{' '.join(format(value, 'g') for value in row)}\n" for row in rows)
    finished = subprocess.run(
        [program], cwd=headers, input=text, capture_output=True, text=True, check=True
    )
    return finished.stdout
