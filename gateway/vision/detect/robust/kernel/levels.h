/* Smaller pictures, and pictures less a veil: `redness.reduced_plain` and `veil.unveiled`. */
#ifndef GATEWAY_LEVELS_H
#define GATEWAY_LEVELS_H

#include "bilinear.h"
#include "wide.h"

typedef struct { /* `sparse_kernel._Unveiling` */
    Picture picture;
    const float *light; /* (rows, width, 3): of the veil, in every column */
    const int32_t *above, *below; /* (height,): the rows of light that a row of the picture lies between */
    const float *share; /* (height,): of the lower one */
    double gain;
    uint8_t *out;
} Unveiling;

#if HAS_WIDE
WIDE static inline __m256i eight_pixels(const uint8_t *p)
{
    const __m256i pairs = _mm256_setr_epi8(0, 3, 1, 4, 2, 5, 6, 9, 7, 10, 8, 11, -1, -1, -1, -1, 0, 3, 1, 4, 2, 5, 6, 9, 7, 10, 8, 11, -1, -1, -1, -1);
    __m128i left = _mm_loadu_si128((const __m128i *)(const void *)p), right = _mm_loadu_si128((const __m128i *)(const void *)(p + 12));
    __m256i both = _mm256_inserti128_si256(_mm256_castsi128_si256(left), right, 1);
    return _mm256_maddubs_epi16(_mm256_shuffle_epi8(both, pairs), _mm256_set1_epi8(1)); /* sums of neighbours, 6 to a half */
}

/* Up to a whole number of fours; how many pixels of the result there are. 4 bytes beyond each are read and written.
 * What lies `ahead` is fetched meanwhile: a new frame is in no cache, and rows are longer than a page of memory. */
WIDE static inline int64_t halved_wide(const uint8_t *above, const uint8_t *below, int64_t width, int64_t ahead, uint8_t *out)
{
    int64_t x = 0;
    for (; x + 6 <= width; x += 4, above += 24, below += 24, out += 12) {
        __builtin_prefetch(above + ahead), __builtin_prefetch(below + ahead);
        __m256i sums = _mm256_add_epi16(eight_pixels(above), eight_pixels(below));
        __m256i means = _mm256_srli_epi16(_mm256_add_epi16(sums, _mm256_set1_epi16(2)), 2);
        __m256i packed = _mm256_packus_epi16(means, means);
        _mm_storel_epi64((__m128i *)(void *)out, _mm256_castsi256_si128(packed));
        _mm_storel_epi64((__m128i *)(void *)(out + 6), _mm256_extracti128_si256(packed, 1));
    }
    return x;
}
#endif

/* `out`: (height / 2, width / 2) pixels, each the mean of four, rounded half up. */
INLINE void halved(const Picture *p, uint8_t *out)
{
    int64_t width = p->width / 2;
    for (int64_t y = 0; y < p->height / 2; y++, out += 3 * width) {
        const uint8_t *above = p->pixels + 2 * y * p->stride, *below = above + p->stride;
        int64_t x = 0;
#if HAS_WIDE
        if (has_wide())
            x = halved_wide(above, below, width, y + 1 < p->height / 2 ? 2 * p->stride : 0, out);
#endif
        for (; x < width; x++)
            for (int64_t c = 3 * x; c < 3 * x + 3; c++) {
                int64_t at = c + 3 * x;
                out[c] = (uint8_t)((above[at] + above[at + 3] + below[at] + below[at + 3] + 2) >> 2);
            }
    }
}

/* `out`: (height / by, width / by) pixels, each the mean of by x by, rounded half to even. `sums`: room for 3 * width. */
INLINE void reduced(const Picture *p, int64_t by, uint16_t *sums, uint8_t *out)
{
    int64_t columns = p->width / by, count = 3 * by * columns;
    float share = 1.0f / (float)(by * by);
    for (int64_t y = 0; y < p->height / by; y++) {
        const uint8_t *row = p->pixels + y * by * p->stride;
        for (int64_t i = 0; i < count; i++)
            sums[i] = row[i];
        for (int64_t n = 1; n < by; n++) {
            row += p->stride;
            for (int64_t i = 0; i < count; i++)
                sums[i] = (uint16_t)(sums[i] + row[i]);
        }
        const uint16_t *from = sums;
        for (int64_t x = 0; x < columns; x++, out += 3) {
            int32_t total[3] = {0, 0, 0};
            for (int64_t n = 0; n < by; n++, from += 3)
                total[0] += from[0], total[1] += from[1], total[2] += from[2];
            for (int c = 0; c < 3; c++)
                out[c] = (uint8_t)(int32_t)(((float)total[c] * share + 8388608.0f) - 8388608.0f); /* 2^23: rounds to even */
        }
    }
}

/* Each row less the light between two of its own, not below 0, times the gain. */
INLINE void unveiled(const Unveiling *t)
{
    const Picture *p = &t->picture;
    float gain = (float)t->gain;
    int64_t count = 3 * p->width;
    for (int64_t y = 0; y < p->height; y++) {
        const uint8_t *from = p->pixels + y * p->stride;
        const float *above = t->light + t->above[y] * count, *below = t->light + t->below[y] * count;
        uint8_t *out = t->out + y * count;
        float lower = t->share[y], upper = 1 - lower;
        for (int64_t i = 0; i < count; i++) {
            float left = (float)from[i] - (above[i] * upper + below[i] * lower);
            float value = (left > 0 ? left : 0) * gain;
            out[i] = (uint8_t)(int32_t)(((value < 255 ? value : 255) + 8388608.0f) - 8388608.0f); /* 2^23: rounds to even */
        }
    }
}

#endif
