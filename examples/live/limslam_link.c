/* See limslam_link.h. Not run on a microcontroller; compiled with gcc and compared with the Python implementation. */
#include "limslam_link.h"

#include <string.h>

/* ---- reading ---- */

uint16_t limslam_checksum(const char *text, size_t length) {
    uint16_t sum = 0xFFFF;
    for (size_t i = 0; i < length; i++) {
        sum ^= (uint16_t)((uint16_t)(uint8_t)text[i] << 8);
        for (int bit = 0; bit < 8; bit++)
            sum = (uint16_t)((sum & 0x8000) ? ((unsigned)sum << 1) ^ 0x1021u : (unsigned)sum << 1);
    }
    return sum;
}

static const char HEX[] = "0123456789ABCDEF";

/* The length of the line before its asterisk, or 0 if the checksum is wrong. */
static size_t checked_length(const char *line) {
    const size_t length = strlen(line);
    if (length < 6 || length >= LIMSLAM_LONGEST_LINE || line[length - 5] != '*') return 0;
    const uint16_t sum = limslam_checksum(line, length - 5);
    for (int i = 0; i < 4; i++)
        if (line[length - 4 + (size_t)i] != HEX[(sum >> (12 - 4 * i)) & 0xF]) return 0;
    return length - 5;
}

/* Read a number from a field that ends with a comma, or at the end of the line. Moves *at behind the field. */
static int read_number(const char **at, const char *end, int64_t low, int64_t high, int64_t *value) {
    const char *p = *at;
    const int negative = p < end && *p == '-';
    int digits = 0;
    int64_t number = 0;
    if (negative) p++;
    for (; p < end && *p >= '0' && *p <= '9'; p++) {
        if (++digits > 10) return 0;
        number = 10 * number + (*p - '0');
    }
    if (digits == 0 || (p < end && *p != ',')) return 0;
    if (negative) number = -number;
    if (number < low || number > high) return 0;
    *value = number;
    *at = p < end ? p + 1 : end + 1; /* behind the end: there is no further field */
    return 1;
}

const char *limslam_collect(struct limslam_reader *reader, char byte) {
    if (byte != '\n') {
        if (reader->length + 1u < LIMSLAM_LONGEST_LINE) reader->text[reader->length++] = byte;
        else reader->is_too_long = 1;
        return NULL;
    }
    const int is_whole = reader->length > 0 && !reader->is_too_long;
    if (reader->length > 0 && reader->text[reader->length - 1] == '\r') reader->length--;
    reader->text[reader->length] = '\0';
    reader->length = 0;
    reader->is_too_long = 0;
    return is_whole ? reader->text : NULL;
}

/* ---- the connection ---- */

/* How far a counter has come, from old to now. It may have overflowed, or step back. */
static int32_t difference(uint32_t now, uint32_t old) {
    const uint32_t steps = now - old;
    return steps < 0x80000000u ? (int32_t)steps : -(int32_t)(0xFFFFFFFFu - steps) - 1;
}

void limslam_start(struct limslam_link *link, const struct limslam_hello *hello) {
    memset(link, 0, sizeof *link);
    link->hello = hello;
    link->owes_hello = 1;
}

static int16_t speed_of(int64_t value) { return (int16_t)value; }

int limslam_hear(struct limslam_link *link, const char *line, uint32_t now) {
    static const int64_t u32 = 0xFFFFFFFFLL;
    const size_t length = checked_length(line);
    if (length < 3 || line[1] != ',') return 0;
    const char *at = line + 2, *end = line + length;
    int64_t first, seq, answers, left = 0, right = 0;
    switch (line[0]) {
    case 'Q':
        if (!read_number(&at, end, 0, 255, &first) || !read_number(&at, end, 0, u32, &seq) || at <= end) return 0;
        link->left = link->right = 0;
        link->has_host = 1;
        link->owes_hello = 1;
        link->ack = (uint32_t)seq;
        link->heard = now;
        return 1;
    case 'V':
        if (!read_number(&at, end, 0, u32, &seq) || !read_number(&at, end, 0, u32, &answers) ||
            !read_number(&at, end, -32768, 32767, &left) || !read_number(&at, end, -32768, 32767, &right) ||
            at <= end)
            return 0;
        break;
    case 'P':
    case 'X':
        if (!read_number(&at, end, 0, u32, &seq) || at <= end) return 0;
        break;
    default:
        return 0;
    }
    if (line[0] == 'X') link->left = link->right = 0; /* even if it is late */
    if (!link->has_host || difference((uint32_t)seq, link->ack) <= 0) return 1;
    link->ack = (uint32_t)seq;
    link->heard = now;
    if (line[0] == 'V') {
        link->left = speed_of(left);
        link->right = speed_of(right);
        link->is_stopped = 0;
    }
    return 1;
}

void limslam_speeds(struct limslam_link *link, uint32_t now, int16_t *left, int16_t *right) {
    const int32_t silence = difference(now, link->heard);
    if (silence > (int32_t)link->hello->watchdog_ms && (link->left || link->right)) {
        link->left = link->right = 0;
        link->is_stopped = 1;
    }
    if (silence > LIMSLAM_HOST_LOST_AFTER) link->has_host = 0;
    *left = link->left;
    *right = link->right;
}

/* ---- writing ---- */

/* A text in the making. Once it is full, nothing more is added. */
struct writer {
    char *text;
    size_t size, length;
    int is_full;
};

static void put(struct writer *out, char byte) {
    if (out->length + 1 < out->size) out->text[out->length++] = byte;
    else out->is_full = 1;
}

static void put_text(struct writer *out, const char *text) {
    while (*text) put(out, *text++);
}

static void put_number(struct writer *out, int64_t value) {
    char digits[20];
    int count = 0;
    put(out, ',');
    if (value < 0) put(out, '-');
    uint64_t rest = value < 0 ? (uint64_t)(-value) : (uint64_t)value;
    do digits[count++] = (char)('0' + rest % 10);
    while (rest /= 10);
    while (count) put(out, digits[--count]);
}

/* End a line that begins at a place with its checksum. A line that does not fit is removed as a whole. */
static void end_line(struct writer *out, size_t begin) {
    const uint16_t sum = limslam_checksum(out->text + begin, out->length - begin);
    put(out, '*');
    for (int shift = 12; shift >= 0; shift -= 4) put(out, HEX[(sum >> shift) & 0xF]);
    put(out, '\n');
    if (out->is_full) out->length = begin;
    out->is_full = 0;
}

static void put_hello(struct writer *out, const struct limslam_hello *hello) {
    const size_t begin = out->length;
    put(out, 'H');
    put_number(out, LIMSLAM_VERSION);
    put_number(out, hello->boot);
    put(out, ',');
    put_text(out, hello->name);
    put_number(out, hello->beams);
    put_number(out, hello->nm_per_tick);
    put_number(out, hello->period_ms);
    put_number(out, hello->watchdog_ms);
    if (hello->token) {
        put(out, ',');
        put_text(out, hello->token);
    }
    end_line(out, begin);
}

/* What is to be sent, with a heading where there is one. */
static size_t say(struct limslam_link *link, uint32_t now, int32_t left_ticks, int32_t right_ticks,
                  const int32_t *heading, const uint32_t *ranges, char *text, size_t size) {
    struct writer out = {text, size, 0, 0};
    if (size == 0) return 0;
    if (link->owes_hello || (!link->has_host && difference(now, link->next_hello) >= 0)) {
        link->owes_hello = 0;
        link->next_hello = now + LIMSLAM_HELLO_EVERY;
        put_hello(&out, link->hello);
    }
    if (link->has_host) {
        const size_t begin = out.length;
        put(&out, heading ? 'T' : 'S');
        put_number(&out, link->seq++);
        put_number(&out, now);
        put_number(&out, left_ticks);
        put_number(&out, right_ticks);
        put_number(&out, link->ack);
        put_number(&out, link->is_stopped);
        if (heading) put_number(&out, *heading);
        for (int beam = 0; beam < link->hello->beams; beam++) {
            if (ranges[beam] > LIMSLAM_NOTHING_SEEN) put_text(&out, ",-");
            else put_number(&out, ranges[beam]);
        }
        end_line(&out, begin);
    }
    text[out.length] = '\0';
    return out.length;
}

size_t limslam_say(struct limslam_link *link, uint32_t now, int32_t left_ticks, int32_t right_ticks,
                   const uint32_t *ranges, char *text, size_t size) {
    return say(link, now, left_ticks, right_ticks, NULL, ranges, text, size);
}

size_t limslam_say_heading(struct limslam_link *link, uint32_t now, int32_t left_ticks, int32_t right_ticks,
                           int32_t heading, const uint32_t *ranges, char *text, size_t size) {
    return say(link, now, left_ticks, right_ticks, &heading, ranges, text, size);
}
