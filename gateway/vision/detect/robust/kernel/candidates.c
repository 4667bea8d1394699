/* Where a red disc might be: the loops of `candidates.py` over pixels, edges and cells; whether the air is clear, what
 * else is red, and smaller and clearer pictures. */
#include "blobs.h"
#include "bilinear.h"
#include "clear_air.h"
#include "levels.h"
#include "regions.h"
#include "votes.h"
#include "wide.h"
#include "wide_registers.h"

int64_t gateway_vote_room(const VoteTask *task) { return vote_room(task); }
int64_t gateway_blob_room(const BlobTask *task) { return blob_room(task); }

int gateway_votes(VoteTask *task, void *work)
{
#if HAS_WIDE
    if (has_wide() && __builtin_cpu_supports("fma"))
        return gateway_votes_wide(task, work);
#endif
    return voted(task, work);
}

void gateway_blobs(BlobTask *task, void *work)
{
#if HAS_WIDE
    if (has_wide() && __builtin_cpu_supports("fma")) {
        gateway_blobs_wide(task, work);
        return;
    }
#endif
    found_blobs(task, work);
}

/* `redness.redness` of a picture, (height, width). */
void gateway_redness(const Picture *picture, const float *log, float *red)
{
    for (int64_t y = 0; y < picture->height; y++) {
        const uint8_t *from = picture->pixels + y * picture->stride;
        for (int64_t x = 0; x < picture->width; x++)
            *red++ = log[from[3 * x + 2]] - log[from[3 * x + 1]];
    }
}

void gateway_halved(const Picture *picture, uint8_t *out) { halved(picture, out); }

void gateway_reduced(const Picture *picture, int64_t by, uint16_t *sums, uint8_t *out) { reduced(picture, by, sums, out); }

void gateway_unveiled(const Unveiling *task)
{
#if HAS_WIDE
    if (has_wide() && __builtin_cpu_supports("fma")) {
        gateway_unveiled_wide(task);
        return;
    }
#endif
    unveiled(task);
}

int gateway_air_is_clear(const Sparse *picture) { return air_is_clear(picture); }

int64_t gateway_region_room(const RegionTask *task) { return region_room(task); }

int64_t gateway_red_regions(RegionTask *task, void *work) { return red_regions(task, work); }
