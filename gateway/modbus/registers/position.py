"""Rows 35 to 39: may the truck move, is it in place, has it moved since. Pure (docs/visit.md)."""

from gateway.core.state import Moved, StateVector, VisitPhase
from gateway.durations import NS_PER_S
from gateway.modbus.registers.register import MEASURED_UINT16, UINT16, Register, StatusWord, Value, named, shown

POSITION_STATUS = StatusWord((
    ("may_move", "the truck may move, as in register may_move; never a condition for loading", lambda s: s.may_move),
    ("in_place", "the truck is in place, as in register in_place: the only condition for loading",
     lambda s: s.in_place),
    ("held", "in place is held by the ranger alone: the marker is covered; held_time is the time since then",
     lambda s: s.visit.held),
    ("moved", "the truck left its place without release; how it was detected: register moved",
     lambda s: s.visit.moved is not Moved.NO),
    ("released", "the PLC has released the truck, which has not left yet", lambda s: s.visit.released),
    ("rolling", "a truck that was in place moves without release: stop loading; before `moved`",
     lambda s: s.visit.rolling),
))  # fmt: skip


def _held_s(state: StateVector, _: int) -> Value:
    since_ns = state.visit.covered_since_ns
    return None if not state.visit.held or since_ns is None else (state.t_ns - since_ns) // NS_PER_S


POSITION: tuple[Register, ...] = (
    Register(35, "position_status", UINT16, 1, "", "position of the truck, one bit each",
             POSITION_STATUS.read, bits=POSITION_STATUS.names),
    shown(36, "in_place", UINT16, 1, "in_place", "1: the truck is in place; the only condition for loading; else 0"),
    shown(37, "moved", UINT16, 1, "moved", "since it was in place, has the truck moved without release?",
          codes=named(Moved)),
    Register(38, "held_time", MEASURED_UINT16, 1, "s", "in_place has been held by the ranger alone for this time",
             _held_s),
    shown(39, "visit_phase", UINT16, 1, "phase", "phase of the visit; for people, decide on in_place and may_move",
          codes=named(VisitPhase)),
)  # fmt: skip
