"""Rows 80 to 96: the handshake with the PLC, which writes the first three; the gateway answers in the others. Pure."""

from enum import IntEnum

from gateway.core.plc import (
    CONTROL_MEANING,
    OUTCOME_MEANING,
    RECIPE_MEANING,
    RESET_MEANING,
    Acquired,
    PlcLink,
    TriggerPhase,
)
from gateway.core.state import StateVector
from gateway.modbus.registers.register import MEASURED_INT16, MEASURED_UINT16, UINT16, Register, Value, named, part

NS_PER_MS = 1_000_000


class HandshakeBit(IntEnum):
    """Bits of the handshake status. Never renumber, only add."""

    WRITES_ON = 0
    PLC_ALIVE = 1
    PLC_LOST = 2
    STOP_LATCHED = 3
    TRIGGER_READY = 4
    TRIGGER_ACK = 5
    ACQUIRING = 6
    RESULTS_VALID = 7
    OVERRUN = 8
    TIMED_OUT = 9


HANDSHAKE_MEANING: dict[HandshakeBit, str] = {
    HandshakeBit.WRITES_ON: "the handshake block can be written",
    HandshakeBit.PLC_ALIVE: "plc_heartbeat has changed within its deadline",
    HandshakeBit.PLC_LOST: "plc_heartbeat has not changed for longer than its deadline",
    HandshakeBit.STOP_LATCHED: "stop is latched: until a reset, a release, or the truck has left",
    HandshakeBit.TRIGGER_READY: "a rising trigger would be accepted",
    HandshakeBit.TRIGGER_ACK: "the trigger was accepted; turns off with the trigger bit",
    HandshakeBit.ACQUIRING: "a triggered measurement runs",
    HandshakeBit.RESULTS_VALID: "the result registers hold the result of acquisition_id",
    HandshakeBit.OVERRUN: "a trigger arrived while none could be accepted, and was lost; until the next accepted one",
    HandshakeBit.TIMED_OUT: "the newest acquisition got no result; until the next accepted trigger",
}


def _status(state: StateVector, _: int) -> Value:
    plc = state.plc
    used = plc.link is not PlcLink.UNUSED
    bits = {
        HandshakeBit.WRITES_ON: used,
        HandshakeBit.PLC_ALIVE: plc.link is PlcLink.ALIVE,
        HandshakeBit.PLC_LOST: plc.link is PlcLink.LOST,
        HandshakeBit.STOP_LATCHED: state.memory.latched,
        HandshakeBit.TRIGGER_READY: used and plc.phase is TriggerPhase.READY,
        HandshakeBit.TRIGGER_ACK: plc.trigger_ack,
        HandshakeBit.ACQUIRING: plc.phase is TriggerPhase.ACQUIRING,
        HandshakeBit.RESULTS_VALID: plc.phase is TriggerPhase.VALID,
        HandshakeBit.OVERRUN: plc.overrun,
        HandshakeBit.TIMED_OUT: plc.timed_out,
    }
    return sum(on << bit for bit, on in bits.items())


def _held(state: StateVector) -> Acquired | None:
    return state.plc.result if state.plc.phase is TriggerPhase.VALID else None


def _age_ms(state: StateVector, _: int) -> Value:
    if state.plc.link in (PlcLink.UNUSED, PlcLink.WAITING):
        return None
    return (state.t_ns - state.plc.beat_ns) // NS_PER_MS


HANDSHAKE: tuple[Register, ...] = (
    Register(80, "plc_heartbeat", UINT16, 1, "", "written by the PLC: any number, changed with every cycle",
             lambda s, _: s.plc.heartbeat, writable=True),
    Register(81, "plc_control", UINT16, 1, "", "written by the PLC: what it wants, one bit each",
             lambda s, _: s.plc.control, bits=named(CONTROL_MEANING), writable=True),
    Register(82, "recipe_select", UINT16, 1, "", "written by the PLC: id of the recipe it wants; 0: the configuration",
             lambda s, _: s.plc.recipe_asked, writable=True),
    Register(83, "handshake_status", UINT16, 1, "", "the gateway's side of the handshake, one bit each", _status,
             bits=named(HANDSHAKE_MEANING)),
    Register(84, "recipe_active", UINT16, 1, "", "id of the recipe in force; 0: the configuration as it is",
             lambda s, _: s.plc.recipe),
    Register(85, "recipe_verdict", UINT16, 1, "", "what became of the newest recipe_select",
             lambda s, _: int(s.plc.recipe_verdict), named(RECIPE_MEANING)),
    Register(86, "reset_verdict", UINT16, 1, "", "what became of the newest reset",
             lambda s, _: int(s.plc.reset_verdict), named(RESET_MEANING)),
    Register(87, "acquisition_id", UINT16, 1, "", "number of the newest accepted trigger: 1 to 65535, 1 again; 0: none",
             lambda s, _: s.plc.acquisition),
    Register(88, "result_id", UINT16, 1, "", "acquisition_id that the held result belongs to; 0: no result is held",
             lambda s, _: 0 if (held := _held(s)) is None else held.number),
    Register(89, "result_outcome", UINT16, 1, "", "outcome of the held result",
             lambda s, _: 0 if (held := _held(s)) is None else int(held.outcome), named(OUTCOME_MEANING)),
    Register(90, "result_u", MEASURED_INT16, 0.1, "px", "marker centre of the held result, to the right",
             part(_held, "u_px")),
    Register(91, "result_v", MEASURED_INT16, 0.1, "px", "marker centre of the held result, downwards",
             part(_held, "v_px")),
    Register(92, "result_radius", MEASURED_UINT16, 0.1, "px", "marker radius of the held result",
             part(_held, "radius_px")),
    Register(93, "result_distance", MEASURED_UINT16, 1, "mm", "distance of the held result",
             part(_held, "distance_mm")),
    Register(94, "plc_age", MEASURED_UINT16, 1, "ms", "since plc_heartbeat last changed", _age_ms),
    Register(95, "plc_writes", UINT16, 1, "", "writes accepted since the start of the gateway, modulo 65536",
             lambda s, _: s.plc.writes & 0xFFFF),
    Register(96, "write_conflicts", UINT16, 1, "", "writes refused because another PLC owns the block: count since the "
             "start of the gateway, modulo 65536", lambda s, _: s.plc.conflicts & 0xFFFF),
)  # fmt: skip
