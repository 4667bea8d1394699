"""The function block's body, once for IEC 61131-3 structured text, Siemens SCL and, but for the decoding, Logix. Pure.

Written as SCL, with `#` before local names and function names in quotes; `iec` takes both away, logix.py
translates. Only what every language and tool shares is used: no pointers, no unions, no shifts, no 64-bit numbers. A
float is put together by arithmetic, which is exact because only powers of two are multiplied.
"""

import re
from collections.abc import Iterable, Iterator, Sequence

from gateway.core.shown import withdrawn
from gateway.core.state import StateVector
from gateway.modbus.exports.decode import NO_VALUE, decode
from gateway.modbus.exports.diagnosis import (
    ALIVE,
    FIRST_ALIVE,
    HALF_CIRCLE,
    HEARTBEAT_CHANGES,
    LAST_ALIVE,
    SOUND,
    VALUES,
    Check,
    Diagnosis,
)
from gateway.modbus.exports.fields import fields
from gateway.modbus.exports.interface import REQUESTS
from gateway.modbus.exports.target import Target, template
from gateway.modbus.registers.register_map import encode

_PLAIN = {"×": "x", "–": "-", "°": "deg", "±": "+-", "µ": "u"}


def body(target: Target) -> str:
    """The body of the function block: decode, checks, heartbeat, outputs, triggered measurement, what is written."""
    return f"{decode(target)}\n{logic(target)}"


def logic(target: Target) -> str:
    """All after the decoding: the same in every language of IEC 61131-3 and at Rockwell."""
    outputs = template("outputs.scl").format(
        first_alive=FIRST_ALIVE,
        last_alive=LAST_ALIVE,
        nothing=indented(nothing()),
        limit=f"T#{target.step_timeout_ms}ms",
        wrong_bay=int(Diagnosis.WRONG_BAY),
        # Bits are put together by adding, which every language can.
        requests=indented(
            "\n".join(f"IF #{name} THEN\n  #PlcControl := #PlcControl + {1 << bit};\nEND_IF;" for name, bit in REQUESTS)
        ),
    )
    return f"{judgement()}\n{outputs}"


def judgement() -> str:
    """From `Raw` to `Diagnostic`: the checks of an image, the heartbeat, the checks of its values."""
    values = {"changes": HEARTBEAT_CHANGES, "half_circle": HALF_CIRCLE}
    return template("judgement.scl").format(sound=_sound(), values=_values(), **values)


def nothing() -> str:
    """Data as that of a gateway that has stopped deciding."""
    dead = (f"#Data.{name} := {value};" for name, value in dead_fields())
    return "\n".join(("#Data := #Nothing;", *dead))


def indented(text: str) -> str:
    return "\n".join(f"  {line}" for line in text.splitlines())


def dead_fields() -> Iterator[tuple[str, str]]:
    """(field, value) of every code, flag and bit that is not 0 in the image of a gateway that has stopped deciding, and
    of every REAL without a value.

    Without them an empty structure would mean "quality good, no reason", and a truck that touches the sensor.
    """
    image = encode(withdrawn(StateVector(""), 0), 0, "big")
    for field in fields():
        register = field.register
        if field.kind == "REAL" and register.kind.no_value is not None:
            yield field.name, NO_VALUE
        if register.codes is None and register.bits is None and register.name != "stop":
            continue
        word = image[register.address]
        if field.part == "bit" and word >> field.bit & 1:
            yield field.name, "TRUE"
        elif field.part == "value" and word not in (0, register.kind.no_value):
            yield field.name, str(word)


def _sound() -> str:
    """The checks of an image itself, before anything in it counts."""
    lines = ["(* The first check that fails turns outputs off. First those of the image itself. *)"]
    return "\n".join([*lines, *_chain(SOUND), "#Sound := #Diagnostic = 0;", ""])


def _values() -> str:
    """The checks of a sound image."""
    chain = indented("\n".join(_chain((*ALIVE, *VALUES))))
    return f"(* Then the checks of the values in a valid image. *)\nIF #Sound THEN\n{chain}\nEND_IF;\n"


def _chain(checks: Sequence[Check]) -> Iterator[str]:
    return first_of("Diagnostic", ((check.condition, check.diagnosis, check.meaning) for check in checks))


def first_of(name: str, rows: Iterable[tuple[str, int, str]]) -> Iterator[str]:
    """`name` becomes the number of the first (condition, number, meaning) that applies; 0 where none does."""
    for n, (condition, number, meaning) in enumerate(rows):
        yield f"{'ELSIF' if n else 'IF'} {condition} THEN"
        yield f"  #{name} := {int(number)}; (* {meaning} *)"
    yield from ("ELSE", f"  #{name} := 0;", "END_IF;")


def iec(text: str) -> str:
    """SCL's local names and quoted function names as plain IEC identifiers. Typed literals keep their `#`."""
    return re.sub(r'"(\w+)"', r"\1", re.sub(r"(?<!\w)#(?=[A-Za-z_])", "", text))


def ascii_only(text: str) -> str:
    """PLC tools disagree on encodings; the few signs that are not ASCII have a plain spelling."""
    for sign, plain in _PLAIN.items():
        text = text.replace(sign, plain)
    return text.encode("ascii", "replace").decode("ascii")
