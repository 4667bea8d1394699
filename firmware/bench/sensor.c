// SPDX-License-Identifier: GPL-3.0-or-later
// Part of the firmware bench, a test program of its own that links simavr (GPL-3.0). See README.md beside this file.
//
// The HC-SR04. The module answers a trigger of at least 10 us: 450 us later ECHO rises, and it falls when the sound is
// back. While a measurement runs, further triggers are not heard. What it played is written down as the truth.
#include <math.h>
#include <string.h>

#include "bench.h"

#define BURST_US 450.0
#define SHORTEST_TRIGGER_US 10.0
#define STRAY_LIMIT 4.0 // in standard deviations: a module does not stray without bound
#define POINTS 4096u

sensor_t sensor = {.air_c = 20.0, .no_echo_ms = 38.0};

static rng_t draws;
static bool has_power, trig_high, busy, echo_is_high;
static uint64_t trig_rose, triggered, rose;
static unsigned number;
static double played_mm, true_mm;
static uint64_t pulse; // of the measurement that runs, cycles; NEVER: until further notice

static struct { uint64_t at; double mm; } points[POINTS];
static size_t first_point, point_count;

static void on_rise(uint64_t at);
static void on_fall(uint64_t at);
static void on_spike(uint64_t at);
static void on_spike_end(uint64_t at);

void sensor_seed(uint64_t seed) { rng_seed(&draws, seed, 2); }
bool sensor_busy(void) { return busy; }
void sensor_restarted(void) { number = 0; }

void sensor_distance(double mm) {
    first_point = 0;
    point_count = 1;
    points[0].at = 0;
    points[0].mm = mm;
}

bool sensor_track(uint64_t at, double mm) {
    if (point_count && points[(first_point + point_count - 1) % POINTS].at >= at) return false;
    if (point_count == POINTS) {
        first_point = (first_point + 1) % POINTS;
        point_count--;
    }
    points[(first_point + point_count) % POINTS].at = at;
    points[(first_point + point_count) % POINTS].mm = mm;
    point_count++;
    return true;
}

// The commanded distance, between two points in a straight line; before the first and after the last point it stands.
static double distance_at(uint64_t at) {
    if (!point_count) return -1.0;
    while (point_count > 1 && points[(first_point + 1) % POINTS].at + CYCLES_PER_MS * 100u <= at) {
        first_point = (first_point + 1) % POINTS; // 0.1 s stay, for who looks back
        point_count--;
    }
    for (size_t i = point_count; i-- > 0;) {
        const size_t a = (first_point + i) % POINTS, b = (a + 1) % POINTS;
        if (points[a].at > at && i > 0) continue;
        if (points[a].at > at || i + 1 == point_count || points[a].mm < 0 || points[b].mm < 0) return points[a].mm;
        const double share = (double)(at - points[a].at) / (double)(points[b].at - points[a].at);
        return points[a].mm + share * (points[b].mm - points[a].mm);
    }
    return -1.0;
}

static double flight_cycles(double mm) { return mm * 2e-3 / (331.3 + 0.606 * sensor.air_c) * CPU_HZ; }

// What the module makes of the distance. Draws the same number of random values whatever comes out.
static double measured(uint64_t at) {
    const bool lost = rng_uniform(&draws) < sensor.dropout, ghost = rng_uniform(&draws) < sensor.ghost_share;
    const double stray = fmax(-STRAY_LIMIT, fmin(STRAY_LIMIT, rng_normal(&draws)));
    true_mm = distance_at(at);
    if (true_mm >= 0) true_mm = distance_at(at + (uint64_t)(BURST_US * CYCLES_PER_US + flight_cycles(true_mm) / 2));
    if (sensor.mode == SENSOR_NO_ECHO) return -1.0;
    if (sensor.mode == SENSOR_AT) return sensor.at_mm;
    if (sensor.wild_mm > 0 && number % 2) return sensor.wild_mm;
    if (ghost) return sensor.ghost_mm;
    if (true_mm < 0 || lost) return -1.0;
    double mm = fmax(0.0, true_mm + stray * sensor.jitter_mm);
    if (sensor.step_mm > 0) mm = round(mm / sensor.step_mm) * sensor.step_mm;
    return mm;
}

static void drive(bool high) {
    echo_is_high = high;
    board_echo(high);
}

static void trigger(uint64_t at) {
    played_mm = measured(at);
    triggered = at;
    busy = true;
    pulse = NEVER;
    if (played_mm >= 0) pulse = (uint64_t)(flight_cycles(played_mm) + 0.5);
    else if (sensor.no_echo_ms > 0) pulse = cycles_of_ms(sensor.no_echo_ms);
    const bool spike = rng_uniform(&draws) < sensor.spike_share;
    if (spike) event_set(on_spike, at + 100 * CYCLES_PER_US);
    event_set(on_rise, at + (uint64_t)(BURST_US * CYCLES_PER_US));
}

void sensor_trig(bool high) {
    const uint64_t now = board_now();
    if (high == trig_high) return;
    trig_high = high;
    if (high) {
        trig_rose = now;
        return;
    }
    if (!has_power) return;
    const double us = (double)(now - trig_rose) / CYCLES_PER_US;
    const char *ignored = NULL;
    if (us < SHORTEST_TRIGGER_US) ignored = "short";
    else if (sensor.mode == SENSOR_DEAD) ignored = "dead";
    else if (sensor.mode == SENSOR_STUCK || echo_is_high || busy) ignored = "busy";
    if (ignored) {
        truth(now, "trigger", ", \"n\": %u, \"us\": %.2f, \"ignored\": \"%s\"", number, us, ignored);
    } else {
        trigger(now);
        truth(now, "trigger", ", \"n\": %u, \"us\": %.2f, \"true_mm\": %.4f, \"played_mm\": %.4f", number, us, true_mm,
              played_mm);
    }
    number++;
}

static void on_spike(uint64_t at) {
    drive(true);
    event_set(on_spike_end, at + (uint64_t)(sensor.spike_us * CYCLES_PER_US));
}

static void on_spike_end(uint64_t at) {
    (void)at;
    if (sensor.mode != SENSOR_STUCK) drive(false);
}

static void on_rise(uint64_t at) {
    (void)at;
    if (!busy) return;
    rose = board_now();
    drive(true);
    if (pulse != NEVER) event_set(on_fall, rose + pulse);
}

static void on_fall(uint64_t at) {
    (void)at;
    const uint64_t now = board_now();
    if (!busy || sensor.mode == SENSOR_STUCK) return;
    busy = false;
    drive(false);
    truth(now, "echo", ", \"trigger_ns\": %llu, \"ticks\": %.2f, \"played_mm\": %.4f",
          (unsigned long long)ns_of(triggered), (double)(now - rose) / 8.0, played_mm);
}

static void idle(void) {
    busy = false;
    event_set(on_rise, NEVER);
    event_set(on_fall, NEVER);
    event_set(on_spike, NEVER);
    event_set(on_spike_end, NEVER);
}

void sensor_mode(sensor_mode_t mode, double at_mm) {
    const sensor_mode_t before = sensor.mode;
    sensor.mode = mode;
    sensor.at_mm = at_mm;
    if (mode == before || !has_power) return;
    if (mode == SENSOR_STUCK || mode == SENSOR_DEAD || before == SENSOR_STUCK) {
        idle();
        drive(mode == SENSOR_STUCK);
    }
}

void sensor_power(bool on) {
    has_power = on;
    trig_high = false;
    idle();
    drive(on && sensor.mode == SENSOR_STUCK);
}
