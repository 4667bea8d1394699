// SPDX-License-Identifier: GPL-3.0-or-later
// Part of the firmware bench, a test program of its own that links simavr (GPL-3.0). See README.md beside this file.
#include "bench.h"

#define EVENTS 16
static struct { event_fn fn; uint64_t at; } events[EVENTS];
static uint64_t earliest = NEVER;

static void look(void) {
    earliest = NEVER;
    for (size_t i = 0; i < EVENTS; i++)
        if (events[i].fn && events[i].at < earliest) earliest = events[i].at;
}

void event_set(event_fn fn, uint64_t at) {
    size_t slot = EVENTS;
    for (size_t i = 0; i < EVENTS; i++)
        if (events[i].fn == fn || (!events[i].fn && slot == EVENTS)) slot = i;
    if (slot == EVENTS) return; // as many slots as there are functions: never full
    events[slot].fn = fn;
    events[slot].at = at;
    const uint64_t before = earliest;
    look();
    if (earliest < before) board_wake(earliest);
}

uint64_t event_next(void) { return earliest; }

void event_fire(uint64_t now) {
    if (earliest > now) return;
    for (size_t i = 0; i < EVENTS; i++) {
        if (!events[i].fn || events[i].at > now) continue;
        const uint64_t at = events[i].at;
        events[i].at = NEVER;
        events[i].fn(at);
    }
    look();
}
