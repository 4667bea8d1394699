/* An HC-SR04 on an Arduino Uno, for the loading gateway. Open this folder in the Arduino IDE, choose "Arduino Uno" and
 * the port, press Upload. In the Serial Monitor at 9600 baud you can read along; send ? to get a hello.
 *
 *     HC-SR04   VCC -> 5V    GND -> GND    TRIG -> D7    ECHO -> D8
 *     DS18B20, if wanted (docs/wiring.md): VDD -> 5V    GND -> GND    DQ -> D2, and 4.7 kohm from D2 to 5V
 *     LED of a beacon, if wanted (docs/beacon.md): D6
 *     Relays, if wanted (docs/wiring.md): in place -> D4    may move -> D5
 *
 * Wiring, flashing and what the LED says: docs/firmware.md. The lines: docs/ranger.md. The logic: src/ranger.h. */

#include "src/board_uno.h"
#include "src/protocol_constants.h"

/* A TMP36 on A0 instead of the DS18B20: take the slashes away, and measure the voltage between the pins AREF and GND while the
 * sketch runs: it differs from board to board, and 1 % of it is 1 % of 0.7 V, that is 0.7 degrees. */
// #define THERMOMETER
#ifndef AREF_MILLIVOLTS
#define AREF_MILLIVOLTS 1100
#endif

static struct ranger ranger;
#ifndef THERMOMETER
static struct ds18b20 thermometer;
#endif

void setup()
{
    board_begin();
    ranger_begin(&ranger, &board_uno, "hcsr04", PROTOCOL_PERIOD_MS, board_reset_cause(), board_seed(),
                 board_now());
#ifndef THERMOMETER
    ds18b20_begin(&thermometer, &board_wire, board_now());
#endif
}

void loop()
{
    const uint32_t now = board_now();
    uint32_t ticks;
    uint8_t byte;
    bool is_high;

#ifdef THERMOMETER
    uint16_t sum;
    if (board_sample_a0(&sum)) {
        ranger_temperature(&ranger, ranger_tmp36(sum, AREF_MILLIVOLTS));
    }
#else
    ds18b20_poll(&thermometer, now, ranger_quiet(&ranger, now));
    ranger_temperature(&ranger, thermometer.temperature_dc);
#endif
    while (board_edge(&ticks, &is_high)) {
        ranger_edge(&ranger, ticks, is_high);
    }
    while (board_received(&byte)) {
        ranger_receive(&ranger, byte);
    }
    if (ranger_poll(&ranger, now, board_echo_is_high())) {
        board_feed_watchdog();
        board_light(ranger.light);
        if (ranger.beacon) {
            board_beacon(ranger.light);
        }
    }
    relay_poll(&ranger.relay, now, board_relay_pins());
    if (ranger.relay.asked) {
        board_relay(ranger.relay.output);
    }
}
