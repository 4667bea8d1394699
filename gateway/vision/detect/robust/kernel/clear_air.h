/* Is the air of a small picture clear? `veil.estimate` up to that decision, to the last bit. */
#ifndef GATEWAY_CLEAR_AIR_H
#define GATEWAY_CLEAR_AIR_H

#include "bilinear.h"

#define AIRLIGHT_QUANTILE 0.7f
#define DARKEST_AIRLIGHT 20.0f
#define MOST_GREEN 1.1f
#define NO_VEIL 0.6f

enum { VEIL_CELLS = 8, MOST_VEIL_SIDE = 160 };

INLINE int64_t inner(int64_t i, int64_t n) { return i < 0 ? -i : i >= n ? 2 * n - 2 - i : i; }

/* 1: `veil.estimate` finds none; 0: it has to be asked. For 8 to MOST_VEIL_SIDE px a side. */
static int air_is_clear(const Picture *p)
{
    int counts[CHANNELS][256] = {{0}};
    float air[CHANNELS], share[CHANNELS][256], local[VEIL_CELLS][VEIL_CELLS];
    int64_t h = p->height, w = p->width, longer = h > w ? h : w;
    if (h < 8 || w < 8)
        return 1;
    for (int64_t y = 0; y < h; y++)
        for (int64_t x = 0; x < 3 * w; x += 3)
            for (int c = 0; c < CHANNELS; c++)
                counts[c][p->pixels[y * p->stride + x + c]]++;
    for (int c = 0; c < CHANNELS; c++) {
        float wanted = AIRLIGHT_QUANTILE * (float)(h * w);
        int level = 0;
        for (int sum = counts[c][0]; (float)sum < wanted; sum += counts[c][level])
            level++;
        air[c] = (float)level;
    }
    float other = air[0] > air[2] ? air[0] : air[2];
    if (air[0] < DARKEST_AIRLIGHT || air[1] < DARKEST_AIRLIGHT || air[2] < DARKEST_AIRLIGHT || air[1] > MOST_GREEN * other)
        return 1;
    for (int c = 0; c < CHANNELS; c++)
        for (int v = 0; v < 256; v++)
            share[c][v] = (float)v / air[c];
    double cell = most(1, (double)longer / VEIL_CELLS);
    int rows = (int)most(1, nearbyint((double)h / cell)), columns = (int)most(1, nearbyint((double)w / cell));
    double high = (double)h / rows, wide = (double)w / columns;
    for (int r = 0; r < rows; r++)
        for (int c = 0; c < columns; c++) {
            int64_t top = (int64_t)(r * high), bottom = r + 1 < rows ? (int64_t)((r + 1) * high) : h;
            int64_t left = (int64_t)(c * wide), right = c + 1 < columns ? (int64_t)((c + 1) * wide) : w;
            float darkest = 1e30f;
            for (int64_t y = top; y < bottom; y++) {
                const uint8_t *lines[3] = {p->pixels + inner(y - 1, h) * p->stride, p->pixels + y * p->stride, p->pixels + inner(y + 1, h) * p->stride};
                for (int64_t x = left; x < right; x++) {
                    int64_t before = 3 * inner(x - 1, w), at = 3 * x, after = 3 * inner(x + 1, w);
                    for (int k = 0; k < CHANNELS; k++) {
                        int sum = 0;
                        for (int n = 0; n < 3; n++)
                            sum += lines[n][before + k] + lines[n][at + k] + lines[n][after + k];
                        float value = share[k][(2 * sum + 9) / 18]; /* a ninth, rounded */
                        darkest = value < darkest ? value : darkest;
                    }
                }
            }
            local[r][c] = darkest;
        }
    int veiled = 0;
    for (int r = 0; r < rows; r++)
        for (int c = 0; c < columns; c++) {
            float near = local[r][c];
            for (int y = r ? r - 1 : 0; y <= r + 1 && y < rows; y++)
                for (int x = c ? c - 1 : 0; x <= c + 1 && x < columns; x++)
                    near = local[y][x] < near ? local[y][x] : near;
            veiled += near > NO_VEIL;
        }
    return 2 * veiled < rows * columns;
}

#endif
