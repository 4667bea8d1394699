/* Samples of the picture along the normals of an ellipse: `normal_profiles.sample`, to the last bit. OpenCV's 8-bit Lab is
 * made of tables, which are repeated here. */
#ifndef GATEWAY_RAYS_H
#define GATEWAY_RAYS_H

#include "bilinear.h"

enum { COARSE_STEPS = 2 * HALF_STEPS + 1, MOST_STEPS = COARSE_STEPS > PROFILE_STEPS ? COARSE_STEPS : PROFILE_STEPS };
enum { COS, SIN, COS2, SIN2, SMOOTH }; /* rows of the table of `count` directions, 21 of the last */

typedef struct { /* `conic.SupportEllipse` */
    double u, v, alpha, beta, gamma;
} Outline;

typedef struct { /* of one measurement */
    int count, steps, channels, inside_count;
    double unit; /* grey levels of one step of a sample */
    double support[MOST_RAYS], inside[MOST_RAYS]; /* px; 1 where the edge lies in the frame, else 0 */
    uint8_t samples[MOST_STEPS * CHANNELS * MOST_RAYS]; /* step by step, channel by channel, ray by ray */
} Rays;

typedef struct { /* `rim_kernel._Lab` */
    const uint16_t *linear, *root; /* by 8-bit colour; by eighths of a grey level */
    int64_t x[3], y[3]; /* of R, G and B, 4096ths */
} Lab;

INLINE double wave_of(const Outline *o) { return sqrt(o->beta * o->beta + o->gamma * o->gamma); }
INLINE double mean_of(const Outline *o) { return sqrt(o->alpha); }
INLINE double minor_of(const Outline *o) { return sqrt(most(o->alpha - wave_of(o), 0)); }
INLINE double major_of(const Outline *o) { return sqrt(o->alpha + wave_of(o)); }

INLINE int real(const Outline *o)
{
    double wave = wave_of(o);
    return isfinite(o->u) && isfinite(o->v) && isfinite(wave) && isfinite(o->alpha) && o->alpha > wave;
}

/* a* of CIE Lab as OpenCV has it for 8 bits, in place: one channel of three is left. */
static void opposed(uint8_t *samples, int count, const Lab *lab)
{
    for (int i = 0; i < count; i++) {
        int64_t b = lab->linear[samples[i]], g = lab->linear[samples[count + i]], r = lab->linear[samples[2 * count + i]];
        int32_t x = lab->root[(r * lab->x[0] + g * lab->x[1] + b * lab->x[2] + 2048) >> 12];
        int32_t y = lab->root[(r * lab->y[0] + g * lab->y[1] + b * lab->y[2] + 2048) >> 12];
        samples[i] = (uint8_t)((500 * (x - y) + (128 << 15) + (1 << 14)) >> 15);
    }
}

/* 0 where the ellipse and its rays miss the frame. `table`: rows of `count` directions. `lab`: NULL for B, G and R. */
static int sampled(const Picture *p, const Outline *o, const double *table, int count, const double *offsets, int steps,
                   double margin, const Lab *lab, int fused, Rays *rays)
{
    const double *cos = table + COS * count, *sin = table + SIN * count, *cos2 = table + COS2 * count, *sin2 = table + SIN2 * count;
    double reach = major_of(o) + offsets[steps - 1] + 2;
    int64_t left = (int64_t)(o->u - reach), top = (int64_t)(o->v - reach);
    int64_t right = (int64_t)(o->u + reach) + 2, bottom = (int64_t)(o->v + reach) + 2;
    double u[MOST_RAYS], v[MOST_RAYS];
    float columns[MOST_RAYS], rows[MOST_RAYS], across[2][MOST_RAYS];
    Neighbours near;

    left = left < 0 ? 0 : left, top = top < 0 ? 0 : top;
    right = right > p->width ? p->width : right, bottom = bottom > p->height ? p->height : bottom;
    if (right - left < 2 || bottom - top < 2)
        return 0;
    for (int i = 0; i < count; i++) {
        double h = sqrt(o->alpha + o->beta * cos2[i] + o->gamma * sin2[i]);
        rays->support[i] = h;
        u[i] = ((o->alpha + o->beta) * cos[i] + o->gamma * sin[i]) / h + (o->u - (double)left);
        v[i] = (o->gamma * cos[i] + (o->alpha - o->beta) * sin[i]) / h + (o->v - (double)top);
        across[0][i] = (float)cos[i], across[1][i] = (float)sin[i];
        rays->inside[i] = 1;
    }
    rays->inside_count = count;
    if (!(reach <= o->u && o->u < (double)(p->width - 1) - reach && reach <= o->v && o->v < (double)(p->height - 1) - reach)) {
        rays->inside_count = 0;
        for (int i = 0; i < count; i++) {
            double wide = fabs(cos[i]) * margin, high = fabs(sin[i]) * margin, x = u[i] + (double)left, y = v[i] + (double)top;
            int in = x >= wide && x + wide <= (double)(p->width - 1) && y >= high && y + high <= (double)(p->height - 1);
            rays->inside[i] = in;
            rays->inside_count += in;
        }
    }
    rays->count = count, rays->steps = steps, rays->channels = lab ? 1 : CHANNELS;
    for (int s = 0; s < steps; s++) {
        float offset = (float)offsets[s];
        uint8_t *out = rays->samples + s * rays->channels * count;
        for (int i = 0; i < count; i++) {
            columns[i] = (float)((double)(offset * across[0][i]) + u[i]);
            rows[i] = (float)((double)(offset * across[1][i]) + v[i]);
        }
        gathered(p->pixels + top * p->stride + 3 * left, p->stride, bottom - top, right - left, columns, rows, count, &near);
        interpolated(&near, count, fused, out);
        if (lab)
            opposed(out, count, lab);
    }
    return 1;
}

#endif
