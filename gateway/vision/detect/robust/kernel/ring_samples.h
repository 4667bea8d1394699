/* Samples along rays from a centre outwards: `radial_sampling.sample_rays` of one candidate, to the last bit. */
#ifndef GATEWAY_RING_SAMPLES_H
#define GATEWAY_RING_SAMPLES_H

#include "bilinear.h"

enum { MOST_SHARES = 32 }; /* samples on a ray */

typedef struct { /* `evidence_kernel`: what Python computes once */
    const float *cos, *sin; /* of the rays, (RADIAL,) */
    const float *log; /* (256,): the logarithm of a stored value, see `redness` */
    const float *wide, *close, *rings, *outwards; /* shares of the way from the centre to the rim, and beyond it */
    const int32_t *triples; /* (triple_count, 3): rays */
    int64_t wide_count, close_count, triple_count;
    int64_t outwards_count, core; /* so many of the latter within the disc */
    int64_t disc, inside; /* of `rings`: so many within the disc, then so many inside the rim; the rest outside */
    int64_t fused; /* whether OpenCV multiplies and adds at once */
    double gain; /* a stored value is the grey level times this */
} EvidenceTables;

typedef struct {
    Picture picture;
    int64_t factor; /* px of the full frame a px */
} Level;

typedef struct { /* px of a level; cosine and sine of the angle of the first axis */
    double u, v, along, across, cos, sin;
} Shape;

typedef struct { /* share by share, ray by ray */
    float red[MOST_SHARES][RADIAL];
    uint8_t seen[MOST_SHARES][RADIAL], bgr[MOST_SHARES][CHANNELS][RADIAL];
} RingSamples;

/* Beyond an edge all is like the edge; also where there is no number. */
INLINE float kept_near(float at, float size) { return at > -2 ? at < size + 1 ? at : size + 1 : -2; }

static void sampled_rings(const Picture *p, const Shape *shape, const float *shares, int count, const EvidenceTables *t,
                          int fused, RingSamples *out)
{
    float u = (float)shape->u, v = (float)shape->v, along = (float)shape->along, across = (float)shape->across;
    float cos = (float)shape->cos, sin = (float)shape->sin, right = (float)((double)p->width - 0.5), low = (float)((double)p->height - 0.5);
    float du[RADIAL], dv[RADIAL], columns[RADIAL], rows[RADIAL];
    Neighbours near;
    for (int i = 0; i < RADIAL; i++) {
        float x = along * t->cos[i], y = across * t->sin[i];
        du[i] = x * cos - y * sin;
        dv[i] = x * sin + y * cos;
    }
    for (int s = 0; s < count; s++) {
        for (int i = 0; i < RADIAL; i++) {
            columns[i] = u + du[i] * shares[s];
            rows[i] = v + dv[i] * shares[s];
            out->seen[s][i] = (columns[i] >= -0.5f) & (columns[i] <= right) & (rows[i] >= -0.5f) & (rows[i] <= low);
            columns[i] = kept_near(columns[i], right), rows[i] = kept_near(rows[i], low);
        }
        gathered(p->pixels, p->stride, p->height, p->width, columns, rows, RADIAL, &near);
        interpolated(&near, RADIAL, fused, out->bgr[s][0]);
        for (int i = 0; i < RADIAL; i++)
            out->red[s][i] = t->log[out->bgr[s][2][i]] - t->log[out->bgr[s][1][i]];
    }
}

#endif
