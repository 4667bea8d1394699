/* Whether red ends all round a disc once more, farther out: `rings.red_ends_plain`. */
#ifndef GATEWAY_OUTWARDS_H
#define GATEWAY_OUTWARDS_H

#include "ring_samples.h"

enum { MOST_OUTWARDS = 72 }; /* samples on a ray */

typedef struct {
    float red[MOST_OUTWARDS * RADIAL];
    uint8_t seen[MOST_OUTWARDS * RADIAL];
    double values[MOST_OUTWARDS * RADIAL], room[2 * MOST_OUTWARDS * RADIAL];
} Outwards;

/* Those with a mark, or all; how many. */
INLINE int outwards_values(const float *values, const uint8_t *mark, int count, double *out)
{
    int n = 0;
    for (int i = 0; i < count; i++) {
        out[n] = (double)values[i];
        n += !mark || mark[i];
    }
    return n;
}

/* The value at place k, and the next larger one. */
INLINE void two_in_order(const float *values, const uint8_t *mark, int count, int k, Outwards *w, float *low, float *high)
{
    int n = outwards_values(values, mark, count, w->values);
    *low = (float)nth(w->values, n, k, w->room);
    n = outwards_values(values, mark, count, w->values);
    *high = (float)nth(w->values, n, k + 1 < n ? k + 1 : k, w->room);
}

static int red_ends(const Picture *p, const Shape *shape, const EvidenceTables *t, int fused, RingSamples *r, Outwards *w)
{
    int count = (int)t->outwards_count, core = (int)t->core, beyond = (count - core) * RADIAL, all = 0;
    int reds[MOST_OUTWARDS], counts[MOST_OUTWARDS];
    double share[MOST_OUTWARDS];
    for (int s = 0; s < count; s += MOST_SHARES) {
        int some = count - s < MOST_SHARES ? count - s : MOST_SHARES;
        sampled_rings(p, shape, t->outwards + s, some, t, fused, r);
        memcpy(w->red + s * RADIAL, r->red, (size_t)some * sizeof r->red[0]);
        memcpy(w->seen + s * RADIAL, r->seen, (size_t)some * sizeof r->seen[0]);
    }
    const float *red = w->red + core * RADIAL;
    const uint8_t *seen = w->seen + core * RADIAL;
    for (int i = 0; i < beyond; i++)
        all += seen[i];
    if (!all)
        return 0;
    float low, high;
    two_in_order(w->red, NULL, core * RADIAL, core * RADIAL / 2 - 1, w, &low, &high); /* an even number */
    double inner = (double)((low + high) / 2);
    float at = (float)(all - 1) * (float)GROUND; /* NumPy's quantile, in single precision */
    int k = (int)at;
    float part = at - (float)k;
    two_in_order(red, seen, beyond, k, w, &low, &high);
    float apart = high - low, ground = part < 0.5f ? low + apart * part : high - apart * (1 - part);
    float red_from = (float)((double)ground + REDDISH * (inner - (double)ground));
    for (int s = 0; s < count - core; s++) {
        reds[s] = counts[s] = 0;
        for (int i = 0; i < RADIAL; i++) {
            counts[s] += seen[s * RADIAL + i];
            reds[s] += seen[s * RADIAL + i] & (red[s * RADIAL + i] > red_from);
        }
        share[s] = counts[s] >= RAYS_SEEN ? (double)reds[s] / counts[s] : 0;
    }
    for (int n = LEAST_OUTWARDS; n < count - core - NEXT_OUTWARDS; n++)
        if (share[n] >= MOST_RED && share[n + 1] < MOST_RED && share[n + NEXT_OUTWARDS] <= FEW_RED && counts[n + NEXT_OUTWARDS] >= RAYS_SEEN)
            return 1;
    return 0;
}

#endif
