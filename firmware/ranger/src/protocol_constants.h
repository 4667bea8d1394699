/* Generated from gateway/ranger/hcsr04/protocol.py by `./dev docs`; a test fails where the two differ. Do not edit. */
#ifndef PROTOCOL_CONSTANTS_H
#define PROTOCOL_CONSTANTS_H

#define PROTOCOL_VERSION 1 /* carried by the hello */
#define PROTOCOL_QUESTION '?' /* the host asks for a hello */
#define PROTOCOL_BEACON_REQUEST 'b' /* the host asks for the beacon's code */
#define PROTOCOL_PERIOD_MS 60 /* cycle as shipped */
#define PROTOCOL_MIN_PERIOD_MS 10
#define PROTOCOL_MAX_PERIOD_MS 500
#define PROTOCOL_HELLO_PERIOD_S 5
#define PROTOCOL_TICKS_PER_MS 2000 /* Timer1 at 16 MHz / 8: 0.5 us */
#define PROTOCOL_MAX_TICKS 999999
#define PROTOCOL_MIN_TEMPERATURE_DC (-400) /* 0.1 degrees C */
#define PROTOCOL_MAX_TEMPERATURE_DC 850
#define PROTOCOL_RELAY_HOLD_MS 280 /* a relay command holds so long from the measurement whose number it bears */
#define PROTOCOL_MAX_LINE 64 /* bytes between $ and line feed */
#define PROTOCOL_TENTHS_PER_TICK_ABOVE 17171 /* 0.1 mm at 20 degrees C for one tick, a fraction */
#define PROTOCOL_TENTHS_PER_TICK_BELOW 20000
#define PROTOCOL_NEAREST_TENTHS 200 /* 0.1 mm; the sensor's range */
#define PROTOCOL_FARTHEST_TENTHS 40000
#define PROTOCOL_FLAG_NO_ECHO 1 /* ECHO rose, but no echo came back in time */
#define PROTOCOL_FLAG_NO_RISING_EDGE 2 /* ECHO never rose after the trigger: dead sensor, or TRIG wire broken */
#define PROTOCOL_FLAG_TOO_NEAR 4 /* nearer than 2 cm */
#define PROTOCOL_FLAG_TOO_FAR 8 /* farther than 4 m */
#define PROTOCOL_FLAG_STUCK_HIGH 16 /* ECHO is still high when the next cycle begins: hanging sensor, or ECHO wire broken */
#define PROTOCOL_RESET_POWER_ON 1
#define PROTOCOL_RESET_RESET_LINE 2
#define PROTOCOL_RESET_BROWN_OUT 4
#define PROTOCOL_RESET_WATCHDOG 8

#endif
