"""A truck's visit after D = 1: in place, held while the marker is covered, moved, released, gone. Pure (docs/visit.md).

`in_place` is entered by both sensors only: D known and 1, the truck standing, aligned and not too far in, for
`settle_s`, no function check. Every loading covers the marker, so from then on the ranger alone may hold it, for as
long as Z stays in its band, the camera is alive and nothing contradicts. A dead sensor ends it at once. What may be a
glitch (a live ranger without a distance, a contradiction) ends it after `hold_grace_s`. It must then be earned again.
"""

from dataclasses import dataclass, replace

from gateway.config import FusionConfig, GuidanceConfig, VisitConfig
from gateway.fusion import FAR_SHARE
from gateway.guidance import to_go_mm
from gateway.model import DEAD, Circle, FunctionCheck, Moved, Place, Quality, StateVector, Visit, VisitPhase

NS_PER_S = 1_000_000_000
LEAVE_BEYOND_MM = 700.0  # beyond Z_th, where leave_distance_mm is not configured
NO_TRUCK_RANGE = frozenset({Quality.NO_ECHO, Quality.TOO_FAR})
BLIND = DEAD | {Quality.WAITING}


@dataclass(frozen=True, slots=True)
class Limits:
    """One bay's configuration, as the recipe in force has it."""

    visit: VisitConfig
    fusion: FusionConfig
    guidance: GuidanceConfig

    @property
    def leave_mm(self) -> float:
        """A truck farther away than this has left."""
        fusion, asked_mm = self.fusion, self.visit.leave_distance_mm
        if asked_mm is None:
            return fusion.distance_threshold_mm + LEAVE_BEYOND_MM
        return max(asked_mm, fusion.distance_threshold_mm + fusion.distance_hysteresis_mm + self.visit.band_mm)


def step(
    visit: Visit, state: StateVector, speed_mm_s: float | None, limits: Limits, *, released: bool, release: bool
) -> Visit:
    """The visit after `state`, which has the sensors and D as they are now.

    `speed_mm_s`: closing speed, None where unknown. `released`: the PLC's release bit, `release`: it has just risen.
    """
    clear_since_ns = _since(visit.clear_since_ns, state, on=clear(state, limits))
    if clear_since_ns != visit.clear_since_ns:
        visit = replace(visit, clear_since_ns=clear_since_ns)
    if is_over(visit, state, limits):
        visit = Visit(phase=visit.phase, clear_since_ns=clear_since_ns)
    if visit.released and not released:
        visit = replace(visit, released=False, place=None)
    if release and visit.place is not None and usable(state):
        visit = _out_of_place(replace(visit, released=True, moved=Moved.NO), "released")
    elif not visit.released:
        if visit.place is not None:
            visit = _watched(visit, visit.place, state, limits)
        visit = _settled(visit, state, speed_mm_s, limits)
    phase = _phase(visit, state, limits)
    return visit if phase is visit.phase else replace(visit, phase=phase)


def usable(state: StateVector) -> bool:
    """Are both sensors alive, the distance known, and no contradiction? The marker may be covered."""
    alive = state.vision.quality not in BLIND and state.range.quality is Quality.GOOD
    return alive and not state.memory.disagree


def lets_go(visit: Visit, state: StateVector, limits: Limits) -> bool:
    """May a released truck drive, whatever D is? Not when it comes nearer instead of leaving."""
    if not visit.released or visit.place is None or state.range.distance_mm is None or not usable(state):
        return False
    return state.range.distance_mm >= visit.place.distance_mm - limits.visit.band_mm


def is_over(visit: Visit, state: StateVector, limits: Limits) -> bool:
    """Has the bay been clear for leave_s?"""
    return _lasts(visit.clear_since_ns, state, limits.visit.leave_s)


def clear(state: StateVector, limits: Limits) -> bool:
    """Do both sensors say that no truck is at the spout? A broken sensor proves nothing."""
    vision, distance_mm = state.vision, state.range.distance_mm
    if vision.quality is Quality.NO_TARGET and vision.wrong_size is None:
        return state.range.quality in NO_TRUCK_RANGE or (distance_mm is not None and distance_mm > limits.leave_mm)
    small = vision.circle is not None and vision.circle.radius_px < FAR_SHARE * limits.fusion.radius_threshold_px
    return small and distance_mm is not None and distance_mm > limits.leave_mm


def _settled(visit: Visit, state: StateVector, speed_mm_s: float | None, limits: Limits) -> Visit:
    """In place, once both sensors have said so for settle_s."""
    circle, distance_mm = state.vision.circle, state.range.distance_mm
    if visit.in_place:
        return visit
    if circle is None or distance_mm is None or not _stands(state, circle, distance_mm, speed_mm_s, limits):
        return visit if visit.still_since_ns is None else replace(visit, still_since_ns=None)
    if visit.still_since_ns is None:
        return replace(visit, still_since_ns=state.t_ns)
    if not _lasts(visit.still_since_ns, state, limits.visit.settle_s):
        return visit
    return replace(
        visit,
        in_place=True,
        moved=Moved.NO,
        place=Place(distance_mm, circle),
        still_since_ns=None,
        in_place_since_ns=state.t_ns,
        covered_since_ns=None,
        doubt_since_ns=None,
        ended="",
    )


def _stands(state: StateVector, circle: Circle, distance_mm: float, speed_mm_s: float | None, limits: Limits) -> bool:
    """D = 1, standing, aligned where an aim is set, not too far in, nothing contradicts, nobody works on the bay."""
    guidance = limits.guidance
    still = speed_mm_s is not None and abs(speed_mm_s) < guidance.still_mm_s
    aligned = guidance.aim_u_px is None or abs(circle.u_px - guidance.aim_u_px) <= guidance.tolerance_px
    not_past = to_go_mm(circle.radius_px, distance_mm, limits.fusion) >= -guidance.overshoot_mm
    sure = not state.memory.disagree and state.memory.disagree_since_ns is None
    working = state.function_check is not FunctionCheck.OFF
    return state.d is True and still and aligned and not_past and sure and not working


def _watched(visit: Visit, place: Place, state: StateVector, limits: Limits) -> Visit:
    """A truck that is or was in place: does it still stand there, and may in_place be held?"""
    moved, contradicts = _compared(place, state, limits.visit)
    covered = contradicts or (state.vision.circle is None and state.vision.quality not in BLIND)
    if moved is not Moved.NO and visit.moved is Moved.NO:
        # One frame without the marker, or with it again, is not enough to tell.
        lasts = _lasts(visit.covered_since_ns, state, limits.visit.hold_grace_s)
        visit = replace(visit, moved=moved, moved_covered=lasts)
    covered_since_ns = _since(visit.covered_since_ns, state, on=covered)
    if covered_since_ns != visit.covered_since_ns:
        visit = replace(visit, covered_since_ns=covered_since_ns)
    if not visit.in_place:
        return visit
    if why := _ended(visit, state, moved):
        return _out_of_place(visit, why)
    doubtful = contradicts or state.memory.disagree or state.range.distance_mm is None
    visit = replace(visit, doubt_since_ns=_since(visit.doubt_since_ns, state, on=doubtful))
    if doubtful and _lasts(visit.doubt_since_ns, state, limits.visit.hold_grace_s):
        return _out_of_place(visit, "contradiction" if state.range.distance_mm is not None else "no distance")
    if covered and _lasts(visit.covered_since_ns, state, limits.visit.hold_limit_s):
        return _out_of_place(visit, "held for too long")
    return visit


def _ended(visit: Visit, state: StateVector, moved: Moved) -> str:
    """What ends in_place at once; empty: nothing."""
    if moved is not Moved.NO:
        return "moved"
    if state.vision.quality in BLIND:
        return "camera dead"
    if state.range.quality in BLIND:
        return "ranger dead"
    if state.function_check is not FunctionCheck.OFF:
        return "function check"
    return "D = 0" if state.d is False else ""


def _compared(place: Place, state: StateVector, config: VisitConfig) -> tuple[Moved, bool]:
    """How the truck has left its place, and whether the sensors contradict each other about it."""
    circle, distance_mm = state.vision.circle, state.range.distance_mm
    left_band = distance_mm is not None and abs(distance_mm - place.distance_mm) > config.band_mm
    if circle is None:
        return (Moved.DISTANCE if left_band else Moved.NO), False
    share, was_px = config.band_share, place.circle.radius_px
    shift_px = max(abs(circle.u_px - place.circle.u_px), abs(circle.v_px - place.circle.v_px))
    shifted = shift_px > share * was_px
    if left_band and distance_mm is not None:
        # R of a truck that far away; nearer to R as it was, the marker stands where it stood: the echo is another.
        fitting_px = was_px * place.distance_mm / distance_mm
        stayed = not shifted and abs(circle.radius_px - was_px) < abs(fitting_px - was_px) / 2
        return (Moved.NO, True) if stayed else (Moved.DISTANCE, False)
    if not was_px / (1 + share) <= circle.radius_px <= was_px * (1 + share):
        return Moved.NO, distance_mm is not None  # R alone has changed: something else red and round
    return (Moved.MARKER if shifted else Moved.NO), False


def _phase(visit: Visit, state: StateVector, limits: Limits) -> VisitPhase:
    if visit.in_place:
        phase = VisitPhase.HELD if visit.held else VisitPhase.IN_PLACE
    elif visit.released:
        phase = VisitPhase.LEAVING if state.d is False else VisitPhase.RELEASED
    elif state.memory.disagree:
        phase = VisitPhase.UNKNOWN
    elif state.d is True:
        phase = VisitPhase.AT_MARK
    elif state.vision.circle is not None and state.range.quality in NO_TRUCK_RANGE:
        phase = VisitPhase.ARRIVING
    elif state.d is False:
        phase = VisitPhase.APPROACHING if visit.place is None else VisitPhase.LEAVING
    else:
        phase = VisitPhase.EMPTY if clear(state, limits) else VisitPhase.UNKNOWN
    return phase


def _since(old_ns: int | None, state: StateVector, *, on: bool) -> int | None:
    if not on:
        return None
    return state.t_ns if old_ns is None else old_ns


def _lasts(since_ns: int | None, state: StateVector, for_s: float) -> bool:
    return since_ns is not None and state.t_ns - since_ns >= for_s * NS_PER_S


def _out_of_place(visit: Visit, why: str) -> Visit:
    return replace(visit, in_place=False, in_place_since_ns=None, still_since_ns=None, doubt_since_ns=None, ended=why)
