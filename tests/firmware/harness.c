/* The ranger's core with a board of memory instead of hardware, driven by one line of text a call, so that the shared
 * library (ctypes) and the executable (stdin, stdout; address sanitizer) take the very same commands:
 *
 *     begin NAME PERIOD_MS MCUSR NOW | poll NOW HIGH | edge TICKS HIGH | receive BYTE | temperature DC | space BYTES |
 *     pins SUM
 *
 * The answer: what poll returned, pulses of TRIG, light, flags, lost_lines, late_cycles, output of the relay, and the sent
 * bytes in hex. The relay's pins follow its output; `pins` are held high from elsewhere. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ds18b20.h"
#include "ranger.h"

#define SENT_MAX 256

struct harness {
    struct ranger ranger;
    struct ranger_board board;
    char name[17];
    uint8_t space;
    uint8_t pins;   /* held high */
    uint8_t driven; /* as by the newest relay_poll */
    unsigned pulses;
    size_t sent_length;
    uint8_t sent[SENT_MAX];
};

static void trigger(void *context)
{
    struct harness *harness = context;
    harness->pulses++;
}

static uint8_t tx_space(void *context)
{
    const struct harness *harness = context;
    return harness->space;
}

static void tx_byte(void *context, uint8_t byte)
{
    struct harness *harness = context;
    if (harness->space == 0 || harness->sent_length == SENT_MAX) {
        abort(); /* the core promised not to */
    }
    harness->space--;
    harness->sent[harness->sent_length++] = byte;
}

struct harness *harness_new(void)
{
    struct harness *harness = calloc(1, sizeof *harness);
    if (harness == NULL) {
        abort();
    }
    harness->board = (struct ranger_board){trigger, tx_space, tx_byte, harness};
    harness->space = UINT8_MAX;
    return harness;
}

void harness_free(struct harness *harness)
{
    free(harness);
}

/* 0: not a command. `answer` takes 1024 bytes. */
int harness_command(struct harness *harness, const char *line, char *answer)
{
    struct ranger *ranger = &harness->ranger;
    bool began = false;
    uint32_t a, b, c;
    int32_t dc;
    char name[17];
    if (sscanf(line, "begin %16s %" SCNu32 " %" SCNu32 " %" SCNu32, name, &a, &b, &c) == 4) {
        memcpy(harness->name, name, sizeof name);
        memset(ranger, 0xA5, sizeof *ranger); /* the core may not count on zeros */
        ranger_begin(ranger, &harness->board, harness->name, (uint16_t)a, (uint8_t)b, 0x1234, c);
        harness->driven = 0;
    } else if (sscanf(line, "poll %" SCNu32 " %" SCNu32, &a, &b) == 2) {
        began = ranger_poll(ranger, a, b != 0);
        relay_poll(&ranger->relay, a, harness->pins | harness->driven);
        harness->driven = ranger->relay.output;
    } else if (sscanf(line, "edge %" SCNu32 " %" SCNu32, &a, &b) == 2) {
        ranger_edge(ranger, a, b != 0);
    } else if (sscanf(line, "receive %" SCNu32, &a) == 1) {
        ranger_receive(ranger, (uint8_t)a);
    } else if (sscanf(line, "temperature %" SCNd32, &dc) == 1) {
        ranger_temperature(ranger, (int16_t)dc);
    } else if (sscanf(line, "space %" SCNu32, &a) == 1) {
        harness->space = (uint8_t)a;
    } else if (sscanf(line, "pins %" SCNu32, &a) == 1) {
        harness->pins = (uint8_t)a;
    } else {
        return 0;
    }
    char *end = answer + sprintf(answer, "%d %u %d %u %u %u %u ", began, harness->pulses, ranger->light, ranger->flags,
                                 ranger->lost_lines, ranger->late_cycles, ranger->relay.output);
    for (size_t at = 0; at < harness->sent_length; at++) {
        end += sprintf(end, "%02x", harness->sent[at]);
    }
    harness->pulses = 0;
    harness->sent_length = 0;
    return 1;
}

bool harness_quiet(const struct harness *harness, uint32_t now)
{
    return ranger_quiet(&harness->ranger, now);
}

/* For codec tests. `relay`: run * 16 + state; it and `beacon` below 0: without. */
int harness_measurement(uint16_t seq, uint32_t ticks, uint8_t flags, int16_t temperature_dc, int32_t relay,
                        int32_t beacon, char *line)
{
    const struct ranger_measurement measurement = {.seq = seq,
                                                   .ticks = ticks,
                                                   .flags = flags,
                                                   .temperature_dc = temperature_dc,
                                                   .has_beacon = beacon >= 0,
                                                   .lit = (uint8_t)beacon,
                                                   .has_relay = relay >= 0,
                                                   .run = (uint16_t)(relay >> 4),
                                                   .relay_state = (uint8_t)(relay & 15)};
    return ranger_write_measurement(line, &measurement);
}

int harness_hello(const char *name, uint16_t period_ms, uint8_t mcusr, char *line)
{
    const struct ranger_hello hello = {name, period_ms, mcusr};
    return ranger_write_hello(line, &hello);
}

/* A DS18B20 whose memory has these bytes. */
static const uint8_t *pad;
static unsigned slots; /* since the reset */

static void wire_hold(bool low)
{
    (void)low;
    slots = 0;
}

static bool wire_slot(bool bit)
{
    const unsigned at = slots++;
    return at < 16 ? bit : (pad[(at - 16) / 8] >> (at - 16) % 8 & 1) != 0;
}

/* The temperature `later` ticks after `bytes` were read for the first time; begun at `now`. */
int16_t harness_ds18b20(const uint8_t *bytes, uint32_t now, uint32_t later)
{
    static const struct ds18b20_wire wire = {wire_hold, wire_slot};
    struct ds18b20 thermometer;
    memset(&thermometer, 0xA5, sizeof thermometer);
    pad = bytes;
    slots = 0;
    ds18b20_begin(&thermometer, &wire, now);
    for (; slots < 16 + 72; now += 500) {
        ds18b20_poll(&thermometer, now, false);
        ds18b20_poll(&thermometer, now, true);
    }
    ds18b20_poll(&thermometer, now - 500 + later, false);
    return thermometer.temperature_dc;
}

#ifdef HARNESS_MAIN
int main(void)
{
    struct harness *harness = harness_new();
    char line[128], answer[1024];
    while (fgets(line, sizeof line, stdin) != NULL) {
        if (!harness_command(harness, line, answer)) {
            fprintf(stderr, "not a command: %s", line);
            return 2;
        }
        puts(answer);
    }
    harness_free(harness);
    return 0;
}
#endif
