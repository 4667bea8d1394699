/* How much redder it is well inside a rim than well outside: `refinement.fall_plain`. */
#ifndef GATEWAY_FALL_H
#define GATEWAY_FALL_H

#include "refined.h"

/* Of the task's outline, `search_px` to either side of it; 0 where no ray lies in the frame. */
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
        falls[count] = (double)(rays->samples[i] - rays->samples[FALL_RAYS + i]) * tables->opponent_unit;
        count += rays->inside[i] > 0;
    }
    if (!count)
        return 0;
    memcpy(seen, falls, sizeof seen);
    double middle = nth(seen, count, count / 2, w->fit.room);
    return count % 2 ? middle : (middle + nth(falls, count, count / 2 - 1, w->fit.room)) / 2;
}

#endif
