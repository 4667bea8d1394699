#include "ranger_wire.h"

#include "protocol_constants.h"

static const char HEX[] = "0123456789ABCDEF";

uint32_t ranger_tenths_at_20c(uint32_t ticks)
{
    /* ticks * ABOVE needs 35 bits: whole multiples of BELOW are taken out first, which changes no digit. */
    const uint32_t whole = ticks / PROTOCOL_TENTHS_PER_TICK_BELOW;
    const uint32_t rest = ticks % PROTOCOL_TENTHS_PER_TICK_BELOW;
    return whole * PROTOCOL_TENTHS_PER_TICK_ABOVE +
           (rest * PROTOCOL_TENTHS_PER_TICK_ABOVE + PROTOCOL_TENTHS_PER_TICK_BELOW / 2) / PROTOCOL_TENTHS_PER_TICK_BELOW;
}

uint16_t ranger_crc(uint16_t crc, uint8_t byte)
{
    crc = (uint16_t)(crc ^ (uint16_t)((uint16_t)byte << 8));
    for (uint8_t bit = 0; bit < 8; bit++) {
        const uint16_t shifted = (uint16_t)(crc << 1);
        crc = (crc & 0x8000u) != 0 ? (uint16_t)(shifted ^ 0x1021u) : shifted;
    }
    return crc;
}

static char *put_text(char *end, const char *text)
{
    while (*text != '\0') {
        *end++ = *text++;
    }
    return end;
}

static char *put_number(char *end, uint32_t value)
{
    char digits[10]; /* the last one first */
    uint8_t count = 0;
    do {
        digits[count++] = (char)('0' + value % 10u);
        value /= 10u;
    } while (value != 0);
    while (count > 0) {
        *end++ = digits[--count];
    }
    return end;
}

static char *put_field(char *end, uint32_t value)
{
    *end++ = ',';
    return put_number(end, value);
}

static char *put_hex(char *end, uint16_t value)
{
    for (int8_t shift = 12; shift >= 0; shift = (int8_t)(shift - 4)) {
        *end++ = HEX[((unsigned)value >> shift) & 0xFu];
    }
    return end;
}

/* The line's end behind its body. Returns the whole length. */
static uint8_t close_line(char *line, char *end)
{
    uint16_t crc = 0;
    for (const char *at = line + 1; at < end; at++) {
        crc = ranger_crc(crc, (uint8_t)*at);
    }
    *end++ = '*';
    end = put_hex(end, crc);
    *end++ = '\r';
    *end++ = '\n';
    return (uint8_t)(end - line);
}

uint8_t ranger_write_measurement(char out[RANGER_MEASUREMENT_MAX], const struct ranger_measurement *measurement)
{
    char *end = put_text(out, "$HCM");
    end = put_field(end, measurement->seq);
    end = put_field(end, measurement->ticks);
    end = put_field(end, ranger_tenths_at_20c(measurement->ticks));
    end = put_field(end, measurement->flags);
    if (measurement->temperature_dc != RANGER_NO_TEMPERATURE) {
        const int32_t value = measurement->temperature_dc;
        *end++ = ',';
        if (value < 0) {
            *end++ = '-';
        }
        end = put_number(end, (uint32_t)(value < 0 ? -value : value));
    }
    if (measurement->has_beacon) {
        *end++ = ',';
        *end++ = 'b';
        *end++ = HEX[measurement->lit >> 4];
        *end++ = HEX[measurement->lit & 0xFu];
    }
    if (measurement->has_relay) {
        *end++ = ',';
        *end++ = 'r';
        end = put_hex(end, measurement->run);
        *end++ = "0123456789AB"[measurement->relay_state];
    }
    return close_line(out, end);
}

uint8_t ranger_write_hello(char out[RANGER_HELLO_MAX], const struct ranger_hello *hello)
{
    char *end = put_text(out, "$HCI,");
    end = put_text(end, hello->name);
    end = put_field(end, PROTOCOL_VERSION);
    end = put_field(end, hello->period_ms);
    end = put_field(end, hello->mcusr);
    return close_line(out, end);
}
