/* Erosion and dilation with squares, 64 pixels to a word: bit i of word j is pixel 64 j + i of its row. */
#ifndef GATEWAY_MORPH_H
#define GATEWAY_MORPH_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "wide.h"

#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(GATEWAY_NARROW)
#define EACH_CPU __attribute__((target_clones("avx2", "default"))) /* the loader picks what the processor has */
#else
#define EACH_CPU
#endif

enum { BITS = 64 };

/* Two pictures that are written in turn: a window of w x h pixels and `pad` on every side; `pitch` words a row. A row may
 * hold bits beyond that, of no meaning. `inside`, `before` and `behind` are rows: where the window is, and what is left
 * and right of it. One word behind each picture may be read. */
typedef struct {
    uint64_t *now, *other, *inside, *before, *behind;
    ptrdiff_t w, h, pad, pitch;
} Sheet;

static inline ptrdiff_t words_of(ptrdiff_t bits) { return (bits + BITS - 1) / BITS; }

/* Bits from `first` to `end` - 1 of a row. */
static void set_bits(uint64_t *row, ptrdiff_t first, ptrdiff_t end)
{
    for (ptrdiff_t i = first; i < end; i++)
        row[i / BITS] |= (uint64_t)1 << i % BITS;
}

/* In memory of 2 pitch (h + 2 pad) + 3 pitch + 2 words, where pitch = words_of(w + 2 pad). */
static Sheet sheet_in(uint64_t *memory, ptrdiff_t w, ptrdiff_t h, ptrdiff_t pad)
{
    ptrdiff_t pitch = words_of(w + 2 * pad), picture = pitch * (h + 2 * pad) + 1;
    Sheet sheet = {memory, memory + picture, memory + 2 * picture, NULL, NULL, w, h, pad, pitch};
    sheet.before = sheet.inside + pitch;
    sheet.behind = sheet.before + pitch;
    memset(sheet.inside, 0, 3 * (size_t)pitch * sizeof *memory);
    set_bits(sheet.before, 0, pad);
    set_bits(sheet.inside, pad, pad + w);
    set_bits(sheet.behind, pad + w, w + 2 * pad);
    return sheet;
}

/* to[i] = a[i] and, or or, what lies `shift` < 64 pixels (along), or as many words (down) behind it. */
EACH_CPU static void both_along(uint64_t *restrict to, const uint64_t *restrict a, int shift, ptrdiff_t n)
{
    for (ptrdiff_t i = 0; i < n; i++)
        to[i] = a[i] & (a[i] >> shift | a[i + 1] << (BITS - shift));
}

EACH_CPU static void either_along(uint64_t *restrict to, const uint64_t *restrict a, int shift, ptrdiff_t n)
{
    for (ptrdiff_t i = 0; i < n; i++)
        to[i] = a[i] | (a[i] >> shift | a[i + 1] << (BITS - shift));
}

EACH_CPU static void both_down(uint64_t *restrict to, const uint64_t *restrict a, ptrdiff_t shift, ptrdiff_t n)
{
    for (ptrdiff_t i = 0; i < n; i++)
        to[i] = a[i] & a[i + shift];
}

EACH_CPU static void either_down(uint64_t *restrict to, const uint64_t *restrict a, ptrdiff_t shift, ptrdiff_t n)
{
    for (ptrdiff_t i = 0; i < n; i++)
        to[i] = a[i] | a[i + shift];
}

static void swap(Sheet *sheet)
{
    uint64_t *now = sheet->now;
    sheet->now = sheet->other;
    sheet->other = now;
}

/* All, or any, of every square of `side` (odd, < 64), whose upper left corner the result is written to: in doubling steps,
 * along the rows, then down. What comes in from the next row stays outside the window. */
static void squares(Sheet *sheet, ptrdiff_t side, int any)
{
    ptrdiff_t n = (sheet->h + 2 * sheet->pad) * sheet->pitch;
    for (ptrdiff_t len = 1, step; len < side; len += step) {
        step = 2 * len <= side ? len : side - len;
        (any ? either_along : both_along)(sheet->other, sheet->now, (int)step, n);
        swap(sheet);
    }
    for (ptrdiff_t len = 1, step; len < side; len += step) {
        step = 2 * len <= side ? len : side - len;
        n -= step * sheet->pitch;
        (any ? either_down : both_down)(sheet->other, sheet->now, step * sheet->pitch, n);
        swap(sheet);
    }
}

/* Move the window, which begins `at` pixels and rows from the corner, at <= pad, to the middle, and set what is round it:
 * each side all ones or all zeros. */
static void centre(Sheet *sheet, ptrdiff_t at, int left, int top, int right, int bottom)
{
    ptrdiff_t pad = sheet->pad, pitch = sheet->pitch;
    int shift = (int)(pad - at);
    for (ptrdiff_t y = 0; y < sheet->h; y++) {
        const uint64_t *from = sheet->now + (y + at) * pitch;
        uint64_t *to = sheet->other + (y + pad) * pitch;
        for (ptrdiff_t i = 0; i < pitch; i++) {
            uint64_t moved = !shift ? from[i] : from[i] << shift | (i ? from[i - 1] >> (BITS - shift) : 0);
            to[i] = (moved & sheet->inside[i]) | (left ? sheet->before[i] : 0) | (right ? sheet->behind[i] : 0);
        }
    }
    size_t border = (size_t)(pad * pitch) * sizeof *sheet->other;
    memset(sheet->other, top ? 255 : 0, border);
    memset(sheet->other + (sheet->h + pad) * pitch, bottom ? 255 : 0, border);
    swap(sheet);
}

#if HAS_WIDE
WIDE static ptrdiff_t pack_wide(const uint8_t *from, ptrdiff_t n, uint64_t *to)
{
    ptrdiff_t i = 0;
    for (; i + BITS <= n; i += BITS)
        to[i / BITS] = (uint32_t)_mm256_movemask_epi8(bytes(from + i))
                       | (uint64_t)(uint32_t)_mm256_movemask_epi8(bytes(from + i + WIDE_BYTES)) << WIDE_BYTES;
    return i;
}

WIDE static ptrdiff_t unpack_wide(const uint64_t *from, ptrdiff_t at, ptrdiff_t n, uint8_t *to)
{
    const __m256i which = _mm256_setr_epi64x(0, 0x0101010101010101, 0x0202020202020202, 0x0303030303030303);
    const __m256i bit = _mm256_set1_epi64x((int64_t)0x8040201008040201);
    ptrdiff_t i = 0;
    for (; i + WIDE_BYTES <= n; i += WIDE_BYTES) {
        const uint64_t *word = from + (at + i) / BITS;
        int skip = (int)((at + i) % BITS);
        uint64_t bits = *word >> skip;
        if (skip > BITS - WIDE_BYTES)
            bits |= word[1] << (BITS - skip);
        __m256i spread = _mm256_shuffle_epi8(_mm256_set1_epi32((int32_t)(uint32_t)bits), which);
        _mm256_storeu_si256((__m256i *)(void *)(to + i), _mm256_cmpeq_epi8(_mm256_and_si256(spread, bit), bit));
    }
    return i;
}
#endif

/* n bytes of 0 or 255 to bits, from bit 0 on; the rest of the last word is cleared. */
static void pack(const uint8_t *from, ptrdiff_t n, uint64_t *to)
{
    ptrdiff_t i = 0;
#if HAS_WIDE
    if (has_wide())
        i = pack_wide(from, n, to);
#endif
    for (uint64_t bits = 0; i < n; i++) {
        bits |= (uint64_t)(from[i] & 1) << i % BITS;
        if (i % BITS == BITS - 1 || i == n - 1) {
            to[i / BITS] = bits;
            bits = 0;
        }
    }
}

/* n bits, from bit `at` on, to bytes of 0 or 255. */
static void unpack(const uint64_t *from, ptrdiff_t at, ptrdiff_t n, uint8_t *to)
{
    ptrdiff_t i = 0;
#if HAS_WIDE
    if (has_wide())
        i = unpack_wide(from, at, n, to);
#endif
    for (; i < n; i++)
        to[i] = (uint8_t)-(from[(at + i) / BITS] >> (at + i) % BITS & 1);
}

#endif
