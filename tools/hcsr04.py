"""The ranger's protocol as docs/ranger.md shows it, and its constants as the C header the firmware is compiled with, so
that board and gateway cannot disagree.

`./dev docs` writes firmware/ranger/src/protocol_constants.h from here; a test fails where the file differs. Pure.
"""

from gateway.core.readings import RelayOutput
from gateway.ranger.hcsr04.protocol import (
    ALL_FLAGS,
    BEACON_REQUEST,
    BURST_NS,
    FLAG_MEANING,
    HELLO_PERIOD_S,
    MAX_LINE,
    MAX_MCUSR,
    MAX_PERIOD_MS,
    MAX_SEQ,
    MAX_TEMPERATURE_DC,
    MAX_TICKS,
    MIN_PERIOD_MS,
    MIN_TEMPERATURE_DC,
    NO_FLAGS,
    PERIOD_MS,
    PROTOCOL_VERSION,
    QUESTION,
    RELAY_HOLD_MS,
    RESET_CAUSES,
    TENTHS_PER_TICK,
    TICK_NS,
    Flags,
    Hello,
    Measurement,
    RelayCommand,
    RelayReport,
    encode_command,
    encode_hello,
    encode_measurement,
)
from gateway.ranger.hcsr04.session import FARTHEST_MM, NEAREST_MM

HEAD = """\
/* Generated from gateway/ranger/hcsr04/protocol.py by `./dev docs`; a test fails where the two differ. Do not edit. */
#ifndef PROTOCOL_CONSTANTS_H
#define PROTOCOL_CONSTANTS_H
"""
TAIL = "\n#endif\n"


def header() -> str:
    """The text of protocol_constants.h."""
    above, below = TENTHS_PER_TICK
    values: tuple[tuple[str, int | str, str], ...] = (
        ("VERSION", PROTOCOL_VERSION, "carried by the hello"),
        ("QUESTION", f"'{QUESTION.decode()}'", "the host asks for a hello"),
        ("BEACON_REQUEST", f"'{BEACON_REQUEST.decode()}'", "the host asks for the beacon's code"),
        ("PERIOD_MS", PERIOD_MS, "cycle as shipped"),
        ("MIN_PERIOD_MS", MIN_PERIOD_MS, ""),
        ("MAX_PERIOD_MS", MAX_PERIOD_MS, ""),
        ("HELLO_PERIOD_S", HELLO_PERIOD_S, ""),
        ("TICKS_PER_MS", 1_000_000 // TICK_NS, "Timer1 at 16 MHz / 8: 0.5 us"),
        ("MAX_TICKS", MAX_TICKS, ""),
        ("MIN_TEMPERATURE_DC", MIN_TEMPERATURE_DC, "0.1 degrees C"),
        ("MAX_TEMPERATURE_DC", MAX_TEMPERATURE_DC, ""),
        ("RELAY_HOLD_MS", RELAY_HOLD_MS, "a relay command holds so long from the measurement whose number it bears"),
        ("MAX_LINE", MAX_LINE, "bytes between $ and line feed"),
        ("TENTHS_PER_TICK_ABOVE", above, "0.1 mm at 20 degrees C for one tick, a fraction"),
        ("TENTHS_PER_TICK_BELOW", below, ""),
        ("NEAREST_TENTHS", round(NEAREST_MM * 10), "0.1 mm; the sensor's range"),
        ("FARTHEST_TENTHS", round(FARTHEST_MM * 10), ""),
        *((f"FLAG_{flag.name}", flag.value, text) for flag, text in FLAG_MEANING.items()),
        *((f"RESET_{name.upper().replace(' ', '_').replace('-', '_')}", bit, "") for bit, name in RESET_CAUSES),
    )
    lines = (_define(*value) for value in values)
    return "\n".join((HEAD, *lines, TAIL))


def _define(name: str, value: int | str, comment: str) -> str:
    text = f"({value})" if isinstance(value, int) and value < 0 else f"{value}"
    return f"#define PROTOCOL_{name} {text}" + (f" /* {comment} */" if comment else "")


def wire_ms(size: int, baud: int) -> float:
    """How long so many bytes take on the wire: start bit, 8 data bits, stop bit."""
    return size * 10_000 / baud


def wire() -> str:
    """The wire as docs/ranger.md shows it."""
    near = encode_measurement(Measurement(1234, 2912))
    warm = encode_measurement(Measurement(1235, 2912, NO_FLAGS, 215))
    no_echo = encode_measurement(Measurement(1236, 0, Flags.NO_ECHO))
    longest = encode_measurement(Measurement(MAX_SEQ, 46_590, ALL_FLAGS, MIN_TEMPERATURE_DC))
    on = RelayReport(0xA1B2, RelayOutput.IN_PLACE, 1)
    hello = encode_hello(Hello("hcsr04", PROTOCOL_VERSION, PERIOD_MS, 2))
    fields = (
        ("`$HCM`", "measurement, one a cycle", ""),
        ("1", "sequence number, 0 after a reset, wraps", f"0-{MAX_SEQ}"),
        ("2", f"width of the ECHO pulse, {TICK_NS / 1000} us", f"0-{MAX_TICKS}"),
        ("3", "distance at 20 °C, 0.1 mm; for people, and must agree with field 2 within 1", ""),
        ("4", "flags, a sum; 0: valid", f"0-{ALL_FLAGS.value}"),
        ("5", "optional: air temperature, 0.1 °C", f"{MIN_TEMPERATURE_DC} to {MAX_TEMPERATURE_DC}"),
        ("6 on", "optional, each begins with its small letter, in the alphabet's order; unknown ones are ignored", ""),
        ("`b`", "the [beacon's](beacon.md) LED in the newest eight cycles, bit 0: this one", "`b00`-`bFF`"),
        (
            "`r`",
            "number of the run, four hex digits; what the board has [on](#the-relay), one hex digit",
            "`r00000`-`rFFFFB`",
        ),
        ("`$HCI`", f"hello: after a reset, every {HELLO_PERIOD_S} s, and when asked with `{QUESTION.decode()}`", ""),
        ("1", "name", "1-16 of `A-Z a-z 0-9 _ . -`"),
        ("2", f"protocol version, now {PROTOCOL_VERSION}", ""),
        ("3", f"cycle, ms; {PERIOD_MS} as shipped", f"{MIN_PERIOD_MS}-{MAX_PERIOD_MS}"),
        ("4", "reset cause (MCUSR): " + ", ".join(f"{bit} {name}" for bit, name in RESET_CAUSES), f"0-{MAX_MCUSR}"),
        ("`$HCR`", "from the gateway: command for the [relay](#the-relay)", ""),
        (
            "1, 2",
            "number of the run and sequence number of the measurement that it replies to",
            f"`0000`-`FFFF`, 0-{MAX_SEQ}",
        ),
        ("3", ", ".join(f"{output.value} {output.name}" for output in RelayOutput), "0-2"),
        ("4, 5", "shortest and longest ECHO pulse of the band, 0.5 us", f"0-{MAX_TICKS}"),
    )
    rows = ["| field | meaning | range |", "|---|---|---|", *(f"| {a} | {b} | {c} |" for a, b, c in fields)]
    flags = ["| flag | name | meaning |", "|---|---|---|"]
    flags += [f"| {flag.value} | {flag.name} | {text} |" for flag, text in FLAG_MEANING.items()]
    lines = (
        ("valid, 250 mm", near),
        ("with temperature, 21.5 °C", warm),
        ("no echo", no_echo),
        ("longest the sensor can cause", longest),
        ("hello", hello),
        ("with the beacon", encode_measurement(Measurement(1234, 2912, beacon=0x5A))),
        ("with the relay", encode_measurement(Measurement(1234, 2912, relay=on))),
        ("relay command", encode_command(RelayCommand(on.run, 1234, on.output, 2562, 3262))),
    )
    examples = ["| example | line | bytes | ms at 9600 baud |", "|---|---|---|---|"]
    examples += [f"| {n} | `{b.decode().strip()}` | {len(b)} | {wire_ms(len(b), 9600):.1f} |" for n, b in lines]
    return "\n\n".join("\n".join(table) for table in (rows, flags, examples, _budget(9600))) + "\n"


def _budget(baud: int) -> list[str]:
    """From the trigger to a complete line, by distance."""
    table = [
        "| target at | ECHO pulse, ms | line, bytes | line, ms | trigger to complete line, ms | wire in use |",
        "|---|---|---|---|---|---|",
    ]
    for mm in (20, 250, 300, 520, 1500, 4000):
        ticks = round(mm * 10 * TENTHS_PER_TICK[1] / TENTHS_PER_TICK[0])
        size = len(encode_measurement(Measurement(12_345, ticks)))
        pulse_ms, line_ms = ticks * TICK_NS / 1e6, wire_ms(size, baud)
        total_ms = BURST_NS / 1e6 + pulse_ms + line_ms
        share = line_ms / PERIOD_MS
        table.append(f"| {mm / 10:g} cm | {pulse_ms:.1f} | {size} | {line_ms:.1f} | {total_ms:.1f} | {share:.0%} |")
    return table
