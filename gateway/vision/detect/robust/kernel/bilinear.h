/* A picture between its pixels: OpenCV's remap with INTER_LINEAR and BORDER_REPLICATE, to the last bit.
 *
 * It computes in single precision, with fused multiplication and addition where the processor has them, and rounds to
 * even.
 */
#ifndef GATEWAY_BILINEAR_H
#define GATEWAY_BILINEAR_H

#include <stdint.h>

#include "numbers.h"

enum { CHANNELS = 3 };

typedef struct { /* `rim_kernel._Picture` */
    const uint8_t *pixels;
    int64_t stride, height, width;
} Picture;

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
INLINE void gathered(const uint8_t *from, int64_t stride, int64_t height, int64_t width, const float *columns, const float *rows,
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

/* B, G and R between the neighbours, channel by channel. */
INLINE void interpolated(const Neighbours *near, int count, int fused, uint8_t *out)
{
    for (int c = 0; c < CHANNELS; c++)
        for (int i = 0; i < count; i++) {
            float corner[4];
            for (int k = 0; k < 4; k++)
                corner[k] = (float)(int32_t)(near->at[k][i] >> 8 * c & 255);
            float above = between(corner[0], corner[1], near->column[i], fused);
            float below = between(corner[2], corner[3], near->column[i], fused);
            float value = between(above, below, near->row[i], fused);
            out[c * count + i] = (uint8_t)(int32_t)((value + 8388608.0f) - 8388608.0f); /* 2^23: rounds to even */
        }
}

#endif
