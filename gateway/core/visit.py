"""A truck's visit after D = 1: in place, held while the marker is covered, moved, released, gone. Pure (docs/visit.md).

`in_place` is entered by both sensors only: D known and 1, the truck standing still, aligned and not too far in, for
`settle_s`, no function check. Every loading covers the marker, so from then on the ranger may hold it on its own, for
as long as Z stays in its band, the camera is alive and nothing contradicts, and for `hold_limit_s` at most. A dead
sensor ends it at once. What may be a glitch (a live ranger without a distance, a contradiction) ends it after
`hold_grace_s`. It must then be confirmed again by both sensors.

A release lets such a truck leave although D is 1 or unknown: the one exception to `stop` (decision 19).
"""

import math
from dataclasses import dataclass

from gateway.config import FusionConfig, GuidanceConfig, VisitConfig
from gateway.core import details, rolling
from gateway.core.agreement import FAR_SHARE
from gateway.core.detection import Circle
from gateway.core.guidance import to_go_mm
from gateway.core.readings import BEYOND_RANGE, DEAD, Quality
from gateway.core.state import (
    Fused,
    Moved,
    ReferencePosition,
    TruckPosition,
    Visit,
    VisitPhase,
    WayOut,
    counted_mm,
)
from gateway.durations import NS_PER_S
from gateway.replacing import replace

NEARER_SHARE = 1.2  # R grows by more only when a truck comes nearer, or another one is seen
LEFT_BEYOND_MM = 700.0  # beyond Z_th, where leave_distance_mm is not configured
NOT_MEASURING = DEAD | {Quality.WAITING}


@dataclass(frozen=True, slots=True)
class VisitLimits:
    """One bay's configuration, as the recipe in force has it."""

    visit: VisitConfig
    fusion: FusionConfig
    guidance: GuidanceConfig

    @property
    def off_mark_mm(self) -> float:
        """A truck farther away than this, with D = 0, has left the mark: what noise does to D ends there."""
        return self.fusion.distance_threshold_mm + self.fusion.distance_hysteresis_mm + self.visit.band_mm

    @property
    def leave_mm(self) -> float:
        """A truck farther away than this has left."""
        asked_mm = self.visit.leave_distance_mm
        if asked_mm is None:
            return self.fusion.distance_threshold_mm + LEFT_BEYOND_MM
        return max(asked_mm, self.off_mark_mm)


def step(
    visit: Visit,
    fused: Fused,
    speed_mm_s: float | None,
    limits: VisitLimits,
    *,
    released: bool,
    release: bool,
    function_check: bool,
) -> Visit:
    """The visit after `fused`, which has the sensors and D as they are now.

    `speed_mm_s`: closing speed, None where unknown. `released`: the release bit of a living PLC, `release`: it has just
    risen. `function_check`: a technician is at work on the bay.
    """
    clear_since_ns = _since(visit.clear_since_ns, fused, on=clear(fused, limits))
    usable_since_ns = _since(visit.usable_since_ns, fused, on=usable(fused))
    if (clear_since_ns, usable_since_ns) != (visit.clear_since_ns, visit.usable_since_ns):
        visit = replace(visit, clear_since_ns=clear_since_ns, usable_since_ns=usable_since_ns)
    over = has_ended(visit, fused, limits)
    if over:
        visit = _after_visit(visit)
    checked = function_check or (visit.checked and not over and not d_is_zero(fused))
    if checked != visit.checked:
        visit = replace(visit, checked=checked)
    if visit.place is not None and not visit.off_mark and _is_off_mark(fused, limits):
        visit = replace(visit, off_mark=True)
    if visit.released:
        visit = _leaving(visit, fused, limits, released=released)
    elif released and release and _may_be_released(visit) and usable(fused):
        visit = replace(_out_of_place(visit, "released"), moved=Moved.NO, moved_covered=False)
        # When the release ends, neither counts on: the truck may have been elsewhere, and its marker seen, meanwhile.
        visit = replace(visit, still_since_ns=None, candidate=None, covered_since_ns=None)
        visit = replace(visit, released=True, farthest_mm=fused.range.distance_mm)
    if not visit.released:
        if visit.place is not None:
            visit = _monitored(visit, visit.place, fused, limits)
        visit = _settled(visit, fused, speed_mm_s, limits)
    way_out, unseen_since_ns = _way_out(visit, fused, limits)
    if (way_out, unseen_since_ns) != (visit.way_out, visit.unseen_since_ns):
        visit = replace(visit, way_out=way_out, unseen_since_ns=unseen_since_ns)
    reference = _reference(visit, fused, speed_mm_s, limits)
    if reference is not visit.reference:
        visit = replace(visit, reference=reference)
    phase = _phase(visit, fused, limits)
    return visit if phase is visit.phase else replace(visit, phase=phase)


def usable(fused: Fused) -> bool:
    """Are both sensors alive, the distance known, and no contradiction? The marker may be covered."""
    alive = fused.vision.quality not in NOT_MEASURING and fused.range.quality is Quality.GOOD
    return alive and not fused.memory.disagree


def _may_be_released(visit: Visit) -> bool:
    """Is or was a truck in place since the start of the gateway, and still at the mark?"""
    return visit.place is not None and not visit.restored and not visit.off_mark


def may_leave(visit: Visit, fused: Fused, limits: VisitLimits) -> bool:
    """May a released truck drive, whatever D is? Only until it has left the mark, and while both sensors are fine."""
    if not visit.released or visit.off_mark or not usable(fused):
        return False
    hold_s = limits.fusion.clear_hold_s if limits.fusion.decision == "held" else 0.0
    return _lasts(visit.usable_since_ns, fused, hold_s)


def has_ended(visit: Visit, fused: Fused, limits: VisitLimits) -> bool:
    """Has the bay been clear for leave_s?"""
    return _lasts(visit.clear_since_ns, fused, limits.visit.leave_s)


def clear(fused: Fused, limits: VisitLimits) -> bool:
    """Do both sensors show that no truck is at the spout? A broken sensor proves nothing."""
    vision, distance_mm = fused.vision, fused.range.distance_mm
    if vision.quality is Quality.NO_TARGET and vision.wrong_size is None:
        return fused.range.quality in BEYOND_RANGE or (distance_mm is not None and distance_mm > limits.leave_mm)
    small = vision.circle is not None and vision.circle.radius_px < FAR_SHARE * limits.fusion.radius_threshold_px
    return small and distance_mm is not None and distance_mm > limits.leave_mm


def _leaving(visit: Visit, fused: Fused, limits: VisitLimits, *, released: bool) -> Visit:
    """The release in the next state: any doubt ends it, so that no other truck inherits it."""
    farthest_mm, distance_mm = visit.farthest_mm, fused.range.distance_mm
    nearer = farthest_mm is not None and distance_mm is not None and distance_mm < farthest_mm - limits.visit.band_mm
    if visit.off_mark:
        # It returns, or another truck arrives: for that one nothing has been released.
        return _after_visit(visit) if nearer or fused.d is True else _farther(visit, distance_mm)
    visit = replace(visit, unconfirmed_since_ns=_since(visit.unconfirmed_since_ns, fused, on=not usable(fused)))
    dead = fused.vision.quality in NOT_MEASURING or fused.range.quality in NOT_MEASURING
    doubtful = _lasts(visit.unconfirmed_since_ns, fused, limits.visit.hold_grace_s)
    if nearer or dead or doubtful or not released:
        return replace(visit, released=False, farthest_mm=None, unconfirmed_since_ns=None)
    return _farther(visit, distance_mm)


def _way_out(visit: Visit, fused: Fused, limits: VisitLimits) -> tuple[WayOut | None, int | None]:
    """Of a truck that was in place and has left the mark, for as long as it is seen and none comes nearer; and since
    when it has not been seen."""
    way, distance_mm, circle = visit.way_out, fused.range.distance_mm, fused.vision.circle
    if visit.in_place or fused.d is True:
        return None, None
    if way is None:
        return (WayOut(distance_mm) if visit.off_mark and distance_mm is not None else None), None
    if distance_mm is not None:
        nearer = distance_mm < way.farthest_mm - limits.visit.band_mm
        return (None if nearer else WayOut(max(distance_mm, way.farthest_mm))), None
    none = fused.vision.quality is Quality.NO_TARGET and fused.range.quality in BEYOND_RANGE
    unseen_since_ns = _since(visit.unseen_since_ns, fused, on=none)
    if _lasts(unseen_since_ns, fused, limits.visit.leave_s):
        return None, None
    if circle is not None:  # beyond the ranger's range
        if way.smallest_px is not None and circle.radius_px > NEARER_SHARE * way.smallest_px:
            return None, None
        way = WayOut(way.farthest_mm, min(circle.radius_px, way.smallest_px or circle.radius_px))
    return way, unseen_since_ns


def _reference(visit: Visit, fused: Fused, speed_mm_s: float | None, limits: VisitLimits) -> ReferencePosition | None:
    """From in place until the truck was released, has left, or its place is not known any more."""
    gone = visit.place is None or visit.released or visit.restored
    if gone or (visit.reference is None and not visit.in_place) or (visit.off_mark and not visit.rolling):
        return None
    reference = visit.reference
    if reference is not None and visit.place is not None and _compared(visit.place, fused, limits.visit)[1]:
        return rolling.without_marker(reference) if reference.rolling_since_ns is None else reference
    new = rolling.step(reference, fused, speed_mm_s, limits.visit, limits.guidance)
    if reference is not None and new.rolling_since_ns is not None and reference.rolling_since_ns is None:
        # As for `moved`: one frame without the marker is not enough to decide.
        return replace(new, covered=_lasts(visit.covered_since_ns, fused, limits.visit.hold_grace_s))
    return new


def _farther(visit: Visit, distance_mm: float | None) -> Visit:
    if distance_mm is None or (visit.farthest_mm is not None and distance_mm <= visit.farthest_mm):
        return visit
    return replace(visit, farthest_mm=distance_mm)


def _is_off_mark(fused: Fused, limits: VisitLimits) -> bool:
    """From here on equation 14 lets the truck leave: fusion has reported D = 0 for clear_hold_s."""
    distance_mm = fused.range.distance_mm
    return fused.d is False and fused.calm and distance_mm is not None and distance_mm > limits.off_mark_mm


def d_is_zero(fused: Fused) -> bool:
    """By both sensors, which fit each other."""
    return fused.d is False and fused.memory.disagree_since_ns is None


def _settled(visit: Visit, fused: Fused, speed_mm_s: float | None, limits: VisitLimits) -> Visit:
    """In place, once both sensors have confirmed it for settle_s, at the same place."""
    circle, distance_mm = fused.vision.circle, fused.range.distance_mm
    if visit.in_place:
        return visit
    # A marker seen where it was, at another distance: one of the two is wrong, and standing still does not mend it.
    doubtful = visit.place is not None and _compared(visit.place, fused, limits.visit)[1]
    if (
        circle is None
        or distance_mm is None
        or doubtful
        or visit.checked
        or not _stands_at_mark(fused, circle, distance_mm, speed_mm_s, limits)
    ):
        return visit if visit.candidate is None else replace(visit, still_since_ns=None, candidate=None)
    if visit.candidate is None or _compared(visit.candidate, fused, limits.visit) != (Moved.NO, False):
        return replace(visit, still_since_ns=fused.t_ns, candidate=_position(fused, distance_mm, circle))
    if not _lasts(visit.still_since_ns, fused, limits.visit.settle_s):
        return visit
    return Visit(
        phase=visit.phase,
        in_place=True,
        place=_position(fused, distance_mm, circle),
        in_place_since_ns=fused.t_ns,
        clear_since_ns=visit.clear_since_ns,
        usable_since_ns=visit.usable_since_ns,
    )


def _position(fused: Fused, distance_mm: float, circle: Circle) -> TruckPosition:
    return TruckPosition(distance_mm, circle, counted_mm(fused.range))


def _stands_at_mark(
    fused: Fused, circle: Circle, distance_mm: float, speed_mm_s: float | None, limits: VisitLimits
) -> bool:
    """D = 1, standing, aligned where an aim is set, not too far in, and nothing contradicts."""
    fusion, guidance = limits.fusion, limits.guidance
    # D may be held at a circle that is not the marker, so that both values must be those of a truck at the mark.
    large = circle.radius_px >= fusion.radius_threshold_px - max(fusion.radius_hysteresis_px, fusion.away_px)
    farthest_mm = fused.range.farthest_mm or distance_mm  # of two rangers both must have it at the mark
    near = farthest_mm <= fusion.distance_threshold_mm + max(fusion.distance_hysteresis_mm, fusion.away_mm)
    still = speed_mm_s is not None and abs(speed_mm_s) < guidance.still_mm_s
    aligned = guidance.aim_u_px is None or abs(circle.u_px - guidance.aim_u_px) <= guidance.tolerance_px
    not_past = to_go_mm(circle.radius_px, distance_mm, fusion) >= -guidance.overshoot_mm
    sure = not fused.memory.disagree and fused.memory.disagree_since_ns is None
    return fused.d is True and large and near and still and aligned and not_past and sure


def _monitored(visit: Visit, place: TruckPosition, fused: Fused, limits: VisitLimits) -> Visit:
    """A truck that is or was in place: does it still stand there, and may in_place be held?"""
    moved, contradicts = _compared(place, fused, limits.visit)
    covered = contradicts or (fused.vision.circle is None and fused.vision.quality not in NOT_MEASURING)
    if moved is not Moved.NO and visit.moved is Moved.NO:
        # One frame without the marker, or with it again, is not enough to decide.
        lasts = _lasts(visit.covered_since_ns, fused, limits.visit.hold_grace_s)
        visit = replace(visit, moved=moved, moved_covered=lasts)
    covered_since_ns = _since(visit.covered_since_ns, fused, on=covered)
    if covered_since_ns != visit.covered_since_ns:
        visit = replace(visit, covered_since_ns=covered_since_ns)
    if not visit.in_place:
        return visit
    if not visit.seen_moving and not contradicts and _seen_elsewhere(place, fused, limits.visit):
        visit = replace(visit, seen_moving=True)
    short_s = min(limits.visit.hold_grace_s, limits.visit.hold_limit_s)
    if not visit.covered and covered and _lasts(visit.covered_since_ns, fused, short_s):
        visit = replace(visit, covered=True)
    if why := _ended(visit, fused, moved):
        return _out_of_place(visit, why)
    disagree = contradicts or fused.memory.disagree or fused.vision.wrong_size is not None
    doubtful = disagree or fused.range.distance_mm is None
    visit = replace(visit, unconfirmed_since_ns=_since(visit.unconfirmed_since_ns, fused, on=doubtful))
    if doubtful and _lasts(visit.unconfirmed_since_ns, fused, limits.visit.hold_grace_s):
        unconfirmed = details.CONTRADICTION if fused.range.distance_mm is not None else details.DISTANCE_LOST
        return _out_of_place(visit, unconfirmed())
    if covered and _lasts(visit.covered_since_ns, fused, limits.visit.hold_limit_s):
        return _out_of_place(visit, details.HELD_TOO_LONG())
    return visit


def _seen_elsewhere(place: TruckPosition, fused: Fused, config: VisitConfig) -> bool:
    """Is the marker seen, and has the truck left its place by more than a truck that stands?"""
    circle, way_mm, was_px = fused.vision.circle, place.way_mm(fused.range), place.circle.radius_px
    if circle is None or way_mm is None:
        return False
    larger = fused.vision.visible is not None and abs(circle.radius_px - was_px) > config.rolling_share * was_px
    return larger or abs(way_mm) > config.rolling_mm


def _ended(visit: Visit, fused: Fused, moved: Moved) -> str:
    """What ends in_place at once; empty: nothing."""
    if moved is not Moved.NO:
        return details.TRUCK_MOVED()
    if fused.vision.quality in NOT_MEASURING:
        return details.CAMERA_DEAD()
    if fused.range.quality in NOT_MEASURING:
        return details.RANGER_DEAD()
    if visit.checked:  # one that is over ended in_place when it began
        return details.IN_CHECK()
    return "D = 0" if fused.d is False else ""


def _compared(place: TruckPosition, fused: Fused, config: VisitConfig) -> tuple[Moved, bool]:
    """How the truck has left its place, and whether the sensors contradict each other about it."""
    circle, way_mm = fused.vision.circle, place.way_mm(fused.range)
    left_band = way_mm is not None and abs(way_mm) > config.band_mm
    if circle is None:
        return (Moved.DISTANCE if left_band else Moved.NO), False
    share, was_px = config.band_share, place.circle.radius_px
    now_mm = max(1.0, place.distance_mm + (way_mm or 0.0))
    fitting_px = was_px * place.distance_mm / now_mm  # R of a truck there
    shift_px = math.hypot(circle.u_px - place.circle.u_px, circle.v_px - place.circle.v_px)
    shifted = shift_px > share * was_px
    if left_band:
        # Nearer to R as it was than to R as it should be: the marker is where it was, the echo is another object's.
        stayed = not shifted and abs(circle.radius_px - was_px) < abs(fitting_px - was_px) / 2
        return (Moved.NO, True) if stayed else (Moved.DISTANCE, False)
    same_size = was_px / (1 + share) <= circle.radius_px <= was_px * (1 + share)
    if same_size and not shifted:
        return Moved.NO, False
    # What is left of a marker partly covered is a circle on a chord of it: r^2 + shift^2 = R^2.
    chord = circle.radius_px**2 + shift_px**2 <= fitting_px**2 * (1 + share**2 / 2)
    if same_size and not chord:
        return Moved.MARKER, False
    return Moved.NO, True  # covered from one side, or something else red and round


def _phase(visit: Visit, fused: Fused, limits: VisitLimits) -> VisitPhase:
    if visit.in_place:
        phase = VisitPhase.HELD if visit.held else VisitPhase.IN_PLACE
    elif visit.released:
        phase = VisitPhase.LEAVING if visit.off_mark or fused.d is False else VisitPhase.RELEASED
    elif fused.memory.disagree:
        phase = VisitPhase.UNKNOWN
    elif fused.d is True:
        phase = VisitPhase.AT_MARK
    elif visit.way_out is not None and (fused.d is False or fused.vision.circle is not None):
        phase = VisitPhase.LEAVING
    elif fused.vision.circle is not None and fused.range.quality in BEYOND_RANGE and not visit.monitored:
        phase = VisitPhase.ARRIVING
    elif fused.d is False:
        phase = VisitPhase.LEAVING if visit.monitored else VisitPhase.APPROACHING
    else:
        # Where a truck was in place just now, a covered marker and a lost echo are no empty bay yet.
        empty = not visit.monitored and clear(fused, limits)
        phase = VisitPhase.EMPTY if empty else VisitPhase.UNKNOWN
    return phase


def _since(old_ns: int | None, fused: Fused, *, on: bool) -> int | None:
    if not on:
        return None
    return fused.t_ns if old_ns is None else old_ns


def _lasts(since_ns: int | None, fused: Fused, for_s: float) -> bool:
    return since_ns is not None and fused.t_ns - since_ns >= for_s * NS_PER_S


def _out_of_place(visit: Visit, why: str) -> Visit:
    return replace(visit, in_place=False, in_place_since_ns=None, unconfirmed_since_ns=None, ended=why)


def _after_visit(visit: Visit) -> Visit:
    return Visit(
        phase=visit.phase,
        clear_since_ns=visit.clear_since_ns,
        usable_since_ns=visit.usable_since_ns,
        way_out=visit.way_out,
        unseen_since_ns=visit.unseen_since_ns,
        ended=details.CLEAR() if visit.in_place else visit.ended,
        checked=visit.checked,
    )
