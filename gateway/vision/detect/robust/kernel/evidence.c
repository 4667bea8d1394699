/* The evidence for candidates in one call: what `evidence.gather` does with some 300 calls of NumPy and OpenCV, and
 * `evidence.of_ellipses` with 100.
 *
 * One source is compiled twice, as the rim's: see `rim.c`. No allocation, no global state.
 */
#include "evidence.h"
#include "wide_registers.h"
#include "wide.h"

int64_t gateway_evidence_work(void) { return (int64_t)sizeof(EvidenceWork); }

void gateway_evidence(const Level *levels, int64_t level_count, EvidenceRow *rows, int64_t count, int64_t seeds,
                      const EvidenceTables *tables, EvidenceWork *work)
{
#if HAS_WIDE
    if (tables->fused && has_wide() && __builtin_cpu_supports("fma")) {
        gateway_evidence_wide(levels, level_count, rows, count, seeds, tables, work);
        return;
    }
    gathered_evidence(levels, level_count, rows, count, seeds, tables, 0, work);
#else
    gathered_evidence(levels, level_count, rows, count, seeds, tables, tables->fused != 0, work);
#endif
}
