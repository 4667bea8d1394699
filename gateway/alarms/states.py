"""One alarm's states of ISA-18.2 / IEC 62682 and their transitions. Pure.

The letters are those of the standards' state diagram. What it leaves to the designer is decided here: no alarm is
announced again by a timer; a latched one must be acknowledged before it can be reset; and an alarm that was hidden on
purpose is announced as new where its cause is still active.
"""

from dataclasses import dataclass
from enum import StrEnum


class AlarmState(StrEnum):
    """The state of an alarm. The names are on the wire."""

    NORMAL = "normal"
    UNACKNOWLEDGED = "unacknowledged"
    ACKNOWLEDGED = "acknowledged"
    RETURNED = "returned"
    LATCHED_UNACKNOWLEDGED = "latched_unacknowledged"
    LATCHED_ACKNOWLEDGED = "latched_acknowledged"
    SHELVED = "shelved"
    SUPPRESSED = "suppressed"
    OUT_OF_SERVICE = "out_of_service"


class AlarmEvent(StrEnum):
    """What makes an alarm change its state. The names are on the wire."""

    OCCURS = "occurs"
    RETURNS = "returns"
    ACKNOWLEDGE = "acknowledge"
    RESET = "reset"
    SHELVE = "shelve"
    UNSHELVE = "unshelve"
    SUPPRESS = "suppress"
    UNSUPPRESS = "unsuppress"
    REMOVE = "remove"
    RESTORE = "restore"


A, B, C = AlarmState.NORMAL, AlarmState.UNACKNOWLEDGED, AlarmState.ACKNOWLEDGED
D = AlarmState.RETURNED
E, F = AlarmState.LATCHED_UNACKNOWLEDGED, AlarmState.LATCHED_ACKNOWLEDGED
G, H, I = AlarmState.SHELVED, AlarmState.SUPPRESSED, AlarmState.OUT_OF_SERVICE  # noqa: E741 - the standard's letters


@dataclass(frozen=True, slots=True)
class Transition:
    """One arrow of the diagram. `latching`, `active`: only for such alarms, only with such a cause; None: for any."""

    source: AlarmState
    event: AlarmEvent
    target: AlarmState
    latching: bool | None = None
    active: bool | None = None


_SHOWN = (A, B, C, D, E, F)
TRANSITIONS: tuple[Transition, ...] = (
    Transition(A, AlarmEvent.OCCURS, B),
    Transition(B, AlarmEvent.ACKNOWLEDGE, C),
    Transition(B, AlarmEvent.RETURNS, D, latching=False),
    Transition(C, AlarmEvent.RETURNS, A, latching=False),
    Transition(D, AlarmEvent.ACKNOWLEDGE, A),
    Transition(D, AlarmEvent.OCCURS, B),
    Transition(B, AlarmEvent.RETURNS, E, latching=True),
    Transition(C, AlarmEvent.RETURNS, F, latching=True),
    Transition(E, AlarmEvent.ACKNOWLEDGE, F),
    Transition(E, AlarmEvent.OCCURS, B),
    Transition(F, AlarmEvent.RESET, A),
    Transition(F, AlarmEvent.OCCURS, B),
    *(Transition(shown, AlarmEvent.SHELVE, G) for shown in _SHOWN),
    Transition(G, AlarmEvent.UNSHELVE, B, active=True),
    Transition(G, AlarmEvent.UNSHELVE, A, active=False),
    *(Transition(shown, AlarmEvent.SUPPRESS, H) for shown in _SHOWN),
    Transition(H, AlarmEvent.UNSUPPRESS, A),
    *(Transition(shown, AlarmEvent.REMOVE, I) for shown in (*_SHOWN, G, H)),
    Transition(I, AlarmEvent.RESTORE, B, active=True),
    Transition(I, AlarmEvent.RESTORE, A, active=False),
)

_NEXT: dict[tuple[AlarmState, AlarmEvent, bool, bool], AlarmState] = {
    (arrow.source, arrow.event, latching, active): arrow.target
    for arrow in TRANSITIONS
    for latching in (False, True)
    for active in (False, True)
    if arrow.latching in (None, latching) and arrow.active in (None, active)
}


def next_state(state: AlarmState, event: AlarmEvent, *, latching: bool, active: bool) -> AlarmState | None:
    """The state after `event`; None where no arrow leads on. `active`: does the cause hold?"""
    return _NEXT.get((state, event, latching, active))
