/* Runs the refinement on tasks from a file, and prints each result in full: `bench/rim_bits.py` has both ends of it. */
#include "refined.h"
#include "task_file.h"

int gateway_rim(Task *task, const Tables *tables, Work *work);
double gateway_fall(const Task *task, const Tables *tables, Work *work);

int main(int count, char **words)
{
    FILE *file = count == 2 ? fopen(words[1], "rb") : NULL;
    if (!file)
        return 2;
    Work *work = malloc(sizeof *work);
    Tables *tables = part(file);
    tables->coarse = part(file);
    tables->directions[FALL_RAYS / RAYS_STEP] = part(file);
    for (int n = LEAST_RAYS / RAYS_STEP; n < DIRECTIONS; n++)
        tables->directions[n] = part(file);
    tables->filter = part(file);
    for (int n = 0; n < 2; n++) {
        tables->subsets[n].rays = part(file);
        tables->subsets[n].inverses = part(file);
    }
    tables->lab.linear = part(file);
    tables->lab.root = part(file);
    int64_t *keys = part(file);
    Profile *profiles = part(file);
    for (Task *task; (task = part(file));) {
        task->picture.pixels = part(file);
        task->profile_keys = keys, task->profiles = profiles;
        int result = gateway_rim(task, tables, work);
        const double results[9] = {task->outline.u, task->outline.v, task->outline.alpha, task->outline.beta, task->outline.gamma,
                                   task->rms_px, task->contrast, task->blur_px, task->wave_px};
        printf("%d %d", result, result == FOUND ? (int)task->inliers : 0);
        for (int n = 0; result == FOUND && n < 9; n++)
            printf(" %a", results[n]);
        task->search_px = 0.25 * minor_of(&task->outline);
        printf(" %a\n", gateway_fall(task, tables, work));
    }
    return 0;
}
