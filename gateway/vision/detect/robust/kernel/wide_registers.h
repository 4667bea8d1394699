/* The robust method for wide registers: `wide_registers.c`. */
#ifndef GATEWAY_WIDE_REGISTERS_H
#define GATEWAY_WIDE_REGISTERS_H

#include <stdint.h>

int gateway_rim_wide(void *task, const void *tables, void *work);
double gateway_fall_wide(const void *task, const void *tables, void *work);
void gateway_evidence_wide(const void *levels, int64_t level_count, void *rows, int64_t count, int64_t seeds, const void *tables, void *work);
int gateway_votes_wide(void *task, void *work);
void gateway_blobs_wide(void *task, void *work);
void gateway_unveiled_wide(const void *task);

#endif
