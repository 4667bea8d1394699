// SPDX-License-Identifier: GPL-3.0-or-later
// Part of the firmware bench, a test program of its own that links simavr (GPL-3.0). See README.md beside this file.
//
// The DS18B20 on D2, at the limits of its data sheet: a slot that is too short, too long or too soon is not understood,
// and is written down as the truth. It knows SKIP ROM, CONVERT T and READ SCRATCHPAD, which is what the firmware uses.
#include <math.h>
#include <string.h>

#include "bench.h"

#define PAD 9u
enum { SKIP_ROM = 0xCC, CONVERT = 0x44, READ = 0xBE };
enum { RESET_US = 480, PRESENCE_AFTER_US = 30, PRESENCE_US = 120, ONE_US = 15, ZERO_US = 60, LONGEST_US = 120, SAYS_US = 30 };
#define CONVERT_MS 750u

ds18b20_t ds18b20;

static bool holds, low;               // the line, by the sensor; by the board
static uint64_t fell, rose;           // by the board
static uint64_t converted = NEVER;    // a conversion that runs ends
static uint8_t pad[PAD], command, bit; // bit: of the command, or of the pad
static enum { IDLE, ROM, FUNCTION, SAYS } state;

static uint8_t crc8(const uint8_t *data, size_t size) {
    uint8_t crc = 0;
    for (size_t i = 0; i < size; i++) {
        crc ^= data[i];
        for (int k = 0; k < 8; k++) crc = (uint8_t)(crc & 1 ? crc >> 1 ^ 0x8C : crc >> 1);
    }
    return crc;
}

static void fill(double c) {
    const int raw = (int)lround(c * 16);
    const uint8_t rest[] = {0x4B, 0x46, 0x7F, 0xFF, 0x0C, 0x10};
    pad[0] = (uint8_t)raw, pad[1] = (uint8_t)(raw >> 8);
    memcpy(pad + 2, rest, sizeof rest);
    pad[8] = crc8(pad, 8);
}

static void drive(void) { board_wire(ds18b20.mode != DS18B20_SHORT && !holds); }

void ds18b20_set(ds18b20_mode_t mode, double c) {
    if (mode == DS18B20_NONE || ds18b20.mode == DS18B20_NONE) fill(85), converted = NEVER, state = IDLE; // its power on
    ds18b20.mode = mode;
    ds18b20.c = c;
    holds = false;
    drive();
}

static void let_go(uint64_t at) {
    (void)at;
    holds = false;
    drive();
}

static void present(uint64_t at) {
    holds = true;
    drive();
    event_set(let_go, at + PRESENCE_US * CYCLES_PER_US);
}

static void wrong(uint64_t now, double us, const char *what) {
    truth(now, "wire", ", \"us\": %.2f, \"wrong\": \"%s\"", us, what);
    state = IDLE;
}

static void heard(uint64_t now, bool one) {
    command = (uint8_t)(command >> 1 | (one ? 0x80 : 0));
    if (++bit < 8) return;
    bit = 0;
    const uint8_t whole = command;
    if (state == ROM) {
        state = whole == SKIP_ROM ? FUNCTION : IDLE;
    } else {
        state = whole == READ ? SAYS : IDLE;
        if (whole == CONVERT) converted = now + CONVERT_MS * CYCLES_PER_MS;
        else if (converted <= now) fill(ds18b20.c), converted = NEVER;
        truth(now, "wire", ", \"command\": %u", whole);
    }
}

static void on_fall(uint64_t now) {
    const double since_us = (double)(now - fell) / CYCLES_PER_US;
    if (state != IDLE && (since_us < ZERO_US + 1 || now - rose < CYCLES_PER_US)) wrong(now, since_us, "too soon");
    fell = now;
    if (state != SAYS || bit >= 8 * PAD) return;
    const uint8_t flipped = ds18b20.mode == DS18B20_CRC && bit / 8 == PAD - 1 ? 1 : 0;
    if ((pad[bit / 8] ^ flipped) >> bit % 8 & 1) return;
    holds = true;
    drive();
    event_set(let_go, now + SAYS_US * CYCLES_PER_US);
}

static void on_rise(uint64_t now) {
    const double us = (double)(now - fell) / CYCLES_PER_US;
    rose = now;
    if (us >= RESET_US) {
        state = ROM, command = bit = 0;
        truth(now, "wire", ", \"reset_us\": %.2f", us);
        event_set(present, now + PRESENCE_AFTER_US * CYCLES_PER_US);
    } else if (state != IDLE && (us < 1 || (us >= ONE_US && us < ZERO_US) || us > LONGEST_US)) {
        wrong(now, us, "length");
    } else if (state == SAYS) {
        if (us < ONE_US) bit++;
        else wrong(now, us, "not a read slot");
    } else if (state != IDLE) {
        heard(now, us < ONE_US);
    }
}

void ds18b20_wire(bool held_low) {
    if (held_low == low) return;
    low = held_low;
    if (low && sensor_busy()) truth(board_now(), "wire", ", \"wrong\": \"an echo is timed\"");
    if (ds18b20.mode == DS18B20_NONE || ds18b20.mode == DS18B20_SHORT) return;
    (low ? on_fall : on_rise)(board_now());
}

void ds18b20_power(bool on) {
    if (on) fill(85);
    converted = NEVER, state = IDLE, low = holds = false;
    drive();
}
