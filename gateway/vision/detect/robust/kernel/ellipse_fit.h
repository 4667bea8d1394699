/* Circles and ellipses through points that are partly wrong: `ellipses.py`, of one candidate. */
#ifndef GATEWAY_ELLIPSE_FIT_H
#define GATEWAY_ELLIPSE_FIT_H

#include "ring_samples.h"

typedef struct { /* of the rays; weight 0: none */
    double u[RADIAL], v[RADIAL], weight[RADIAL];
} Points;

INLINE double length_of(double x, double y) { return sqrt(x * x + y * y); }

/* `ellipses.circles_by_consensus`: 0 where there is none. */
static int agreed_circle(const Points *p, const EvidenceTables *t, double tolerance, Shape *circle)
{
    double best = 0, worth[RADIAL];
    for (int64_t n = 0; n < t->triple_count; n++) {
        int32_t a = t->triples[3 * n], b = t->triples[3 * n + 1], c = t->triples[3 * n + 2];
        double ab[2] = {p->u[b] - p->u[a], p->v[b] - p->v[a]}, ac[2] = {p->u[c] - p->u[a], p->v[c] - p->v[a]};
        double twice = 2 * (ab[0] * ac[1] - ab[1] * ac[0]);
        if (!(p->weight[a] > 0 && p->weight[b] > 0 && p->weight[c] > 0 && fabs(twice) > 1e-6))
            continue;
        double bb = ab[0] * ab[0] + ab[1] * ab[1], cc = ac[0] * ac[0] + ac[1] * ac[1];
        double du = (ac[1] * bb - ab[1] * cc) / twice, dv = (ab[0] * cc - ac[0] * bb) / twice;
        double u = p->u[a] + du, v = p->v[a] + dv, radius = length_of(du, dv), inverse = 1 / tolerance;
        for (int i = 0; i < RADIAL; i++) {
            double gap = (length_of(p->u[i] - u, p->v[i] - v) - radius) * inverse;
            worth[i] = most(1 - gap * gap, 0);
        }
        double sum = dot(worth, p->weight, RADIAL);
        if (sum > best + SAME_WORTH) /* the first of equally good ones, whatever the order of the sums */
            best = sum, *circle = (Shape){u, v, radius, radius, 1, 0};
    }
    return best > 0;
}

/* `ellipses._axes`, without an angle: its cosine and sine. 0 for what is no ellipse. */
INLINE int axes_of(const double *solution, Shape *s)
{
    double a = 0.5 + solution[0], b = solution[1], c = 0.5 - solution[0], d = solution[2], e = solution[3], f = solution[4];
    double bottom = 4 * a * c - b * b;
    if (!(bottom > LEAST_BOTTOM))
        return 0;
    s->u = (b * e - 2 * c * d) / bottom, s->v = (b * d - 2 * a * e) / bottom;
    double rest = -(f + 0.5 * (d * s->u + e * s->v)), spread = length_of(a - c, b);
    if (!(rest > 0))
        return 0;
    s->along = sqrt(2 * rest / most(1 - spread, 1e-9)), s->across = sqrt(2 * rest / (1 + spread));
    s->cos = 1, s->sin = 0;
    if (spread > CIRCULAR) { /* half of the angle of (c - a, -b), from 0 to pi */
        double cos2 = (c - a) / spread, sin2 = -b / spread;
        if (cos2 < 0) {
            s->sin = sqrt((1 - cos2) / 2);
            s->cos = sin2 / (2 * s->sin);
        } else {
            s->cos = sqrt((1 + cos2) / 2);
            s->sin = sin2 / (2 * s->cos);
            if (s->sin < 0)
                s->cos = -s->cos, s->sin = -s->sin;
        }
    }
    return 1;
}

/* `ellipses._conics`: 0 where the points don't suffice. */
static int conic_through(const Points *p, const double *trust, Shape *s)
{
    double row[5][RADIAL], weighted[RADIAL], right[RADIAL], x[RADIAL], y[RADIAL], normal[25], solution[5];
    double sum = total(trust, RADIAL), u = dot(trust, p->u, RADIAL) / sum, v = dot(trust, p->v, RADIAL) / sum;
    int usable = 0;
    for (int i = 0; i < RADIAL; i++) {
        x[i] = p->u[i] - u, y[i] = p->v[i] - v;
        right[i] = x[i] * x[i] + y[i] * y[i];
        usable += trust[i] > LEAST_TRUST;
    }
    double scale = sqrt(dot(trust, right, RADIAL) / sum);
    if (usable < FEWEST_POINTS || !(scale > 1e-3))
        return 0;
    double shrunk = 1 / scale;
    for (int i = 0; i < RADIAL; i++) {
        x[i] *= shrunk, y[i] *= shrunk;
        row[0][i] = x[i] * x[i] - y[i] * y[i], row[1][i] = x[i] * y[i], row[2][i] = x[i], row[3][i] = y[i], row[4][i] = 1;
        right[i] = -0.5 * (x[i] * x[i] + y[i] * y[i]);
    }
    for (int r = 0; r < 5; r++) {
        for (int i = 0; i < RADIAL; i++)
            weighted[i] = row[r][i] * trust[i] / sum;
        double out[5];
        dots(weighted, row[r], RADIAL, 5 - r, RADIAL, out);
        for (int c = r; c < 5; c++)
            normal[5 * r + c] = normal[5 * c + r] = out[c - r];
        normal[6 * r] += 1e-9;
        solution[r] = dot(weighted, right, RADIAL);
    }
    if (!solved(normal, solution, 5, 1, DBL_MIN) || !axes_of(solution, s))
        return 0;
    s->u = u + scale * s->u, s->v = v + scale * s->v;
    s->along *= scale, s->across *= scale;
    return 1;
}

/* `ellipses.ellipses_by_weights`: from `s`; 0 where there is none. */
static int ellipse_near(const Points *p, double tolerance, Shape *s)
{
    double trust[RADIAL];
    for (int turn = 0; turn < ELLIPSE_ROUNDS; turn++) {
        for (int i = 0; i < RADIAL; i++) {
            double du = p->u[i] - s->u, dv = p->v[i] - s->v;
            double share = length_of((du * s->cos + dv * s->sin) / s->along, (dv * s->cos - du * s->sin) / s->across);
            double gap = length_of(du, dv) * (1 - 1 / most(share, 1e-3)) / tolerance;
            gap = most(1 - gap * gap, 0);
            trust[i] = p->weight[i] * (gap * gap);
        }
        if (!conic_through(p, trust, s))
            return 0;
    }
    return 1;
}

#endif
