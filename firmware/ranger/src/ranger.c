#include "ranger.h"

#include "protocol_constants.h"

#define HELLO_TICKS ((uint32_t)PROTOCOL_HELLO_PERIOD_S * 1000u * PROTOCOL_TICKS_PER_MS)

/* The LED's code, in cycles: each blink is four on, four off, and eighteen more off close the row. */
#define BLINK_CYCLES 8u
#define PAUSE_CYCLES 18u

static bool passed(uint32_t now, uint32_t moment)
{
    return (int32_t)(now - moment) >= 0;
}

/* A line is sent whole or not at all. `spare` bytes are to stay free behind it. */
static bool say(struct ranger *ranger, const char *line, uint8_t length, uint8_t spare)
{
    const struct ranger_board *board = ranger->board;
    if (board->tx_space(board->context) < length + spare) {
        return false;
    }
    for (uint8_t at = 0; at < length; at++) {
        board->tx_byte(board->context, (uint8_t)line[at]);
    }
    return true;
}

/* A hello leaves room for a measurement: it may delay one, but never cost one. */
static void say_hello(struct ranger *ranger, uint32_t now)
{
    char line[RANGER_HELLO_MAX];
    const uint8_t length = ranger_write_hello(line, &ranger->hello);
    if (say(ranger, line, length, RANGER_MEASUREMENT_MAX)) {
        ranger->hello_at = now;
        ranger->hello_said = true;
        ranger->asked = false;
    }
}

/* `at`: when it became known. */
static void report(struct ranger *ranger, uint32_t ticks, uint8_t flags, uint32_t at)
{
    char line[RANGER_MEASUREMENT_MAX];
    struct relay *relay = &ranger->relay;
    relay_measured(relay, ranger->seq, ticks, flags, at);
    const struct ranger_measurement measurement = {.seq = ranger->seq,
                                                   .ticks = ticks,
                                                   .flags = flags,
                                                   .temperature_dc = ranger->temperature_dc,
                                                   .has_beacon = ranger->beacon,
                                                   .lit = ranger->lit,
                                                   .has_relay = relay->asked,
                                                   .run = relay->run,
                                                   .relay_state = (uint8_t)(relay->output << 2 | relay->pins)};
    if (!say(ranger, line, ranger_write_measurement(line, &measurement), 0)) {
        ranger->lost_lines++;
    }
    ranger->seq++;
    ranger->flags = flags;
    ranger->state = RANGER_REPORTED;
}

static void light_up(struct ranger *ranger)
{
    if (ranger->light_step >= ranger->light_blinks * BLINK_CYCLES + PAUSE_CYCLES || ranger->light_blinks == 0) {
        uint8_t blinks = 0; /* 1 for the lowest flag */
        for (uint8_t flags = ranger->flags; flags != 0; flags = (uint8_t)(flags >> 1)) {
            blinks++;
        }
        ranger->light_blinks = blinks;
        ranger->light_step = 0;
    }
    const bool in_row = ranger->light_step < ranger->light_blinks * BLINK_CYCLES;
    ranger->light = ranger->light_blinks == 0 || (in_row && ranger->light_step % BLINK_CYCLES < BLINK_CYCLES / 2);
    ranger->light_step++;
}

/* The next state of the beacon: xorshift, which `now` makes another code after each reset: it also counts when the host
 * asked, and how late the main loop is. */
static void light_code(struct ranger *ranger, uint32_t now)
{
    uint16_t code = (uint16_t)(ranger->code ^ (uint16_t)now);
    if (code == 0) {
        code = 1;
    }
    code = (uint16_t)(code ^ (uint16_t)(code << 7));
    code = (uint16_t)(code ^ (uint16_t)(code >> 9));
    code = (uint16_t)(code ^ (uint16_t)(code << 8));
    ranger->code = code;
    ranger->light = ((unsigned)code >> 8 & 1u) != 0;
    ranger->lit = (uint8_t)((unsigned)ranger->lit << 1 | ranger->light);
    ranger->beacon = true;
}

static void end_cycle(struct ranger *ranger, uint32_t now, bool echo_is_high)
{
    if (ranger->state == RANGER_WAIT_FALL) {
        /* Low, but nobody saw it fall: the width is not known. */
        report(ranger, 0, echo_is_high ? PROTOCOL_FLAG_STUCK_HIGH : PROTOCOL_FLAG_NO_ECHO, now);
    } else if (ranger->state == RANGER_BLOCKED) {
        report(ranger, 0, PROTOCOL_FLAG_STUCK_HIGH, now);
    }
}

static void begin_cycle(struct ranger *ranger, uint32_t now, bool echo_is_high)
{
    if (now - ranger->due > RANGER_LATE_TICKS) {
        ranger->late_cycles++;
        ranger->due = now;
    }
    ranger->started = now;
    ranger->due += ranger->period_ticks;
    ranger->hello_said = false;
    light_up(ranger);
    if (ranger->beacon_asked) {
        light_code(ranger, now);
    }
    if (echo_is_high) {
        ranger->state = RANGER_BLOCKED;
        if (ranger->blocked_cycles < RANGER_NUDGE_CYCLES) {
            ranger->blocked_cycles++;
            return;
        }
    } else {
        ranger->state = RANGER_WAIT_RISE;
        ranger->blocked_cycles = 0;
    }
    ranger->board->trigger(ranger->board->context);
}

void ranger_begin(struct ranger *ranger, const struct ranger_board *board, const char *name, uint16_t period_ms,
                  uint8_t mcusr, uint16_t seed, uint32_t now)
{
    *ranger = (struct ranger){0};
    relay_begin(&ranger->relay, seed);
    ranger->board = board;
    ranger->hello.name = name;
    ranger->hello.period_ms = period_ms;
    ranger->hello.mcusr = mcusr;
    ranger->period_ticks = (uint32_t)period_ms * PROTOCOL_TICKS_PER_MS;
    ranger->due = now + ranger->period_ticks;
    ranger->temperature_dc = RANGER_NO_TEMPERATURE;
    ranger->state = RANGER_REPORTED;
    ranger->hello_at = now;
    ranger->asked = true; /* in case there is no room for it now */
    say_hello(ranger, now);
}

void ranger_edge(struct ranger *ranger, uint32_t ticks, bool is_high)
{
    if (is_high) {
        if (ranger->state == RANGER_WAIT_RISE) {
            ranger->rose = ticks;
            ranger->state = RANGER_WAIT_FALL;
        }
        return;
    }
    if (ranger->state != RANGER_WAIT_FALL) {
        return;
    }
    const uint32_t width = ticks - ranger->rose;
    if (width >= RANGER_NO_ECHO_TICKS) {
        report(ranger, 0, PROTOCOL_FLAG_NO_ECHO, ticks);
        return;
    }
    const uint32_t tenths = ranger_tenths_at_20c(width);
    uint8_t flags = 0;
    if (tenths < PROTOCOL_NEAREST_TENTHS) {
        flags = PROTOCOL_FLAG_TOO_NEAR;
    } else if (tenths > PROTOCOL_FARTHEST_TENTHS) {
        flags = PROTOCOL_FLAG_TOO_FAR;
    }
    report(ranger, width, flags, ticks);
}

void ranger_receive(struct ranger *ranger, uint8_t byte)
{
    if (byte == PROTOCOL_QUESTION) {
        ranger->asked = true;
    }
    if (byte == PROTOCOL_BEACON_REQUEST) {
        ranger->beacon_asked = true;
    }
    relay_receive(&ranger->relay, byte);
}

void ranger_temperature(struct ranger *ranger, int16_t temperature_dc)
{
    const bool possible =
        temperature_dc >= PROTOCOL_MIN_TEMPERATURE_DC && temperature_dc <= PROTOCOL_MAX_TEMPERATURE_DC;
    ranger->temperature_dc = possible ? temperature_dc : RANGER_NO_TEMPERATURE;
}

bool ranger_poll(struct ranger *ranger, uint32_t now, bool echo_is_high)
{
    bool began = false;
    if (ranger->state == RANGER_WAIT_RISE && now - ranger->started >= RANGER_RISE_LIMIT_TICKS) {
        report(ranger, 0, PROTOCOL_FLAG_NO_RISING_EDGE, now);
    }
    if (passed(now, ranger->due)) {
        end_cycle(ranger, now, echo_is_high);
        begin_cycle(ranger, now, echo_is_high);
        began = true;
    }
    /* Every 5 s, right behind a measurement, so that it is gone before the next one. */
    const bool hello_due = ranger->state == RANGER_REPORTED && now - ranger->hello_at >= HELLO_TICKS;
    if (hello_due || (ranger->asked && !ranger->hello_said)) {
        say_hello(ranger, now);
    }
    return began;
}

bool ranger_quiet(const struct ranger *ranger, uint32_t now)
{
    const bool timed = ranger->state == RANGER_WAIT_RISE || ranger->state == RANGER_WAIT_FALL;
    return !timed && (int32_t)(ranger->due - now) >= RANGER_QUIET_TICKS;
}

int16_t ranger_tmp36(uint16_t sum_of_64, uint16_t reference_mv)
{
    /* sum / 64 / 1024 * reference is the voltage; less 500 mV, one millivolt is one tenth of a degree. */
    const uint32_t millivolts = ((uint32_t)sum_of_64 * reference_mv + 32768u) / 65536u;
    return (int16_t)((int32_t)millivolts - 500);
}
