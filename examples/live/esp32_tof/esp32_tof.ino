/* A robot with an ESP32, six VL53L0X time-of-flight chips and two geared motors with encoders, for `limslam live`.
 *
 * NOT RUN ON HARDWARE. The tests compile this sketch against stand-ins for the libraries, and the protocol in
 * limslam_link.c is tested. Pins, gains and directions are a first guess: check them with the wheels off the ground.
 *
 * Needs: Arduino core for ESP32, library "VL53L0X" by Pololu. Copy limslam_link.h and limslam_link.c beside this file.
 * The robot is described for the host in esp32_tof.toml. docs/live.md has the wiring and the first drive.
 *
 * With WRITE_CSV the sketch only writes a log for `limslam replay`, a row each 50 ms (docs/robot/own_log.md).
 */
#include <VL53L0X.h>
#include <Wire.h>

#include "limslam_link.h"

/* #define USE_WIFI "name of the network", "password" */
/* #define WRITE_CSV */ /* no host: write a log, with the motors off, so that the robot can be pushed */
/* #define CARD */      /* write the log to an SD card instead of the serial port */
/* #define GYRO */      /* a board with an MPU-6050, flat on the robot, on the same two wires as the ranges */

#ifdef CARD
#include <SD.h>
#include <SPI.h>
static const int8_t CARD_SCK = 4, CARD_MISO = 33, CARD_MOSI = 23, CARD_CS = 5;
static File card;
#endif

#ifdef USE_WIFI
#include <WiFi.h>
#include <WiFiUdp.h>
/* limslam live --udp 4700 --listen 0.0.0.0 --token limslam
 * Without --listen the host hears only itself. Choose a token of your own: it keeps apart the robots of one network. */
static const uint16_t HOST_PORT = 4700;
#define TOKEN "limslam"
static WiFiUDP udp;
static IPAddress host(255, 255, 255, 255); /* until a host has answered, everybody in the network is asked */
#else
#define TOKEN NULL /* at the end of a cable there is no other robot */
#endif

/* The same order as beams_deg in esp32_tof.toml: 90, 45, 15, -15, -45, -90 deg. */
static const int BEAMS = 6;
static const uint8_t XSHUT[BEAMS] = {13, 14, 16, 17, 18, 19};
static const uint8_t FIRST_ADDRESS = 0x30;

/* Left wheel, right wheel. Each motor driver input takes a PWM signal: one turns ahead, the other one back. */
static const uint8_t AHEAD[2] = {25, 27}, BACK[2] = {26, 32};
static const uint8_t ENCODER_A[2] = {34, 36}, ENCODER_B[2] = {35, 39};

/* Wheel of 65 mm, 1440 ticks a turn: 3.1416 * 65 mm / 1440 = 0.1418 mm. Calibrate it: docs/logs.md. */
static const uint32_t NM_PER_TICK = 141800;
static const uint16_t PERIOD_MS = 50, WATCHDOG_MS = 300, CONTROL_MS = 10;

/* Speed control: PWM of 0 to 255 for each mm/s wanted, for each mm/s missing, and for each mm that is missing. */
static const float FEED_FORWARD = 0.55f, GAIN = 0.4f, GAIN_OF_LAG = 3.0f;

static struct limslam_hello hello = {0, "esp32-tof", BEAMS, NM_PER_TICK, PERIOD_MS, WATCHDOG_MS, TOKEN};
static struct limslam_link connection;
static struct limslam_reader reader;
static VL53L0X sensors[BEAMS];
static bool is_there[BEAMS];
static volatile int32_t ticks[2];
static float lag[2]; /* mm */

static void IRAM_ATTR left_tick() { ticks[0] += digitalRead(ENCODER_A[0]) == digitalRead(ENCODER_B[0]) ? 1 : -1; }
static void IRAM_ATTR right_tick() { ticks[1] += digitalRead(ENCODER_A[1]) == digitalRead(ENCODER_B[1]) ? 1 : -1; }

/* All chips begin with the same address. They are switched on one by one, and each gets an address of its own. */
static void start_sensors() {
    Wire.begin();
    Wire.setClock(400000);
    for (int i = 0; i < BEAMS; i++) {
        pinMode(XSHUT[i], OUTPUT);
        digitalWrite(XSHUT[i], LOW);
    }
    for (int i = 0; i < BEAMS; i++) {
        pinMode(XSHUT[i], INPUT); /* the board pulls it up to its own voltage */
        delay(10);
        sensors[i].setTimeout(50);
        is_there[i] = sensors[i].init();
        if (!is_there[i]) continue;
        sensors[i].setAddress((uint8_t)(FIRST_ADDRESS + i));
        sensors[i].setMeasurementTimingBudget(33000);
        sensors[i].startContinuous();
    }
}

/* The distance if the chip has a new one. It answers 8190 or more where it saw nothing, which is beyond max_range. */
static uint32_t new_range(int i) {
    if (!is_there[i]) return LIMSLAM_NO_READING;
    const bool is_ready = (sensors[i].readReg(VL53L0X::RESULT_INTERRUPT_STATUS) & 0x07) != 0;
    if (!is_ready) return LIMSLAM_NO_READING;
    const uint16_t mm = sensors[i].readRangeContinuousMillimeters();
    return sensors[i].timeoutOccurred() ? LIMSLAM_NO_READING : mm;
}

static double heading; /* deg, counter-clockwise */
#ifdef GYRO
static const uint8_t GYRO_ADDRESS = 0x68;
static bool has_gyro;
static float turn_rate_at_rest; /* deg/s */

static bool set_gyro(uint8_t place, uint8_t value) {
    Wire.beginTransmission(GYRO_ADDRESS);
    Wire.write(place);
    Wire.write(value);
    return Wire.endTransmission() == 0;
}

/* deg/s, counter-clockwise if the chip's side with the print looks up */
static float turn_rate() {
    Wire.beginTransmission(GYRO_ADDRESS);
    Wire.write((uint8_t)0x47);
    Wire.endTransmission(false);
    Wire.requestFrom(GYRO_ADDRESS, (uint8_t)2);
    const int high = Wire.read();
    const int low = Wire.read();
    return (float)(int16_t)(high << 8 | low) / 65.5f;
}

/* The robot has to stand still for the second in which the error of the chip is measured. */
static void start_gyro() {
    static const int SAMPLES = 100;
    has_gyro = set_gyro(0x6B, 0) && set_gyro(0x1A, 3) && set_gyro(0x1B, 0x08); /* awake, 42 Hz, 500 deg/s */
    for (int i = 0; has_gyro && i < SAMPLES; i++) {
        delay(10);
        turn_rate_at_rest += turn_rate() / SAMPLES;
    }
}

static void follow_turn(uint32_t now) {
    static uint32_t before = now;
    if (has_gyro) heading += 0.001 * (now - before) * (turn_rate() - turn_rate_at_rest);
    before = now;
}
#else
static const bool has_gyro = false;
static void start_gyro() {}
static void follow_turn(uint32_t) {}
#endif

static void drive_motor(int side, float pwm) {
    const int duty = (int)constrain(fabsf(pwm), 0.0f, 255.0f);
    analogWrite(AHEAD[side], pwm > 0.0f ? duty : 0);
    analogWrite(BACK[side], pwm < 0.0f ? duty : 0);
}

/* Hold the speeds that the host wants, or zero when the watchdog says so. */
static void control_wheels(uint32_t now) {
    static int32_t before[2];
    int16_t wanted[2];
    limslam_speeds(&connection, now, &wanted[0], &wanted[1]);
    for (int side = 0; side < 2; side++) {
        const int32_t count = ticks[side];
        const float driven = 1e-6f * NM_PER_TICK * (float)(count - before[side]);
        before[side] = count;
        if (wanted[side] == 0) { /* a standing wheel gets no current */
            lag[side] = 0.0f;
            drive_motor(side, 0.0f);
            continue;
        }
        const float missing = (float)wanted[side] - 1000.0f * driven / CONTROL_MS;
        lag[side] = constrain(lag[side] + 0.001f * CONTROL_MS * missing, -20.0f, 20.0f);
        drive_motor(side, FEED_FORWARD * (float)wanted[side] + GAIN * missing + GAIN_OF_LAG * lag[side]);
    }
}

static void hear_byte(char byte) {
    const char *line = limslam_collect(&reader, byte);
    if (line) limslam_hear(&connection, line, millis());
}

#ifdef USE_WIFI
static void start_line() {
    WiFi.begin(USE_WIFI);
    while (WiFi.status() != WL_CONNECTED) delay(100);
    WiFi.setSleep(false); /* sleep delays packets by 100 ms and more */
    udp.begin(HOST_PORT);
}

static void hear_line() {
    while (udp.parsePacket() > 0) {
        /* While there is a host, nobody else is obeyed. */
        const bool is_host = !connection.has_host || udp.remoteIP() == host;
        while (udp.available()) {
            const char byte = (char)udp.read();
            if (is_host) hear_byte(byte);
        }
        if (!is_host) continue;
        hear_byte('\n');
        if (connection.has_host) host = udp.remoteIP();
    }
    if (!connection.has_host) host = IPAddress(255, 255, 255, 255);
}

static void send_text(const char *text, size_t length) {
    udp.beginPacket(host, HOST_PORT);
    udp.write((const uint8_t *)text, length);
    udp.endPacket();
}
#else
static void hear_line() {
    while (Serial.available()) hear_byte((char)Serial.read());
}

#ifdef CARD
/* A new file each time: log0.csv, log1.csv, ... Without a card, the serial port says so. */
static void start_line() {
    char name[16];
    Serial.begin(115200);
    SPI.begin(CARD_SCK, CARD_MISO, CARD_MOSI, CARD_CS);
    while (!SD.begin(CARD_CS)) {
        Serial.println("no card");
        delay(1000);
    }
    int number = 0;
    do snprintf(name, sizeof name, "/log%d.csv", number++);
    while (SD.exists(name));
    card = SD.open(name, FILE_WRITE);
}

static void send_text(const char *text, size_t length) {
    static uint32_t next_flush;
    card.write((const uint8_t *)text, length);
    if ((int32_t)(millis() - next_flush) < 0) return;
    next_flush = millis() + 1000; /* what is lost when the robot is switched off */
    card.flush();
}
#else
static void start_line() { Serial.begin(115200); }

static void send_text(const char *text, size_t length) { Serial.write((const uint8_t *)text, length); }
#endif
#endif

#if defined(WRITE_CSV) || defined(CARD)
static const char COLUMNS[] = "time_ms,left_ticks,right_ticks,r_90_mm,r_45_mm,r_15_mm,r_-15_mm,r_-45_mm,r_-90_mm";

/* A row of the log. A range without a new reading stays empty. The names of the columns are repeated every 10 s, for a
 * monitor that is opened late. */
static size_t new_text(uint32_t now, const uint32_t *ranges, char *text, size_t size) {
    static uint32_t rows;
    size_t length = 0;
    if (rows++ % 200 == 0) length += snprintf(text, size, "%s%s\n", COLUMNS, has_gyro ? ",yaw_deg" : "");
    length += snprintf(text + length, size - length, "%lu,%ld,%ld", (unsigned long)now, (long)ticks[0], (long)ticks[1]);
    for (int i = 0; i < BEAMS; i++) {
        text[length++] = ',';
        if (ranges[i] == LIMSLAM_NO_READING) continue;
        length += snprintf(text + length, size - length, "%lu", (unsigned long)ranges[i]);
    }
    if (has_gyro) length += snprintf(text + length, size - length, ",%.2f", heading);
    text[length++] = '\n';
    return length;
}
#else
static size_t new_text(uint32_t now, const uint32_t *ranges, char *text, size_t size) {
    if (!has_gyro) return limslam_say(&connection, now, ticks[0], ticks[1], ranges, text, size);
    const int32_t turned = (int32_t)(1000.0 * heading);
    return limslam_say_heading(&connection, now, ticks[0], ticks[1], turned, ranges, text, size);
}
#endif

void setup() {
    for (int side = 0; side < 2; side++) {
        pinMode(AHEAD[side], OUTPUT);
        pinMode(BACK[side], OUTPUT);
        drive_motor(side, 0.0f);
        pinMode(ENCODER_A[side], INPUT);
        pinMode(ENCODER_B[side], INPUT);
    }
    attachInterrupt(digitalPinToInterrupt(ENCODER_A[0]), left_tick, CHANGE);
    attachInterrupt(digitalPinToInterrupt(ENCODER_A[1]), right_tick, CHANGE);
    start_line();
    start_sensors();
    start_gyro();
    hello.boot = esp_random();
    limslam_start(&connection, &hello);
}

void loop() {
    static uint32_t next_control, next_line;
    const uint32_t now = millis();
    hear_line();
    if ((int32_t)(now - next_control) >= 0) {
        next_control = now + CONTROL_MS;
        control_wheels(now);
        follow_turn(now);
    }
    if ((int32_t)(now - next_line) >= 0) {
        next_line = now + PERIOD_MS;
        uint32_t ranges[BEAMS];
        char text[LIMSLAM_LONGEST_TEXT];
        for (int i = 0; i < BEAMS; i++) ranges[i] = new_range(i);
        send_text(text, new_text(now, ranges, text, sizeof text));
    }
}
