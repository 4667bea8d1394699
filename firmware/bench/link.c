// SPDX-License-Identifier: GPL-3.0-or-later
// Part of the firmware bench, a test program of its own that links simavr (GPL-3.0). See README.md beside this file.
//
// Between the UART and the host: down (board to host) and up, each a wire with a sender and a receiver of its own baud
// rate; behind the down wire the damage of a bad cable.
#include <string.h>

#include "bench.h"

#define LINE 80u

static void heard_down(double at, uint8_t value);
static void heard_up(double at, uint8_t value);
static wire_t down = {.heard = heard_down}, up = {.heard = heard_up};

static rng_t draws;
static double noise_share, port_baud = 9600.0, forced_baud;
static uint64_t burst_until, burst_next;
static bool muted;
static int fake_version = -1;

static uint8_t line[LINE]; // what the UART sends, since the last line feed
static size_t line_size;
static bool keeps;         // the line is kept back until its end: it may be a hello to rewrite

void link_seed(uint64_t seed) { rng_seed(&draws, seed, 3); }
void link_noise(double share) { noise_share = share; }
void link_mute(bool on) { muted = on; }
void link_version(int version) { fake_version = version; }
void link_host_baud(double baud) { forced_baud = baud; }
void link_baud(double baud) { port_baud = baud; }

void link_burst(uint64_t until) {
    burst_next = board_now();
    burst_until = until;
}

static double host_bit(void) { return CPU_HZ / (forced_baud > 0 ? forced_baud : port_baud); }

static uint16_t crc_xmodem(const uint8_t *data, size_t size) {
    uint16_t crc = 0;
    for (size_t i = 0; i < size; i++) {
        crc = (uint16_t)(crc ^ (data[i] << 8));
        for (int k = 0; k < 8; k++) crc = (uint16_t)(crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1);
    }
    return crc;
}

// "$HCI,name,1,60,2*CRC" becomes "$HCI,name,VERSION,60,2*CRC": another firmware, as far as the host can tell.
static size_t rewritten(uint8_t *out) {
    const uint8_t *const name = line + 5, *const end = line + line_size;
    const uint8_t *const comma = memchr(name, ',', (size_t)(end - name));
    const uint8_t *const rest = comma ? memchr(comma + 1, ',', (size_t)(end - comma - 1)) : NULL;
    const uint8_t *const star = rest ? memchr(rest, '*', (size_t)(end - rest)) : NULL;
    if (!star) {
        memcpy(out, line, line_size);
        return line_size;
    }
    const int size = snprintf((char *)out, LINE, "%.*s%d%.*s", (int)(comma + 1 - line), (const char *)line, fake_version,
                              (int)(star - rest), (const char *)rest);
    const int checksum = snprintf((char *)out + size, LINE - (size_t)size, "*%04X\r\n",
                                  crc_xmodem(out + 1, (size_t)size - 1));
    return (size_t)size + (size_t)checksum;
}

static void put(const uint8_t *data, size_t size) {
    for (size_t i = 0; i < size; i++) {
        const double end = wire_send(&down, board_now(), board_bit_cycles(), data[i]);
        if (data[i] == '\n') truth_line((uint64_t)end, line, line_size);
    }
}

void link_sent(uint8_t value) {
    if (line_size < LINE - 16) line[line_size++] = value; // room for a longer version
    static const char hello[] = "$HCI,";
    const bool may_be_hello = fake_version >= 0 && !memcmp(line, hello, line_size < 5 ? line_size : 5);
    if (may_be_hello && value != '\n' && line_size < LINE - 16) {
        keeps = true;
        return;
    }
    if (may_be_hello && keeps && line_size > 5) {
        uint8_t out[LINE];
        const size_t size = rewritten(out);
        memcpy(line, out, size);
        line_size = size;
    }
    if (keeps) put(line, line_size);
    else put(&value, 1);
    keeps = false;
    if (value == '\n') line_size = 0;
}

void link_silence(void) {
    wire_cut(&down, board_now());
    line_size = 0;
    keeps = false;
}

static int renewed = -1;
static unsigned band[2];

void link_renew(int output, unsigned nearest, unsigned farthest) {
    renewed = output;
    band[0] = nearest, band[1] = farthest;
}

// The host's reply to a line: the relay command with its number.
static void reply(uint8_t value) {
    static char heard[LINE];
    static size_t size;
    if (value == '$') size = 0;
    if (size < LINE - 1) heard[size++] = (char)value;
    if (value != '\n' || renewed < 0) return;
    heard[size] = 0;
    unsigned seq = 0;
    char run[5] = "0000", out[LINE], *const field = strstr(heard, ",r");
    if (sscanf(heard, "$HCM,%u,", &seq) != 1) return;
    if (field) memcpy(run, field + 2, 4);
    int length = snprintf(out, LINE, "$HCR,%s,%u,%d,%u,%u", run, seq, field ? renewed : 0, band[0], band[1]);
    const unsigned crc = crc_xmodem((const uint8_t *)out + 1, (size_t)length - 1);
    length += snprintf(out + length, LINE - (size_t)length, "*%04X\r\n", crc);
    link_host((const uint8_t *)out, (size_t)length);
}

static void deliver(uint8_t value) {
    if (muted) return;
    port_write(&value, 1);
    reply(value);
}

// The same mixture as the simulated ranger's: a bit flipped, a byte made up, a byte lost.
static void heard_down(double at, uint8_t value) {
    if ((uint64_t)at < burst_until) return;
    if (noise_share <= 0 || rng_uniform(&draws) >= noise_share) {
        deliver(value);
        return;
    }
    const uint32_t kind = rng_below(&draws, 3);
    if (kind == 0) {
        deliver((uint8_t)(value ^ 1u << rng_below(&draws, 8)));
    } else if (kind == 1) {
        deliver(value);
        deliver((uint8_t)rng_below(&draws, 256));
    }
}

static void heard_up(double at, uint8_t value) {
    (void)at;
    if (muted) return;
    truth(board_now(), "heard", ", \"byte\": %d", value);
    board_hear(value);
}

size_t link_room(void) {
    const size_t waiting = wire_waiting(&up, board_now());
    return waiting < 64 ? 64 - waiting : 0; // the USB bridge's buffer; the host waits for it
}

void link_host(const uint8_t *data, size_t size) {
    for (size_t i = 0; i < size; i++)
        (void)wire_send(&up, board_now(), host_bit(), data[i]);
}

void link_delay(uint64_t cycles) { wire_delay(&up, cycles); }

void link_run(uint64_t now) {
    wire_run(&down, now, host_bit());
    wire_run(&up, now, board_bit_cycles());
    while (burst_next < burst_until && burst_next <= now) { // a burst: bytes of nothing, back to back
        deliver((uint8_t)rng_below(&draws, 256));
        burst_next += (uint64_t)(10.0 * host_bit());
    }
}
