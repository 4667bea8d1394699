// SPDX-License-Identifier: GPL-3.0-or-later
// Part of the firmware bench, a test program of its own that links simavr (GPL-3.0). See README.md beside this file.
//
// The Uno: an ATmega328P in simavr, its reset line, its power and its pins. What simavr 1.6 needs to be told:
// - it counts a parity bit that is not there (11 bits a byte): the UART's pace is set anew after each register write;
// - a write to TIFRn clears all the flags of that timer, and an overflow in that moment is lost: written anew;
// - its sleep really sleeps: replaced, the bench paces itself;
// - a reset forgets every cycle timer and every pin: the bench keeps its own events and drives ECHO again.
#include <string.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_timer.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <simavr/sim_io.h>

#include "bench.h"

// ATmega328P data sheet, register summary; data memory addresses.
enum { PINB = 0x23, PIND = 0x29, DDRD = 0x2A, PORTD = 0x2B, MCUSR = 0x54, UCSR0A = 0xC0, UCSR0C = 0xC2, UBRR0L = 0xC4, UBRR0H = 0xC5, RAM = 0x100 };
enum { ECHO_PIN = 0, WIRE_PIN = 2, RELAY_PIN = 4, RELAY_PINS = 2, BEACON_PIN = 6, TRIG_PIN = 7, U2X0 = 1 << 1 };
enum { BOOT_START = 0x7E00, RUNAWAY = 0x7DFE };

static avr_t *avr;
static avr_uart_t *uart;
static avr_irq_t *echo_pin, *wire_pin, *trig_pin, *beacon_pin, *adc_pin, *uart_in;
static elf_firmware_t elf;
static board_options_t options;
static rng_t garbage;
static uint64_t offset;      // bench time less simavr's
static uint64_t idle_until;  // the boot delay: the processor does not run before
static bool powered, held, echo_high, wire_high = true, was_reset;
static unsigned relay_pins; // D4 and D5, one bit each
static bool lit;            // D6
static double adc_mv = 750.0;

uint64_t board_now(void) { return avr->cycle + offset; }
bool board_powered(void) { return powered; }

double board_bit_cycles(void) {
    const unsigned divider = avr->data[UBRR0L] + ((avr->data[UBRR0H] & 0x0Fu) << 8) + 1u;
    return (avr->data[UCSR0A] & U2X0 ? 8.0 : 16.0) * divider;
}

static void on_uart_register(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)value, (void)param;
    uart->cycles_per_byte = (avr_cycle_count_t)(10.0 * board_bit_cycles()); // 8N1
}

// Data sheet: a flag is cleared by writing a one to it; zeros change nothing.
static void on_timer_flags(avr_t *unused, avr_io_addr_t address, uint8_t value, void *param) {
    (void)unused, (void)address;
    avr_timer_t *const timer = param;
    avr_int_vector_t *vectors[2 + AVR_TIMER_COMP_COUNT] = {&timer->overflow, &timer->icr};
    for (size_t i = 0; i < AVR_TIMER_COMP_COUNT; i++) vectors[2 + i] = &timer->comp[i].interrupt;
    for (size_t i = 0; i < sizeof vectors / sizeof *vectors; i++)
        if (vectors[i]->vector && value >> vectors[i]->raised.bit & 1) avr_clear_interrupt(avr, vectors[i]);
}

static void on_uart_out(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    link_sent((uint8_t)value);
}

static void on_trig(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    sensor_trig(value & 1u);
}

static void relay_pins_are(unsigned pins) {
    if (pins == relay_pins) return;
    relay_pins = pins;
    truth(board_now(), "relay", ", \"pins\": %u", pins);
}

static void on_relay(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq;
    const unsigned bit = 1u << (uintptr_t)param;
    relay_pins_are(value & 1u ? relay_pins | bit : relay_pins & ~bit);
}

static void beacon_is(bool on) {
    if (on == lit) return;
    lit = on;
    led_is(board_now(), on);
}

static void on_beacon(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    beacon_is(value & 1u);
}

static void on_direction(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    ds18b20_wire(value >> WIRE_PIN & 1u && !(avr->data[PORTD] >> WIRE_PIN & 1u));
}

static void on_reset(avr_t *unused) {
    (void)unused;
    was_reset = true;
}

static void no_sleep(avr_t *unused, avr_cycle_count_t how_long) { (void)unused, (void)how_long; }

static void quiet(avr_t *unused, const int level, const char *format, va_list args) {
    (void)unused;
    if (level <= LOG_ERROR) vfprintf(stderr, format, args);
}

static avr_cycle_count_t on_next_event(avr_t *unused, avr_cycle_count_t when, void *param) {
    (void)unused, (void)when, (void)param;
    return 0; // only there so that a sleeping processor wakes for it
}

// What the board looks like after any reset, whoever pulled it.
static void after_reset(int cause) {
    was_reset = false;
    uint32_t no_flags = 0; // neither printing nor sleeping
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &no_flags);
    if (cause != WATCHDOG) avr->data[MCUSR] = (uint8_t)cause; // simavr sets WDRF itself
    avr->run_cycle_limit = CYCLES_PER_MS; // instructions in a row between two looks at the timers
    trig_pin->value = beacon_pin->value = 0;
    for (int i = 0; i < RELAY_PINS; i++)
        avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), RELAY_PIN + i)->value = 0;
    board_echo(echo_high);
    ds18b20_wire(false);
    board_wire(wire_high);
    board_adc(adc_mv);
    link_silence();
    sensor_restarted();
    relay_pins_are(0); // inputs, and pulled down
    beacon_is(false);
    truth(board_now(), "reset", ", \"mcusr\": %d", cause);
}

static void restart(int cause) {
    const uint64_t now = board_now();
    avr->state = cpu_Running;
    avr_reset(avr);
    offset = now - avr->cycle;
    after_reset(cause);
    idle_until = now + cycles_of_ms(options.boot_ms);
}

// Intel hex; data records only, which all lie in the upper 512 bytes.
static bool load_bootloader(const char *path) {
    FILE *const file = fopen(path, "r");
    char line[600];
    bool good = file != NULL, any = false;
    while (good && fgets(line, sizeof line, file)) {
        unsigned size, address, kind, byte;
        if (line[strspn(line, "\r\n")] == 0) continue;
        if (sscanf(line, ":%2x%4x%2x", &size, &address, &kind) != 3 || strlen(line) < 9 + 2 * size) good = false;
        if (!good || kind != 0) continue;
        good = address >= BOOT_START && address + size <= avr->flashend + 1u;
        for (unsigned i = 0; good && i < size; i++) {
            good = sscanf(line + 9 + 2 * i, "%2x", &byte) == 1;
            avr->flash[address + i] = (uint8_t)byte;
        }
        any = true;
    }
    if (file) fclose(file);
    if (!good || !any) fprintf(stderr, "bench: %s: not a boot loader of the upper 512 bytes\n", path);
    avr->reset_pc = BOOT_START;
    return good && any;
}

bool board_open(const board_options_t *wanted) {
    options = *wanted;
    rng_seed(&garbage, options.seed, 1);
    avr_global_logger_set(quiet);
    memset(&elf, 0, sizeof elf);
    if (elf_read_firmware(options.elf, &elf) || !elf.flash) {
        fprintf(stderr, "bench: cannot read firmware %s\n", options.elf);
        return false;
    }
    avr = avr_make_mcu_by_name("atmega328p");
    if (!avr || avr_init(avr)) return false;
    avr->log = LOG_ERROR;
    avr->frequency = CPU_HZ;
    avr->vcc = avr->avcc = avr->aref = 5000;
    if (elf.flashbase + elf.flashsize > BOOT_START) {
        fprintf(stderr, "bench: %s leaves no room for the boot loader\n", options.elf);
        return false;
    }
    avr_loadcode(avr, elf.flash, elf.flashsize, elf.flashbase);
    avr->flash[RUNAWAY] = 0xFF, avr->flash[RUNAWAY + 1] = 0xCF; // rjmp .-2
    avr->codeend = avr->flashend;
    if (options.bootloader && !load_bootloader(options.bootloader)) return false;
    avr->sleep = no_sleep;
    avr->reset = on_reset;
    for (avr_io_t *io = avr->io_port; io; io = io->next) {
        if (!strcmp(io->kind, "uart")) uart = (avr_uart_t *)io;
        if (strcmp(io->kind, "timer")) continue;
        avr_timer_t *const timer = (avr_timer_t *)io;
        const avr_io_addr_t flags = AVR_DATA_TO_IO(timer->overflow.raised.reg);
        avr->io[flags].w.c = on_timer_flags;
        avr->io[flags].w.param = timer;
    }
    echo_pin = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), ECHO_PIN);
    wire_pin = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), WIRE_PIN);
    trig_pin = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), TRIG_PIN);
    beacon_pin = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), BEACON_PIN);
    adc_pin = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0);
    uart_in = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_t *const uart_out = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT);
    if (!uart || !echo_pin || !wire_pin || !trig_pin || !beacon_pin || !adc_pin || !uart_in || !uart_out) {
        fputs("bench: this simavr has another ATmega328P\n", stderr);
        return false;
    }
    avr_irq_register_notify(trig_pin, on_trig, NULL);
    avr_irq_register_notify(avr_iomem_getirq(avr, DDRD, NULL, AVR_IOMEM_IRQ_ALL), on_direction, NULL);
    avr_irq_register_notify(uart_out, on_uart_out, NULL);
    for (uintptr_t i = 0; i < RELAY_PINS; i++)
        avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), (int)(RELAY_PIN + i)), on_relay, (void *)i);
    avr_irq_register_notify(beacon_pin, on_beacon, NULL);
    static const uint16_t pace[] = {UCSR0A, UCSR0C, UBRR0L, UBRR0H};
    for (size_t i = 0; i < sizeof pace / sizeof *pace; i++)
        avr_irq_register_notify(avr_iomem_getirq(avr, pace[i], NULL, AVR_IOMEM_IRQ_ALL), on_uart_register, NULL);
    return true;
}

void board_close(void) { avr_terminate(avr); }

void board_power(bool on) {
    if (on == powered) return;
    powered = on;
    truth(board_now(), "power", ", \"on\": %s", on ? "true" : "false");
    if (!on) {
        relay_pins_are(0);
        beacon_is(false);
        link_silence();
        sensor_power(false);
        ds18b20_power(false);
        return;
    }
    for (size_t i = RAM; i <= avr->ramend; i++) avr->data[i] = (uint8_t)rng_next(&garbage);
    sensor_power(true);
    ds18b20_power(true);
    restart(POWER_ON);
}

void board_reset(void) {
    if (powered) restart(RESET_LINE);
}

void board_hold(bool on) {
    if (on == held) return;
    held = on;
    if (on) link_silence(), relay_pins_are(0), beacon_is(false);
    else if (powered) restart(RESET_LINE);
}

void board_hang(bool interrupts) {
    if (!interrupts) avr->sreg[S_I] = 0;
    avr->pc = RUNAWAY;
    avr->state = cpu_Running;
    truth(board_now(), "hang", ", \"interrupts\": %s", interrupts ? "true" : "false");
}

static void drive(unsigned port, uint16_t pins, unsigned pin, avr_irq_t *irq, bool high) {
    // "external": without it simavr would drive a pin with a pull-up high at the next write to any pin of the port.
    avr_ioport_external_t pull = {.mask = 1u << pin, .value = high ? 1u << pin : 0u};
    pull.name = port & 0x7Fu;
    avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(port), &pull);
    avr_raise_irq(irq, high);
    avr->data[pins] = (uint8_t)((avr->data[pins] & ~(1u << pin)) | (high ? 1u << pin : 0u));
}

void board_echo(bool high) {
    echo_high = high;
    drive('B', PINB, ECHO_PIN, echo_pin, high);
}

void board_wire(bool high) {
    wire_high = high;
    drive('D', PIND, WIRE_PIN, wire_pin, high);
}

void board_adc(double millivolt) {
    adc_mv = millivolt;
    avr_raise_irq(adc_pin, millivolt > 0 ? (uint32_t)(millivolt + 0.5) : 0);
}

void board_hear(uint8_t byte) {
    if (powered && !held && board_now() >= idle_until) avr_raise_irq(uart_in, byte);
}

const char *board_crashed(void) {
    if (avr->state == cpu_Crashed) return "the processor crashed";
    if (avr->state == cpu_Done) return "the firmware sleeps with interrupts off";
    return NULL;
}

void board_skip(uint64_t until) {
    if (until > board_now()) offset = until - avr->cycle;
}

void board_wake(uint64_t at) {
    const uint64_t now = board_now();
    avr_cycle_timer_register(avr, at > now ? at - now : 1, on_next_event, NULL);
    avr->run_cycle_count = 1; // it may be in the middle of a row of instructions
}

static void run_processor(uint64_t until) {
    board_wake(until);
    while (board_now() < until && board_now() < event_next()) {
        const avr_cycle_count_t before = avr->cycle;
        const int state = avr_run(avr);
        if (avr->cycle < before) offset += before - avr->cycle;
        if (state == cpu_Crashed || state == cpu_Done) return;
        if (was_reset) {
            after_reset(WATCHDOG);
            idle_until = board_now() + cycles_of_ms(options.boot_ms);
            return;
        }
    }
}

void board_run(uint64_t until) {
    while (board_now() < until && !board_crashed()) {
        uint64_t next = event_next();
        if (next > until) next = until;
        const bool runs = powered && !held && board_now() >= idle_until;
        if (powered && !held && !runs && idle_until < next) next = idle_until;
        if (next > board_now()) {
            if (runs) run_processor(next);
            else board_skip(next);
        }
        event_fire(board_now());
    }
}
