/* The ranger's lines: fields in, bytes out. The contract is docs/ranger.md. No state, no hardware.
 *
 * A line is `$`, a body, `*`, the CRC-16/XMODEM of the body as four upper-case hex digits, CR LF. */
#ifndef RANGER_WIRE_H
#define RANGER_WIRE_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Bytes of the longest lines: 16 bit sequence, 6 digit ticks and tenths; 16 letter name, 3 digit numbers. */
#define RANGER_MEASUREMENT_MAX 52
#define RANGER_HELLO_MAX 40

/* Of `temperature_dc`: there is no thermometer, or it says what cannot be. */
#define RANGER_NO_TEMPERATURE INT16_MIN

struct ranger_measurement {
    uint16_t seq;           /* 0 after a reset, wraps */
    uint32_t ticks;         /* width of the ECHO pulse, 0.5 us, at most PROTOCOL_MAX_TICKS */
    uint8_t flags;          /* sum of PROTOCOL_FLAG_...; 0: valid */
    int16_t temperature_dc; /* 0.1 degrees C, or RANGER_NO_TEMPERATURE: the line has no such field */
    bool has_beacon;        /* the line has the beacon's field */
    uint8_t lit;            /* the LED in the newest cycles, bit 0: this one */
    bool has_relay;         /* the line has the relay's field */
    uint16_t run;
    uint8_t relay_state; /* what is on, times 4, plus the pins that are high */
};

struct ranger_hello {
    const char *name; /* 1-16 of A-Z a-z 0-9 _ . - */
    uint16_t period_ms;
    uint8_t mcusr; /* why the board was reset: sum of PROTOCOL_RESET_... */
};

/* The distance at 20 degrees C in 0.1 mm, rounded half up; exact for every tick value up to PROTOCOL_MAX_TICKS. */
uint32_t ranger_tenths_at_20c(uint32_t ticks);

/* One more byte for a CRC-16/XMODEM that began with 0; what _crc_xmodem_update of avr-libc does. */
uint16_t ranger_crc(uint16_t crc, uint8_t byte);

/* Write one line. Returns its length; there is no terminating zero. */
uint8_t ranger_write_measurement(char out[RANGER_MEASUREMENT_MAX], const struct ranger_measurement *measurement);
uint8_t ranger_write_hello(char out[RANGER_HELLO_MAX], const struct ranger_hello *hello);

#ifdef __cplusplus
}
#endif
#endif
