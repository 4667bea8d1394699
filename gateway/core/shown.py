"""What may be shown of a bay now: the one rule of every output, so that all of them show the same. Pure.

A state is valid until `valid_until_ns`, which every tick of the control task extends. Readings do not: without
ticks nothing is decided, and good values must not be shown beside a heartbeat that no longer counts.
"""

from typing import Protocol

from gateway.core import fusion
from gateway.core.state import Reason, StateVector


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


def withdrawn(state: StateVector, now_ns: int) -> StateVector:
    """`state` as shown when the control task does not run: stop on, may_move off, no values."""
    return fusion.forced_stop(state, Reason.GATEWAY_FAULT, now_ns)
