/* The coarse stage: the steepest change on every ray, and the ellipse that most rays agree on: `rim_coarse.py`. */
#ifndef GATEWAY_COARSE_H
#define GATEWAY_COARSE_H

#include "fit.h"

enum { THIRD = COARSE_STEPS / 3 };
enum { MOST_SUBSETS = 128 };

typedef struct { /* ellipses or circles through a few rays each: `rim_kernel._Subsets` */
    const int32_t *rays; /* (count, size) */
    const double *inverses; /* (count, size, size) */
    int64_t size, count;
} Subsets;

typedef struct {
    double shift[COARSE_RAYS], weight[COARSE_RAYS], top[COARSE_RAYS], bend[COARSE_RAYS];
    double inner[CHANNELS][COARSE_RAYS], away[CHANNELS][COARSE_RAYS], outward[CHANNELS][COARSE_RAYS];
    double along[COARSE_STEPS][COARSE_RAYS], slope[COARSE_STEPS][COARSE_RAYS];
    double changes[MOST_SUBSETS][5], cost[MOST_SUBSETS];
    double room[3 * (COARSE_RAYS + 1)];
} Coarse;

INLINE double rounded_tenth(double value) { return nearbyint(value * 10) / 10; }

/* The offset (px) of the steepest change on every ray and its weight; the blur (px). */
static double steepest(const Rays *rays, const double *filter, double step, Coarse *c)
{
    enum { N = COARSE_RAYS };
    static const double every[N] = {[0 ... N - 1] = 1};
    const double *seen = rays->inside_count ? rays->inside : every;
    double length[N];
    for (int i = 0; i < N; i++)
        length[i] = 0;
    for (int k = 0; k < rays->channels; k++) {
        double outer[N];
        for (int i = 0; i < N; i++) {
            int32_t first = 0, last = 0;
            for (int s = 0; s < THIRD; s++) {
                first += rays->samples[(s * rays->channels + k) * N + i];
                last += rays->samples[((COARSE_STEPS - 1 - s) * rays->channels + k) * N + i];
            }
            c->inner[k][i] = (double)first * rays->unit / THIRD;
            outer[i] = (double)last * rays->unit / THIRD;
        }
        ptrdiff_t n = chosen(c->inner[k], seen, N, c->room);
        double usual = nth(c->room, n, n / 2, c->room + N + 1);
        for (int i = 0; i < N; i++)
            c->away[k][i] = usual - outer[i];
        for (int i = 0; i < N; i++) {
            double beside = c->away[k][(i + N - 1) % N], beyond = c->away[k][(i + 1) % N];
            c->outward[k][i] = beside + 2 * c->away[k][i] + beyond;
            length[i] += c->outward[k][i] * c->outward[k][i];
        }
    }
    for (int i = 0; i < N; i++)
        length[i] = sqrt(length[i]) + 1e-3;
    for (int k = 0; k < rays->channels; k++)
        for (int i = 0; i < N; i++)
            c->outward[k][i] = c->outward[k][i] / length[i] * rays->unit;
    for (int s = 0; s < COARSE_STEPS; s++)
        for (int i = 0; i < N; i++) {
            double sum = 0;
            for (int k = 0; k < rays->channels; k++)
                sum += (double)rays->samples[(s * rays->channels + k) * N + i] * c->outward[k][i];
            c->along[s][i] = sum;
        }
    memset(c->slope, 0, sizeof c->slope);
    for (int s = BLIND; s < COARSE_STEPS - BLIND; s++) {
        int from = s - FILTER_REACH < 0 ? 0 : s - FILTER_REACH, to = s + FILTER_REACH >= COARSE_STEPS ? COARSE_STEPS - 1 : s + FILTER_REACH;
        for (int j = from; j <= to; j++)
            for (int i = 0; i < N; i++)
                c->slope[s][i] += filter[s * COARSE_STEPS + j] * c->along[j][i];
    }
    for (int i = 0; i < N; i++)
        c->top[i] = c->slope[0][i];
    for (int s = 1; s < COARSE_STEPS; s++)
        for (int i = 0; i < N; i++)
            c->top[i] = most(c->top[i], c->slope[s][i]);
    for (int i = 0; i < N; i++) {
        int peak = 0;
        while (c->slope[peak][i] < c->top[i] - TIE)
            peak++;
        double top = c->slope[peak][i];
        double before = c->slope[(peak + COARSE_STEPS - 1) % COARSE_STEPS][i], after = c->slope[(peak + 1) % COARSE_STEPS][i];
        c->top[i] = top;
        c->bend[i] = most(2 * top - before - after, 1e-3);
        c->shift[i] = ((double)(peak - HALF_STEPS) + within(-0.5, 0.5 * (after - before) / c->bend[i], 0.5)) * step;
    }
    double usual = most(quantile(c->top, rays->inside, N, 0.5, c->room), 1), ratio[N];
    for (int i = 0; i < N; i++) {
        c->weight[i] = rays->inside[i] > 0 && c->top[i] > LEAST_SLOPE * usual ? least(c->top[i] / usual, MOST_SLOPE) : 0;
        ratio[i] = c->top[i] / c->bend[i];
    }
    double variance = (quantile(ratio, c->weight, N, 0.5, c->room) - FILTER_SIGMA * FILTER_SIGMA) * step * step;
    return within(LEAST_BLUR_PX, rounded_tenth((step <= COARSE_STEP_PX ? 1 : SHARP) * sqrt(most(variance, 0))), MOST_BLUR_PX);
}

/* The changes of the ellipse by the subsets, and how badly the rays fit each: `cost`. How many there are. */
static int judged(const Subsets *kinds, const double *design, double tolerance, Coarse *c)
{
    int count = 0;
    double inverse = 1 / tolerance, misfit[COARSE_RAYS];
    for (int kind = 0; kind < 2; kind++) {
        int size = (int)kinds[kind].size;
        const int32_t *rays = kinds[kind].rays;
        const double *row = kinds[kind].inverses;
        for (int64_t n = 0; n < kinds[kind].count; n++, count++, rays += size) {
            double *change = c->changes[count];
            for (int k = 0; k < 5; k++)
                change[k] = 0;
            for (int k = 0; k < size; k++, row += size)
                for (int j = 0; j < size; j++)
                    change[k] += row[j] * c->shift[rays[j]];
            for (int i = 0; i < COARSE_RAYS; i++) {
                double off = change[0] * design[i] + change[1] * design[COARSE_RAYS + i] + change[2] * design[2 * COARSE_RAYS + i] +
                             change[3] * design[3 * COARSE_RAYS + i] + change[4] * design[4 * COARSE_RAYS + i];
                off = (off - c->shift[i]) * inverse;
                misfit[i] = least(off * off, 1);
            }
            c->cost[count] = dot(misfit, c->weight, COARSE_RAYS);
        }
    }
    return count;
}

/* 0 without enough edges; else the outline and the guess at the blur are overwritten. */
static int coarsely(Rays *rays, const double *table, const double *filter, const Subsets *subsets, double step,
                    Outline *outline, double *sigma, Coarse *c, Fit *fit)
{
    double tolerance = most(most(AGREED_PX, AGREED_SHARE * mean_of(outline)), AGREED_STEPS * step);
    FitOptions options = {.smallest_scale = COARSE_SCALE_PX, .largest_scale = tolerance, .rounds = COARSE_ROUNDS};
    int usable = 0, first = 0;
    *sigma = steepest(rays, filter, step, c);
    for (int i = 0; i < COARSE_RAYS; i++)
        usable += c->weight[i] > 0;
    if (usable < FEWEST_EDGES)
        return 0;
    designed(outline, table, rays->support, COARSE_RAYS, fit->design);
    int count = judged(subsets, fit->design, tolerance, c);
    double lowest = c->cost[0];
    for (int n = 1; n < count; n++)
        lowest = least(lowest, c->cost[n]);
    while (!(c->cost[first] <= lowest + TIE))
        first++;
    if (!fitted(outline, c->shift, c->weight, COARSE_RAYS, c->changes[first], &options, fit))
        return 0;
    *outline = fit->outline;
    return 1;
}

#endif
