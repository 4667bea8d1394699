#include "ds18b20.h"

#include "protocol_constants.h"
#include "ranger_wire.h"

/* Data sheet of the DS18B20. The bits of SKIP ROM (CC) and of the command behind it, the lowest one first. */
#define CONVERT 0x44CCu
#define READ_PAD 0xBECCu
#define COMMAND_BITS 16u
#define READ_BITS (COMMAND_BITS + 8u * DS18B20_PAD)
#define RESET_TICKS 1000u      /* low for 480 us, and as long for its answer */
#define SLOT_TICKS 240u        /* at least 60 us a slot; interrupts may make one begin late */
#define CONVERT_TICKS 1600000u /* 750 ms at most */
#define POWER_ON 0x0550        /* 85 degrees C */
#define CONFIGURATION 4u       /* this byte is 0xx11111 */

static void next(struct ds18b20 *thermometer, enum ds18b20_step step, uint32_t now, uint32_t wait)
{
    thermometer->step = step;
    thermometer->since = now;
    thermometer->wait = wait;
}

/* CRC-8 of Dallas (x8 + x5 + x4 + 1, the lowest bit first). */
static uint8_t crc_of(const uint8_t pad[DS18B20_PAD])
{
    uint8_t crc = 0;
    for (uint8_t at = 0; at < DS18B20_PAD - 1; at++) {
        crc ^= pad[at];
        for (uint8_t bit = 0; bit < 8; bit++) {
            crc = (uint8_t)((crc & 1u) != 0 ? crc >> 1 ^ 0x8C : crc >> 1);
        }
    }
    return crc;
}

static void take(struct ds18b20 *thermometer, uint32_t now)
{
    const uint8_t *pad = thermometer->pad;
    const int16_t raw = (int16_t)((uint16_t)pad[1] << 8 | pad[0]); /* 1/16 degree */
    if (crc_of(pad) != pad[DS18B20_PAD - 1] || (pad[CONFIGURATION] & 0x9Fu) != 0x1Fu || raw == POWER_ON) {
        return;
    }
    const int32_t temperature_dc = ((int32_t)raw * 10 + (raw < 0 ? -8 : 8)) / 16;
    if (temperature_dc >= PROTOCOL_MIN_TEMPERATURE_DC && temperature_dc <= PROTOCOL_MAX_TEMPERATURE_DC) {
        thermometer->temperature_dc = (int16_t)temperature_dc;
        thermometer->taken = now;
    }
}

static void next_slot(struct ds18b20 *thermometer, uint32_t now)
{
    const uint8_t at = thermometer->bit++;
    const uint16_t command = thermometer->reading ? READ_PAD : CONVERT;
    const bool high = thermometer->wire->slot(at >= COMMAND_BITS || ((unsigned)command >> at & 1u) != 0);
    if (at >= COMMAND_BITS) {
        uint8_t *byte = &thermometer->pad[(at - COMMAND_BITS) / 8u];
        *byte = (uint8_t)(*byte >> 1 | (high ? 0x80u : 0u));
    }
    if (at + 1u < (thermometer->reading ? READ_BITS : COMMAND_BITS)) {
        next(thermometer, DS18B20_SLOTS, now, SLOT_TICKS);
        return;
    }
    if (thermometer->reading) {
        take(thermometer, now);
    }
    next(thermometer, DS18B20_PAUSED, now, thermometer->reading ? DS18B20_PAUSE_TICKS : CONVERT_TICKS);
    thermometer->reading = !thermometer->reading;
}

void ds18b20_begin(struct ds18b20 *thermometer, const struct ds18b20_wire *wire, uint32_t now)
{
    *thermometer = (struct ds18b20){0};
    thermometer->wire = wire;
    thermometer->temperature_dc = RANGER_NO_TEMPERATURE;
    next(thermometer, DS18B20_PAUSED, now, 0);
}

void ds18b20_poll(struct ds18b20 *thermometer, uint32_t now, bool quiet)
{
    if (thermometer->temperature_dc != RANGER_NO_TEMPERATURE && now - thermometer->taken >= DS18B20_HOLD_TICKS) {
        thermometer->temperature_dc = RANGER_NO_TEMPERATURE;
    }
    /* What holds the line low ends as soon as it may: a low of 1 ms would take the supply from a sensor without its own. */
    if (now - thermometer->since < thermometer->wait || !(quiet || thermometer->step == DS18B20_RESET)) {
        return;
    }
    if (thermometer->step == DS18B20_PAUSED) {
        thermometer->wire->hold(true);
        next(thermometer, DS18B20_RESET, now, RESET_TICKS);
    } else if (thermometer->step == DS18B20_RESET) {
        thermometer->wire->hold(false);
        thermometer->bit = 0;
        next(thermometer, DS18B20_SLOTS, now, RESET_TICKS);
    } else {
        next_slot(thermometer, now);
    }
}
