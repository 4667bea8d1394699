/* The robust fit of an ellipse to offsets along its normals: `support.fit`. */
#ifndef GATEWAY_FIT_H
#define GATEWAY_FIT_H

#include "rays.h"

typedef struct {
    double smallest_scale, largest_scale;
    int rounds;
} FitOptions;

typedef struct {
    Outline outline;
    double step_px;
    double design[5 * MOST_RAYS], weights[MOST_RAYS], residuals[MOST_RAYS];
    double moves[MOST_RAYS], weighted[MOST_RAYS], room[3 * (MOST_RAYS + 1)];
} Fit;

/* How the offset along every normal answers to (du, dv, x, y, z): five rows of `count`. */
static void designed(const Outline *o, const double *table, const double *support, int count, double *design)
{
    double mean = mean_of(o);
    memcpy(design, table + COS * count, 2 * (size_t)count * sizeof *design);
    for (int i = 0; i < count; i++) {
        double share = mean / support[i];
        design[2 * count + i] = share;
        design[3 * count + i] = table[COS2 * count + i] * share;
        design[4 * count + i] = table[SIN2 * count + i] * share;
    }
}

static void answered(const double *design, const double *change, const double *offsets, int count, double *moves, double *residuals)
{
    for (int i = 0; i < count; i++) {
        double move = change[0] * design[i] + change[1] * design[count + i] + change[2] * design[2 * count + i] +
                      change[3] * design[3 * count + i] + change[4] * design[4 * count + i];
        moves[i] = move;
        residuals[i] = offsets[i] - move;
    }
}

/* `support._scale` of the residuals' sizes, of usable rays that the last round did not reject. */
INLINE double scale_of(const double *residuals, const double *weights, int count, double cut, double *room)
{
    ptrdiff_t n = 0;
    for (int i = 0; i < count; i++) {
        room[n] = fabs(residuals[i]);
        n += (weights[i] > 0) & (room[n] < cut);
    }
    return n ? nth(room, n, (ptrdiff_t)(SCALE_QUANTILE * (double)n), room + MOST_RAYS + 1) / QUANTILE_SIGMAS : 0;
}

/* `support._toward_circle` */
static void doubted(const Outline *o, const double *information, const Fit *fit, int count, double *change)
{
    double sum = total(fit->weights, count), squares = dot(fit->weights, fit->weights, count);
    double rays = sum * sum / squares;
    double a[9], b[6], misfit = 0;
    if (!(rays > 6))
        return;
    for (int i = 0; i < count; i++)
        misfit += fit->weights[i] * (fit->residuals[i] * fit->residuals[i]);
    double variance = misfit / (rays - 5), half = 0.5 / mean_of(o);
    double y = change[3] + o->beta * half, z = change[4] + o->gamma * half;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            a[3 * i + j] = information[5 * i + j];
        b[2 * i] = information[5 * i + 3], b[2 * i + 1] = information[5 * i + 4];
    }
    if (!solved(a, b, 3, 2, DBL_EPSILON))
        return;
    double precision[4];
    for (int i = 0; i < 2; i++) {
        for (int j = 0; j < 2; j++) {
            double s = 0;
            for (int k = 0; k < 3; k++)
                s += information[5 * (3 + i) + k] * b[2 * k + j];
            precision[2 * i + j] = information[5 * (3 + i) + 3 + j] - s;
        }
    }
    double evidence = (y * (y * precision[0] + z * precision[2]) + z * (y * precision[1] + z * precision[3])) / most(variance, 1e-12);
    double share = evidence > 0 ? least(1, DOUBT / evidence) : 1;
    y *= share, z *= share;
    for (int i = 0; i < 3; i++)
        change[i] += b[2 * i] * y + b[2 * i + 1] * z;
    change[3] -= y, change[4] -= z;
}

/* `support._moved` */
INLINE int moved(const Outline *o, const double *change, Outline *to)
{
    double mean = mean_of(o), twice = 2 * mean, x = change[2], y = change[3], z = change[4];
    to->u = o->u + change[0];
    to->v = o->v + change[1];
    to->alpha = o->alpha + twice * x + x * x + (y * y + z * z) / 2;
    to->beta = o->beta + twice * y;
    to->gamma = o->gamma + twice * z;
    return real(to) && mean + x > 0;
}

/* 0 where the rays don't suffice. `change`: where to start; overwritten. `fit->design` is that of the outline. */
static int fitted(const Outline *o, const double *offsets, const double *weights, int count, double *change,
                  const FitOptions *options, Fit *fit)
{
    double information[25], solution[5], matrix[25], cut = INFINITY;
    int usable = 0;
    for (int i = 0; i < count; i++)
        usable += weights[i] > 0;
    if (usable < FEWEST_EDGES)
        return 0;
    double ridge = FIT_RIDGE * total(weights, count);
    answered(fit->design, change, offsets, count, fit->moves, fit->residuals);
    for (int turn = 0; turn < options->rounds; turn++) {
        if (turn < SCALED_ROUNDS) {
            double scale = scale_of(fit->residuals, weights, count, cut, fit->room);
            cut = TUKEY * least(most(scale, options->smallest_scale), options->largest_scale);
        }
        double inverse = 1 / cut;
        for (int i = 0; i < count; i++) {
            double heft = fit->residuals[i] * inverse;
            heft = most(1 - heft * heft, 0);
            fit->weights[i] = heft * heft * weights[i];
        }
        for (int r = 0; r < 5; r++) {
            double row[6];
            for (int i = 0; i < count; i++)
                fit->weighted[i] = fit->design[r * count + i] * fit->weights[i];
            dots(fit->weighted, fit->design + r * count, count, 5 - r, count, row);
            for (int c = r; c < 5; c++)
                information[5 * r + c] = information[5 * c + r] = row[c - r];
            solution[r] = dot(fit->weighted, offsets, count);
        }
        information[18] += ridge, information[24] += ridge;
        memcpy(matrix, information, sizeof matrix);
        if (!solved(matrix, solution, 5, 1, DBL_EPSILON))
            return 0;
        memcpy(change, solution, sizeof solution);
        answered(fit->design, change, offsets, count, fit->moves, fit->residuals);
    }
    doubted(o, information, fit, count, change);
    answered(fit->design, change, offsets, count, fit->moves, fit->residuals);
    fit->step_px = 0;
    for (int i = 0; i < count; i++)
        fit->step_px = most(fit->step_px, fabs(fit->moves[i]));
    return moved(o, change, &fit->outline);
}

#endif
