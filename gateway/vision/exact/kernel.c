/* The loops of the exact shortcuts: the red test on a lattice, for which OpenCV has no call, and the masks of a window, for
 * which it has several, made for larger pictures.
 *
 * All blur with the separable kernel (w[2] w[1] w[0] w[1] w[2])^2 / 256, rounded half up, the border mirrored without
 * repeating the edge pixel, which is OpenCV's 8-bit Gaussian of side 1, 3 or 5; and both look the blurred colour up in a
 * table of 2^24 bits, index b + 256 g + 65536 r, which is made from OpenCV's own conversion and thresholds. Nothing here
 * knows what red is. All sums fit 16 bits: 255 * 16 * 16 + 128 < 65536.
 *
 * No allocation, no global state, no call out: the caller gives all memory. Pictures are BGR, 3 bytes a pixel, rows
 * `stride` bytes apart.
 */
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifndef GATEWAY_SOURCE
#define GATEWAY_SOURCE 0
#endif

#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__)
#define EACH_CPU __attribute__((target_clones("avx2", "default"))) /* the loader picks what the processor has */
#else
#define EACH_CPU
#endif

#define TILE 512 /* pixels of a row that are blurred at once: five rows of them stay in the nearest cache */
#define HALO 2 /* pixels that a kernel of side 5 needs beyond each end of a row */

/* Checksum of the source that this was built from: a stale library is told from a fresh one. */
uint32_t gateway_source(void) { return (uint32_t)GATEWAY_SOURCE; }

static ptrdiff_t mirrored(ptrdiff_t i, ptrdiff_t n)
{
    if (n == 1)
        return 0;
    while (i < 0 || i >= n)
        i = i < 0 ? -i : 2 * n - 2 - i;
    return i;
}

/* Row y, columns x0 to x1 - 1, blurred, into `row` (3 bytes a pixel). `sums` has room for x1 - x0 + 2 HALO pixels. */
EACH_CPU static void blur_row(const uint8_t *image, ptrdiff_t stride, ptrdiff_t height, ptrdiff_t width, ptrdiff_t y,
                              ptrdiff_t x0, ptrdiff_t x1, const uint16_t *w, uint16_t *restrict sums,
                              uint8_t *restrict row)
{
    const uint8_t *restrict r0 = image + mirrored(y - 2, height) * stride;
    const uint8_t *restrict r1 = image + mirrored(y - 1, height) * stride;
    const uint8_t *restrict r2 = image + y * stride;
    const uint8_t *restrict r3 = image + mirrored(y + 1, height) * stride;
    const uint8_t *restrict r4 = image + mirrored(y + 2, height) * stride;
    const uint16_t w0 = w[0], w1 = w[1], w2 = w[2];
    ptrdiff_t from = x0 - HALO < 0 ? 0 : x0 - HALO, to = x1 + HALO > width ? width : x1 + HALO;
    uint16_t *restrict s = sums - 3 * (x0 - HALO); /* s[3 x + channel] */

    for (ptrdiff_t i = 3 * from; i < 3 * to; i++)
        s[i] = (uint16_t)(w0 * r2[i] + w1 * (uint16_t)(r1[i] + r3[i]) + w2 * (uint16_t)(r0[i] + r4[i]));
    for (ptrdiff_t x = x0 - HALO; x < from; x++)
        for (int c = 0; c < 3; c++)
            s[3 * x + c] = s[3 * mirrored(x, width) + c];
    for (ptrdiff_t x = to; x < x1 + HALO; x++)
        for (int c = 0; c < 3; c++)
            s[3 * x + c] = s[3 * mirrored(x, width) + c];

    const uint16_t *restrict t = sums + 3 * HALO;
    ptrdiff_t n = 3 * (x1 - x0);
    for (ptrdiff_t i = 0; i < n; i++)
        row[i] = (uint8_t)((uint16_t)(w0 * t[i] + w1 * (uint16_t)(t[i - 3] + t[i + 3])
                                      + w2 * (uint16_t)(t[i - 6] + t[i + 6]) + 128) >> 8);
}

/* Two tables behind each other: a bit for each pair (g, r), index g + 256 r, set where any b makes it red; then the bit of
 * each colour. The first has 8 KB and stays in the nearest cache: it spares most of the way to the second, of 2 MB. */
enum { PAIR_BYTES = 256 * 256 / 8 };

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

/* cells[i][j] = 1 where row ys[i] has a horizontal run of red over column xs[j] that is at least `side` pixels long, or
 * at least (side + 1) / 2 and touches the picture's left or right edge, or fills the row; else 0. Columns ascend. */
void gateway_scan(const uint8_t *image, ptrdiff_t stride, ptrdiff_t height, ptrdiff_t width, const int32_t *ys,
                  ptrdiff_t rows, const int32_t *xs, ptrdiff_t columns, ptrdiff_t side, const uint16_t *w,
                  const uint8_t *tables, uint16_t *sums, uint8_t *row, uint8_t *cells)
{
    for (ptrdiff_t i = 0; i < rows; i++) {
        uint8_t *out = cells + i * columns;
        ptrdiff_t j = 0, clear = 0; /* columns left of `clear` have been dealt with */
        for (ptrdiff_t x = 0; x < width; x += TILE)
            blur_row(image, stride, height, width, ys[i], x, x + TILE < width ? x + TILE : width, w, sums, row + 3 * x);
        while (j < columns) {
            ptrdiff_t a = xs[j], b = a;
            if (!red(row + 3 * a, tables)) {
                clear = a + 1;
                out[j++] = 0;
                continue;
            }
            while (a > clear && red(row + 3 * (a - 1), tables))
                a--;
            while (b + 1 < width && red(row + 3 * (b + 1), tables))
                b++;
            ptrdiff_t need = a == 0 || b == width - 1 ? (side + 1) / 2 : side;
            uint8_t found = b - a + 1 >= (need < width ? need : width);
            while (j < columns && xs[j] <= b)
                out[j++] = found;
            clear = b + 1;
        }
    }
}

/* Where the blurred pixel is red 255, else 0, into rows `pitch` bytes apart. */
static void mask_window(const uint8_t *image, ptrdiff_t stride, ptrdiff_t height, ptrdiff_t width, ptrdiff_t x0,
                        ptrdiff_t y0, ptrdiff_t x1, ptrdiff_t y1, const uint16_t *w, const uint8_t *tables,
                        uint16_t *sums, uint8_t *row, uint8_t *mask, ptrdiff_t pitch)
{
    for (ptrdiff_t y = y0; y < y1; y++, mask += pitch) {
        blur_row(image, stride, height, width, y, x0, x1, w, sums, row);
        for (ptrdiff_t x = 0; x < x1 - x0; x++)
            mask[x] = (uint8_t)-red(row + 3 * x, tables);
    }
}

/* M_0 of a window, x1 - x0 bytes a row. */
void gateway_mask(const uint8_t *image, ptrdiff_t stride, ptrdiff_t height, ptrdiff_t width, ptrdiff_t x0, ptrdiff_t y0,
                  ptrdiff_t x1, ptrdiff_t y1, const uint16_t *w, const uint8_t *tables,
                  uint16_t *sums, uint8_t *row, uint8_t *mask)
{
    mask_window(image, stride, height, width, x0, y0, x1, y1, w, tables, sums, row, mask, x1 - x0);
}

EACH_CPU static void least(uint8_t *restrict to, const uint8_t *restrict a, ptrdiff_t shift, ptrdiff_t n)
{
    const uint8_t *restrict b = a + shift;
    for (ptrdiff_t i = 0; i < n; i++)
        to[i] = a[i] < b[i] ? a[i] : b[i];
}

EACH_CPU static void most(uint8_t *restrict to, const uint8_t *restrict a, ptrdiff_t shift, ptrdiff_t n)
{
    const uint8_t *restrict b = a + shift;
    for (ptrdiff_t i = 0; i < n; i++)
        to[i] = a[i] > b[i] ? a[i] : b[i];
}

/* Two pictures that are written in turn, h + 2 pad rows of `pitch` = w + 2 pad bytes, the window in their middle. */
typedef struct {
    uint8_t *now, *other;
    ptrdiff_t w, h, pad, pitch;
} Sheet;

/* The least or most of every square of `side` (odd), whose upper left corner the result is written to: in doubling steps
 * over the flat bytes, along rows, then down. What wraps from row to row stays outside the window. */
static void squares(Sheet *sheet, ptrdiff_t side, int want_most)
{
    ptrdiff_t n = (sheet->h + 2 * sheet->pad) * sheet->pitch;
    for (int down = 0; down < 2; down++) {
        ptrdiff_t unit = down ? sheet->pitch : 1;
        for (ptrdiff_t len = 1; len < side;) {
            ptrdiff_t step = 2 * len <= side ? len : side - len;
            n -= step * unit;
            (want_most ? most : least)(sheet->other, sheet->now, step * unit, n);
            uint8_t *swap = sheet->now;
            sheet->now = sheet->other;
            sheet->other = swap;
            len += step;
        }
    }
}

/* Move the window from where `squares` left it back to the middle, and set what is round it. */
static void centre(Sheet *sheet, ptrdiff_t side, int left, int top, int right, int bottom)
{
    ptrdiff_t pad = sheet->pad, off = pad - side / 2;
    for (ptrdiff_t y = 0; y < sheet->h; y++) {
        uint8_t *to = sheet->other + (y + pad) * sheet->pitch;
        memset(to, left, (size_t)pad);
        memcpy(to + pad, sheet->now + (y + off) * sheet->pitch + off, (size_t)sheet->w);
        memset(to + pad + sheet->w, right, (size_t)pad);
    }
    memset(sheet->other, top, (size_t)(pad * sheet->pitch));
    memset(sheet->other + (sheet->h + pad) * sheet->pitch, bottom, (size_t)(pad * sheet->pitch));
    uint8_t *swap = sheet->now;
    sheet->now = sheet->other;
    sheet->other = swap;
}

/* M_c of a window: M_0, erosion, dilation, dilation, erosion with a square of `side` (odd). Pixels outside the picture take
 * no part. Beyond the window's own edges all counts as not red for the first erosion, and as not there for the rest.
 * `sheets`: 2 (x1 - x0 + 4 r) (y1 - y0 + 4 r) bytes, r = side / 2. */
void gateway_clean(const uint8_t *image, ptrdiff_t stride, ptrdiff_t height, ptrdiff_t width, ptrdiff_t x0,
                   ptrdiff_t y0, ptrdiff_t x1, ptrdiff_t y1, ptrdiff_t side, const uint16_t *w, const uint8_t *tables,
                   uint16_t *sums, uint8_t *row, uint8_t *sheets, uint8_t *mask)
{
    ptrdiff_t pad = side / 2 * 2;
    Sheet sheet = {sheets, NULL, x1 - x0, y1 - y0, pad, x1 - x0 + 2 * pad};
    sheet.other = sheets + (sheet.h + 2 * pad) * sheet.pitch;
    mask_window(image, stride, height, width, x0, y0, x1, y1, w, tables, sums, row,
                sheet.now + pad * sheet.pitch + pad, sheet.pitch);
    centre(&sheet, 1, x0 > 0 ? 0 : 255, y0 > 0 ? 0 : 255, x1 < width ? 0 : 255, y1 < height ? 0 : 255);
    squares(&sheet, side, 0);
    centre(&sheet, side, 0, 0, 0, 0);
    squares(&sheet, 2 * side - 1, 1);
    centre(&sheet, 2 * side - 1, 255, 255, 255, 255);
    squares(&sheet, side, 0);
    ptrdiff_t off = pad - side / 2;
    for (ptrdiff_t y = 0; y < sheet.h; y++)
        memcpy(mask + y * sheet.w, sheet.now + (y + off) * sheet.pitch + off, (size_t)sheet.w);
}
