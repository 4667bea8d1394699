/* The ranger's core: when to trigger, what an echo means, what to say. Portable C99, no hardware, no clock, no globals.
 *
 * This header is the manual. The caller owns one `struct ranger` and four small functions (`struct ranger_board`), and
 * passes the time in: a 32 bit counter of 0.5 us ticks that may wrap (it does so every 36 minutes).
 *
 *     ranger_begin(&ranger, &board, "hcsr04", PROTOCOL_PERIOD_MS, mcusr, seed, now);      once; says hello
 *     for (;;) {
 *         for every captured edge of ECHO, in order:  ranger_edge(&ranger, ticks, is_high);
 *         for every received byte:                    ranger_receive(&ranger, byte);
 *         when a temperature is known:                ranger_temperature(&ranger, tenths_of_a_degree);
 *         ranger_poll(&ranger, now, echo_is_high);    as often as possible; take `now` before collecting the edges
 *         relay_poll(&ranger.relay, now, pins);       then, see relay.h
 *     }
 *
 * Nothing here waits. All functions are to be called from one context (the main loop), none from an interrupt: edges
 * carry the time at which the hardware saw them, so it does not matter how late they are handed over.
 *
 * One cycle: TRIG is pulsed, ECHO rises (about 0.45 ms later), ECHO falls after the sound's way there and back. Every
 * cycle is reported by exactly one line, as soon as it is known what became of it and at the latest when it ends:
 *
 *     ECHO fell                           ticks, and TOO_NEAR or TOO_FAR outside 2 cm to 4 m (at 20 degrees C)
 *     ... but later than RANGER_NO_ECHO_TICKS after it rose     NO_ECHO
 *     ECHO did not rise within RANGER_RISE_LIMIT_TICKS          NO_RISING_EDGE
 *     ECHO is high when the cycle begins or ends                STUCK_HIGH
 *
 * A cycle that begins with ECHO high gives no trigger, because the sensor is still busy. After
 * RANGER_NUDGE_CYCLES such cycles TRIG is pulsed all the same: some modules hold ECHO until they are triggered again.
 * No fault ends the cycles, so the board never falls silent because a sensor died. */
#ifndef RANGER_H
#define RANGER_H

#include "ranger_wire.h"
#include "relay.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ECHO has to rise within 10 ms of the trigger; an HC-SR04 takes 0.45 ms. */
#define RANGER_RISE_LIMIT_TICKS 20000u
/* Longer than 30 ms is no echo: 4 m take 26 ms at -40 degrees C, and an HC-SR04 that hears nothing says 38 ms. */
#define RANGER_NO_ECHO_TICKS 60000u
/* A cycle that would begin later than this (1 ms) moves all later ones, so that no two begin too close together. */
#define RANGER_LATE_TICKS 2000u
#define RANGER_NUDGE_CYCLES 8u
/* Before a cycle begins, 1 ms. */
#define RANGER_QUIET_TICKS 2000

/* What the core needs of the hardware. None of these may wait longer than some ten microseconds. */
struct ranger_board {
    void (*trigger)(void *context);               /* pulse TRIG for at least 10 us, then watch ECHO for both edges */
    uint8_t (*tx_space)(void *context);           /* bytes that tx_byte would take now */
    void (*tx_byte)(void *context, uint8_t byte); /* only called where there is space */
    void *context;                                /* handed to each of them */
};

enum ranger_state {
    RANGER_REPORTED, /* this cycle's line was said; waiting for the next */
    RANGER_WAIT_RISE,
    RANGER_WAIT_FALL,
    RANGER_BLOCKED, /* ECHO was high when the cycle began */
};

struct ranger {
    /* For the caller to read. */
    uint16_t lost_lines;  /* lines dropped because tx_space was too small; a line is sent whole or not at all */
    uint16_t late_cycles; /* cycles that began later than RANGER_LATE_TICKS */
    uint8_t flags;        /* of the newest measurement */
    bool light;           /* the LED: see ranger_poll */
    bool beacon;          /* it blinks the beacon's code */
    struct relay relay;   /* see relay.h; begun with ranger_begin */

    /* The core's own. */
    const struct ranger_board *board;
    struct ranger_hello hello;
    enum ranger_state state;
    uint32_t period_ticks;
    uint32_t due;      /* the next cycle begins */
    uint32_t started;  /* this cycle began */
    uint32_t rose;     /* ECHO rose in this cycle */
    uint32_t hello_at; /* the newest hello was said */
    uint16_t seq;      /* of the next measurement */
    int16_t temperature_dc;
    uint8_t blocked_cycles; /* in a row; stays at RANGER_NUDGE_CYCLES */
    uint8_t light_step;
    uint8_t light_blinks;
    uint16_t code;     /* the beacon's, at random */
    uint8_t lit;       /* the LED in the newest cycles, bit 0: this one */
    bool beacon_asked; /* since a reset, and from the next cycle on */
    bool asked;       /* a question waits for its answer */
    bool hello_said;  /* in this cycle */
};

/* Fill the struct and say hello. The first trigger follows one period later, so that an old echo has died away.
 * `board` and `name` must outlive `ranger`; `period_ms` is PROTOCOL_MIN_PERIOD_MS to PROTOCOL_MAX_PERIOD_MS; `seed`
 * differs from one reset to the next. */
void ranger_begin(struct ranger *ranger, const struct ranger_board *board, const char *name, uint16_t period_ms,
                  uint8_t mcusr, uint16_t seed, uint32_t now);

/* ECHO changed at `ticks`. Edges that make no sense (a second rise, a fall without a rise) are ignored. */
void ranger_edge(struct ranger *ranger, uint32_t ticks, bool is_high);

/* A byte from the host, for the relay, too. A `?` asks for a hello: at most one is said in a cycle, several questions get one answer.
 * A `b` asks for the beacon: from the next cycle on the LED blinks a code, which the lines carry. */
void ranger_receive(struct ranger *ranger, uint8_t byte);

/* The air's temperature, sent with every measurement from now on. Outside PROTOCOL_MIN/MAX_TEMPERATURE_DC, or
 * RANGER_NO_TEMPERATURE: lines carry none. */
void ranger_temperature(struct ranger *ranger, int16_t temperature_dc);

/* Do what is due. Returns true when a cycle began: the moment to feed a watchdog, since a clock that stands still then
 * bites too. Sets `light`: on while measurements are valid; else it blinks 1 NO_ECHO, 2 NO_RISING_EDGE, 3 TOO_NEAR,
 * 4 TOO_FAR or 5 STUCK_HIGH times, a quarter of a second each, with a pause of about a second. With the beacon it is on
 * or off at random in each cycle. */
bool ranger_poll(struct ranger *ranger, uint32_t now, bool echo_is_high);

/* Is no echo being timed, and the next cycle 1 ms away at least? Then what takes less than that disturbs nothing. */
bool ranger_quiet(const struct ranger *ranger, uint32_t now);

/* 0.1 degrees C from the sum of 64 ten-bit samples of a TMP36 (0.5 V at 0 degrees C, 10 mV a degree). */
int16_t ranger_tmp36(uint16_t sum_of_64, uint16_t reference_mv);

#ifdef __cplusplus
}
#endif
#endif
