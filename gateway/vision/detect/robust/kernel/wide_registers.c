/* `rim.c`, `evidence.c` and `candidates.c` for AVX2 and fused multiplication and addition. */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(GATEWAY_NARROW)
#if defined(__clang__)
#pragma clang attribute push(__attribute__((target("avx2,fma"))), apply_to = function)
#else
#pragma GCC target("avx2,fma")
#endif
#include "blobs.h"
#include "evidence.h"
#include "levels.h"
#include "refined.h"
#include "votes.h"
#include "wide_registers.h"

int gateway_rim_wide(void *task, const void *tables, void *work) { return refined(task, tables, work, 1); }

double gateway_fall_wide(const void *task, const void *tables, void *work) { return fall(task, tables, work, 1); }

void gateway_evidence_wide(const void *levels, int64_t level_count, void *rows, int64_t count, int64_t seeds, const void *tables, void *work)
{
    gathered_evidence(levels, level_count, rows, count, seeds, tables, 1, work);
}

int gateway_votes_wide(void *task, void *work) { return voted(task, work); }

void gateway_blobs_wide(void *task, void *work) { found_blobs(task, work); }

void gateway_unveiled_wide(const void *task) { unveiled(task); }

#if defined(__clang__)
#pragma clang attribute pop
#endif
#else
typedef int nothing; /* a unit has to have something in it */
#endif
