/* Samples of the picture along the normals of an ellipse: `normal_profiles.sample`, to the last bit.
 *
 * OpenCV's bilinear remap computes in single precision, with fused multiplication and addition where the processor has
 * them, and rounds to even; its 8-bit Lab is made of tables. Both are repeated here.
 */
#ifndef GATEWAY_RAYS_H
#define GATEWAY_RAYS_H

#include <stdint.h>

#include "numbers.h"

enum { MOST_RAYS = 320, MOST_STEPS = 33, CHANNELS = 3 };
enum { COS, SIN, COS2, SIN2, SMOOTH }; /* rows of the table of `count` directions, 21 of the last */

typedef struct { /* `conic.SupportEllipse` */
    double u, v, alpha, beta, gamma;
} Outline;

typedef struct { /* `rim_kernel._Picture` */
    const uint8_t *pixels;
    int64_t stride, height, width;
} Picture;

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

/* The whole part: a cast that rounds down. */
INLINE int32_t floor_of(float value)
{
    int32_t whole = (int32_t)value;
    return whole - ((float)whole > value);
}

INLINE float between(float a, float b, float share, int fused)
{
    return fused ? __builtin_fmaf(share, b - a, a) : a + share * (b - a);
}

/* Four neighbours of every sample of a step, packed as pixels of three bytes. */
typedef struct {
    uint32_t at[4][MOST_RAYS];
    float column[MOST_RAYS], row[MOST_RAYS]; /* shares of the right and of the lower ones */
} Neighbours;

INLINE uint32_t pixel(const uint8_t *p) { return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16; }

INLINE int64_t limited(int64_t i, int64_t n) { return i < 0 ? 0 : i >= n ? n - 1 : i; }

INLINE uint32_t four_bytes(const uint8_t *p)
{
    uint32_t word;
    memcpy(&word, p, sizeof word);
#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
    word = __builtin_bswap32(word);
#endif
    return word;
}

/* Of the pixels (rows, columns) of a window, which begins at `from` and is repeated beyond its edges. */
static void gathered(const uint8_t *from, int64_t stride, int64_t height, int64_t width, const float *columns, const float *rows,
                     int count, Neighbours *n)
{
    int32_t x[MOST_RAYS], y[MOST_RAYS];
    int32_t left = INT32_MAX, right = INT32_MIN, top = INT32_MAX, bottom = INT32_MIN;
    for (int i = 0; i < count; i++) {
        x[i] = floor_of(columns[i]), y[i] = floor_of(rows[i]);
        n->column[i] = columns[i] - (float)x[i], n->row[i] = rows[i] - (float)y[i];
        left = x[i] < left ? x[i] : left, right = x[i] > right ? x[i] : right;
        top = y[i] < top ? y[i] : top, bottom = y[i] > bottom ? y[i] : bottom;
    }
    if (left >= 0 && top >= 0 && right + 2 < width && bottom + 1 < height) { /* four bytes can be read of three */
        for (int i = 0; i < count; i++) {
            const uint8_t *p = from + y[i] * stride + 3 * (int64_t)x[i];
            n->at[0][i] = four_bytes(p), n->at[1][i] = four_bytes(p + 3);
            n->at[2][i] = four_bytes(p + stride), n->at[3][i] = four_bytes(p + stride + 3);
        }
        return;
    }
    for (int i = 0; i < count; i++)
        for (int k = 0; k < 4; k++)
            n->at[k][i] = pixel(from + limited(y[i] + k / 2, height) * stride + 3 * limited(x[i] + k % 2, width));
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
        for (int c = 0; c < CHANNELS; c++) {
            for (int i = 0; i < count; i++) {
                float corner[4];
                for (int k = 0; k < 4; k++)
                    corner[k] = (float)(int32_t)(near.at[k][i] >> 8 * c & 255);
                float above = between(corner[0], corner[1], near.column[i], fused);
                float below = between(corner[2], corner[3], near.column[i], fused);
                float value = between(above, below, near.row[i], fused);
                out[c * count + i] = (uint8_t)(int32_t)((value + 8388608.0f) - 8388608.0f); /* 2^23: rounds to even */
            }
        }
        if (lab)
            opposed(out, count, lab);
    }
    return 1;
}

#endif
