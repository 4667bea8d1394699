"""Does the image that a PLC reads say what the gateway has decided? Pure: an image and the shared state in, words out.

Whoever asks is the version that ran before: no register is ever renumbered, so it reads the image of a newer one, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from gateway.core.state import Reason, VisitPhase
from gateway.errors import ProtocolError
from gateway.modbus.exports.diagnosis import Raw, contradictions
from gateway.modbus.exports.fields import fields
from gateway.modbus.registers.register_map import BLOCK_WORDS, KNOWN_FLOAT32, Value, decode
from gateway.shared_state import SharedVector
from gateway.status_file import BayNow

FIRST_WORDS = 100  # so many has the block in every map version
KNOWN = slice(40, 44)  # the words of known_u32 and known_f32: they show the word order


@dataclass(frozen=True, slots=True)
class Compared:
    """One image with what was decided. `fault`: what differs, in words. `certain`: both were of the same moment, or the
    image contradicts itself; else another look may find them equal. `heartbeat`: of the image."""

    fault: str
    certain: bool
    heartbeat: float | None = None


def compared(
    image: Sequence[int], vector: SharedVector, bay: BayNow, *, known: Sequence[int] = (), any_map: bool = False
) -> Compared:
    """`bay`: by the status file, which is up to a second older. `known`: the words at KNOWN before the update.
    `any_map`: the image may be of an older map version, with FIRST_WORDS words."""
    if known and tuple(image[KNOWN]) != tuple(known):
        return Compared("the known constants at 40 to 43 are not those of before: another word order?", certain=True)
    try:
        values = decode((*image, *[0] * (BLOCK_WORDS - len(image))), *((0,) if any_map else ()))
    except ProtocolError as error:
        return Compared(str(error), certain=False)  # torn by chance
    heartbeat, raw = values["heartbeat"], _raw(values)
    found = contradictions(raw)
    if found or values["known_f32"] != KNOWN_FLOAT32:
        why = f"the image contradicts itself: {found[0]}" if found else f"known_f32 is {values['known_f32']}"
        return Compared(why, certain=True, heartbeat=heartbeat)
    if vector.reason is Reason.GATEWAY_FAULT:
        return Compared("its control does not run", certain=False, heartbeat=heartbeat)
    differing = _differing(values, vector)
    if values["seq_begin"] != 2 * vector.seq & 0xFFFF:
        why = f"image {values['seq_begin']:.0f} is not of state {vector.seq}"
        return Compared("; ".join([why, *differing]), certain=False, heartbeat=heartbeat)
    fault = "; ".join(differing) or _against_status(raw, bay)
    return Compared(fault, certain=bool(differing), heartbeat=heartbeat)


def _raw(values: dict[str, Value]) -> Raw:
    raw: dict[str, float | bool] = {}
    for field in fields():
        value = values[field.register.name]
        match field.part:
            case "value":
                raw[field.name] = value or 0
            case "valid":
                raw[field.name] = value is not None
            case "bit":
                raw[field.name] = bool(int(value or 0) >> field.bit & 1)
    return raw


def _differing(values: dict[str, Value], vector: SharedVector) -> list[str]:
    decided: dict[str, Value] = {
        "stop": int(vector.stop),
        "may_move": int(vector.may_move),
        "in_place": int(vector.in_place),
        "moved": int(vector.moved),
        "reason": int(vector.reason),
        "d": None if vector.d is None else int(vector.d),
        "vision_quality": int(vector.vision_quality),
        "range_quality": int(vector.range_quality),
    }
    return [f"{name} is {values[name]}, decided {value}" for name, value in decided.items() if values[name] != value]


def _against_status(raw: Raw, bay: BayNow) -> str:
    phase = int(raw["visit_phase"])
    if phase in set(VisitPhase) and (name := VisitPhase(phase).name.lower()) != bay.phase:  # not one of a newer version
        return f"visit_phase is {name}, and the status says {bay.phase}"
    if bay.function_check in ("", "off"):
        return ""
    if not raw["ne107_active_function_check"]:
        return "a function check is on, and ne107_active does not say so"
    if raw["in_place"] or (raw["may_move"] and bay.function_check != "may_move_kept"):
        return f"a function check is on, and may_move is {raw['may_move']}, in_place {raw['in_place']}"
    return ""
