/* `rim.c` for AVX2 and fused multiplication and addition. */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(GATEWAY_NARROW)
#if defined(__clang__)
#pragma clang attribute push(__attribute__((target("avx2,fma"))), apply_to = function)
#else
#pragma GCC target("avx2,fma")
#endif
#include "refined.h"
#include "rim_wide.h"

int gateway_rim_wide(void *task, const void *tables, void *work) { return refined(task, tables, work, 1); }

#if defined(__clang__)
#pragma clang attribute pop
#endif
#else
typedef int nothing; /* a unit has to have something in it */
#endif
