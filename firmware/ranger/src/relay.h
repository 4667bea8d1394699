/* The board's two outputs, which the host must renew: never both, and off as soon as one of the conditions of
 * docs/ranger.md ends. Portable C99, no hardware, no clock; times as in ranger.h.
 *
 *     relay_receive(&relay, byte);                     every byte from the host
 *     relay_measured(&relay, seq, ticks, flags, at);   every measurement, before its line is written
 *     relay_poll(&relay, now, pins);                   as often as possible; then switch the pins as `output` says */
#ifndef RELAY_H
#define RELAY_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* `$HCR,FFFF,65535,2,999999,999999*FFFF` and a carriage return. */
#define RELAY_COMMAND_MAX 38
/* A command may reply to one of so many measurements; a power of two. */
#define RELAY_NUMBERS 4u
/* Measurements in a row that are outside the band, or not valid, until the output goes off. */
#define RELAY_ODD 2u
/* An output goes on in the third cycle after one went off: 120 ms at least, in which the relay behind it lets go. */
#define RELAY_PAUSE 3u

enum relay_output { RELAY_NONE, RELAY_IN_PLACE, RELAY_MAY_MOVE }; /* one bit each, as the pins */

struct relay {
    /* For the caller to read. */
    uint8_t output; /* enum relay_output: what is to be on */
    bool asked;     /* a command has come since the reset: lines carry the field, and the pins are outputs */
    uint8_t pins;   /* that are high: a sum of enum relay_output, from the newest relay_poll */
    uint16_t run;   /* with the sequence number: the number that a command must bear */

    /* Its own. */
    uint16_t seed;
    uint16_t seq;                   /* of the newest measurement */
    uint32_t issued[RELAY_NUMBERS]; /* when the newest measurements were known, by the low bits of their numbers */
    uint8_t usable;                 /* the newest so many numbers are not used up */
    uint32_t ticks;                 /* of the newest measurement; 0: not valid */
    uint32_t nearest, farthest;     /* ticks; the band */
    uint32_t ends;                  /* then an output goes off */
    uint8_t odd;                    /* measurements in a row outside the band */
    uint8_t pause;                  /* cycles that both still have to stay off */
    uint8_t length;                 /* of `text`; 0: between lines */
    char text[RELAY_COMMAND_MAX + 1]; /* the line from its `$` on */
};

/* Both off. `seed` differs from one reset to the next. */
void relay_begin(struct relay *relay, uint16_t seed);

void relay_receive(struct relay *relay, uint8_t byte);

/* A measurement became known at `at`. `flags`: not 0 is not valid. */
void relay_measured(struct relay *relay, uint16_t seq, uint32_t ticks, uint8_t flags, uint32_t at);

/* Time passes. `pins`: those that are high, as they are read back. */
void relay_poll(struct relay *relay, uint32_t now, uint8_t pins);

#ifdef __cplusplus
}
#endif
#endif
