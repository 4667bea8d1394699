#include "board_uno.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>
#include <util/atomic.h>
#include <util/delay.h>

#include "protocol_constants.h"

#define BAUD 9600
#include <util/setbaud.h>

#define TRIG_BIT _BV(PORTD7)
#define ECHO_BIT _BV(PINB0)
#define LED_BIT _BV(PORTB5)
#define BEACON_BIT _BV(PORTD6)
#define WIRE_BIT _BV(PORTD2)
#define RELAY_SHIFT PORTD4 /* RELAY_IN_PLACE is D4, RELAY_MAY_MOVE D5 */
#define RELAY_BITS ((uint8_t)((RELAY_IN_PLACE | RELAY_MAY_MOVE) << RELAY_SHIFT))

/* -- why we are here ------------------------------------------------------------------------------------------- */

#define ALIVE_MARK 0x52414E47ul
#define STALL_OVERFLOWS 6u /* of Timer1, 33 ms each: only a watchdog lets the firmware be unfed for this time */

static uint8_t saved_mcusr __attribute__((section(".noinit")));
static uint32_t alive_mark __attribute__((section(".noinit")));
static volatile uint8_t overflows_unfed __attribute__((section(".noinit")));
static uint16_t resets __attribute__((section(".noinit"))); /* garbage after a power cut, which does as well */
static uint8_t reset_cause;

/* Before main and before the variables are set up: after a watchdog reset the watchdog is still on, and short. */
void board_save_reset_cause(void) __attribute__((naked, used, section(".init3")));
void board_save_reset_cause(void)
{
    saved_mcusr = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

static uint8_t find_reset_cause(void)
{
    if (saved_mcusr != 0) {
        return saved_mcusr;
    }
    if (alive_mark != ALIVE_MARK) {
        return PROTOCOL_RESET_POWER_ON;
    }
    return overflows_unfed >= STALL_OVERFLOWS ? PROTOCOL_RESET_WATCHDOG : PROTOCOL_RESET_RESET_LINE;
}

uint8_t board_reset_cause(void)
{
    return reset_cause;
}

uint16_t board_seed(void)
{
    return (uint16_t)(resets * 0x9E37u); /* odd: no two of 65,536 are alike */
}

void board_feed_watchdog(void)
{
    wdt_reset();
    overflows_unfed = 0;
}

/* -- time and echo: Timer1 ------------------------------------------------------------------------------------- */

enum capture { CAPTURE_OFF, CAPTURE_RISE, CAPTURE_FALL };

static volatile uint16_t overflows; /* the upper half of the time */
static volatile uint8_t capture;    /* which edge the hardware waits for */
static volatile uint8_t edges_seen; /* 0, 1 or 2 of this cycle */
static volatile uint32_t edge_ticks[2];
static uint8_t edges_taken;

ISR(TIMER1_OVF_vect)
{
    overflows++;
    if (overflows_unfed < UINT8_MAX) {
        overflows_unfed++;
    }
}

/* A count of Timer1 as a time; interrupts are off. The count may be younger than an overflow not yet served. */
static uint32_t extended(uint16_t count)
{
    uint16_t upper = overflows;
    if ((TIFR1 & _BV(TOV1)) != 0 && count < 0x8000u) {
        upper++;
    }
    return ((uint32_t)upper << 16) | count;
}

static void watch_for(uint8_t edge)
{
    capture = edge;
    if (edge == CAPTURE_RISE) {
        TCCR1B |= _BV(ICES1);
    } else {
        TCCR1B = (uint8_t)(TCCR1B & ~_BV(ICES1));
    }
    TIFR1 = _BV(ICF1); /* changing the edge may set it */
}

static void edge_at(uint32_t ticks)
{
    edge_ticks[edges_seen] = ticks;
    edges_seen++;
}

ISR(TIMER1_CAPT_vect)
{
    edge_at(extended(ICR1));
    if (capture == CAPTURE_RISE) {
        watch_for(CAPTURE_FALL);
        if ((PINB & ECHO_BIT) != 0) {
            return;
        }
        edge_at(extended(TCNT1)); /* a spike, gone before the edge was changed: nearer than any sensor sees */
    }
    capture = CAPTURE_OFF;
    TIMSK1 = _BV(TOIE1);
}

uint32_t board_now(void)
{
    uint32_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        now = extended(TCNT1);
    }
    return now;
}

static void trigger(void *context)
{
    (void)context;
    PORTD |= TRIG_BIT;
    _delay_us(12);
    PORTD = (uint8_t)(PORTD & ~TRIG_BIT);
    /* Only now: the trigger may be heard on the ECHO wire of a long cable, and ECHO rises no sooner than 0.1 ms later. */
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        edges_seen = 0;
        edges_taken = 0;
        watch_for(CAPTURE_RISE);
        TIMSK1 = _BV(TOIE1) | _BV(ICIE1);
    }
}

bool board_edge(uint32_t *ticks, bool *is_high)
{
    if (edges_taken >= edges_seen) {
        return false;
    }
    *is_high = edges_taken == 0;
    *ticks = edge_ticks[edges_taken]; /* seen, so it does not change any more */
    edges_taken++;
    return true;
}

bool board_echo_is_high(void)
{
    return (PINB & ECHO_BIT) != 0;
}

/* -- UART: 9600 8N1 ---------------------------------------------------------------------------------------------- */

#define TX_SIZE 128u /* powers of two; one byte stays free */
#define RX_SIZE 16u

static volatile uint8_t tx_ring[TX_SIZE], rx_ring[RX_SIZE];
static volatile uint8_t tx_head, tx_tail, rx_head, rx_tail; /* head: written next, tail: read next */

ISR(USART_UDRE_vect)
{
    UDR0 = tx_ring[tx_tail];
    tx_tail = (uint8_t)((tx_tail + 1u) % TX_SIZE);
    if (tx_tail == tx_head) {
        UCSR0B = (uint8_t)(UCSR0B & ~_BV(UDRIE0));
    }
}

ISR(USART_RX_vect)
{
    const bool garbled = (UCSR0A & _BV(FE0)) != 0; /* to be read before the byte */
    const uint8_t byte = UDR0;
    const uint8_t next = (uint8_t)((rx_head + 1u) % RX_SIZE);
    if (!garbled && next != rx_tail) { /* a full ring drops: the host asks again */
        rx_ring[rx_head] = byte;
        rx_head = next;
    }
}

static uint8_t tx_space(void *context)
{
    (void)context;
    return (uint8_t)((tx_tail - tx_head - 1u) % TX_SIZE);
}

static void tx_byte(void *context, uint8_t byte)
{
    (void)context;
    tx_ring[tx_head] = byte;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        tx_head = (uint8_t)((tx_head + 1u) % TX_SIZE);
        UCSR0B |= _BV(UDRIE0);
    }
}

bool board_received(uint8_t *byte)
{
    if (rx_tail == rx_head) {
        return false;
    }
    *byte = rx_ring[rx_tail];
    rx_tail = (uint8_t)((rx_tail + 1u) % RX_SIZE);
    return true;
}

uint8_t board_relay_pins(void)
{
    return (uint8_t)((PIND & RELAY_BITS) >> RELAY_SHIFT);
}

void board_beacon(bool on)
{
    PORTD = (uint8_t)(on ? PORTD | BEACON_BIT : PORTD & ~BEACON_BIT); /* no interrupt writes it */
    DDRD |= BEACON_BIT;
}

void board_relay(uint8_t output)
{
    PORTD = (uint8_t)((PORTD & ~RELAY_BITS) | ((output << RELAY_SHIFT) & RELAY_BITS)); /* no interrupt writes it */
    DDRD |= RELAY_BITS;
}

/* -- the rest ---------------------------------------------------------------------------------------------------- */

void board_light(bool on)
{
    if (on) {
        PORTB |= LED_BIT;
    } else {
        PORTB = (uint8_t)(PORTB & ~LED_BIT);
    }
}

bool board_sample_a0(uint16_t *sum_of_64)
{
    static uint16_t sum;
    static uint8_t samples;
    if ((ADCSRA & _BV(ADSC)) != 0) {
        return false;
    }
    if (samples > 0) { /* the first conversion after a change of the reference is not to be used */
        sum = (uint16_t)(sum + ADC);
    }
    samples++;
    bool complete = false;
    if (samples > 64) {
        *sum_of_64 = sum;
        sum = 0;
        samples = 1;
        complete = true;
    }
    ADMUX = _BV(REFS1) | _BV(REFS0); /* A0 against 1.1 V */
    ADCSRA = _BV(ADEN) | _BV(ADSC) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
    return complete;
}

/* -- 1-Wire: D2 --------------------------------------------------------------------------------------------------- */

/* No interrupt writes PORTD or DDRD. Pulled up weakly, too: without a sensor the line is high, not open. */
static void wire_hold(bool low)
{
    if (low) {
        PORTD = (uint8_t)(PORTD & ~WIRE_BIT);
        DDRD |= WIRE_BIT;
    } else {
        DDRD = (uint8_t)(DDRD & ~WIRE_BIT);
        PORTD |= WIRE_BIT;
    }
}

static bool wire_slot(bool bit)
{
    bool high = false;
    if (!bit) {
        wire_hold(true);
        _delay_us(65); /* 60 to 120 us; all interrupts together take less than 30 */
        wire_hold(false);
        return high;
    }
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        wire_hold(true);
        _delay_us(2); /* 1 to 15 us */
        wire_hold(false);
        _delay_us(9); /* what the sensor says holds until 15 us after the line fell */
        high = (PIND & WIRE_BIT) != 0;
    }
    return high;
}

void board_begin(void)
{
    reset_cause = find_reset_cause();
    alive_mark = ALIVE_MARK;
    resets++;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        PORTD = (uint8_t)(PORTD & ~TRIG_BIT);
        DDRD |= TRIG_BIT;
        DDRB = (uint8_t)((DDRB | LED_BIT) & ~ECHO_BIT);
        /* Pulled up, so that a broken wire reads as stuck. Left open it would hear the mains, and as 60 ms are just three
           periods of 50 Hz, its 10 ms would look like a steady 1.7 m. */
        PORTB |= ECHO_BIT;

        TCCR1A = 0; /* the Arduino core has set Timer1 up for analogWrite */
        TCCR1B = _BV(ICNC1) | _BV(CS11);
        TCNT1 = 0;
        TIFR1 = _BV(TOV1) | _BV(ICF1);
        TIMSK1 = _BV(TOIE1);

        UCSR0A = USE_2X ? _BV(U2X0) : 0; /* before the rate: an emulator looks at it when the rate is written */
        UBRR0 = UBRR_VALUE;
        UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
        UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
    }
    sei();
    wdt_enable(WDTO_250MS);
    board_feed_watchdog();
}

const struct ranger_board board_uno = {trigger, tx_space, tx_byte, 0};
const struct ds18b20_wire board_wire = {wire_hold, wire_slot};
