#include <stdint.h>

#ifndef GATEWAY_SOURCE
#define GATEWAY_SOURCE 0
#endif

/* Checksum of all sources that this was built from: a stale library is told from a fresh one. */
uint32_t gateway_source(void) { return (uint32_t)GATEWAY_SOURCE; }
