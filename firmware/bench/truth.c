// SPDX-License-Identifier: GPL-3.0-or-later
// Part of the firmware bench, a test program of its own that links simavr (GPL-3.0). See README.md beside this file.
#include <stdarg.h>

#include "bench.h"

static FILE *out;
static bool real;
static FILE *led;
static uint64_t led_zero_ns;

static void begin(uint64_t at, const char *type) {
    fprintf(out, "{\"t_ns\": %llu, ", (unsigned long long)ns_of(at));
    if (real) fprintf(out, "\"real_ns\": %llu, ", (unsigned long long)monotonic_ns());
    fprintf(out, "\"type\": \"%s\"", type);
}

bool truth_open(const char *path, bool with_real_time) {
    real = with_real_time;
    out = fopen(path, "w");
    if (out) setvbuf(out, NULL, _IOLBF, 0);
    return out != NULL;
}

void truth_close(void) {
    if (out) fclose(out);
    out = NULL;
}

bool led_open(const char *path, uint64_t zero_ns) {
    led = fopen(path, "wb");
    led_zero_ns = zero_ns;
    return led != NULL;
}

void led_close(const char *path) {
    if (!led) return;
    fclose(led);
    (void)remove(path);
    led = NULL;
}

void led_is(uint64_t at, bool lit) {
    static uint64_t count;
    truth(at, "led", ", \"lit\": %s", lit ? "true" : "false");
    if (!led) return;
    const int64_t cycle[2] = {(int64_t)(led_zero_ns + ns_of(at)), lit};
    if (fseek(led, (long)(count++ % LED_CYCLES * sizeof cycle), SEEK_SET) == 0)
        (void)!fwrite(cycle, sizeof cycle, 1, led);
    fflush(led);
}

void truth(uint64_t at, const char *type, const char *format, ...) {
    if (!out) return;
    begin(at, type);
    va_list args;
    va_start(args, format);
    vfprintf(out, format, args);
    va_end(args);
    fputs("}\n", out);
}

void truth_line(uint64_t at, const uint8_t *line, size_t size) {
    if (!out) return;
    begin(at, "line");
    fputs(", \"text\": \"", out);
    for (size_t i = 0; i < size; i++) {
        const uint8_t c = line[i];
        if (c < ' ' || c > '~' || c == '"' || c == '\\') fprintf(out, "\\u%04x", c);
        else fputc(c, out);
    }
    fputs("\"}\n", out);
}
