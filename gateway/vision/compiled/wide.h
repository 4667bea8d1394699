/* Where 32 bytes can be dealt with at once, and whether this processor can. */
#ifndef GATEWAY_WIDE_H
#define GATEWAY_WIDE_H

#include <stdint.h>

#if defined(__x86_64__) && defined(__GNUC__) && !defined(GATEWAY_NARROW)
#include <immintrin.h>
#define HAS_WIDE 1
#define WIDE __attribute__((target("avx2")))

enum { WIDE_BYTES = 32 };

static inline int has_wide(void) { return __builtin_cpu_supports("avx2"); }

WIDE static inline __m256i bytes(const uint8_t *p) { return _mm256_loadu_si256((const __m256i *)(const void *)p); }
#else
#define HAS_WIDE 0
#endif

#endif
