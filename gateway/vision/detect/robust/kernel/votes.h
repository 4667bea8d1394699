/* Edges of redness vote for the centres of discs: `candidates.votes`. */
#ifndef GATEWAY_VOTES_H
#define GATEWAY_VOTES_H

#include <stdint.h>

#include "median.h"

#define TWO_PI 6.283185307179586f

typedef struct { /* `candidate_kernel.VoteTask` */
    const float *size, *largest, *gx, *gy; /* (height, width): of the gradient, the largest of it around, its parts */
    int64_t height, width;
    const float *radii;
    int64_t radius_count;
    double outer, middle; /* of the blur of the votes */
    double peaks[PEAKS][4]; /* row, column, number of the radius, votes */
} VoteTask;

INLINE int64_t vote_cells(const VoteTask *t) { return (t->height / CELL + 1 + 2 * MARGIN) * (t->width / CELL + 1 + 2 * MARGIN); }

/* Bytes to work in. */
INLINE int64_t vote_room(const VoteTask *t) { return 28 * t->height * t->width + 32 * vote_cells(t) + 64; }

typedef struct {
    int count;
    float *x, *y, *dx, *dy, *weight, *share; /* the last: of a circle */
    int32_t *cell;
} VotingEdges;

static void ridges(const VoteTask *t, VotingEdges *e, float *strength)
{
    float least_gradient = (float)LEAST_GRADIENT, ridge_share = (float)RIDGE_SHARE;
    int32_t *ridge = e->cell;
    int count = 0;
    for (int64_t y = 0; y < t->height; y++) {
        const float *size = t->size + y * t->width, *largest = t->largest + y * t->width;
        for (int64_t x = 0; x < t->width; x++)
            ridge[x] = (size[x] > least_gradient) & (size[x] >= ridge_share * largest[x]);
        for (int64_t x = 0; x < t->width; x++) {
            if (!ridge[x])
                continue;
            strength[count] = size[x];
            e->x[count] = (float)x, e->y[count] = (float)y;
            e->dx[count] = t->gx[y * t->width + x] / size[x], e->dy[count] = t->gy[y * t->width + x] / size[x];
            count++;
        }
    }
    e->count = count;
}

INLINE int32_t whole_of(double value)
{
    int32_t whole = (int32_t)value;
    return whole - ((double)whole > value);
}

/* The votes at one radius, cell by cell, added to a sheet of zeros. */
static void cast_votes(const VotingEdges *e, float radius, int32_t rows, int32_t columns, double *sheet)
{
    float round = TWO_PI * radius;
    int32_t none = rows * columns; /* a cell of its own */
    for (int i = 0; i < e->count; i++) {
        int32_t column = whole_of(((double)e->x[i] + (double)(radius * e->dx[i])) / CELL) + MARGIN;
        int32_t row = whole_of(((double)e->y[i] + (double)(radius * e->dy[i])) / CELL) + MARGIN;
        int inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows);
        e->cell[i] = inside ? row * columns + column : none;
        e->share[i] = e->weight[i] / round;
    }
    for (int i = 0; i < e->count; i++)
        sheet[e->cell[i]] += (double)e->share[i];
}

/* Blurred by three cells in both directions, and the sheet cleared; beyond the edge as within, mirrored in it. `rows` and `columns` are 2 at least. */
static void blurred(double *sheet, int32_t rows, int32_t columns, float outer, float middle, float *line, float *flat, float *out)
{
    for (int32_t n = 0; n < rows; n++) {
        double *sums = sheet + (int64_t)n * columns;
        float *to = flat + (int64_t)n * columns, *from = line + 1;
        for (int32_t i = 0; i < columns; i++)
            from[i] = (float)sums[i], sums[i] = 0;
        from[-1] = from[1], from[columns] = from[columns - 2];
        for (int32_t i = 0; i < columns; i++)
            to[i] = from[i] * middle + (from[i - 1] + from[i + 1]) * outer;
    }
    for (int32_t n = 0; n < rows; n++) {
        const float *at = flat + (int64_t)n * columns, *above = n ? at - columns : at + columns, *below = n < rows - 1 ? at + columns : at - columns;
        float *to = out + (int64_t)n * columns;
        for (int32_t i = 0; i < columns; i++)
            to[i] = (at[i] * middle + (above[i] + below[i]) * outer) * 4; /* of the blur's gain at a peak */
    }
}

/* The largest of a cell and its neighbours, less the one itself, is next to nothing. */
INLINE int is_peak(const float *best, int32_t rows, int32_t columns, int32_t row, int32_t column, float same_vote)
{
    float own = best[(int64_t)row * columns + column] + same_vote;
    for (int32_t r = row ? row - 1 : 0; r <= row + 1 && r < rows; r++)
        for (int32_t c = column ? column - 1 : 0; c <= column + 1 && c < columns; c++)
            if (best[(int64_t)r * columns + c] > own)
                return 0;
    return 1;
}

/* The best peaks, in order of their votes to five digits, then row by row; how many. */
static int peaks_of(VoteTask *t, const float *best, const int32_t *which, int32_t rows, int32_t columns)
{
    float least_vote = (float)LEAST_VOTE, same_vote = (float)SAME_VOTE;
    int count = 0;
    double order[PEAKS + 1];
    for (int32_t row = 0; row < rows; row++)
        for (int32_t column = 0; column < columns; column++) {
            int64_t cell = (int64_t)row * columns + column;
            if (!(best[cell] >= least_vote) || !is_peak(best, rows, columns, row, column, same_vote))
                continue;
            double votes = nearbyint((double)best[cell] * 1e5);
            int at = count;
            for (; at > 0 && order[at - 1] < votes; at--)
                ;
            if (at == PEAKS)
                continue;
            count += count < PEAKS;
            for (int n = count - 1; n > at; n--) {
                order[n] = order[n - 1];
                memcpy(t->peaks[n], t->peaks[n - 1], sizeof t->peaks[n]);
            }
            order[at] = votes;
            t->peaks[at][0] = row, t->peaks[at][1] = column, t->peaks[at][2] = which[cell], t->peaks[at][3] = votes / 1e5;
        }
    return count;
}

/* How many peaks there are. */
static int voted(VoteTask *t, void *work)
{
    int64_t pixels = t->height * t->width, cells = vote_cells(t);
    int32_t rows = (int32_t)(t->height / CELL) + 1 + 2 * MARGIN, columns = (int32_t)(t->width / CELL) + 1 + 2 * MARGIN;
    double *sheet = work;
    float *flat = (float *)(sheet + cells + 1), *smooth[3] = {flat + cells, flat + 2 * cells, flat + 3 * cells}, *best = flat + 4 * cells;
    int32_t *which = (int32_t *)(best + cells);
    float *edges = (float *)(which + cells);
    VotingEdges e = {0, edges, edges + pixels, edges + 2 * pixels, edges + 3 * pixels, edges + 4 * pixels, edges + 5 * pixels,
                     (int32_t *)(edges + 6 * pixels)};
    float outer = (float)t->outer, middle = (float)t->middle;
    ridges(t, &e, e.weight);
    if (e.count < FEWEST_VOTERS)
        return 0;
    float usual = median_of(e.weight, e.count, (float *)e.cell);
    for (int i = 0; i < e.count; i++)
        e.weight[i] = e.weight[i] / (e.weight[i] + usual);
    for (int64_t n = 0; n < cells; n++)
        best[n] = -1, which[n] = 0, sheet[n] = 0;
    sheet[cells] = 0;
    for (int r = 0; r <= t->radius_count; r++) {
        if (r < t->radius_count) {
            cast_votes(&e, t->radii[r], rows, columns, sheet);
            blurred(sheet, rows, columns, outer, middle, e.share, flat, smooth[r % 3]);
        }
        if (!r)
            continue;
        const float *own = smooth[(r - 1) % 3], *before = smooth[(r + 1) % 3], *after = smooth[r % 3];
        int ends = r == 1 || r == t->radius_count;
        for (int64_t n = 0; n < cells; n++) {
            float value = ends ? own[n] : 0.5f * own[n] + 0.25f * (before[n] + after[n]);
            int32_t better = -(value > best[n]); /* all bits or none: without a branch */
            which[n] = (which[n] & ~better) | ((r - 1) & better);
            best[n] = value > best[n] ? value : best[n];
        }
    }
    return peaks_of(t, best, which, rows, columns);
}

#endif
