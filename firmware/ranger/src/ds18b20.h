/* A DS18B20 as the thermometer of the air, alone on its 1-Wire line and with its own supply. Portable C99, no hardware,
 * no clock; times as in ranger.h. Nothing here waits, and one call is one slot at most.
 *
 *     ds18b20_begin(&thermometer, &wire);                 once
 *     ds18b20_poll(&thermometer, now, quiet);             as often as possible, right after `now` was taken
 *     ranger_temperature(&ranger, thermometer.temperature_dc);
 *
 * Only the sensor itself can say that it is there: what is read counts if its CRC-8 and the bits that never change are
 * right (a line that is held low has a CRC that is right, too) and it is not the 85 degrees of a sensor that has not
 * converted since its power on. */
#ifndef DS18B20_H
#define DS18B20_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* From one conversion to the next about 4 s: it begins so long after the reading. */
#define DS18B20_PAUSE_TICKS 6300000u
/* A temperature is given for 10 s at most from its reading: one that fails in between is allowed for. */
#define DS18B20_HOLD_TICKS 20000000u
#define DS18B20_PAD 9u /* bytes of its memory; the last one is their CRC-8 */

/* What the core needs of the hardware. */
struct ds18b20_wire {
    void (*hold)(bool low); /* the line low, or let go */
    bool (*slot)(bool bit); /* one slot: write 0, or write 1 and read. Is the line high 15 us after it began? */
};

enum ds18b20_step { DS18B20_PAUSED, DS18B20_RESET, DS18B20_SLOTS };

struct ds18b20 {
    int16_t temperature_dc; /* for the caller: 0.1 degrees C, or RANGER_NO_TEMPERATURE */

    const struct ds18b20_wire *wire;
    enum ds18b20_step step;
    bool reading;    /* what has been converted; false: it is to convert */
    uint8_t bit;     /* of the command and what is read after it */
    uint32_t since;  /* the step's newest action */
    uint32_t wait;   /* so long from then on */
    uint32_t taken;  /* temperature_dc was read */
    uint8_t pad[DS18B20_PAD];
};

void ds18b20_begin(struct ds18b20 *thermometer, const struct ds18b20_wire *wire, uint32_t now);

/* Do what is due. `quiet`: ranger_quiet, a slot of 70 us disturbs nothing now. */
void ds18b20_poll(struct ds18b20 *thermometer, uint32_t now, bool quiet);

#ifdef __cplusplus
}
#endif
#endif
