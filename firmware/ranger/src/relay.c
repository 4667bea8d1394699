#include "relay.h"

#include "protocol_constants.h"
#include "ranger_wire.h"

#define HOLD_TICKS ((uint32_t)PROTOCOL_RELAY_HOLD_MS * PROTOCOL_TICKS_PER_MS)

struct command {
    uint32_t run, seq, output, nearest, farthest;
};

static void switch_off(struct relay *relay)
{
    if (relay->output != RELAY_NONE) {
        relay->output = RELAY_NONE;
        relay->pause = RELAY_PAUSE;
    }
}

static bool inside(const struct relay *relay)
{
    return relay->ticks != 0 && relay->ticks >= relay->nearest && relay->ticks <= relay->farthest;
}

/* The number at *at, of 1 to 6 digits, hexadecimal of 1 to 4, and what must follow it. */
static bool take(const char **at, uint32_t base, char end, uint32_t *value)
{
    uint8_t digits = 0;
    for (*value = 0; **at != end; (*at)++, digits++) {
        const char digit = **at;
        const uint32_t worth = digit >= '0' && digit <= '9'   ? (uint32_t)(digit - '0')
                               : digit >= 'A' && digit <= 'F' ? (uint32_t)(digit - 'A' + 10)
                                                              : base;
        if (worth >= base || digits == (base == 16 ? 4 : 6)) {
            return false;
        }
        *value = *value * base + worth;
    }
    (*at)++;
    return digits > 0;
}

/* The command in `text`, which ends with a zero. */
static bool understood(const char *text, struct command *command)
{
    static const char head[] = "$HCR,";
    const char *at = text;
    for (const char *expected = head; *expected != '\0'; expected++, at++) {
        if (*at != *expected) {
            return false;
        }
    }
    if (!take(&at, 16, ',', &command->run) || !take(&at, 10, ',', &command->seq) ||
        !take(&at, 10, ',', &command->output) || !take(&at, 10, ',', &command->nearest) ||
        !take(&at, 10, '*', &command->farthest)) {
        return false;
    }
    uint16_t crc = 0;
    for (const char *byte = text + 1; byte < at - 1; byte++) {
        crc = ranger_crc(crc, (uint8_t)*byte);
    }
    uint32_t given;
    return take(&at, 16, '\r', &given) && given == crc && *at == '\0';
}

static void obey(struct relay *relay, const struct command *command)
{
    relay->asked = true;
    if (command->output == RELAY_NONE) {
        switch_off(relay);
        return;
    }
    const uint16_t age = (uint16_t)(relay->seq - command->seq);
    if (command->run != relay->run || command->seq > UINT16_MAX || age >= relay->usable ||
        command->output > RELAY_MAY_MOVE) {
        return;
    }
    relay->usable = (uint8_t)age; /* only the younger ones are left */
    const bool renewed = relay->output == command->output;
    if (!renewed) {
        switch_off(relay);
    }
    relay->nearest = command->nearest;
    relay->farthest = command->farthest;
    if (!renewed) {
        if (relay->pause > 0 || relay->pins != 0 || !inside(relay)) {
            return;
        }
        relay->odd = 0;
    }
    relay->output = (uint8_t)command->output;
    relay->ends = relay->issued[command->seq % RELAY_NUMBERS] + HOLD_TICKS;
}

void relay_begin(struct relay *relay, uint16_t seed)
{
    *relay = (struct relay){0};
    relay->seed = seed;
}

void relay_receive(struct relay *relay, uint8_t byte)
{
    if (byte == '$') {
        relay->length = 0;
    } else if (relay->length == 0 || relay->length == RELAY_COMMAND_MAX) {
        relay->length = 0; /* outside a line, or too long */
        return;
    }
    if (byte != '\n') {
        relay->text[relay->length++] = (char)byte;
        return;
    }
    relay->text[relay->length] = '\0';
    relay->length = 0;
    struct command command;
    if (understood(relay->text, &command)) {
        obey(relay, &command);
    }
}

void relay_measured(struct relay *relay, uint16_t seq, uint32_t ticks, uint8_t flags, uint32_t at)
{
    if (!relay->asked) {
        return;
    }
    if (relay->run == 0 || seq == 0) {
        relay->seed = (uint16_t)(relay->seed + at);
        relay->run = relay->seed; /* 0, once in 65,536 times: another one with the next measurement */
        relay->usable = 0;
    }
    relay->seq = seq;
    relay->issued[seq % RELAY_NUMBERS] = at;
    if (relay->usable < RELAY_NUMBERS) {
        relay->usable++;
    }
    relay->ticks = flags == 0 ? ticks : 0;
    if (relay->pause > 0) {
        relay->pause--;
    }
    if (inside(relay)) {
        relay->odd = 0;
    } else if (relay->odd < RELAY_ODD && ++relay->odd == RELAY_ODD) {
        switch_off(relay);
    }
}

void relay_poll(struct relay *relay, uint32_t now, uint8_t pins)
{
    relay->pins = pins;
    const bool other = (pins & (uint8_t)~relay->output) != 0; /* from elsewhere: two are on */
    if (relay->output != RELAY_NONE && (other || (int32_t)(now - relay->ends) >= 0)) {
        switch_off(relay);
    }
}
