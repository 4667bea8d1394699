/* The two passes of the blur, with weights of 16ths: down, then along. All sums fit 16 bits: 16 (255 * 16 + 8) < 65536.
 *
 * Rounding half up adds 128 to the sum of 256ths. The first pass adds 8 to each of its sums, which the second makes 16
 * times as much of.
 */
#ifndef GATEWAY_BLUR_H
#define GATEWAY_BLUR_H

#include <stddef.h>
#include <stdint.h>

#include "wide.h"

enum { ROUNDING = 8 };

#if HAS_WIDE
/* 32 sums. Each pair of rows is interleaved, weighted and added in one step. */
WIDE static inline void add_rows_at(const uint8_t *const *rows, ptrdiff_t i, __m256i w0, __m256i w1, __m256i w2,
                                    uint16_t *sums)
{
    const __m256i one = _mm256_set1_epi8(1);
    __m256i r0 = bytes(rows[0] + i), r1 = bytes(rows[1] + i), r2 = bytes(rows[2] + i), r3 = bytes(rows[3] + i),
            r4 = bytes(rows[4] + i);
    __m256i low = _mm256_add_epi16(_mm256_maddubs_epi16(_mm256_unpacklo_epi8(r2, one), w0),
                                   _mm256_add_epi16(_mm256_maddubs_epi16(_mm256_unpacklo_epi8(r1, r3), w1),
                                                    _mm256_maddubs_epi16(_mm256_unpacklo_epi8(r0, r4), w2)));
    __m256i high = _mm256_add_epi16(_mm256_maddubs_epi16(_mm256_unpackhi_epi8(r2, one), w0),
                                    _mm256_add_epi16(_mm256_maddubs_epi16(_mm256_unpackhi_epi8(r1, r3), w1),
                                                     _mm256_maddubs_epi16(_mm256_unpackhi_epi8(r0, r4), w2)));
    _mm256_storeu_si256((__m256i *)(void *)(sums + i), _mm256_permute2x128_si256(low, high, 0x20));
    _mm256_storeu_si256((__m256i *)(void *)(sums + i + 16), _mm256_permute2x128_si256(low, high, 0x31));
}

WIDE static void add_rows_wide(const uint8_t *const *rows, ptrdiff_t n, const uint16_t *w, uint16_t *sums)
{
    const __m256i w0 = _mm256_set1_epi16((int16_t)(w[0] | ROUNDING << 8)), w1 = _mm256_set1_epi16((int16_t)(w[1] | w[1] << 8)),
                  w2 = _mm256_set1_epi16((int16_t)(w[2] | w[2] << 8));
    for (ptrdiff_t i = 0; i + WIDE_BYTES < n; i += WIDE_BYTES)
        add_rows_at(rows, i, w0, w1, w2, sums);
    add_rows_at(rows, n - WIDE_BYTES, w0, w1, w2, sums); /* some of it again */
}

WIDE static inline __m256i words(const uint16_t *p) { return _mm256_loadu_si256((const __m256i *)(const void *)p); }

WIDE static inline __m256i add_columns_at(const uint16_t *t, __m256i w0, __m256i w1, __m256i w2)
{
    __m256i beside = _mm256_mullo_epi16(_mm256_add_epi16(words(t - 3), words(t + 3)), w1);
    __m256i beyond = _mm256_mullo_epi16(_mm256_add_epi16(words(t - 6), words(t + 6)), w2);
    return _mm256_srli_epi16(_mm256_add_epi16(_mm256_mullo_epi16(words(t), w0), _mm256_add_epi16(beside, beyond)), 8);
}

WIDE static void add_columns_wide(const uint16_t *t, ptrdiff_t n, const uint16_t *w, uint8_t *row)
{
    const __m256i w0 = _mm256_set1_epi16((int16_t)w[0]), w1 = _mm256_set1_epi16((int16_t)w[1]),
                  w2 = _mm256_set1_epi16((int16_t)w[2]);
    for (ptrdiff_t i = 0;; i = i + 2 * WIDE_BYTES <= n ? i + WIDE_BYTES : n - WIDE_BYTES) {
        __m256i both = _mm256_packus_epi16(add_columns_at(t + i, w0, w1, w2), add_columns_at(t + i + 16, w0, w1, w2));
        _mm256_storeu_si256((__m256i *)(void *)(row + i), _mm256_permute4x64_epi64(both, 0xD8));
        if (i + WIDE_BYTES >= n)
            return;
    }
}
#endif

/* sums[i] = the weighted sum of byte i of five rows, and ROUNDING. */
static inline void add_rows(const uint8_t *const *rows, ptrdiff_t n, const uint16_t *w, uint16_t *restrict sums)
{
#if HAS_WIDE
    if (n >= WIDE_BYTES && has_wide()) {
        add_rows_wide(rows, n, w, sums);
        return;
    }
#endif
    const uint16_t w0 = w[0], w1 = w[1], w2 = w[2];
    const uint8_t *r0 = rows[0], *r1 = rows[1], *r2 = rows[2], *r3 = rows[3], *r4 = rows[4];
    for (ptrdiff_t i = 0; i < n; i++)
        sums[i] = (uint16_t)(w0 * r2[i] + w1 * (uint16_t)(r1[i] + r3[i]) + w2 * (uint16_t)(r0[i] + r4[i]) + ROUNDING);
}

/* row[i] = the weighted sum of t[i] and its neighbours, 3 and 6 before and behind it, over 256. */
static inline void add_columns(const uint16_t *restrict t, ptrdiff_t n, const uint16_t *w, uint8_t *restrict row)
{
#if HAS_WIDE
    if (n >= WIDE_BYTES && has_wide()) {
        add_columns_wide(t, n, w, row);
        return;
    }
#endif
    const uint16_t w0 = w[0], w1 = w[1], w2 = w[2];
    for (ptrdiff_t i = 0; i < n; i++)
        row[i] = (uint8_t)((uint16_t)(w0 * t[i] + w1 * (uint16_t)(t[i - 3] + t[i + 3])
                                      + w2 * (uint16_t)(t[i - 6] + t[i + 6])) >> 8);
}

#endif
