/* The evidence for a red disc at a place: `evidence.py`, of one candidate after the other.
 *
 * What is in single precision there is so here, too, and rounded alike: the evidence on a given rim is the same to the last bit.
 */
#ifndef GATEWAY_EVIDENCE_H
#define GATEWAY_EVIDENCE_H

#include "ellipse_fit.h"
#include "outwards.h"

typedef struct { /* `evidence_kernel._ROW`: what is asked, px of the full frame; in its place what was found */
    Shape shape;
    double found, coverage, leak, covered, visible, contrast, rise, noise, fill, hollow, redness, haze, colour[3];
} EvidenceRow;

enum { RIMS, SEEDS, ENDS }; /* `evidence_kernel` */

typedef struct {
    RingSamples rings;
    Outwards outwards;
    Points points;
    float fall[MOST_SHARES][RADIAL], sum[MOST_SHARES][RADIAL];
    double values[CORE_END * RADIAL], again[CORE_END * RADIAL], room[2 * CORE_END * RADIAL];
} EvidenceWork;

/* `evidence.masked_rank`: 0 of none. */
static float marked_rank(const float *values, const uint8_t *mark, int part, int of, EvidenceWork *w)
{
    int count = 0;
    for (int i = 0; i < RADIAL; i++) {
        w->values[count] = (double)values[i];
        count += mark[i];
    }
    return count ? (float)nth(w->values, count, (count - 1) * part / of, w->room) : 0;
}

static float marked_median(const float *values, const uint8_t *mark, EvidenceWork *w)
{
    return marked_rank(values, mark, 1, 2, w);
}

/* Of an even number of samples: the mean of the two in the middle. */
static float even_median(float (*values)[RADIAL], int shares, EvidenceWork *w)
{
    int count = shares * RADIAL;
    for (int n = 0; n < count; n++)
        w->values[n] = w->again[n] = (double)values[n / RADIAL][n % RADIAL];
    float low = (float)nth(w->values, count, count / 2 - 1, w->room), high = (float)nth(w->again, count, count / 2, w->room);
    return (low + high) / 2;
}

/* On every ray. */
static void ray_medians(float (*values)[RADIAL], int shares, float *medians)
{
    for (int i = 0; i < RADIAL; i++) {
        float sorted[MOST_SHARES] = {0}; /* gcc 15 sees a use before the loop: there is none, shares > 0 */
        for (int s = 0; s < shares; s++) {
            float value = values[s][i];
            int at = s;
            for (; at > 0 && sorted[at - 1] > value; at--)
                sorted[at] = sorted[at - 1];
            sorted[at] = value;
        }
        medians[i] = shares % 2 ? sorted[shares / 2] : (sorted[shares / 2 - 1] + sorted[shares / 2]) / 2;
    }
}

/* `evidence._edges` */
static void edges_on_rays(const Level *level, const Shape *shape, const float *shares, int count, const EvidenceTables *t,
                          int fused, EvidenceWork *w)
{
    int at[RADIAL];
    float height[RADIAL], shift[RADIAL];
    uint8_t rising[RADIAL];
    sampled_rings(&level->picture, shape, shares, count, t, fused, &w->rings);
    memcpy(w->sum[0], w->rings.red[0], sizeof w->sum[0]);
    for (int s = 1; s < count; s++)
        for (int i = 0; i < RADIAL; i++)
            w->sum[s][i] = w->sum[s - 1][i] + w->rings.red[s][i];
    memset(w->fall, 0, sizeof w->fall);
    for (int s = BEFORE_EDGE + 1; s < count - BEFORE_EDGE; s++)
        for (int i = 0; i < RADIAL; i++) {
            float before = w->sum[s - 1][i] - w->sum[s - 1 - BEFORE_EDGE][i], after = w->sum[s + BEFORE_EDGE][i] - w->sum[s][i];
            w->fall[s][i] = w->rings.seen[s + BEFORE_EDGE][i] ? (before - after) / BEFORE_EDGE : 0;
        }
    for (int i = 0; i < RADIAL; i++)
        at[i] = 0, height[i] = w->fall[0][i];
    for (int s = 1; s < count; s++)
        for (int i = 0; i < RADIAL; i++) {
            at[i] = w->fall[s][i] > height[i] ? s : at[i];
            height[i] = w->fall[s][i] > height[i] ? w->fall[s][i] : height[i];
        }
    for (int i = 0; i < RADIAL; i++) {
        float left = at[i] ? w->fall[at[i] - 1][i] : 0, right = w->fall[at[i] + 1][i];
        float bend = left - 2 * height[i] + right, off;
        bend = bend < -1e-9f ? bend : -1e-9f;
        off = 0.5f * (left - right) / bend;
        shift[i] = off < -0.5f ? -0.5f : off > 0.5f ? 0.5f : off;
        rising[i] = height[i] > 0;
    }
    float usual = marked_median(height, rising, w), spacing = shares[1] - shares[0];
    for (int i = 0; i < RADIAL; i++) {
        float weight = height[i] / (usual + 1e-6f), share = shares[at[i]] + shift[i] * spacing;
        weight = weight < 0 ? 0 : weight > (float)MOST_FALL ? (float)MOST_FALL : weight;
        double x = shape->along * (double)t->cos[i] * (double)share, y = shape->across * (double)t->sin[i] * (double)share;
        w->points.weight[i] = weight > (float)LEAST_FALL && usual > (float)LEAST_USUAL ? (double)weight : 0;
        w->points.u[i] = shape->u + x * shape->cos - y * shape->sin;
        w->points.v[i] = shape->v + x * shape->sin + y * shape->cos;
    }
}

/* The rim round a seed, px of its level: 0 where there is none. */
static int rim_round(const Level *level, Shape *shape, const EvidenceTables *t, int fused, EvidenceWork *w)
{
    Shape circle, seed = *shape;
    edges_on_rays(level, shape, t->wide, (int)t->wide_count, t, fused, w);
    if (!agreed_circle(&w->points, t, SEED_SHARE * seed.along + SEED_PX, &circle))
        return 0;
    if (!(length_of(circle.u - seed.u, circle.v - seed.v) < seed.along && circle.along > SEED_SMALLEST * seed.along &&
          circle.along < SEED_LARGEST * seed.along))
        return 0;
    *shape = circle;
    for (int turn = 0; turn < NEAR_ROUNDS; turn++) {
        Shape before = *shape;
        edges_on_rays(level, shape, t->close, (int)t->close_count, t, fused, w);
        if (!ellipse_near(&w->points, NEAR_SHARE * before.across + NEAR_PX, shape))
            return 0;
        if (!(shape->across > NEAR_SMALLEST * before.across && shape->along < NEAR_LARGEST * before.along))
            return 0;
    }
    return 1;
}

/* Euclidean change of colour between the means of the samples next to the rim, on every ray. */
static void colour_steps(const RingSamples *r, int first_outside, float *steps)
{
    for (int i = 0; i < RADIAL; i++)
        steps[i] = 0;
    for (int c = 0; c < CHANNELS; c++)
        for (int i = 0; i < RADIAL; i++) {
            int32_t inside = 0, outside = 0;
            for (int n = 0; n < NEXT_TO_RIM; n++) {
                inside += r->bgr[first_outside - NEXT_TO_RIM + n][c][i];
                outside += r->bgr[first_outside + n][c][i];
            }
            float change = (float)inside / NEXT_TO_RIM - (float)outside / NEXT_TO_RIM;
            steps[i] += change * change;
        }
    for (int i = 0; i < RADIAL; i++)
        steps[i] = sqrtf(steps[i]);
}

INLINE int at_place(const int *counts, int place)
{
    int level = 0;
    for (int sum = counts[0]; sum <= place; sum += counts[level])
        level++;
    return level;
}

/* Medians of the colour inside, and how bright the darkest part of all is. 0 where nothing inside is in the picture. */
static int colours_of(const RingSamples *r, int disc, int count, double gain, EvidenceRow *row)
{
    int counts[CHANNELS][256] = {{0}}, darkest[256] = {0}, inside = 0, all = 0;
    for (int s = 0; s < count; s++)
        for (int i = 0; i < RADIAL; i++) {
            uint8_t b = r->bgr[s][0][i], g = r->bgr[s][1][i], least_of_two = b < g ? b : g, red = r->bgr[s][2][i];
            int seen = r->seen[s][i];
            darkest[least_of_two < red ? least_of_two : red] += seen, all += seen;
            if (s < disc)
                counts[0][b] += seen, counts[1][g] += seen, counts[2][red] += seen, inside += seen;
        }
    if (!inside)
        return 0;
    for (int c = 0; c < CHANNELS; c++)
        row->colour[c] = (at_place(counts[c], (inside - 1) / 2) + at_place(counts[c], inside / 2)) / 2.0 / gain;
    double place = (all - 1) * DARKEST, share = place - floor(place);
    double low = at_place(darkest, (int)place), apart = at_place(darkest, least(place + 1, all - 1)) - low;
    double dark = share < 0.5 ? low + apart * share : low + apart - apart * (1 - share);
    row->haze = least(dark / gain / FULL_VEIL, MOST_HAZE);
    return 1;
}

/* `evidence.measure`: 0 where hardly any of the rim is in the picture. */
static int measured_on(const Level *level, const Shape *shape, const EvidenceTables *t, int fused, EvidenceWork *w, EvidenceRow *row)
{
    RingSamples *r = &w->rings;
    float edge_step = (float)EDGE_STEP, shown_from = (float)SHOWN;
    int n = (int)t->disc, m = n + (int)t->inside, count = m + (int)t->inside, seen = 0, leaks = 0, covers = 0, visible = 0, empty = 0;
    int64_t red_area = 0, area = 0;
    float within[RADIAL], beyond[RADIAL], next[RADIAL], gap[RADIAL], steps[RADIAL];
    uint8_t used[RADIAL], red_within[RADIAL], red_next[RADIAL], shown[RADIAL], both[RADIAL];
    sampled_rings(&level->picture, shape, t->rings, count, t, fused, r);
    for (int i = 0; i < RADIAL; i++) {
        used[i] = 1;
        for (int s = m; s < count; s++)
            used[i] &= r->seen[s][i];
        seen += used[i];
    }
    if (seen < FEWEST_RAYS || !colours_of(r, n, count, t->gain, row))
        return 0;
    ray_medians(r->red + n, m - n, within);
    ray_medians(r->red + m, count - m, beyond);
    ray_medians(r->red + m, NEXT_TO_RIM, next);
    for (int i = 0; i < RADIAL; i++)
        gap[i] = within[i] - beyond[i];
    float reddish = marked_rank(beyond, used, 1, 3, w) + shown_from * marked_rank(gap, used, 2, 3, w);
    for (int i = 0; i < RADIAL; i++)
        both[i] = used[i] & (within[i] > reddish);
    float contrast = marked_median(gap, both, w), around = marked_median(beyond, used, w);
    float red_from = around + shown_from * contrast;
    colour_steps(r, m, steps);
    for (int i = 0; i < RADIAL; i++) {
        red_within[i] = within[i] > red_from, red_next[i] = next[i] > red_from;
        shown[i] = used[i] & red_within[i] & !red_next[i] & (gap[i] > shown_from * contrast) & (contrast > 0);
    }
    float usual = marked_median(steps, shown, w);
    for (int i = 0; i < RADIAL; i++) {
        int edged = steps[i] > edge_step * usual, through = used[i] & red_within[i] & red_next[i];
        leaks += through & !edged;
        covers += used[i] & !red_within[i] & !red_next[i] & edged;
        visible += shown[i] | (through & edged);
        both[i] = used[i] & red_within[i];
    }
    row->redness = (double)marked_median(within, both, w);
    for (int i = 0; i < RADIAL; i++) {
        float off = gap[i] - contrast;
        gap[i] = off < 0 ? -off : off;
        int red = 0;
        for (int s = CORE_FIRST; s <= CORE_LAST; s++)
            red += r->red[s][i] > red_from;
        empty += 2 * red < CORE_LAST - CORE_FIRST + 1;
    }
    for (int s = 0; s < n; s++)
        for (int i = 0; i < RADIAL; i++) {
            int white = r->bgr[s][0][i] >= WHITE && r->bgr[s][1][i] >= WHITE && r->bgr[s][2][i] >= WHITE;
            int counts = r->seen[s][i] & !white;
            area += (s + 1) * counts;
            red_area += (s + 1) * (counts & (r->red[s][i] > red_from));
        }
    row->coverage = (double)visible / seen, row->leak = (double)leaks / seen;
    row->covered = (double)covers / seen, row->visible = (double)visible / RADIAL;
    row->contrast = (double)contrast, row->noise = (double)((float)SIGMAS * marked_median(gap, shown, w));
    row->rise = (double)(even_median(r->red, CORE_END, w) - around);
    row->fill = (double)red_area / (double)(area ? area : 1);
    row->hollow = (double)empty / RADIAL;
    return 1;
}

/* On which level something of this radius is measured, px of the full frame. */
INLINE const Level *level_for(const Level *levels, int64_t count, double radius)
{
    int octave;
    frexp(most(radius / EVIDENCE_RADIUS_PX / (double)levels->factor, 1e-9), &octave);
    return levels + (octave < 1 ? 0 : octave > count ? count - 1 : octave - 1);
}

/* `evidence.gather` of SEEDS, `evidence.of_ellipses`, or `rings.red_ends_plain`, whose answer is `found`. */
static void gathered_evidence(const Level *levels, int64_t level_count, EvidenceRow *rows, int64_t count, int64_t kind,
                              const EvidenceTables *t, int fused, EvidenceWork *w)
{
    for (int64_t k = 0; k < count; k++) {
        Shape *s = &rows[k].shape;
        const Level *level = level_for(levels, level_count, s->across);
        double factor = (double)level->factor, middle = (factor - 1) / 2;
        s->u = (s->u - middle) / factor, s->v = (s->v - middle) / factor;
        s->along /= factor, s->across /= factor;
        if (kind == ENDS)
            rows[k].found = red_ends(&level->picture, s, t, fused, &w->rings, &w->outwards);
        else
            rows[k].found = (kind != SEEDS || rim_round(level, s, t, fused, w)) && measured_on(level, s, t, fused, w, rows + k);
        s->u = s->u * factor + middle, s->v = s->v * factor + middle;
        s->along *= factor, s->across *= factor;
    }
}

#endif
