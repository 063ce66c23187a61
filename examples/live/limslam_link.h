/* The robot's side of LimSLAM's line protocol (docs/live.md), for any microcontroller: C99, no malloc, no printf.
 *
 * The tests of LimSLAM compile this file with gcc and compare it, line by line, with the Python implementation. It has
 * not been run on a microcontroller.
 *
 * A robot needs five calls:
 *
 *     limslam_start(&link, &hello);                      once, after power-on
 *     line = limslam_collect(&reader, byte);             for each byte that arrives
 *     if (line) limslam_hear(&link, line, millis());     for each line that is complete
 *     limslam_speeds(&link, millis(), &left, &right);    often; it stops the wheels when nothing comes
 *     limslam_say(&link, millis(), ...);                 once each period; print the text that it writes
 */
#ifndef LIMSLAM_LINK_H
#define LIMSLAM_LINK_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define LIMSLAM_VERSION 2
#define LIMSLAM_MAX_BEAMS 64
#define LIMSLAM_LONGEST_LINE 512     /* bytes of a line, with its end */
#define LIMSLAM_LONGEST_TEXT 640     /* bytes of what limslam_say writes: a hello and a telemetry line */
#define LIMSLAM_NOTHING_SEEN 65535u  /* the beam saw nothing up to its maximum */
#define LIMSLAM_NO_READING 65536u    /* the beam has no new reading */
#define LIMSLAM_HELLO_EVERY 500      /* ms between two hellos of a robot without a host */
#define LIMSLAM_HOST_LOST_AFTER 3000 /* ms without a line after which the robot looks for a host again */

/* What the robot says about itself. */
struct limslam_hello {
    uint32_t boot;        /* differs each time the robot is switched on: a random number */
    const char *name;     /* 1 to 24 letters, digits, '_', '.' or '-' */
    uint8_t beams;        /* number of ranges, 1 to LIMSLAM_MAX_BEAMS */
    uint32_t nm_per_tick; /* wheel travel for each tick, nm */
    uint16_t period_ms;   /* time between two telemetry lines */
    uint16_t watchdog_ms; /* time without a line after which the wheels stop */
    const char *token;    /* the word of `limslam live --token`, written like a name, or NULL */
};

/* The state of the connection. limslam_start sets it; read has_host, and leave the rest alone. */
struct limslam_link {
    const struct limslam_hello *hello;
    uint32_t seq, ack, heard, next_hello;
    int16_t left, right;
    uint8_t has_host, is_stopped, owes_hello;
};

/* Collects bytes into lines. Set it to zero once. */
struct limslam_reader {
    char text[LIMSLAM_LONGEST_LINE];
    uint16_t length;
    uint8_t is_too_long;
};

void limslam_start(struct limslam_link *link, const struct limslam_hello *hello);

/* Add a byte. The complete line, without its end, or NULL. The line is valid until the next call. */
const char *limslam_collect(struct limslam_reader *reader, char byte);

/* Take a line without its end at the time now, ms. 1 if it was a command, 0 if it was damaged or something else. */
int limslam_hear(struct limslam_link *link, const char *line, uint32_t now);

/* The wheel speeds at the time now, ms, in mm/s. They are zero when nothing was heard for the watchdog's time. */
void limslam_speeds(struct limslam_link *link, uint32_t now, int16_t *left, int16_t *right);

/* Write what is to be sent now into text, with a zero at its end. Call it once each period.
 *
 * The ticks count from power-on and may overflow. Ranges are in mm, or LIMSLAM_NOTHING_SEEN, or LIMSLAM_NO_READING.
 * Returns the number of bytes. A line for which there is no room in size bytes is left out.
 */
size_t limslam_say(struct limslam_link *link, uint32_t now, int32_t left_ticks, int32_t right_ticks,
                   const uint32_t *ranges, char *text, size_t size);

/* The same with the heading of an inertial measurement unit, in thousandths of a degree: counter-clockwise, from any
 * direction, and it may count on beyond a full turn. Call limslam_say in periods without a new heading.
 */
size_t limslam_say_heading(struct limslam_link *link, uint32_t now, int32_t left_ticks, int32_t right_ticks,
                           int32_t heading, const uint32_t *ranges, char *text, size_t size);

/* CRC-16 with the polynomial 0x1021 and the initial value 0xFFFF. */
uint16_t limslam_checksum(const char *text, size_t length);

#ifdef __cplusplus
}
#endif

#endif
