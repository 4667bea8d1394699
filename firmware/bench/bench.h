// SPDX-License-Identifier: GPL-3.0-or-later
// Part of the firmware bench, a test program of its own that links simavr (GPL-3.0). See README.md beside this file.
//
// What the bench's parts know of each other. All times are cycles of the 16 MHz clock since the bench began, also while
// the board has no power or is held in reset: "now" never stands still because the processor does.
#ifndef BENCH_H
#define BENCH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#define CPU_HZ 16000000u
#define CYCLES_PER_US (CPU_HZ / 1000000u)
#define CYCLES_PER_MS (CPU_HZ / 1000u)
#define NEVER UINT64_MAX

enum { POWER_ON = 1, RESET_LINE = 2, BROWN_OUT = 4, WATCHDOG = 8 }; // MCUSR

static inline uint64_t cycles_of_ms(double ms) { return ms <= 0 ? 0 : (uint64_t)(ms * CYCLES_PER_MS + 0.5); }
static inline uint64_t ns_of(uint64_t cycles) { return cycles * 125u / 2u; }

// -- random.c: seeded, one stream per user, so that one fault does not change what another one draws
typedef struct { uint64_t state; } rng_t;
void rng_seed(rng_t *rng, uint64_t seed, uint64_t stream);
uint64_t rng_next(rng_t *rng);
double rng_uniform(rng_t *rng);            // [0, 1)
double rng_normal(rng_t *rng);             // mean 0, standard deviation 1
uint32_t rng_below(rng_t *rng, uint32_t n); // 0 to n - 1

// -- truth.c: what was played, one JSON object a line
uint64_t monotonic_ns(void); // the machine's time, whatever the board's pace
bool truth_open(const char *path, bool with_real_time);
void truth_close(void);
void truth(uint64_t at, const char *type, const char *format, ...) __attribute__((format(printf, 3, 4)));
void truth_line(uint64_t at, const uint8_t *line, size_t size);

// The LED on D6, of which truth.c also keeps the newest changes for the simulated camera (gateway/sim/led.py).
#define LED_CYCLES 256u
bool led_open(const char *path, uint64_t zero_ns); // zero_ns: the host's clock at the board's time 0
void led_close(const char *path);                  // the file is removed
void led_is(uint64_t at, bool lit);

// -- board.c: the Uno
typedef struct {
    const char *elf, *bootloader; // bootloader: an Intel hex file, or NULL: the sketch starts at once
    double boot_ms;               // after power on and reset: the processor does nothing for this time
    uint64_t seed;
} board_options_t;
bool board_open(const board_options_t *options);
void board_close(void);
uint64_t board_now(void);
void board_run(uint64_t until);            // processor, sensor and wires
void board_wake(uint64_t at);              // the processor is to be interrupted then, if it runs
void board_skip(uint64_t until);           // time passes, the processor does not run
void board_power(bool on);
bool board_powered(void);
void board_reset(void);                    // the reset line, pulled once
void board_hold(bool on);                  // the reset button, held down
void board_hang(bool interrupts);          // runs away, interrupts served or not: only the watchdog can help
void board_echo(bool high);                // drives PB0
void board_wire(bool high);                // drives PD2, as long as the board does not hold it low
void board_adc(double millivolt);          // drives ADC0
void board_hear(uint8_t byte);             // the byte that the UART's receiver made of the line
double board_bit_cycles(void);             // of the UART's baud rate as the firmware set it
const char *board_crashed(void);           // NULL: runs

// -- events.c: what is to happen at a cycle
typedef void (*event_fn)(uint64_t at);
void event_set(event_fn fn, uint64_t at);  // one pending call per function; NEVER cancels
uint64_t event_next(void);
void event_fire(uint64_t now);             // everything that is due

// -- sensor.c: the HC-SR04
typedef enum { SENSOR_OK, SENSOR_NO_ECHO, SENSOR_DEAD, SENSOR_STUCK, SENSOR_AT } sensor_mode_t;
typedef struct {
    sensor_mode_t mode;
    double at_mm;                          // SENSOR_AT: it says this, whatever is there
    double jitter_mm, step_mm, dropout;
    double air_c;
    double wild_mm;                        // every other reading; 0: off
    double ghost_mm, ghost_share;          // an echo of something else
    double spike_us, spike_share;          // a short pulse on ECHO before the real one
    double no_echo_ms;                     // ECHO's width when nothing came back; 0: stays high until the next power cut
} sensor_t;
extern sensor_t sensor;
void sensor_seed(uint64_t seed);
void sensor_trig(bool high);               // from the board's pin
void sensor_power(bool on);
void sensor_mode(sensor_mode_t mode, double at_mm);
bool sensor_busy(void);                    // from the trigger until ECHO fell
void sensor_restarted(void);               // the count of triggers begins anew, as the firmware's does
void sensor_distance(double mm);           // from now on; below 0: nothing in the beam
bool sensor_track(uint64_t at, double mm); // a point of a polyline in time; false: not later than the point before

// -- ds18b20.c: the thermometer
typedef enum { DS18B20_NONE, DS18B20_OK, DS18B20_CRC, DS18B20_SHORT } ds18b20_mode_t; // SHORT: its line is held low
typedef struct { ds18b20_mode_t mode; double c; } ds18b20_t;
extern ds18b20_t ds18b20;
void ds18b20_set(ds18b20_mode_t mode, double c);
void ds18b20_wire(bool held_low);          // by the board
void ds18b20_power(bool on);

// -- wire.c: a serial line, bit by bit: what one end sends at its baud rate, the other end samples at its own
#define WIRE_BYTES 1024u
typedef struct { double start, bit; uint64_t cut; uint8_t value; } wire_byte_t;
typedef struct {
    wire_byte_t sent[WIRE_BYTES];          // ring; [first, first + count)
    size_t first, count;
    double free;                           // when the last stop bit ends
    double looked;                         // the receiver has seen everything up to here
    void (*heard)(double at, uint8_t value);
} wire_t;
double wire_send(wire_t *wire, uint64_t now, double bit, uint8_t value); // when its stop bit ends
void wire_run(wire_t *wire, uint64_t now, double bit);                   // the receiver, up to now
void wire_cut(wire_t *wire, uint64_t now);                               // the sender lets go of the line
void wire_delay(wire_t *wire, uint64_t cycles);                          // all that is on it comes so much later
size_t wire_waiting(const wire_t *wire, uint64_t now);                   // bytes not yet begun

// -- link.c: between the UART and the host: both wires, damage, the cable
void link_seed(uint64_t seed);
void link_sent(uint8_t value);             // the UART's transmitter was given a byte
void link_silence(void);                   // reset or power cut in the middle of a byte
void link_run(uint64_t now);
void link_delay(uint64_t cycles);          // the processor stood still: the host's bytes wait for it
size_t link_room(void);                     // bytes that the host may send now
void link_host(const uint8_t *data, size_t size); // what the host says
void link_renew(int output, unsigned nearest, unsigned farthest); // reply to each line as the gateway does; below 0: not
void link_noise(double share);
void link_burst(uint64_t until);
void link_mute(bool on);
void link_version(int version);            // hellos leave with another protocol version; below 0: as they are
void link_host_baud(double baud);          // 0: as the host has set the port
void link_baud(double baud);               // the port's setting

// -- port.c: the pty
typedef struct { const char *path; bool dtr, own_folder; FILE *capture; } port_options_t;
bool port_open(const port_options_t *options);
void port_close(void);
void port_plug(bool in);                   // the cable, which is the board's power too
bool port_plugged(void);
bool port_opened(void);
void port_poll(void);                      // opened, closed, what the host says
void port_write(const uint8_t *data, size_t size);
extern uint64_t port_dropped;              // bytes that nobody was there to read

// -- commands.c
extern const char COMMANDS_HELP[];
bool command_file(const char *path);
bool command_line(const char *line);       // false: not understood; says why on stderr
uint64_t command_next(void);
void command_fire(uint64_t now);
extern bool quit;

#endif
