/* The fine stage: the shift of a blurred step along every ray, and the ellipse through the steps: `rim_fine.py`. */
#ifndef GATEWAY_FINE_H
#define GATEWAY_FINE_H

#include "coarse.h"

typedef struct { /* `normal_profiles.Profile` */
    double offsets[PROFILE_STEPS], filters[4 * PROFILE_STEPS], gram[16];
} Profile;

typedef struct {
    double shift[MOST_RAYS], own[MOST_RAYS], variance[MOST_RAYS], weight[MOST_RAYS], noise[MOST_RAYS];
    double level[CHANNELS][MOST_RAYS], height[CHANNELS][MOST_RAYS], moved[CHANNELS][MOST_RAYS], spread[CHANNELS][MOST_RAYS];
    double clear[CHANNELS + 1][MOST_RAYS], usually[CHANNELS + 1][MOST_RAYS], energy[MOST_RAYS];
    double power[MOST_RAYS], strange[MOST_RAYS], room[3 * (MOST_RAYS + 1)];
} Edges;

/* Level, height, shift and spread of the step in every channel of every ray, and what they leave unexplained. */
static void filtered(const Rays *rays, const Profile *profile, Edges *e)
{
    int count = rays->count, steps = rays->steps;
    for (int i = 0; i < count; i++)
        e->noise[i] = 0;
    for (int c = 0; c < rays->channels; c++) {
        double *f[4] = {e->level[c], e->height[c], e->moved[c], e->spread[c]};
        for (int i = 0; i < count; i++)
            f[0][i] = f[1][i] = f[2][i] = f[3][i] = e->energy[i] = 0;
        for (int s = 0; s < steps; s++) {
            const uint8_t *samples = rays->samples + (s * rays->channels + c) * count;
            double w0 = profile->filters[s], w1 = profile->filters[steps + s], w2 = profile->filters[2 * steps + s],
                   w3 = profile->filters[3 * steps + s];
            for (int i = 0; i < count; i++) {
                double value = (double)(int32_t)samples[i] * rays->unit;
                e->level[c][i] += w0 * value;
                e->height[c][i] += w1 * value;
                e->moved[c][i] += w2 * value;
                e->spread[c][i] += w3 * value;
                e->energy[i] += value * value;
            }
        }
        for (int i = 0; i < count; i++) {
            double explained = 0;
            for (int k = 0; k < 4; k++) {
                double sum = 0;
                for (int j = 0; j < 4; j++)
                    sum += profile->gram[4 * k + j] * f[j][i];
                explained += f[k][i] * sum;
            }
            e->noise[i] += e->energy[i] - explained;
        }
    }
    for (int i = 0; i < count; i++)
        e->noise[i] = e->noise[i] / (rays->channels * (steps - 4)) + NOISE_FLOOR;
}

/* `rim_fine._measure` */
static void measured(const Rays *rays, const Profile *profile, const double *table, double sigma, Edges *e)
{
    int count = rays->count, channels = rays->channels;
    const double *inside = rays->inside, *smooth = table + SMOOTH * count;
    double sums[CHANNELS + 1];
    filtered(rays, profile, e);
    for (int i = 0; i < count; i++)
        e->own[i] = e->strange[i] = 0;
    for (int c = 0; c < channels; c++)
        for (int i = 0; i < count; i++)
            e->own[i] += e->height[c][i] * e->height[c][i];
    double usual = most(quantile(e->own, inside, count, 0.5, e->room), 1);
    double quiet = quantile(e->noise, inside, count, QUIET_QUANTILE, e->room);
    double *clear = e->clear[channels];
    for (int i = 0; i < count; i++)
        clear[i] = inside[i] > 0 && e->own[i] > CLEAR * usual;
    for (int c = 0; c < channels; c++)
        for (int i = 0; i < count; i++)
            e->clear[c][i] = e->height[c][i] * clear[i];
    memset(e->usually, 0, sizeof e->usually);
    for (int m = 0; m < SMOOTH_ROWS; m++) {
        const double *row = smooth + m * count;
        dots(row, e->clear[0], MOST_RAYS, channels + 1, count, sums);
        for (int c = 0; c <= channels; c++)
            for (int i = 0; i < count; i++)
                e->usually[c][i] += sums[c] * row[i];
    }
    for (int c = 0; c < channels; c++)
        for (int i = 0; i < count; i++)
            e->usually[c][i] /= most(e->usually[channels][i], LEAST_CLEAR);
    for (int i = 0; i < count; i++) {
        double power = 0, shift = 0, spread = 0, square = sigma * sigma;
        for (int c = 0; c < channels; c++) {
            power += e->usually[c][i] * e->usually[c][i];
            shift += e->moved[c][i] * e->usually[c][i];
            spread += e->spread[c][i] * e->usually[c][i];
        }
        e->power[i] = power = most(power, 1);
        e->shift[i] = shift / power;
        e->variance[i] = square + within(-square, spread / power, MOST_VARIANCE * square);
    }
    for (int c = 0; c < channels; c++) {
        double *inner = e->level[c];
        for (int i = 0; i < count; i++)
            inner[i] += e->height[c][i];
        ptrdiff_t n = count;
        if (rays->inside_count)
            n = chosen(inner, inside, count, e->room);
        else
            memcpy(e->room, inner, (size_t)count * sizeof *inner);
        double middle = nth(e->room, n, n / 2, e->room + count + 1);
        for (int i = 0; i < count; i++)
            e->strange[i] += (inner[i] - middle) * (inner[i] - middle);
    }
    for (int i = 0; i < count; i++) {
        double strange = e->strange[i] / (STRANGE * e->power[i] + STRANGE_GREY2), plain = least(QUIET * quiet / e->noise[i], 1);
        double weight = least(e->power[i] / usual, MOST_POWER) / (1 + strange * strange);
        plain *= plain;
        weight *= plain * plain;
        int none = (clear[i] == 0) | (e->own[i] < LEAST_POWER) | (fabs(e->shift[i]) > SHIFT_SIGMAS * sigma + SHIFT_PX);
        e->weight[i] = none ? 0 : weight;
    }
}

/* Variance of the blur across the rim by direction: constant, cos 2 phi, sin 2 phi. `rim_fine._blur` */
static void blur_of(const double *table, const Edges *e, int count, double *room, double *blur)
{
    static const double ridge[3] = {BLUR_RIDGE, BLUR_WAVE_RIDGE, BLUR_WAVE_RIDGE};
    double information[9], sum = total(e->weight, count) + 1e-9;
    const double *waves[3] = {NULL, table + COS2 * count, table + SIN2 * count};
    for (int r = 0; r < 3; r++) {
        for (int i = 0; i < count; i++)
            room[i] = r ? waves[r][i] * e->weight[i] : e->weight[i];
        information[3 * r] = total(room, count);
        dots(room, waves[1], count, 2, count, information + 3 * r + 1); /* the rows follow each other */
        blur[r] = dot(room, e->variance, count);
    }
    for (int r = 0; r < 3; r++)
        information[4 * r] += ridge[r] * sum;
    if (!solved(information, blur, 3, 1, DBL_MIN))
        blur[0] = blur[1] = blur[2] = 0;
}

/* Rms over the sectors of their mean residuals. */
INLINE double wave_px_of(const Fit *fit, int count)
{
    int size = count / SECTORS, seen = 0;
    double squares = 0;
    for (int s = 0; s < SECTORS; s++) {
        double heft = 0, mean = 0;
        for (int i = s * size; i < (s + 1) * size; i++) {
            heft += fit->weights[i];
            mean += fit->weights[i] * fit->residuals[i];
        }
        if (heft > 0) {
            mean /= heft;
            squares += mean * mean;
            seen++;
        }
    }
    return sqrt(squares / seen);
}

#endif
