"""Images of a live bay with doubts in them, for programs that must agree about each: seeded, the same every time."""

import random
from typing import Any

from gateway.core.plc import Acquired, Handshake, PlcLink, TriggerOutcome, TriggerPhase
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Reason, StateVector, Visit
from gateway.modbus.exports.structured_text import FUNCTION_BLOCK
from gateway.modbus.exports.target import Target
from gateway.modbus.registers.register_map import REGISTERS, encode
from tests.permitted import permitted, standing
from tests.structured_text import Instance, Program

BAY = Target().identity

ADDRESS = {register.name: register.address for register in REGISTERS}
_WATCHED = (
    *("seq_begin", "map_version", "heartbeat", "status", "stop", "may_move", "reason", "vision_quality"),
    *(
        "range_quality",
        "known_u32",
        "known_f32",
        "seq_end",
        "in_place",
        "moved",
        "position_status",
        "d",
        "signal_lamps",
        "unit_id",
        "bay_identity",
        "handshake_status",
        "plc_heartbeat",
    ),
)
_CHANGES: tuple[dict[str, Any], ...] = (
    {"vision": VisionReading(0, Quality.COASTED)},
    {"vision": VisionReading(0, Quality.STALE)},
    {"range": RangeReading(0, Quality.NO_ECHO)},
    {"may_move": False},
    {"may_move": False, "stop": True, "reason": Reason.NO_TARGET, "visit": Visit()},
)


def words(state: StateVector) -> list[int]:
    return list(encode(state, 1_763_640_000_123_456_789, "big", BAY))


def block_of(program: Program) -> Instance:
    """A function block that is told which bay it reads, as every exported program does."""
    made = program.instance(FUNCTION_BLOCK)
    made.values |= {"UnitId": BAY.unit_id, "BayIdentity": BAY.number}
    return made


def torn(state: StateVector, seq_end: int) -> list[int]:
    """The words of `state`, with the end of another image."""
    image = words(state)
    image[ADDRESS["seq_end"]] = seq_end
    return image


def doubtful(count: int, seed: int = 61131) -> list[list[int]]:
    """Three good images of a truck that may move, then `count` of one that may and one that stands, some changed."""
    chance = random.Random(seed)
    images = [words(permitted(heartbeat)) for heartbeat in (6, 7, 8)]
    for n in range(count):
        state = (permitted, standing)[n // 40 % 2]
        image = words(state(9 + n // 3, **chance.choice([{}, {}, {}, *_CHANGES])))
        for _ in range(chance.choice((0, 0, 0, 0, 0, 0, 0, 1, 2))):
            image[ADDRESS[chance.choice(_WATCHED)]] = chance.choice((0, 1, 2, 4, 10, 0x1234, 0x5678, 0xFFFF))
        images.append(image)
    return images


def answered(
    heartbeat: int,
    phase: TriggerPhase = TriggerPhase.READY,
    *,
    control: int = 0,
    number: int = 0,
    ack: bool = False,
    timed_out: bool = False,
    echo: int = 0,
) -> list[int]:
    """The image of a gateway with writes on, as its handshake stands."""
    result = (
        Acquired(number, 0, TriggerOutcome.IN_PLACE, 320.0, 240.0, 190.0, 281.0)
        if phase is TriggerPhase.VALID
        else None
    )
    plc = Handshake(
        PlcLink.ALIVE,
        heartbeat=echo,
        control=control,
        phase=phase,
        acquisition=number,
        trigger_ack=ack,
        timed_out=timed_out,
        result=result,
    )
    return words(standing(heartbeat, plc=plc))
