"""Which output of the ranger's board a state asks for, and the band of distances in which it may stay on. Pure.

It only repeats what is decided: where the state would show neither `in_place` nor `may_move`, nothing is on.
"""

from dataclasses import dataclass

from gateway.core.readings import RelayOutput
from gateway.core.state import StateVector
from gateway.core.visit import VisitLimits


@dataclass(frozen=True, slots=True)
class RelayDecision:
    """Of one state. The board's own measurement must stay in the band."""

    t_ns: int  # of the state, monotonic
    output: RelayOutput = RelayOutput.NONE
    nearest_mm: float = 0.0
    farthest_mm: float = 0.0


def decided(state: StateVector, limits: VisitLimits, max_range_mm: float) -> RelayDecision:
    """`limits`: of the recipe in force; `max_range_mm`: the ranger's. Without a distance in the band nothing is on."""
    visit, band_mm = state.visit, limits.visit.band_mm
    if state.in_place and state.stop and not state.may_move and visit.place is not None:
        place_mm = visit.place.distance_mm
        found = RelayDecision(state.t_ns, RelayOutput.IN_PLACE, place_mm - band_mm, place_mm + band_mm)
    elif state.may_move and not state.stop and not state.in_place:
        # A truck that leaves may be anywhere; one that comes has no business well beyond its stopping place.
        nearest_mm = limits.fusion.distance_threshold_mm - limits.guidance.overshoot_mm if state.d is False else 0.0
        found = RelayDecision(state.t_ns, RelayOutput.MAY_MOVE, nearest_mm, max_range_mm)
    else:
        return RelayDecision(state.t_ns)
    distance_mm = state.range.distance_mm
    inside = distance_mm is not None and found.nearest_mm <= distance_mm <= found.farthest_mm
    return found if inside else RelayDecision(state.t_ns)
