// SPDX-License-Identifier: GPL-3.0-or-later
// Part of the firmware bench, a test program of its own that links simavr (GPL-3.0). See README.md beside this file.
//
// SplitMix64 (Steele, Lea, Flood 2014): small, and good enough to scatter a sensor.
#include <math.h>

#include "bench.h"

void rng_seed(rng_t *rng, uint64_t seed, uint64_t stream) {
    rng->state = seed * 0x9E3779B97F4A7C15u + stream * 0xD1342543DE82EF95u;
    (void)rng_next(rng);
}

uint64_t rng_next(rng_t *rng) {
    uint64_t z = (rng->state += 0x9E3779B97F4A7C15u);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

double rng_uniform(rng_t *rng) { return (double)(rng_next(rng) >> 11) * 0x1.0p-53; }

double rng_normal(rng_t *rng) {
    const double u = 1.0 - rng_uniform(rng), v = rng_uniform(rng);
    return sqrt(-2.0 * log(u)) * cos(6.283185307179586 * v);
}

uint32_t rng_below(rng_t *rng, uint32_t n) { return (uint32_t)(rng_uniform(rng) * n); }
