/* All of the refinement, for the registers that the including file chooses. */
#ifndef GATEWAY_REFINED_H
#define GATEWAY_REFINED_H

#include "fine.h"

#define PI 3.14159265358979323846

enum { NONE, FOUND, NO_PROFILE };
enum { DIRECTIONS = MOST_RAYS / RAYS_STEP + 1 };

typedef struct { /* `rim_kernel._Tables` */
    const double *coarse, *directions[DIRECTIONS]; /* by the number of rays over RAYS_STEP */
    const double *filter;
    Subsets subsets[2];
    Lab lab;
    int64_t fused; /* whether OpenCV multiplies and adds at once */
} Tables;

typedef struct { /* `rim_kernel._Task`: what is asked, how far it has come, and the result */
    Picture picture;
    Outline outline;
    double search_px, sigma; /* 0: the coarse stage, which guesses the blur, is still to come */
    int64_t opponent, turn;
    const int64_t *profile_keys; /* (n, 3): tenths of sigma, steps to either side, hundredths of a step */
    const Profile *profiles;
    int64_t profile_count;
    int64_t missing[3]; /* the profile that is needed, where it is not among the tables */
    double rms_px, contrast, blur_px, wave_px;
    int64_t inliers, inside, rays;
} Task;

typedef struct {
    Rays rays;
    Fit fit;
    union {
        Coarse coarse;
        Edges edges;
    };
} Work;

INLINE int sane(const Outline *o, const Picture *p)
{
    if (!real(o) || minor_of(o) < SMALLEST_AXIS_PX || major_of(o) > LARGEST_AXIS_PX)
        return 0;
    double reach = major_of(o);
    return -reach < o->u && o->u < (double)p->width + reach && -reach < o->v && o->v < (double)p->height + reach;
}

INLINE const Profile *profile_of(const Task *task, const int64_t *key)
{
    for (int64_t n = 0; n < task->profile_count; n++)
        if (!memcmp(task->profile_keys + 3 * n, key, 3 * sizeof *key))
            return task->profiles + n;
    return NULL;
}

INLINE int reported(const Rays *rays, Work *w, double sigma, Task *task)
{
    int count = rays->count, inliers = 0;
    double squares = 0, height[MOST_RAYS];
    for (int i = 0; i < count; i++) {
        int in = w->fit.weights[i] > 0;
        inliers += in;
        squares += in ? w->fit.residuals[i] * w->fit.residuals[i] : 0;
        height[i] = sqrt(w->edges.own[i]);
    }
    if ((double)inliers / count < LEAST_VISIBLE)
        return NONE;
    task->rms_px = sqrt(squares / inliers);
    task->contrast = quantile(height, w->fit.weights, count, 0.5, w->edges.room);
    task->blur_px = sigma;
    task->wave_px = wave_px_of(&w->fit, count);
    task->inliers = inliers, task->inside = rays->inside_count, task->rays = count;
    return FOUND;
}

/* One round of the fine stage: NONE, FOUND, NO_PROFILE, or -1 where another is needed. */
static int round_of(Task *task, const Tables *tables, Work *w, int fused)
{
    Outline *o = &task->outline;
    double sigma = task->sigma, room = ROOM * minor_of(o);
    double even = RAYS_STEP * nearbyint(2 * PI * mean_of(o) / RAYS_STEP);
    int count = (int)least(most(LEAST_RAYS, even), MOST_RAYS);
    double step = least(most(STEP_PX, STEP_SIGMAS * sigma), room / LEAST_STEPS);
    int64_t half = (int64_t)ceil(least(most(RAY_SIGMAS * sigma + RAY_PX, SHORTEST_RAY_PX), room) / step);
    int64_t key[3] = {(int64_t)nearbyint(10 * sigma), half, (int64_t)nearbyint(100 * step)};
    const Profile *profile = profile_of(task, key);
    const double *table = tables->directions[count / RAYS_STEP];
    if (!profile) {
        memcpy(task->missing, key, sizeof key);
        return NO_PROFILE;
    }
    int steps = 2 * (int)half + 1;
    if (!sampled(&task->picture, o, table, count, profile->offsets, steps, least(FRAME_PX + sigma, room),
                 task->opponent ? &tables->lab : NULL, fused, &w->rays))
        return NONE;
    measured(&w->rays, profile, table, sigma, &w->edges);
    double blur[3], change[5] = {0}, offsets[MOST_RAYS];
    blur_of(table, &w->edges, count, w->fit.weighted, blur);
    double beta = o->beta, gamma = o->gamma, bend = 0.5 / (o->alpha * o->alpha - (beta * beta + gamma * gamma));
    for (int i = 0; i < count; i++) {
        double h = w->rays.support[i];
        double along = blur[0] - blur[1] * table[COS2 * count + i] - blur[2] * table[SIN2 * count + i];
        offsets[i] = w->edges.shift[i] + most(along, 0) * (h * h * h * bend);
    }
    FitOptions options = {.smallest_scale = FINE_SCALE_PX, .largest_scale = most(LARGEST_SCALE_PX, LARGEST_SCALE * mean_of(o)),
                          .rounds = FINE_ROUNDS};
    designed(o, table, w->rays.support, count, w->fit.design);
    if (!fitted(o, offsets, w->edges.weight, count, change, &options, &w->fit) || !sane(&w->fit.outline, &task->picture))
        return NONE;
    *o = w->fit.outline;
    task->sigma = least(most(rounded_tenth(sqrt(most(blur[0], 0))), SHARPEST_PX), most(SOFTEST * minor_of(o), SOFTEST_PX));
    double grown = task->sigma - sigma;
    int still = w->fit.step_px < STILL_SIGMAS * task->sigma && -SHRUNK * task->sigma <= grown && grown <= GROWN * task->sigma;
    return still || ++task->turn >= ROUNDS ? reported(&w->rays, w, task->sigma, task) : -1;
}

static int refined(Task *task, const Tables *tables, Work *w, int fused)
{
    Outline *o = &task->outline;
    w->rays.unit = task->opponent ? OPPONENT : 1;
    if (!sane(o, &task->picture) || !(task->search_px > 0))
        return NONE;
    if (!(task->sigma > 0)) {
        double offsets[COARSE_STEPS], step = least(task->search_px, FARTHEST * minor_of(o)) / HALF_STEPS;
        for (int s = 0; s < COARSE_STEPS; s++)
            offsets[s] = (double)(float)((s - HALF_STEPS) * step);
        if (!sampled(&task->picture, o, tables->coarse, COARSE_RAYS, offsets, COARSE_STEPS, 0, task->opponent ? &tables->lab : NULL,
                     fused, &w->rays) ||
            !coarsely(&w->rays, tables->coarse, tables->filter, tables->subsets, step, o, &task->sigma, &w->coarse, &w->fit) ||
            !sane(o, &task->picture))
            return NONE;
    }
    for (;;) {
        int done = round_of(task, tables, w, fused);
        if (done >= 0)
            return done;
    }
}

/* How much redder it is well inside the task's outline than well outside, `search_px` to either side of it; 0 where no ray
 * lies in the frame: `refinement.fall_plain`. */
static double fall(const Task *task, const Tables *tables, Work *w, int fused)
{
    Rays *rays = &w->rays;
    double apart = (double)(float)task->search_px, offsets[2] = {-apart, apart}, falls[FALL_RAYS], seen[FALL_RAYS];
    int count = 0;
    if (!sane(&task->outline, &task->picture) ||
        !sampled(&task->picture, &task->outline, tables->directions[FALL_RAYS / RAYS_STEP], FALL_RAYS, offsets, 2, task->search_px,
                 &tables->lab, fused, rays))
        return 0;
    for (int i = 0; i < FALL_RAYS; i++) {
        falls[count] = rays->samples[i] * OPPONENT - rays->samples[FALL_RAYS + i] * OPPONENT;
        count += rays->inside[i] > 0;
    }
    if (!count)
        return 0;
    memcpy(seen, falls, sizeof seen);
    double middle = nth(seen, count, count / 2, w->fit.room);
    return count % 2 ? middle : (middle + nth(falls, count, count / 2 - 1, w->fit.room)) / 2;
}

#endif
