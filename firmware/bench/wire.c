// SPDX-License-Identifier: GPL-3.0-or-later
// Part of the firmware bench, a test program of its own that links simavr (GPL-3.0). See README.md beside this file.
//
// A serial line as a voltage over time. The sender puts start bit, eight data bits (lowest first) and stop bit on it at
// its own pace; the receiver waits for a falling edge and samples the middle of each bit at its own. So a wrong baud
// rate makes the very garbage that it makes on copper.
#include "bench.h"

#define BITS 10

static wire_byte_t *at_index(wire_t *wire, size_t i) { return &wire->sent[(wire->first + i) % WIRE_BYTES]; }

double wire_send(wire_t *wire, uint64_t now, double bit, uint8_t value) {
    if (wire->count == WIRE_BYTES) return wire->free; // the caller looks at wire_waiting
    const double start = wire->free > (double)now ? wire->free : (double)now;
    wire->count++;
    *at_index(wire, wire->count - 1) = (wire_byte_t){.start = start, .bit = bit, .cut = NEVER, .value = value};
    wire->free = start + BITS * bit;
    return wire->free;
}

void wire_cut(wire_t *wire, uint64_t now) {
    for (size_t i = 0; i < wire->count; i++) {
        wire_byte_t *const byte = at_index(wire, i);
        if (byte->start + BITS * byte->bit > (double)now && byte->cut > now) byte->cut = now;
    }
    while (wire->count && at_index(wire, wire->count - 1)->start >= (double)now) wire->count--;
    if (wire->free > (double)now) wire->free = (double)now;
}

void wire_delay(wire_t *wire, uint64_t cycles) {
    for (size_t i = 0; i < wire->count; i++) {
        wire_byte_t *const byte = at_index(wire, i);
        byte->start += (double)cycles;
        if (byte->cut != NEVER) byte->cut += cycles;
    }
    wire->free += (double)cycles;
    wire->looked += (double)cycles;
}

size_t wire_waiting(const wire_t *wire, uint64_t now) {
    size_t waiting = 0;
    for (size_t i = wire->count; i-- > 0; waiting++)
        if (wire->sent[(wire->first + i) % WIRE_BYTES].start <= (double)now) break;
    return waiting;
}

// Bit `k` of a byte as it stands on the line; stop bit and everything after: high.
static bool bit_of(const wire_byte_t *byte, int k) {
    if (k < 1) return false;
    return k > 8 || (byte->value >> (k - 1) & 1);
}

static bool level(wire_t *wire, double t) {
    for (size_t i = 0; i < wire->count; i++) {
        const wire_byte_t *const byte = at_index(wire, i);
        if (t < byte->start) return true;
        if (t >= byte->start + BITS * byte->bit || t >= (double)byte->cut) continue;
        return bit_of(byte, (int)((t - byte->start) / byte->bit));
    }
    return true;
}

// The first falling edge from `from` on; below 0: none that is known yet.
static double falling_edge(wire_t *wire, double from) {
    for (size_t i = 0; i < wire->count; i++) {
        const wire_byte_t *const byte = at_index(wire, i);
        for (int k = 0; k < BITS; k++) {
            const double t = byte->start + k * byte->bit;
            if (t < from || t >= (double)byte->cut) continue;
            if (!bit_of(byte, k) && (k == 0 || bit_of(byte, k - 1))) return t;
        }
    }
    return -1.0;
}

void wire_run(wire_t *wire, uint64_t now, double bit) {
    for (;;) {
        const double edge = falling_edge(wire, wire->looked);
        if (edge < 0 || edge + (BITS - 0.5) * bit > (double)now) break;
        unsigned value = 0;
        for (int k = 1; k <= 8; k++) value |= (unsigned)level(wire, edge + (k + 0.5) * bit) << (k - 1);
        wire->looked = edge + (BITS - 0.5) * bit;
        if (!level(wire, edge + 0.5 * bit)) wire->heard(wire->looked, (uint8_t)value); // else: a spike, no start bit
    }
    while (wire->count) {
        const wire_byte_t *const oldest = at_index(wire, 0);
        const double end = oldest->start + BITS * oldest->bit;
        if (end > wire->looked && end + 2 * BITS * bit > (double)now) break;
        wire->first = (wire->first + 1) % WIRE_BYTES;
        wire->count--;
    }
}
