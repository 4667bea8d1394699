"""Rows 80 to 96: the handshake with the PLC, which writes the first three; the gateway answers in the others. Pure."""

from gateway.core.plc import Acquired, Control, PlcLink, RecipeVerdict, ResetVerdict, TriggerOutcome, TriggerPhase
from gateway.core.state import StateVector
from gateway.durations import NS_PER_MS
from gateway.modbus.registers.register import (
    MEASURED_INT16,
    MEASURED_UINT16,
    UINT16,
    Register,
    StatusWord,
    Value,
    named,
    part,
    shown,
)


def _used(state: StateVector) -> bool:
    return state.plc.link is not PlcLink.UNUSED


HANDSHAKE_STATUS = StatusWord((
    ("writes_on", "the handshake block can be written", _used),
    ("plc_alive", "plc_heartbeat has changed within its deadline", lambda s: s.plc.link is PlcLink.ALIVE),
    ("plc_lost", "plc_heartbeat has not changed for longer than its deadline", lambda s: s.plc.link is PlcLink.LOST),
    ("stop_latched", "stop is latched: until a reset, a release, or the truck has left", lambda s: s.memory.latched),
    ("trigger_ready", "a rising trigger would be accepted", lambda s: _used(s) and s.plc.phase is TriggerPhase.READY),
    ("trigger_ack", "the trigger was accepted; turns off with the trigger bit", lambda s: s.plc.trigger_ack),
    ("acquiring", "a triggered measurement runs", lambda s: s.plc.phase is TriggerPhase.ACQUIRING),
    ("results_valid", "the result registers hold the result of acquisition_id",
     lambda s: s.plc.phase is TriggerPhase.VALID),
    ("overrun", "a trigger arrived while none could be accepted, and was lost; until the next accepted one",
     lambda s: s.plc.overrun),
    ("timed_out", "the newest acquisition got no result; until the next accepted trigger", lambda s: s.plc.timed_out),
))  # fmt: skip


def _held(state: StateVector) -> Acquired | None:
    return state.plc.result if state.plc.phase is TriggerPhase.VALID else None


def _age_ms(state: StateVector, _: int) -> Value:
    if state.plc.link in (PlcLink.UNUSED, PlcLink.WAITING) or not state.running:
        return None
    return (state.t_ns - state.plc.beat_ns) // NS_PER_MS


HANDSHAKE: tuple[Register, ...] = (
    Register(80, "plc_heartbeat", UINT16, 1, "", "written by the PLC: any number, changed with every cycle",
             lambda s, _: s.plc.heartbeat, writable=True),
    Register(81, "plc_control", UINT16, 1, "", "written by the PLC: what it wants, one bit each",
             lambda s, _: s.plc.control, bits=named(Control), writable=True),
    Register(82, "recipe_select", UINT16, 1, "", "written by the PLC: id of the recipe it wants; 0: the configuration",
             lambda s, _: s.plc.recipe_asked, writable=True),
    Register(83, "handshake_status", UINT16, 1, "", "the gateway's side of the handshake, one bit each",
             HANDSHAKE_STATUS.read, bits=HANDSHAKE_STATUS.names),
    shown(84, "recipe_active", UINT16, 1, "plc.recipe"),
    Register(85, "recipe_verdict", UINT16, 1, "", "what became of the newest recipe_select",
             lambda s, _: int(s.plc.recipe_verdict), named(RecipeVerdict)),
    Register(86, "reset_verdict", UINT16, 1, "", "what became of the newest reset",
             lambda s, _: int(s.plc.reset_verdict), named(ResetVerdict)),
    shown(87, "acquisition_id", UINT16, 1, "plc.acquisition_id",
          "number of the newest accepted trigger: 1 to 65535, 1 again; 0: none"),
    Register(88, "result_id", UINT16, 1, "", "acquisition_id that the held result belongs to; 0: no result is held",
             lambda s, _: 0 if (held := _held(s)) is None else held.number),
    Register(89, "result_outcome", UINT16, 1, "", "outcome of the held result",
             lambda s, _: 0 if (held := _held(s)) is None else int(held.outcome), named(TriggerOutcome)),
    Register(90, "result_u", MEASURED_INT16, 0.1, "px", "marker centre of the held result, to the right",
             part(_held, "u_px")),
    Register(91, "result_v", MEASURED_INT16, 0.1, "px", "marker centre of the held result, downwards",
             part(_held, "v_px")),
    Register(92, "result_radius", MEASURED_UINT16, 0.1, "px", "marker radius of the held result",
             part(_held, "radius_px")),
    Register(93, "result_distance", MEASURED_UINT16, 1, "mm", "distance of the held result",
             part(_held, "distance_mm")),
    Register(94, "plc_age", MEASURED_UINT16, 1, "ms", "since plc_heartbeat last changed", _age_ms),
    shown(95, "plc_writes", UINT16, 1, "plc.writes", "writes accepted since the start of the gateway, modulo 65536"),
    shown(96, "write_conflicts", UINT16, 1, "plc.write_conflicts",
          "writes refused because another program owns the block: count since the start of the gateway, modulo 65536"),
)  # fmt: skip
