/* The refinement for wide registers: `rim_wide.c`. */
#ifndef GATEWAY_RIM_WIDE_H
#define GATEWAY_RIM_WIDE_H

int gateway_rim_wide(void *task, const void *tables, void *work);

#endif
