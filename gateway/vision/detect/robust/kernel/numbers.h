/* Sums in a fixed order, order statistics and small systems of equations.
 *
 * Four sums run side by side and are added at the end, in wide registers and without them: the result is the same to the
 * last bit. Numbers of rays are multiples of four.
 */
#ifndef GATEWAY_NUMBERS_H
#define GATEWAY_NUMBERS_H

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

#define INLINE static inline

typedef double Four __attribute__((vector_size(32)));

enum { FEW = 16 }; /* values are sorted, not partitioned */

INLINE double least(double a, double b) { return b < a ? b : a; }
INLINE double most(double a, double b) { return b > a ? b : a; }
INLINE double within(double low, double value, double high) { return least(most(value, low), high); }

/* out[k] = sum of a[i] b[k][i], `n` of them; `rows` (at most 6) of b are `pitch` apart. */
INLINE void dots(const double *a, const double *b, ptrdiff_t pitch, int rows, ptrdiff_t n, double *out)
{
    Four sums[6], x, y;
    for (int k = 0; k < rows; k++)
        sums[k] = (Four){0, 0, 0, 0};
    for (ptrdiff_t i = 0; i < n; i += 4) {
        memcpy(&x, a + i, sizeof x);
        for (int k = 0; k < rows; k++) {
            memcpy(&y, b + k * pitch + i, sizeof y);
            sums[k] += x * y;
        }
    }
    for (int k = 0; k < rows; k++)
        out[k] = (sums[k][0] + sums[k][1]) + (sums[k][2] + sums[k][3]);
}

INLINE double dot(const double *a, const double *b, ptrdiff_t n)
{
    double sum;
    dots(a, b, 0, 1, n, &sum);
    return sum;
}

INLINE double total(const double *a, ptrdiff_t n)
{
    Four sum = {0, 0, 0, 0}, x;
    for (ptrdiff_t i = 0; i < n; i += 4) {
        memcpy(&x, a + i, sizeof x);
        sum += x;
    }
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* The value that would be at place k (0 to n - 1) if a were sorted. `a` is overwritten; `room` for 2 n values. */
static double nth(double *a, ptrdiff_t n, ptrdiff_t k, double *room)
{
    double *low = room, *high = room + n;
    while (n > FEW) {
        double x = a[0], y = a[n / 2], z = a[n - 1];
        double pivot = most(least(x, y), least(most(x, y), z));
        ptrdiff_t below = 0, above = 0;
        for (ptrdiff_t i = 0; i < n; i++) { /* without a branch that depends on the data */
            low[below] = high[above] = a[i];
            below += a[i] < pivot;
            above += a[i] > pivot;
        }
        double *rest = a;
        if (k < below) {
            a = low, low = rest, n = below;
        } else if (k < n - above) {
            return pivot;
        } else {
            a = high, high = rest, k -= n - above, n = above;
        }
    }
    for (ptrdiff_t i = 1; i < n; i++) {
        double value = a[i];
        ptrdiff_t j = i;
        for (; j > 0 && a[j - 1] > value; j--)
            a[j] = a[j - 1];
        a[j] = value;
    }
    return a[k];
}

/* The values that have a mark, in order; how many. */
INLINE ptrdiff_t chosen(const double *values, const double *mark, ptrdiff_t n, double *out)
{
    ptrdiff_t count = 0;
    for (ptrdiff_t i = 0; i < n; i++) {
        out[count] = values[i];
        count += mark[i] > 0;
    }
    return count;
}

/* Of the values with a mark, without interpolation; 0 of none. `room` for 3 (n + 1) values. */
INLINE double quantile(const double *values, const double *mark, ptrdiff_t n, double share, double *room)
{
    ptrdiff_t count = chosen(values, mark, n, room);
    return count ? nth(room, count, (ptrdiff_t)(share * (double)count), room + n + 1) : 0;
}

/* Solve a x = b by Cholesky for symmetric a (n x n, its lower half used) and b (n x m), in place. 0 where a pivot is below
 * `smallest`. */
INLINE int solved(double *a, double *b, int n, int m, double smallest)
{
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            double s = a[i * n + j];
            for (int k = 0; k < j; k++)
                s -= a[i * n + k] * a[j * n + k];
            if (j < i)
                a[i * n + j] = s * a[j * n + j];
            else if (s < smallest)
                return 0;
            else
                a[i * n + i] = 1 / sqrt(s);
        }
    }
    for (int c = 0; c < m; c++) {
        for (int i = 0; i < n; i++) {
            double s = b[i * m + c];
            for (int k = 0; k < i; k++)
                s -= a[i * n + k] * b[k * m + c];
            b[i * m + c] = s * a[i * n + i];
        }
        for (int i = n - 1; i >= 0; i--) {
            double s = b[i * m + c];
            for (int k = i + 1; k < n; k++)
                s -= a[k * n + i] * b[k * m + c];
            b[i * m + c] = s * a[i * n + i];
        }
    }
    return 1;
}

#endif
