"""What may be shown of a bay now: the one rule of every output, so that all of them show the same. Pure.

A state is valid until `valid_until_ns`, which every tick of the control task extends. Readings do not: without
ticks nothing is decided, and good values must not be shown beside a heartbeat that no longer counts.
"""

from typing import Protocol

from gateway.core import fusion
from gateway.core.plc import TriggerPhase
from gateway.core.state import Guidance, GuidanceCode, Reason, StateVector
from gateway.replacing import replace


class Dated(Protocol):
    """A state in any form: StateVector, or what other processes read of it."""

    @property
    def valid_until_ns(self) -> int: ...

    @property
    def reason(self) -> Reason: ...


def shown(state: StateVector, now_ns: int) -> StateVector:
    """`state`, or, when it is no longer valid, the same with stop on and every value withdrawn.

    `now_ns`: monotonic, the clock of the state.
    """
    return state if valid(state, now_ns) else withdrawn(state, now_ns)


def valid(state: Dated, now_ns: int) -> bool:
    """May `state` be shown at `now_ns`? The last state of a gateway that has shut down stays."""
    return now_ns <= state.valid_until_ns or state.reason is Reason.SHUTDOWN


def resumed(state: StateVector, now_ns: int) -> StateVector:
    """`state` as the next step goes on from it: itself, or, where it has been shown withdrawn meanwhile, without all
    that must be earned again.

    What a PLC saw withdrawn must not come back by itself: in place, a release, a triggered measurement, and the time
    for which nothing has stopped the truck. Readings have their own ages, and D only ever ends by both sensors.
    """
    if valid(state, now_ns):
        return state
    memory, plc = state.memory, state.plc
    memory = replace(
        memory,
        vision_failure=replace(memory.vision_failure, alive_since_ns=None),
        range_failure=replace(memory.range_failure, alive_since_ns=None),
        no_cause_since_ns=None,
        pending_since_ns=None,
        absent_since_ns=None,
        track=(),
        drive=memory.drive.resumed(),
    )
    return replace(
        state,
        stop=True,
        may_move=False,
        reason=Reason.GATEWAY_FAULT,
        d=None,
        memory=memory,
        plc=replace(plc.withdrawn(), timed_out=plc.timed_out or plc.phase is TriggerPhase.ACQUIRING),
        guidance=Guidance(GuidanceCode.FAULT),
        visit=state.visit.withdrawn(),
        setpoint=state.setpoint.withdrawn(),
        pose=None,
    )


def withdrawn(state: StateVector, now_ns: int) -> StateVector:
    """`state` as shown when the control task does not run: stop on, may_move off, no values."""
    return fusion.forced_stop(state, Reason.GATEWAY_FAULT, now_ns)


def lapsed(state: StateVector, now_ns: int) -> StateVector | None:
    """`state` as it has been shown since it was no longer valid; None: it is valid, or has never been."""
    if valid(state, now_ns) or not valid(state, state.t_ns):
        return None
    return withdrawn(state, state.valid_until_ns + 1)
