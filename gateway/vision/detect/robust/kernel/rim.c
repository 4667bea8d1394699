/* The refinement of a rim in one call: what `refinement.refine_plain` does with some 250 calls of NumPy and OpenCV.
 *
 * Same steps, same constants, double precision throughout but for the samples, which are OpenCV's to the last bit. One
 * source is compiled twice: here for all processors, in `wide_registers.c` for those with wide registers and fused
 * multiplication and addition. Only the samples are rounded differently by the two, as OpenCV's are; where `fused` is the
 * same, so is every bit.
 *
 * No allocation, no global state: the caller gives all memory, and the tables, which Python computes once.
 */
#include "refined.h"
#include "wide_registers.h"
#include "wide.h"

int64_t gateway_rim_work(void) { return (int64_t)sizeof(Work); }

/* NONE, FOUND, or NO_PROFILE: to be called again with the missing one among the tables. */
int gateway_rim(Task *task, const Tables *tables, Work *work)
{
#if HAS_WIDE
    if (tables->fused && has_wide() && __builtin_cpu_supports("fma")) /* OpenCV fuses where it has wide registers */
        return gateway_rim_wide(task, tables, work);
    return refined(task, tables, work, 0);
#else
    return refined(task, tables, work, tables->fused != 0);
#endif
}

/* `refinement.fall_plain` of the task's outline, its reach `search_px`. */
double gateway_fall(const Task *task, const Tables *tables, Work *work)
{
#if HAS_WIDE
    if (tables->fused && has_wide() && __builtin_cpu_supports("fma"))
        return gateway_fall_wide(task, tables, work);
    return fall(task, tables, work, 0);
#else
    return fall(task, tables, work, tables->fused != 0);
#endif
}
