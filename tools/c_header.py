"""The protocol's constants as the C header the firmware is compiled with, so that board and gateway cannot disagree.

`./dev docs` writes firmware/ranger/src/protocol_constants.h from here; a test fails where the file differs. Pure.
"""

from gateway.ranger.hcsr04 import protocol
from gateway.ranger.hcsr04.session import FARTHEST_MM, NEAREST_MM

HEAD = """\
/* Generated from gateway/ranger/hcsr04/protocol.py by `./dev docs`; a test fails where the two differ. Do not edit. */
#ifndef PROTOCOL_CONSTANTS_H
#define PROTOCOL_CONSTANTS_H
"""
TAIL = "\n#endif\n"


def header() -> str:
    """The text of protocol_constants.h."""
    above, below = protocol.TENTHS_PER_TICK
    values: tuple[tuple[str, int | str, str], ...] = (
        ("VERSION", protocol.PROTOCOL_VERSION, "carried by the hello"),
        ("QUESTION", f"'{protocol.QUESTION.decode()}'", "the host asks for a hello"),
        ("PERIOD_MS", protocol.PERIOD_MS, "cycle as shipped"),
        ("MIN_PERIOD_MS", protocol.MIN_PERIOD_MS, ""),
        ("MAX_PERIOD_MS", protocol.MAX_PERIOD_MS, ""),
        ("HELLO_PERIOD_S", protocol.HELLO_PERIOD_S, ""),
        ("TICKS_PER_MS", 1_000_000 // protocol.TICK_NS, "Timer1 at 16 MHz / 8: 0.5 us"),
        ("MAX_TICKS", protocol.MAX_TICKS, ""),
        ("MIN_TEMPERATURE_DC", protocol.MIN_TEMPERATURE_DC, "0.1 degrees C"),
        ("MAX_TEMPERATURE_DC", protocol.MAX_TEMPERATURE_DC, ""),
        ("MAX_LINE", protocol.MAX_LINE, "bytes between $ and line feed"),
        ("TENTHS_PER_TICK_ABOVE", above, "0.1 mm at 20 degrees C for one tick, a fraction"),
        ("TENTHS_PER_TICK_BELOW", below, ""),
        ("NEAREST_TENTHS", round(NEAREST_MM * 10), "0.1 mm; the sensor's range"),
        ("FARTHEST_TENTHS", round(FARTHEST_MM * 10), ""),
        *((f"FLAG_{flag.name}", flag.value, text) for flag, text in protocol.FLAG_MEANING.items()),
        *(
            (f"RESET_{name.upper().replace(' ', '_').replace('-', '_')}", bit, "")
            for bit, name in protocol.RESET_CAUSES
        ),
    )
    lines = (_define(*value) for value in values)
    return "\n".join((HEAD, *lines, TAIL))


def _define(name: str, value: int | str, comment: str) -> str:
    text = f"({value})" if isinstance(value, int) and value < 0 else f"{value}"
    return f"#define PROTOCOL_{name} {text}" + (f" /* {comment} */" if comment else "")
