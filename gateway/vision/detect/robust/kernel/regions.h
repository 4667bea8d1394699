/* The red spots of a sparse picture but for the one that is followed: `red_change.red_regions`. */
#ifndef GATEWAY_REGIONS_H
#define GATEWAY_REGIONS_H

#include "bilinear.h"
#include "clear_air.h"

typedef struct { /* `sparse_kernel.RegionTask`; px of the sparse picture: every `step`-th from the middle of the first on */
    Picture picture;
    int64_t step, u, v, inner, outer; /* of what is followed: its centre, the radius that is surely it, and its whole one */
    const float *log;
    int64_t faint; /* there is anything red at all */
} RegionTask;

typedef struct {
    int32_t x0, y0, x1, y1;
} Box;

INLINE int64_t sparse_side(int64_t side, int64_t step) { return (side - step / 2 + step - 1) / step; }

/* Bytes to work in: the boxes first. */
INLINE int64_t region_room(const RegionTask *t)
{
    int64_t pixels = sparse_side(t->picture.height, t->step) * sparse_side(t->picture.width, t->step);
    return 2 * pixels * (int64_t)sizeof(float) + (pixels / SMALLEST_REGION_PX + 1) * (int64_t)sizeof(Box) +
           (t->picture.width + 2) * (int64_t)sizeof(double);
}

/* A mean over 3 x 3 px as OpenCV has it; the sums are exact. `down`: for w + 2 values. */
static void region_blur(const float *red, int64_t h, int64_t w, double *down, float *out)
{
    for (int64_t y = 0; y < h; y++, out += w) {
        const float *above = red + inner(y - 1, h) * w, *at = red + y * w, *below = red + inner(y + 1, h) * w;
        for (int64_t x = 0; x < w; x++)
            down[x + 1] = (double)above[x] + (double)at[x] + (double)below[x];
        down[0] = down[2], down[w + 1] = down[w - 1];
        for (int64_t x = 0; x < w; x++)
            out[x] = (float)((down[x] + down[x + 1] + down[x + 2]) * (1.0 / 9));
    }
}

/* The columns of row y within the disc of radius r round the task's centre: from the first on, up to the last. */
INLINE int64_t disc_row(const RegionTask *t, int64_t y, int64_t r, int64_t w, int64_t *last)
{
    int64_t dv = y - t->v, left = r * r + r - dv * dv, du = -1;
    if (left >= 0)
        for (du = (int64_t)sqrt((double)left) + 1; du * du > left;)
            du--;
    *last = t->u + du < w ? t->u + du + 1 : w;
    return t->u - du > 0 ? t->u - du : 0;
}

/* All that hangs together with pixel `at`, corner to corner, is taken out of the plane; its area. */
static int64_t region_taken(float *red, int64_t h, int64_t w, float bar, int32_t at, int32_t *stack, Box *box)
{
    int64_t count = 1, area = 0;
    stack[0] = at, red[at] = 0;
    *box = (Box){INT32_MAX, INT32_MAX, 0, 0};
    while (count) {
        int32_t pixel = stack[--count], x = pixel % (int32_t)w, y = pixel / (int32_t)w;
        area++;
        box->x0 = x < box->x0 ? x : box->x0, box->x1 = x + 1 > box->x1 ? x + 1 : box->x1;
        box->y0 = y < box->y0 ? y : box->y0, box->y1 = y + 1 > box->y1 ? y + 1 : box->y1;
        for (int32_t v = y ? y - 1 : 0; v <= y + 1 && v < h; v++)
            for (int32_t u = x ? x - 1 : 0; u <= x + 1 && u < w; u++)
                if (red[v * w + u] > bar) {
                    red[v * w + u] = 0;
                    stack[count++] = v * (int32_t)w + u;
                }
    }
    return area;
}

/* How many boxes there are in `work`, in the order of their first pixels; -1: there may be a veil, or hardly a picture. */
static int64_t red_regions(RegionTask *t, void *work)
{
    const Picture *p = &t->picture;
    int64_t step = t->step, h = sparse_side(p->height, step), w = sparse_side(p->width, step), longer = h > w ? h : w;
    int64_t every = (longer + MOST_VEIL_SIDE - 1) / MOST_VEIL_SIDE, faint = 0, inside = 0, count = 0;
    const uint8_t *first = p->pixels + step / 2 * p->stride + 3 * (step / 2);
    Sparse coarse = {first, every * step * p->stride, 3 * every * step, (h + every - 1) / every, (w + every - 1) / every};
    Box *boxes = work;
    double *down = (double *)(void *)(boxes + h * w / SMALLEST_REGION_PX + 1);
    float *red = (float *)(void *)(down + w + 2), *blurred = red + h * w;
    double sum = 0;
    if (h < 2 || w < 2 || !air_is_clear(&coarse))
        return -1;
    for (int64_t y = 0; y < h; y++) {
        const uint8_t *from = first + y * step * p->stride;
        for (int64_t x = 0; x < w; x++, from += 3 * step)
            red[y * w + x] = t->log[from[2]] - t->log[from[1]];
    }
    region_blur(red, h, w, down, blurred);
    for (int64_t y = 0; y < h; y++) {
        int64_t last;
        for (int64_t x = disc_row(t, y, t->inner, w, &last); x < last; x++, inside++)
            sum += (double)blurred[y * w + x];
    }
    double redness = inside ? sum / (double)inside : 0, bar = AS_RED * least(FULL_REDNESS, redness);
    float least_red = (float)LEAST_RED, as_red = (float)most(LEAST_RED, bar);
    for (int64_t y = 0; y < h; y++) {
        int64_t last;
        for (int64_t x = disc_row(t, y, t->outer, w, &last); x < last; x++)
            blurred[y * w + x] = 0;
        for (int64_t x = 0; x < w; x++)
            faint += blurred[y * w + x] > least_red;
    }
    t->faint = faint >= SMALLEST_REGION_PX;
    for (int64_t at = 0; at < h * w; at++)
        if (blurred[at] > as_red)
            count += region_taken(blurred, h, w, as_red, (int32_t)at, (int32_t *)(void *)red, boxes + count) >= SMALLEST_REGION_PX;
    return count;
}

#endif
