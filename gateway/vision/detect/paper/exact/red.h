/* Which of a row's colours are red.
 *
 * The arbiter is a table of 2^24 bits, index b + 256 g + 65536 r, made from OpenCV's own conversion and thresholds. Where
 * the processor has AVX2, 32 pixels at once are put into one of three classes first: red, not red, or too close to a
 * threshold to say, which the table decides. The bounds between the classes come with the table, from the same source,
 * and `gateway_disagreements` compares all 2^24 colours before they are used.
 */
#ifndef GATEWAY_RED_H
#define GATEWAY_RED_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "wide.h"

/* Two tables behind each other: a bit for each pair (g, r), index g + 256 r, set where any b makes it red; then the bit of
 * each colour. The first has 8 KB and stays in the nearest cache: it spares most of the way to the second, of 2 MB. */
enum { PAIR_BYTES = 256 * 256 / 8 };

/* A number f = q d - p x of the largest less the least channel d and another x: red has f >= maybe, and f >= sure is
 * enough. 0 < q, p < 128, so that f fits 16 bits. */
typedef struct {
    int32_t q, p, maybe, sure;
} Bound;

/* Red needs r to be the largest channel, r >= value, and all three bounds: x = r (saturation), g - b and b - g (hue, on
 * either side of 0; 0 where negative). `wide`: 1 if all that is so. `green`: see `maybe.h`. */
typedef struct {
    int32_t wide, value;
    Bound saturation, yellow, purple;
    int32_t green;
} Rule;

/* One load of four bytes: a row has one to spare. */
static inline int red(const uint8_t *p, const uint8_t *tables)
{
    uint32_t colour;
    memcpy(&colour, p, sizeof colour);
#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
    colour = __builtin_bswap32(colour);
#endif
    colour &= 0xFFFFFF;
    uint32_t pair = colour >> 8;
    if (!(tables[pair >> 3] >> (pair & 7) & 1))
        return 0;
    return tables[PAIR_BYTES + (colour >> 3)] >> (colour & 7) & 1;
}

#if HAS_WIDE
typedef struct {
    __m256i factors, maybe, sure;
} WideBound;

WIDE static inline WideBound widened(const Bound *bound)
{
    uint16_t factors = (uint16_t)((uint8_t)bound->q | (uint16_t)((uint8_t)-bound->p << 8));
    return (WideBound){_mm256_set1_epi16((int16_t)factors), _mm256_set1_epi16((int16_t)(bound->maybe - 1)),
                       _mm256_set1_epi16((int16_t)(bound->sure - 1))};
}

/* Narrow `maybe` and `sure`, 32 bytes each, by one bound. */
WIDE static inline void hold(const WideBound *bound, __m256i d, __m256i x, __m256i *maybe, __m256i *sure)
{
    __m256i low = _mm256_maddubs_epi16(_mm256_unpacklo_epi8(d, x), bound->factors);
    __m256i high = _mm256_maddubs_epi16(_mm256_unpackhi_epi8(d, x), bound->factors);
    *maybe = _mm256_and_si256(*maybe, _mm256_packs_epi16(_mm256_cmpgt_epi16(low, bound->maybe),
                                                         _mm256_cmpgt_epi16(high, bound->maybe)));
    *sure = _mm256_and_si256(*sure, _mm256_packs_epi16(_mm256_cmpgt_epi16(low, bound->sure),
                                                       _mm256_cmpgt_epi16(high, bound->sure)));
}

/* 16 bytes at p and 16 at p + 48: the same third of two groups of 16 pixels. */
WIDE static inline __m256i third(const uint8_t *p)
{
    __m128i low = _mm_loadu_si128((const __m128i *)(const void *)p);
    __m128i high = _mm_loadu_si128((const __m128i *)(const void *)(p + 48));
    return _mm256_inserti128_si256(_mm256_castsi128_si256(low), high, 1);
}

/* One channel of 32 pixels, gathered from the three thirds. */
WIDE static inline __m256i channel(__m256i a, __m256i b, __m256i c, __m128i from_a, __m128i from_b, __m128i from_c)
{
    return _mm256_or_si256(_mm256_or_si256(_mm256_shuffle_epi8(a, _mm256_broadcastsi128_si256(from_a)),
                                           _mm256_shuffle_epi8(b, _mm256_broadcastsi128_si256(from_b))),
                           _mm256_shuffle_epi8(c, _mm256_broadcastsi128_si256(from_c)));
}

/* As `red_row`, for n >= 32. */
WIDE static void red_row_wide(const uint8_t *row, ptrdiff_t n, const Rule *rule, const uint8_t *tables, uint8_t *out)
{
    const __m128i b_a = _mm_setr_epi8(0, 3, 6, 9, 12, 15, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1);
    const __m128i b_b = _mm_setr_epi8(-1, -1, -1, -1, -1, -1, 2, 5, 8, 11, 14, -1, -1, -1, -1, -1);
    const __m128i b_c = _mm_setr_epi8(-1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, 1, 4, 7, 10, 13);
    const __m128i g_a = _mm_setr_epi8(1, 4, 7, 10, 13, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1);
    const __m128i g_b = _mm_setr_epi8(-1, -1, -1, -1, -1, 0, 3, 6, 9, 12, 15, -1, -1, -1, -1, -1);
    const __m128i g_c = _mm_setr_epi8(-1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, 2, 5, 8, 11, 14);
    const __m128i r_a = _mm_setr_epi8(2, 5, 8, 11, 14, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1);
    const __m128i r_b = _mm_setr_epi8(-1, -1, -1, -1, -1, 1, 4, 7, 10, 13, -1, -1, -1, -1, -1, -1);
    const __m128i r_c = _mm_setr_epi8(-1, -1, -1, -1, -1, -1, -1, -1, -1, -1, 0, 3, 6, 9, 12, 15);
    const WideBound saturation = widened(&rule->saturation), yellow = widened(&rule->yellow),
                    purple = widened(&rule->purple);
    const __m256i value = _mm256_set1_epi8((int8_t)rule->value);

    for (ptrdiff_t done = 0; done < n; done += WIDE_BYTES) {
        if (done > n - WIDE_BYTES)
            done = n - WIDE_BYTES; /* some of it again */
        const uint8_t *p = row + 3 * done;
        __m256i a = third(p), b = third(p + 16), c = third(p + 32);
        __m256i blue = channel(a, b, c, b_a, b_b, b_c), green = channel(a, b, c, g_a, g_b, g_c),
                red_ = channel(a, b, c, r_a, r_b, r_c);
        __m256i most = _mm256_max_epu8(_mm256_max_epu8(blue, green), value);
        __m256i maybe = _mm256_cmpeq_epi8(_mm256_max_epu8(most, red_), red_), sure = maybe;
        __m256i d = _mm256_sub_epi8(red_, _mm256_min_epu8(blue, green)); /* means something only where r is largest */
        hold(&saturation, d, red_, &maybe, &sure);
        if (!_mm256_testz_si256(maybe, maybe)) {
            hold(&yellow, d, _mm256_subs_epu8(green, blue), &maybe, &sure);
            hold(&purple, d, _mm256_subs_epu8(blue, green), &maybe, &sure);
        }
        sure = _mm256_and_si256(sure, maybe);
        _mm256_storeu_si256((__m256i *)(void *)(out + done), sure);
        for (uint32_t open = (uint32_t)_mm256_movemask_epi8(_mm256_andnot_si256(sure, maybe)); open; open &= open - 1) {
            int i = __builtin_ctz(open);
            out[done + i] = (uint8_t)-red(p + 3 * i, tables);
        }
    }
}
#endif

/* 255 for each of the row's n pixels that is red, else 0. `row` has one byte more than 3 n that may be read. */
static inline void red_row(const uint8_t *row, ptrdiff_t n, const Rule *rule, const uint8_t *tables, uint8_t *out)
{
#if HAS_WIDE
    if (n >= WIDE_BYTES && rule->wide && has_wide()) {
        red_row_wide(row, n, rule, tables, out);
        return;
    }
#else
    (void)rule;
#endif
    for (ptrdiff_t i = 0; i < n; i++)
        out[i] = (uint8_t)-red(row + 3 * i, tables);
}

#endif
