/* The loops of the exact shortcuts: the red test on a lattice, for which OpenCV has no call, and the masks of a window, for
 * which it has several, made for larger pictures.
 *
 * All blur with the separable kernel (w[2] w[1] w[0] w[1] w[2])^2 / 256, rounded half up, the border mirrored without
 * repeating the edge pixel, which is OpenCV's 8-bit Gaussian of side 1, 3 or 5 (`blur.h`). What is red stands in tables that
 * are made from OpenCV's own conversion and thresholds (`red.h`).
 *
 * No allocation, no global state, no call out: the caller gives all memory. Pictures are BGR, 3 bytes a pixel, rows
 * `stride` bytes apart.
 */
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "blur.h"
#include "maybe.h"
#include "morph.h"
#include "red.h"

#define TILE 128 /* pixels of a row at once: memory is then asked for the next ones evenly */
#define ROWS_AHEAD 8 /* of a window are fetched from memory before they are needed */
#define RED_WINDOW 192 /* pixels: a narrower window lies round something red, and holds little else */

/* The bytes from `first` to `end` - 1 will be read soon. */
static inline void fetch_ahead(const uint8_t *bytes, ptrdiff_t first, ptrdiff_t end)
{
#if defined(__GNUC__)
    for (ptrdiff_t i = first; i < end; i += 64)
        __builtin_prefetch(bytes + i, 0, 2);
#else
    (void)bytes, (void)first, (void)end;
#endif
}

static ptrdiff_t mirrored(ptrdiff_t i, ptrdiff_t n)
{
    if (n == 1)
        return 0;
    while (i < 0 || i >= n)
        i = i < 0 ? -i : 2 * n - 2 - i;
    return i;
}

/* Row y, columns x0 to x1 - 1, blurred, into `row` (3 bytes a pixel). `sums` has room for x1 - x0 + 2 HALO_PX pixels. */
static void blur_row(const uint8_t *image, ptrdiff_t stride, ptrdiff_t height, ptrdiff_t width, ptrdiff_t y, ptrdiff_t x0,
                     ptrdiff_t x1, const uint16_t *w, uint16_t *sums, uint8_t *row)
{
    ptrdiff_t from = x0 - HALO_PX < 0 ? 0 : x0 - HALO_PX, to = x1 + HALO_PX > width ? width : x1 + HALO_PX;
    uint16_t *s = sums - 3 * (x0 - HALO_PX); /* s[3 x + channel] */
    const uint8_t *rows[5];

    for (int i = 0; i < 5; i++)
        rows[i] = image + mirrored(y + i - HALO_PX, height) * stride + 3 * from;
    add_rows(rows, 3 * (to - from), w, s + 3 * from);
    for (ptrdiff_t x = x0 - HALO_PX; x < from; x++)
        memcpy(s + 3 * x, s + 3 * mirrored(x, width), 3 * sizeof *s);
    for (ptrdiff_t x = to; x < x1 + HALO_PX; x++)
        memcpy(s + 3 * x, s + 3 * mirrored(x, width), 3 * sizeof *s);
    add_columns(sums + 3 * HALO_PX, 3 * (x1 - x0), w, row);
}

/* Columns x0 to x1 - 1 of row y: where the blurred pixel is red 255, else 0. Returns 0 if no pixel is, and that was seen at
 * once, which is tried if `sparse`. `row`: room for 3 (x1 - x0) + 1 bytes; `may`: for chunks_of(x1 - x0 + 2 HALO_PX). */
static int mask_row(const uint8_t *image, ptrdiff_t stride, ptrdiff_t height, ptrdiff_t width, ptrdiff_t y, ptrdiff_t x0,
                    ptrdiff_t x1, const uint16_t *w, const Rule *rule, const uint8_t *tables, uint16_t *sums, uint8_t *row,
                    uint8_t *may, int sparse, uint8_t *mask)
{
    ptrdiff_t from = x0 - HALO_PX < 0 ? 0 : x0 - HALO_PX, to = x1 + HALO_PX > width ? width : x1 + HALO_PX, n = chunks_of(to - from);
    const uint8_t *rows[5];
    int any = 0;
    for (int i = 0; i < 5; i++)
        rows[i] = image + mirrored(y + i - HALO_PX, height) * stride + 3 * from;
    if (!sparse || !may_be_red(rows, to - from, rule, may)) {
        blur_row(image, stride, height, width, y, x0, x1, w, sums, row);
        red_row(row, x1 - x0, rule, tables, mask);
        return 1;
    }
    memset(mask, 0, (size_t)(x1 - x0));
    for (ptrdiff_t j = 0; j < n; j++) { /* the chunks that may be red, and those beside them: HALO_PX is less than a chunk */
        if (!may[j])
            continue;
        ptrdiff_t first = j ? j - 1 : 0;
        while (j + 1 < n && (may[j] || may[j + 1]))
            j++; /* a gap of one chunk is beside both */
        ptrdiff_t a = from + CHUNK_PX * first, b = from + CHUNK_PX * (j + 1);
        a = a < x0 ? x0 : a;
        b = b > x1 ? x1 : b;
        if (a >= b)
            continue;
        blur_row(image, stride, height, width, y, a, b, w, sums, row);
        red_row(row, b - a, rule, tables, mask + a - x0);
        any = 1;
    }
    return any;
}

/* cells[i][j] = 1 where row ys[i] has a horizontal run of red over column xs[j] that is at least `side` pixels long, or
 * at least (side + 1) / 2 and touches the picture's left or right edge, or fills the row; else 0. Columns ascend.
 * `row`: room for 4 width + 1 + chunks_of(width) bytes. */
void gateway_scan(const uint8_t *image, ptrdiff_t stride, ptrdiff_t height, ptrdiff_t width, const int32_t *ys,
                  ptrdiff_t rows, const int32_t *xs, ptrdiff_t columns, ptrdiff_t side, const uint16_t *w,
                  const Rule *rule, const uint8_t *tables, uint16_t *sums, uint8_t *row, uint8_t *cells)
{
    uint8_t *reds = row + 3 * width + 1, *may = reds + width;
    for (ptrdiff_t i = 0; i < rows; i++) {
        uint8_t *out = cells + i * columns;
        int any = 0;
        memset(out, 0, (size_t)columns);
        for (ptrdiff_t x = 0; x < width; x += TILE) {
            ptrdiff_t end = x + TILE < width ? x + TILE : width;
            for (ptrdiff_t y = ys[i] + HALO_PX + 1; i + 1 < rows && y < height && y <= ys[i + 1] + HALO_PX; y++)
                fetch_ahead(image + y * stride, 3 * x, 3 * end);
            any |= mask_row(image, stride, height, width, ys[i], x, end, w, rule, tables, sums, row, may, 1, reds + x);
        }
        if (!any)
            continue;
        ptrdiff_t j = 0;
        for (const uint8_t *at = memchr(reds, 255, (size_t)width); at && j < columns;) {
            const uint8_t *end = memchr(at, 0, (size_t)(reds + width - at));
            ptrdiff_t a = at - reds, b = end ? end - reds : width; /* red from a to b - 1 */
            ptrdiff_t need = a == 0 || b == width ? (side + 1) / 2 : side;
            uint8_t found = b - a >= (need < width ? need : width);
            while (j < columns && xs[j] < a)
                j++;
            while (j < columns && xs[j] < b)
                out[j++] = found;
            at = end ? memchr(end, 255, (size_t)(reds + width - end)) : NULL;
        }
    }
}

/* How many of all 2^24 colours the classes and the table see differently. Row and out: 769 and 256 bytes. */
uint32_t gateway_disagreements(const Rule *rule, const uint8_t *tables)
{
    uint8_t row[769], out[256];
    uint32_t wrong = 0;
    for (uint32_t pair = 0; pair < 65536; pair++) {
        for (int b = 0; b < 256; b++) {
            row[3 * b] = (uint8_t)b;
            row[3 * b + 1] = (uint8_t)pair;
            row[3 * b + 2] = (uint8_t)(pair >> 8);
        }
        red_row(row, 256, rule, tables, out);
        const uint8_t *bits = tables + PAIR_BYTES + 32 * pair;
        for (int b = 0; b < 256; b++)
            wrong += out[b] != (uint8_t)-(bits[b >> 3] >> (b & 7) & 1);
    }
    return wrong;
}

/* The row that will be looked at some rows later. */
static void fetch_row(const uint8_t *image, ptrdiff_t stride, ptrdiff_t height, ptrdiff_t y, ptrdiff_t x0, ptrdiff_t x1)
{
    if (y + ROWS_AHEAD < height)
        fetch_ahead(image + (y + ROWS_AHEAD) * stride, 3 * x0, 3 * x1);
}

/* M_0 of a window, x1 - x0 bytes a row. */
void gateway_mask(const uint8_t *image, ptrdiff_t stride, ptrdiff_t height, ptrdiff_t width, ptrdiff_t x0, ptrdiff_t y0,
                  ptrdiff_t x1, ptrdiff_t y1, const uint16_t *w, const Rule *rule, const uint8_t *tables,
                  uint16_t *sums, uint8_t *row, uint8_t *mask)
{
    uint8_t *may = row + 4 * width + 1;
    for (ptrdiff_t y = y0; y < y1; y++, mask += x1 - x0) {
        fetch_row(image, stride, height, y, x0, x1);
        mask_row(image, stride, height, width, y, x0, x1, w, rule, tables, sums, row, may, x1 - x0 >= RED_WINDOW, mask);
    }
}

/* M_c of a window: M_0, erosion, dilation, dilation, erosion with a square of `side` (odd, < 32). Pixels outside the picture
 * take no part. Beyond the window's own edges all counts as not red for the first erosion, and as not there for the rest.
 * `sheets`: memory for `sheet_in`, pad = 2 (side / 2); `row`: as for `gateway_scan`. */
void gateway_clean(const uint8_t *image, ptrdiff_t stride, ptrdiff_t height, ptrdiff_t width, ptrdiff_t x0,
                   ptrdiff_t y0, ptrdiff_t x1, ptrdiff_t y1, ptrdiff_t side, const uint16_t *w, const Rule *rule,
                   const uint8_t *tables, uint16_t *sums, uint8_t *row, uint64_t *sheets, uint8_t *mask)
{
    ptrdiff_t reach = side / 2, pad = 2 * reach;
    Sheet sheet = sheet_in(sheets, x1 - x0, y1 - y0, pad);
    uint8_t *reds = row + 3 * width + 1, *may = reds + width;
    for (ptrdiff_t y = y0; y < y1; y++) {
        fetch_row(image, stride, height, y, x0, x1);
        mask_row(image, stride, height, width, y, x0, x1, w, rule, tables, sums, row, may, x1 - x0 >= RED_WINDOW, reds);
        pack(reds, sheet.w, sheet.now + (y - y0) * sheet.pitch);
    }
    centre(&sheet, 0, x0 == 0, y0 == 0, x1 == width, y1 == height);
    squares(&sheet, side, 0);
    centre(&sheet, pad - reach, 0, 0, 0, 0);
    squares(&sheet, 2 * side - 1, 1);
    centre(&sheet, 0, 1, 1, 1, 1);
    squares(&sheet, side, 0);
    for (ptrdiff_t y = 0; y < sheet.h; y++)
        unpack(sheet.now + (y + pad - reach) * sheet.pitch, pad - reach, sheet.w, mask + y * sheet.w);
}
