/* Red blobs at several thresholds, all in one pass: `candidates.blobs`. */
#ifndef GATEWAY_BLOBS_H
#define GATEWAY_BLOBS_H

#include "median.h"

typedef struct {
    int32_t left, top, width, height;
    float radius, fill;
    int64_t first; /* its first pixel, row by row */
} Blob;

typedef struct { /* `candidate_kernel.BlobTask` */
    const float *red; /* (height, width) */
    int64_t height, width, factor;
    double shares[THRESHOLDS]; /* between the median and the largest redness, growing */
    double smallest, largest; /* radius, px of the full frame */
    int64_t counts[THRESHOLDS];
    Blob blobs[THRESHOLDS][BLOBS]; /* the largest first; equally large ones row by row */
} BlobTask;

typedef struct {
    int32_t left, right, top, parent, area, now; /* now: its number in the next row; -1: none yet */
    int64_t first;
} Part;

typedef struct {
    int32_t start, end, part;
} Run;

typedef struct { /* of one threshold */
    Run *runs, *above; /* of this row and of the one above */
    Part *parts, *spare;
    int32_t run_count, above_count, at, part_count;
} Row;

/* Bytes to work in. */
INLINE int64_t blob_room(const BlobTask *t)
{
    int64_t most_runs = t->width / 2 + 1;
    return 4 * t->height * t->width + 4 * t->width + 64 + THRESHOLDS * most_runs * (int64_t)(2 * sizeof(Run) + 4 * sizeof(Part));
}

INLINE int32_t root_of(Part *parts, int32_t n)
{
    while (parts[n].parent != n)
        n = parts[n].parent = parts[parts[n].parent].parent;
    return n;
}

/* A run of pixels over the threshold has ended: it belongs to what it touches in the row above. */
static void run_ended(Row *r, int32_t start, int32_t end, int32_t y, int64_t width)
{
    int32_t own = -1;
    while (r->at < r->above_count && r->above[r->at].end <= start)
        r->at++;
    for (int32_t n = r->at; n < r->above_count && r->above[n].start < end; n++) {
        int32_t other = root_of(r->parts, r->above[n].part);
        if (own < 0) {
            own = other;
        } else if (own != other) {
            Part *to = r->parts + own, *from = r->parts + other;
            to->left = to->left < from->left ? to->left : from->left, to->right = to->right > from->right ? to->right : from->right;
            to->top = to->top < from->top ? to->top : from->top, to->first = to->first < from->first ? to->first : from->first;
            to->area += from->area;
            from->parent = own;
        }
    }
    if (own < 0) {
        own = r->part_count++;
        r->parts[own] = (Part){start, end, y, own, 0, -1, (int64_t)y * width + start};
    }
    Part *part = r->parts + own;
    part->left = start < part->left ? start : part->left, part->right = end > part->right ? end : part->right;
    part->area += end - start;
    r->runs[r->run_count++] = (Run){start, end, own};
}

/* Kept among the largest if it is about as wide as high, and full enough. */
static void blob_ended(BlobTask *t, int k, const Part *part, int32_t bottom)
{
    float width = (float)(part->right - part->left), height = (float)(bottom - part->top);
    float radius = 0.5f * sqrtf(width * height) * (float)t->factor, fill = (float)part->area / (width * height);
    float longer = width > height ? width : height, shorter = width > height ? height : width;
    if (!(radius >= (float)t->smallest && radius <= (float)t->largest && fill > (float)LEAST_FILL && longer < (float)MOST_LONGER * shorter))
        return;
    Blob *kept = t->blobs[k];
    int64_t at = t->counts[k];
    while (at > 0 && (kept[at - 1].radius < radius || (kept[at - 1].radius == radius && kept[at - 1].first > part->first)))
        at--;
    if (at == BLOBS)
        return;
    t->counts[k] += t->counts[k] < BLOBS;
    for (int64_t n = t->counts[k] - 1; n > at; n--)
        kept[n] = kept[n - 1];
    kept[at] = (Blob){part->left, part->top, part->right - part->left, bottom - part->top, radius, fill, part->first};
}

/* What has no run in this row has ended with the row above; the rest is numbered anew. */
static void row_ended(BlobTask *t, int k, Row *r, int32_t y)
{
    int32_t count = 0;
    for (int32_t n = 0; n < r->run_count; n++) {
        int32_t root = root_of(r->parts, r->runs[n].part);
        Part *part = r->parts + root;
        if (part->now < 0) {
            part->now = count;
            r->spare[count] = *part;
            r->spare[count].parent = count, r->spare[count].now = -1;
            count++;
        }
        r->runs[n].part = part->now;
    }
    for (int32_t n = 0; n < r->part_count; n++)
        if (r->parts[n].parent == n && r->parts[n].now < 0)
            blob_ended(t, k, r->parts + n, y);
    Part *parts = r->parts;
    r->parts = r->spare, r->spare = parts, r->part_count = count;
    Run *runs = r->runs;
    r->runs = r->above, r->above = runs;
    r->above_count = r->run_count, r->run_count = r->at = 0;
}

INLINE float largest_of(const float *values, int64_t count)
{
    enum { LANES = 8 };
    float lane[LANES];
    int64_t n = 0;
    for (int k = 0; k < LANES; k++)
        lane[k] = values[0];
    for (; n + LANES <= count; n += LANES)
        for (int k = 0; k < LANES; k++)
            lane[k] = values[n + k] > lane[k] ? values[n + k] : lane[k];
    for (; n < count; n++)
        lane[0] = values[n] > lane[0] ? values[n] : lane[0];
    for (int k = 1; k < LANES; k++)
        lane[0] = lane[k] > lane[0] ? lane[k] : lane[0];
    return lane[0];
}

static void found_blobs(BlobTask *t, void *work)
{
    int64_t pixels = t->height * t->width, most_runs = t->width / 2 + 1;
    double middle = (double)median_of(t->red, pixels, work);
    float thresholds[THRESHOLDS];
    int32_t start[THRESHOLDS];
    Row rows[THRESHOLDS];
    Part *parts = (Part *)work;
    Run *runs = (Run *)(parts + 4 * most_runs * THRESHOLDS);
    int32_t *level = (int32_t *)(runs + 2 * most_runs * THRESHOLDS);
    double top = (double)largest_of(t->red, pixels);
    for (int k = 0; k < THRESHOLDS; k++) {
        t->counts[k] = 0;
        thresholds[k] = (float)(middle + t->shares[k] * (top - middle));
        rows[k] = (Row){.runs = runs + 2 * k * most_runs, .above = runs + (2 * k + 1) * most_runs,
                        .parts = parts + 4 * k * most_runs, .spare = parts + (4 * k + 2) * most_runs};
    }
    if (top - middle < LEAST_SPREAD)
        return;
    for (int32_t y = 0; y <= (int32_t)t->height; y++) {
        int before = 0;
        if (y < (int32_t)t->height) {
            const float *red = t->red + (int64_t)y * t->width;
            memset(level, 0, (size_t)t->width * sizeof *level);
            for (int k = 0; k < THRESHOLDS; k++)
                for (int64_t x = 0; x < t->width; x++)
                    level[x] += red[x] >= thresholds[k];
            for (int32_t x = 0; x < (int32_t)t->width; x++) {
                int own = level[x];
                if (own == before)
                    continue;
                for (int k = before; k < own; k++)
                    start[k] = x;
                for (int k = own; k < before; k++)
                    run_ended(rows + k, start[k], x, y, t->width);
                before = own;
            }
            for (int k = 0; k < before; k++)
                run_ended(rows + k, start[k], (int32_t)t->width, y, t->width);
        }
        for (int k = 0; k < THRESHOLDS; k++)
            if (rows[k].run_count || rows[k].part_count)
                row_ended(t, k, rows + k, y);
            else
                rows[k].above_count = 0;
    }
}

#endif
