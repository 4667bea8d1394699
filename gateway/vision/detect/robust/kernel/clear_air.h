/* Is the air of a small picture clear? `veil.estimate` up to that decision, to the last bit. */
#ifndef GATEWAY_CLEAR_AIR_H
#define GATEWAY_CLEAR_AIR_H

#include "bilinear.h"

typedef struct { /* `sparse_kernel._PICTURE`: pixels that lie so many bytes apart */
    const uint8_t *pixels;
    int64_t down, right, height, width;
} Sparse;

INLINE int64_t inner(int64_t i, int64_t n) { return i < 0 ? -i : i >= n ? 2 * n - 2 - i : i; }

/* The least sum of 3 x 3 samples in every column of the rows from `top` to `bottom` of one channel. */
INLINE void least_sums(const uint8_t *plane, int64_t h, int64_t w, int64_t top, int64_t bottom, int16_t *sums)
{
    int16_t down[MOST_VEIL_SIDE + 2];
    for (int64_t x = 0; x < w; x++)
        sums[x] = INT16_MAX;
    for (int64_t y = top; y < bottom; y++) {
        const uint8_t *above = plane + inner(y - 1, h) * w, *at = plane + y * w, *below = plane + inner(y + 1, h) * w;
        for (int64_t x = 0; x < w; x++)
            down[x + 1] = (int16_t)(above[x] + at[x] + below[x]);
        down[0] = down[2], down[w + 1] = down[w - 1];
        for (int64_t x = 0; x < w; x++) {
            int16_t sum = (int16_t)(down[x] + down[x + 1] + down[x + 2]);
            sums[x] = sum < sums[x] ? sum : sums[x];
        }
    }
}

/* 1: `veil.estimate` finds none; 0: it has to be asked. For MOST_VEIL_SIDE px a side at most. */
static int air_is_clear(const Sparse *p)
{
    uint8_t planes[CHANNELS][MOST_VEIL_SIDE * MOST_VEIL_SIDE];
    int counts[CHANNELS][256] = {{0}};
    int16_t sums[CHANNELS][MOST_VEIL_SIDE];
    float bright = (float)BRIGHT, darkest_air = (float)DARKEST_AIRLIGHT;
    float most_green = (float)MOST_GREEN, no_veil = (float)NO_VEIL;
    float air[CHANNELS], local[VEIL_CELLS][VEIL_CELLS];
    int64_t h = p->height, w = p->width, longer = h > w ? h : w;
    if (h < 8 || w < 8)
        return 1;
    if (longer > MOST_VEIL_SIDE)
        return 0;
    for (int64_t y = 0; y < h; y++)
        for (int64_t x = 0; x < w; x++)
            for (int c = 0; c < CHANNELS; c++) {
                uint8_t value = p->pixels[y * p->down + x * p->right + c];
                planes[c][y * w + x] = value;
                counts[c][value]++;
            }
    for (int c = 0; c < CHANNELS; c++) {
        float wanted = bright * (float)(h * w);
        int level = 0;
        for (int sum = counts[c][0]; (float)sum < wanted; sum += counts[c][level])
            level++;
        air[c] = (float)level;
    }
    float other = air[0] > air[2] ? air[0] : air[2];
    if (air[0] < darkest_air || air[1] < darkest_air || air[2] < darkest_air || air[1] > most_green * other)
        return 1;
    double cell = most(1, (double)longer / VEIL_CELLS);
    int rows = (int)most(1, nearbyint((double)h / cell)), columns = (int)most(1, nearbyint((double)w / cell));
    double high = (double)h / rows, wide = (double)w / columns;
    for (int r = 0; r < rows; r++) {
        for (int k = 0; k < CHANNELS; k++)
            least_sums(planes[k], h, w, (int64_t)(r * high), r + 1 < rows ? (int64_t)((r + 1) * high) : h, sums[k]);
        for (int c = 0; c < columns; c++) {
            int64_t left = (int64_t)(c * wide), right = c + 1 < columns ? (int64_t)((c + 1) * wide) : w;
            float darkest = 1e30f;
            for (int k = 0; k < CHANNELS; k++) {
                int least_sum = INT16_MAX;
                for (int64_t x = left; x < right; x++)
                    least_sum = sums[k][x] < least_sum ? sums[k][x] : least_sum;
                float value = (float)((2 * least_sum + 9) / 18) / air[k]; /* a ninth, rounded: it grows with the sum */
                darkest = value < darkest ? value : darkest;
            }
            local[r][c] = darkest;
        }
    }
    int veiled = 0;
    for (int r = 0; r < rows; r++)
        for (int c = 0; c < columns; c++) {
            float near = local[r][c];
            for (int y = r ? r - 1 : 0; y <= r + 1 && y < rows; y++)
                for (int x = c ? c - 1 : 0; x <= c + 1 && x < columns; x++)
                    near = local[y][x] < near ? local[y][x] : near;
            veiled += near > no_veil;
        }
    return veiled < LEAST_PART * (rows * columns);
}

#endif
