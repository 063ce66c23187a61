/* An e-puck (version 1), for `limslam live --serial PORT --robot e-puck` over its Bluetooth serial port.
 *
 * NOT RUN ON HARDWARE, and compiled only against stand-ins for the e-puck library of GCTronic, which it needs. The
 * protocol in limslam_link.c is tested. Add limslam_link.c to the project.
 *
 * The infrared sensors of an e-puck measure how much light comes back, not a distance, and see 4 to 6 cm. Such a robot
 * follows walls and maps small arenas. Measure INTENSITY below with a white wall and a ruler.
 */
#include <a_d/advance_ad_scan/e_ad_conv.h>
#include <a_d/advance_ad_scan/e_prox.h>
#include <motor_led/advance_one_timer/e_agenda.h>
#include <motor_led/advance_one_timer/e_motors.h>
#include <motor_led/e_init_port.h>
#include <uart/e_uart_char.h>

#include "limslam_link.h"

#define BEAMS 8
#define PERIOD_MS 100
#define MAX_STEPS 1000 /* a second */

/* The sensors in the order of the robot e-puck: 17, 49, 90, 150, -150, -90, -49, -17 deg. */
static const unsigned int SENSOR[BEAMS] = {7, 6, 5, 4, 3, 2, 1, 0};

/* Calibrated intensity at these distances. MEASURE YOURS: it depends on the robot and on the colour of the wall. */
#define POINTS 7
static const int MM[POINTS] = {5, 10, 15, 20, 30, 40, 60};
static const int INTENSITY[POINTS] = {2000, 1300, 600, 380, 220, 150, 90};

/* A wheel of 41 mm turns in 1000 steps: 3.1416 * 41 mm / 1000 = 0.1288 mm. */
static const struct limslam_hello HELLO = {1, "e-puck", BEAMS, 128800, PERIOD_MS, 400, 0};

static volatile uint32_t clock_ms;

static void count_ms(void) { clock_ms++; }

/* The clock has 32 bits and the processor 16: it may change between the two halves. */
static uint32_t now_ms(void) {
    uint32_t first, second;
    do {
        first = clock_ms;
        second = clock_ms;
    } while (first != second);
    return first;
}

/* The distance for an intensity, by straight lines between the points of the table. */
static uint32_t range_of(int intensity) {
    int i;
    if (intensity < INTENSITY[POINTS - 1]) return LIMSLAM_NOTHING_SEEN;
    if (intensity >= INTENSITY[0]) return 0; /* too near to be measured */
    for (i = 1; intensity < INTENSITY[i]; i++) {}
    return (uint32_t)(MM[i] - (int32_t)(MM[i] - MM[i - 1]) * (intensity - INTENSITY[i]) /
                                  (INTENSITY[i - 1] - INTENSITY[i]));
}

static int steps_of(int16_t mm_per_s) {
    const int32_t steps = (int32_t)mm_per_s * 10000 / 1288;
    return (int)(steps > MAX_STEPS ? MAX_STEPS : steps < -MAX_STEPS ? -MAX_STEPS : steps);
}

/* The counters of the library have 16 bits. Their differences are summed in 32. */
static int32_t summed(int count, int16_t *before, int32_t *sum) {
    *sum += (int16_t)((uint16_t)count - (uint16_t)*before);
    *before = (int16_t)count;
    return *sum;
}

static void drive(struct limslam_link *connection) {
    int16_t left, right;
    limslam_speeds(connection, now_ms(), &left, &right);
    e_set_speed_left(steps_of(left));
    e_set_speed_right(steps_of(right));
}

static void hear(struct limslam_link *connection, struct limslam_reader *reader) {
    char byte;
    while (e_ischar_uart1() && e_getchar_uart1(&byte)) {
        const char *line = limslam_collect(reader, byte);
        if (line) limslam_hear(connection, line, now_ms());
    }
}

static void say(struct limslam_link *connection) {
    static char text[LIMSLAM_LONGEST_TEXT];
    static int16_t left_before, right_before;
    static int32_t left, right;
    uint32_t ranges[BEAMS];
    int i;
    if (e_uart1_sending()) return; /* the library reads the text while it sends */
    for (i = 0; i < BEAMS; i++) ranges[i] = range_of(e_get_calibrated_prox(SENSOR[i]));
    summed(e_get_steps_left(), &left_before, &left);
    summed(e_get_steps_right(), &right_before, &right);
    e_send_uart1_char(text, (int)limslam_say(connection, now_ms(), left, right, ranges, text, sizeof text));
}

int main(void) {
    static struct limslam_link connection;
    static struct limslam_reader reader;
    static struct limslam_hello hello;
    uint32_t next_line = 0;
    e_init_port();
    e_init_uart1();
    e_init_motors();
    e_init_ad_scan(ALL_ADC);
    e_calibrate_ir(); /* nothing may be near the robot now */
    e_activate_agenda(count_ms, 10);
    e_start_agendas_processing();
    hello = HELLO;
    /* The noise of the sensors is the only random number of this robot. */
    hello.boot = (uint32_t)e_get_prox(0) << 20 ^ (uint32_t)e_get_ambient_light(2) << 10 ^ (uint32_t)e_get_prox(5);
    limslam_start(&connection, &hello);
    for (;;) {
        hear(&connection, &reader);
        drive(&connection);
        if ((int32_t)(now_ms() - next_line) >= 0) {
            next_line = now_ms() + PERIOD_MS;
            say(&connection);
        }
    }
}
