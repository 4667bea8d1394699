"""How one alarm lives: the states of ISA-18.2 / IEC 62682 and what leads from one to the next. Pure.

The letters are those of the standards' state diagram. What it leaves to the designer is decided here: no alarm is
announced again by a timer; a latched one must be acknowledged before it can be reset; and whatever was hidden on
purpose is announced as new where its cause still stands.
"""

from dataclasses import dataclass
from enum import StrEnum


class AlarmState(StrEnum):
    """Where an alarm stands. The names are on the wire."""

    NORMAL = "normal"
    UNACKNOWLEDGED = "unacknowledged"
    ACKNOWLEDGED = "acknowledged"
    RETURNED = "returned"
    LATCHED_UNACKNOWLEDGED = "latched_unacknowledged"
    LATCHED_ACKNOWLEDGED = "latched_acknowledged"
    SHELVED = "shelved"
    SUPPRESSED = "suppressed"
    OUT_OF_SERVICE = "out_of_service"


STATE_MEANING: dict[AlarmState, tuple[str, str]] = {
    AlarmState.NORMAL: ("A", "its cause does not hold, and nobody has to take notice of it"),
    AlarmState.UNACKNOWLEDGED: ("B", "its cause holds, and nobody has taken notice yet"),
    AlarmState.ACKNOWLEDGED: ("C", "its cause holds, and somebody has taken notice"),
    AlarmState.RETURNED: ("D", "its cause came and went, and nobody has taken notice yet"),
    AlarmState.LATCHED_UNACKNOWLEDGED: ("E", "its cause came and went; it must be acknowledged, then reset"),
    AlarmState.LATCHED_ACKNOWLEDGED: ("F", "its cause went; it stays until somebody resets it"),
    AlarmState.SHELVED: ("G", "put aside by a person for a limited time"),
    AlarmState.SUPPRESSED: ("H", "meaningless for the moment, by design: its row says when"),
    AlarmState.OUT_OF_SERVICE: ("I", "taken out of service by a person, until they put it back"),
}


class Cue(StrEnum):
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


CUE_MEANING: dict[Cue, str] = {
    Cue.OCCURS: "its cause holds for its on-delay",
    Cue.RETURNS: "its cause is gone for its off-delay",
    Cue.ACKNOWLEDGE: "a person takes notice; changes nothing but the alarm",
    Cue.RESET: "a person ends a latched alarm whose cause is gone",
    Cue.SHELVE: "a person puts it aside for a while",
    Cue.UNSHELVE: "that while is over, or a person takes it back",
    Cue.SUPPRESS: "it becomes meaningless, by design",
    Cue.UNSUPPRESS: "it means something again; a cause that holds is announced after the on-delay",
    Cue.REMOVE: "a person takes it out of service",
    Cue.RESTORE: "a person puts it back into service",
}

A, B, C = AlarmState.NORMAL, AlarmState.UNACKNOWLEDGED, AlarmState.ACKNOWLEDGED
D = AlarmState.RETURNED
E, F = AlarmState.LATCHED_UNACKNOWLEDGED, AlarmState.LATCHED_ACKNOWLEDGED
G, H, I = AlarmState.SHELVED, AlarmState.SUPPRESSED, AlarmState.OUT_OF_SERVICE  # noqa: E741 - the standard's letters


@dataclass(frozen=True, slots=True)
class Transition:
    """One arrow of the diagram. `latching`, `active`: only for such alarms, only with such a cause; None: for any."""

    source: AlarmState
    cue: Cue
    target: AlarmState
    latching: bool | None = None
    active: bool | None = None


_SHOWN = (A, B, C, D, E, F)
TRANSITIONS: tuple[Transition, ...] = (
    Transition(A, Cue.OCCURS, B),
    Transition(B, Cue.ACKNOWLEDGE, C),
    Transition(B, Cue.RETURNS, D, latching=False),
    Transition(C, Cue.RETURNS, A, latching=False),
    Transition(D, Cue.ACKNOWLEDGE, A),
    Transition(D, Cue.OCCURS, B),
    Transition(B, Cue.RETURNS, E, latching=True),
    Transition(C, Cue.RETURNS, F, latching=True),
    Transition(E, Cue.ACKNOWLEDGE, F),
    Transition(E, Cue.OCCURS, B),
    Transition(F, Cue.RESET, A),
    Transition(F, Cue.OCCURS, B),
    *(Transition(shown, Cue.SHELVE, G) for shown in _SHOWN),
    Transition(G, Cue.UNSHELVE, B, active=True),
    Transition(G, Cue.UNSHELVE, A, active=False),
    *(Transition(shown, Cue.SUPPRESS, H) for shown in _SHOWN),
    Transition(H, Cue.UNSUPPRESS, A),
    *(Transition(shown, Cue.REMOVE, I) for shown in (*_SHOWN, G, H)),
    Transition(I, Cue.RESTORE, B, active=True),
    Transition(I, Cue.RESTORE, A, active=False),
)

_NEXT: dict[tuple[AlarmState, Cue, bool, bool], AlarmState] = {
    (arrow.source, arrow.cue, latching, active): arrow.target
    for arrow in TRANSITIONS
    for latching in (False, True)
    for active in (False, True)
    if arrow.latching in (None, latching) and arrow.active in (None, active)
}


def following(state: AlarmState, cue: Cue, *, latching: bool, active: bool) -> AlarmState | None:
    """The state after `cue`; None where no arrow leads on. `active`: does the cause hold?"""
    return _NEXT.get((state, cue, latching, active))


def markdown() -> str:
    """The states, and every arrow, for docs/alarms.md."""
    states = [f"| {letter} | `{state.value}` | {meaning} |" for state, (letter, meaning) in STATE_MEANING.items()]
    arrows: dict[tuple[Cue, AlarmState, str], list[str]] = {}
    for arrow in TRANSITIONS:
        only = [] if arrow.latching is None else ["latching" if arrow.latching else "not latching"]
        only += [] if arrow.active is None else ["cause holds" if arrow.active else "cause gone"]
        key = (arrow.cue, arrow.target, ", ".join(only))
        arrows.setdefault(key, []).append(STATE_MEANING[arrow.source][0])
    rows = [
        f"| `{cue.value}` | {', '.join(sources)} | {STATE_MEANING[target][0]} | {only} | {CUE_MEANING[cue]} |"
        for (cue, target, only), sources in arrows.items()
    ]
    head = ["| | state | meaning |", "|---|---|---|", *states, ""]
    return "\n".join([*head, "| what happens | from | to | only where | |", "|---|---|---|---|---|", *rows]) + "\n"
