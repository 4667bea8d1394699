/* Where nothing of a row can be red: seen before the second pass of the blur, with a third of the instructions.
 *
 * Red needs little green: a number k <= 31 (`Rule.green`, read off the table of colours; 0: there is none) is such that
 * 32 g <= k r + 26 for every red colour. Take the first pass of the blur only, down, rounded up at each step: v of a channel
 * is at least the exact weighted mean of the five rows, V, and less than V + 1.2. f(v) is at least k v / 32. Where
 *
 *     v_green > f(v_red) + 2, so V_green > k V_red / 32 + 1.8
 *
 * in all columns that the second pass takes together, the same holds for what it makes of them, since it is a weighted mean
 * and the condition is linear. Rounded half up: g > k r / 32 + 1.8 - 0.5 - 0.5 k / 32, so 32 g > k r + 26: not red.
 */
#ifndef GATEWAY_MAYBE_H
#define GATEWAY_MAYBE_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "red.h"
#include "wide.h"

enum { GREEN_BITS = 5, SLACK = 2 }; /* binary places of k; see above */

static inline ptrdiff_t chunks_of(ptrdiff_t pixels) { return (pixels + CHUNK_PX - 1) / CHUNK_PX; }

#if HAS_WIDE
WIDE static inline __m256i down_at(const uint8_t *const *rows, ptrdiff_t i)
{
    __m256i middle = bytes(rows[2] + i), outer = _mm256_avg_epu8(bytes(rows[0] + i), bytes(rows[4] + i));
    outer = _mm256_avg_epu8(_mm256_avg_epu8(outer, middle), middle);
    return _mm256_avg_epu8(_mm256_avg_epu8(bytes(rows[1] + i), bytes(rows[3] + i)), outer);
}

/* may[j] = 0 where all pixels of chunk j, 32 j to 32 j + 31 of n >= 32, have too much green to be red, as above. */
WIDE static void may_wide(const uint8_t *const *rows, ptrdiff_t n, int32_t green, uint8_t *may)
{
    const __m128i g_a = _mm_setr_epi8(1, 4, 7, 10, 13, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1);
    const __m128i g_b = _mm_setr_epi8(-1, -1, -1, -1, -1, 0, 3, 6, 9, 12, 15, -1, -1, -1, -1, -1);
    const __m128i g_c = _mm_setr_epi8(-1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, 2, 5, 8, 11, 14);
    const __m128i r_a = _mm_setr_epi8(2, 5, 8, 11, 14, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1);
    const __m128i r_b = _mm_setr_epi8(-1, -1, -1, -1, -1, 1, 4, 7, 10, 13, -1, -1, -1, -1, -1, -1);
    const __m128i r_c = _mm_setr_epi8(-1, -1, -1, -1, -1, -1, -1, -1, -1, -1, 0, 3, 6, 9, 12, 15);
    const __m256i none = _mm256_setzero_si256(), slack = _mm256_set1_epi8(SLACK);
    __m256i place[GREEN_BITS];
    for (int i = 0; i < GREEN_BITS; i++)
        place[i] = _mm256_set1_epi8(green >> i & 1 ? -1 : 0);

    for (ptrdiff_t j = 0; j < chunks_of(n); j++) {
        ptrdiff_t i = 3 * (CHUNK_PX * (j + 1) > n ? n - CHUNK_PX : CHUNK_PX * j);
        __m256i first = down_at(rows, i), second = down_at(rows, i + 32), last = down_at(rows, i + 64);
        /* the same thirds of two groups of 16 pixels, as `red_row_wide` has them */
        __m256i a = _mm256_permute2x128_si256(first, second, 0x30), b = _mm256_permute2x128_si256(first, last, 0x21),
                c = _mm256_permute2x128_si256(second, last, 0x30);
        __m256i g = channel(a, b, c, g_a, g_b, g_c), r = channel(a, b, c, r_a, r_b, r_c), f = none;
        for (int k = 0; k < GREEN_BITS; k++)
            f = _mm256_avg_epu8(f, _mm256_and_si256(r, place[k])); /* f(v): half of it and a place more, rounded up */
        __m256i maybe = _mm256_cmpeq_epi8(_mm256_subs_epu8(_mm256_subs_epu8(g, f), slack), none);
        may[j] = !_mm256_testz_si256(maybe, maybe);
    }
}
#endif

/* Whether `may`, room for chunks_of(n) bytes, could be told for a row of n pixels. */
static inline int may_be_red(const uint8_t *const *rows, ptrdiff_t n, const Rule *rule, uint8_t *may)
{
#if HAS_WIDE
    if (n >= CHUNK_PX && rule->green && has_wide()) {
        may_wide(rows, n, rule->green, may);
        return 1;
    }
#else
    (void)rows, (void)n, (void)rule, (void)may;
#endif
    return 0;
}

#endif
