/* What the ranger needs of an Arduino Uno (ATmega328P, 16 MHz). All globals of the firmware live behind this header.
 *
 *     TRIG  D7 (PD7)          any output
 *     ECHO  D8 (PB0, ICP1)    Timer1 copies its count into ICR1 in the cycle in which the pin changes
 *     LED   D13 (PB5)         the Uno's own
 *     D2    DS18B20, optional: an open drain, pulled up weakly
 *     A0    TMP36 instead, optional
 *     D6    LED of the beacon (PD6), optional: an input until the host asks for it
 *     D4    relay "in place" (PD4), D5 relay "may move" (PD5), optional: inputs until the host asks for them
 *
 * Timer1 counts 0.5 us. The UART is interrupt-driven on both sides and never waits. Do not use Serial, pulseIn, Servo
 * or Tone beside it: they want the same hardware. Timer0, and with it millis(), is the Arduino core's and free. */
#ifndef BOARD_UNO_H
#define BOARD_UNO_H

#include "ds18b20.h"
#include "ranger.h"

#ifdef __cplusplus
extern "C" {
#endif

extern const struct ranger_board board_uno;
/* A 0 is low for 65 us and longer with interrupts on; in a 1 they are off for 13 us. */
extern const struct ds18b20_wire board_wire;

/* Take the hardware and start the watchdog (0.25 s). */
void board_begin(void);

/* Why the board was reset, as in MCUSR. The boot loader of the Uno clears MCUSR before a sketch can read it; then it is
 * told from memory that survives a reset: 8 if the firmware had hung (with interrupts on), 2 if it had been running, 1 if
 * it had not. */
uint8_t board_reset_cause(void);

/* Another number after each reset. */
uint16_t board_seed(void);

/* Time since board_begin in 0.5 us ticks. Wraps. */
uint32_t board_now(void);

/* The next captured edge of ECHO. False: there is none. */
bool board_edge(uint32_t *ticks, bool *is_high);
bool board_echo_is_high(void);

/* The next byte from the host. False: there is none. */
bool board_received(uint8_t *byte);

/* The relay's pins that are high, read back, as a sum of enum relay_output. */
uint8_t board_relay_pins(void);
/* Make them outputs, with this one high and the other low. */
void board_relay(uint8_t output);

void board_light(bool on);
/* Make D6 an output, and switch it. */
void board_beacon(bool on);
void board_feed_watchdog(void);

/* Sampling A0 against the internal reference, one sample a call. True: `sum_of_64` is complete. */
bool board_sample_a0(uint16_t *sum_of_64);

#ifdef __cplusplus
}
#endif
#endif
