"""Cuts the visits of trucks out of a bay's states: states in, one VisitSummary for each visit out. Pure.

Nothing that decides reads this. A visit begins with the first sight of a truck by either sensor, and is one
only once both have measured it within `visit.leave_distance_mm`: for CONFIRM_S, or with D = 1. So a person, a lamp or
an echo alone makes no visit. It ends when the bay has been clear for `visit.leave_s`, or when the released truck has
left the mark and another one closes up. Its size in memory does not depend on its length.

After a restart the visit that was open before goes on, if anything stands in the bay and the gateway was off for
RESUME_S at most; otherwise it has ended meanwhile.
"""

from dataclasses import dataclass
from statistics import median

from gateway.core.detection import Circle
from gateway.core.state import Moved, Reason, StateVector, VisitPhase
from gateway.core.visit import VisitLimits
from gateway.core.visit_summary import MS_PER_S, Fault, VisitEnd, VisitSummary, joined, merged
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.replacing import replace

CONFIRM_S = 1.0
RIM_FRAMES = 15
ONE_SENSOR_S = 300.0  # what only one sensor sees, or what waits far off, has begun this long ago at most
RESUME_S = 3600.0
FAR_RADIUS_SHARE = 0.95  # a circle smaller than this of the one before is farther away, whatever the noise
FAULTS = frozenset({
    Reason.VISION_STALE, Reason.CAMERA_DOWN, Reason.VISION_FAULT, Reason.RANGE_STALE, Reason.RANGER_DOWN,
    Reason.RANGE_TOO_NEAR, Reason.RANGER_STUCK, Reason.RANGE_UNSTABLE, Reason.RANGER_VERSION, Reason.RANGERS_DISAGREE,
    Reason.SENSORS_DISAGREE, Reason.GATEWAY_FAULT, Reason.PLC_LOST, Reason.VISION_AGE_UNPROVEN, Reason.BEACON_LOST,
})  # fmt: skip
"""Reasons of `stop` that are faults during a visit. A marker that is covered while loading is not a fault."""


@dataclass(frozen=True, slots=True)
class Turns:
    """Reversals of the motion along the line of sight, each by more than the ranger's noise."""

    extreme_mm: float | None = None  # farthest in the direction of motion
    outward: bool | None = None  # None: not known yet
    count: int = 0

    def step(self, distance_mm: float, noise_mm: float) -> "Turns":
        if self.extreme_mm is None:
            return Turns(distance_mm)
        moved_mm = distance_mm - self.extreme_mm
        if self.outward is None:
            return self if abs(moved_mm) <= noise_mm else Turns(distance_mm, moved_mm > 0)
        if (moved_mm > 0) is self.outward:
            return replace(self, extreme_mm=distance_mm) if moved_mm else self
        return self if abs(moved_mm) <= noise_mm else Turns(distance_mm, not self.outward, self.count + 1)

    @property
    def corrections(self) -> int:
        """Of a truck that was never in place: its last way out does not count as one."""
        return max(0, self.count - bool(self.outward))


@dataclass(frozen=True, slots=True)
class Truck:
    """What is known of the truck that is in the bay. Monotonic ns; `so_far` has the times since `begun_ns`."""

    begun_ns: int
    so_far: VisitSummary
    phase: VisitPhase
    phase_since_ns: int
    circle: Circle | None  # at the beginning: one that is farther away begins anew, until it is confirmed
    distance_mm: float | None
    confirmed: bool = False
    both_since_ns: int | None = None
    unseen_since_ns: int | None = None
    stop_ns: int | None = None  # D first 1, and the truck does not stand yet
    stop_mm: float = 0.0
    in_place_since_ns: int | None = None
    fault: Reason | None = None
    fault_since_ns: int = 0
    turns: Turns = Turns()  # by the ranger, and by R
    seen_turns: Turns = Turns()
    rims: tuple[tuple[float, float], ...] = ()  # visible share and contrast, first in place
    px_mm: float = 0.0  # R times Z of the first pair, in which R becomes a distance

    @property
    def both_turns(self) -> Turns:
        """Those that both sensors show: an echo, a lamp or a person is not counted as motion."""
        return min(self.turns, self.seen_turns, key=lambda turns: turns.count)

    def summary(self, t_ns: int, end: VisitEnd = VisitEnd.OPEN) -> VisitSummary:
        """As of `t_ns`."""
        truck = _counted(self, t_ns, t_ns)
        corrections = truck.so_far.corrections if truck.so_far.times_in_place else truck.both_turns.corrections
        return replace(truck.so_far, length_s=_s(t_ns - self.begun_ns), end=end, corrections=corrections)


@dataclass(frozen=True, slots=True)
class VisitProgress:
    """The visits of one bay since the gateway's start. `earlier`: open when the gateway ended before."""

    truck: Truck | None = None
    earlier: VisitSummary | None = None
    was_clear: bool = False  # since the start

    def open(self, t_ns: int) -> VisitSummary | None:
        """The visit that goes on, if any."""
        if self.truck is None or not self.truck.confirmed:
            return self.earlier
        return self.joined(self.truck.summary(t_ns))

    def joined(self, summary: VisitSummary) -> VisitSummary:
        """With what was known of it before the restart."""
        return summary if self.earlier is None else joined(self.earlier, summary)


def step(
    progress: VisitProgress, old: StateVector, state: StateVector, limits: VisitLimits, unix_ns: int
) -> tuple[VisitProgress, VisitSummary | None]:
    """After `state`, which came of `old`, at the Unix time `unix_ns`; with the visit that has ended, if one has."""
    if state.reason is Reason.SHUTDOWN:
        return progress, None  # the truck is there, whatever the last state says
    truck, clear_ns = progress.truck, state.visit.clear_since_ns
    if clear_ns is not None and state.t_ns - clear_ns >= limits.visit.leave_s * NS_PER_S:
        ended: VisitSummary | None = None
        if truck is not None and truck.confirmed:
            ended, truck = progress.joined(truck.summary(max(truck.begun_ns, clear_ns), VisitEnd.CLEAR)), None
        elif progress.earlier is not None:
            ended = _while_off(progress.earlier)
        if ended is not None or not progress.was_clear:
            progress = VisitProgress(truck, was_clear=True)
        if ended is not None:
            return progress, ended
    elif truck is not None and truck.confirmed and _followed(old, state):
        ended = progress.joined(truck.summary(state.t_ns, VisitEnd.NEXT_TRUCK))
        return VisitProgress(_begun(state, unix_ns), was_clear=True), ended
    after = _step(truck, old, state, limits, unix_ns, known=progress.earlier is not None)
    return progress if after is truck else replace(progress, truck=after), None


def resumed(progress: VisitProgress, earlier: VisitSummary, unix_ns: int) -> tuple[VisitProgress, VisitSummary | None]:
    """With the visit that was open when the gateway ended before; or that visit, where it can't go on any more."""
    off_s = unix_ns / NS_PER_S - earlier.last_seen_ms / MS_PER_S
    if progress.was_clear or progress.earlier is not None or not 0 <= off_s <= RESUME_S:
        return progress, _while_off(earlier)
    return replace(progress, earlier=earlier), None


def _while_off(earlier: VisitSummary) -> VisitSummary:
    return replace(earlier, end=VisitEnd.GATEWAY_OFF, interruptions=earlier.interruptions + 1)


def _followed(old: StateVector, state: StateVector) -> bool:
    """The released truck was on its way, and now a truck comes nearer: gateway/core/visit.py ends the release."""
    lapsed = state.t_ns > old.valid_until_ns  # that ends a release, too
    return old.visit.released and old.visit.off_mark and not state.visit.released and not lapsed


def _step(
    truck: Truck | None, old: StateVector, state: StateVector, limits: VisitLimits, unix_ns: int, *, known: bool
) -> Truck | None:
    """`known`: a truck was here before the restart; it need not be confirmed again."""
    circle, distance_mm, t_ns = state.vision.circle, state.range.distance_mm, state.t_ns
    near = distance_mm is not None and distance_mm <= limits.leave_mm - limits.visit.band_mm
    seen = circle is not None or near
    if truck is None:
        return _begun(state, unix_ns) if seen else None
    if not truck.confirmed:
        unseen_ns = None if seen else t_ns if truck.unseen_since_ns is None else truck.unseen_since_ns
        if unseen_ns is not None and t_ns - unseen_ns >= limits.visit.leave_s * NS_PER_S:
            return None
        if seen and (t_ns - truck.begun_ns >= ONE_SENSOR_S * NS_PER_S or _farther(truck, state, limits)):
            truck = _begun(state, unix_ns)
        both = circle is not None and near and state.d is not None
        both_ns = None if not both else t_ns if truck.both_since_ns is None else truck.both_since_ns
        lasts = both_ns is not None and t_ns - both_ns >= CONFIRM_S * NS_PER_S
        confirmed = lasts or (both and state.d is True) or (known and near)
        if (unseen_ns, both_ns, confirmed) != (truck.unseen_since_ns, truck.both_since_ns, False):
            truck = replace(truck, unseen_since_ns=unseen_ns, both_since_ns=both_ns, confirmed=confirmed)
    truck = _of_stop(_of_times(truck, old, state), old, state, limits)
    return _of_motion(_of_rim(_of_place(truck, old, state, unix_ns), old, state), state, limits)


def _begun(state: StateVector, unix_ns: int) -> Truck:
    return Truck(
        begun_ns=state.t_ns,
        so_far=VisitSummary(unix_ns // NS_PER_MS, 0.0, unintended=False),
        phase=state.visit.phase,
        phase_since_ns=state.t_ns,
        circle=state.vision.circle,
        distance_mm=state.range.distance_mm,
    )


def _farther(truck: Truck, state: StateVector, limits: VisitLimits) -> bool:
    """Is a truck outside farther away than when it was first seen? Then it is the one before, on its way out."""
    if state.visit.clear_since_ns is None:
        return False
    if truck.distance_mm is not None and state.range.distance_mm is not None:
        return state.range.distance_mm > truck.distance_mm + limits.visit.band_mm
    if truck.circle is not None and state.vision.circle is not None:
        return state.vision.circle.radius_px < FAR_RADIUS_SHARE * truck.circle.radius_px
    return False


def _counted(truck: Truck, t_ns: int, valid_until_ns: int) -> Truck:
    """With the times until `t_ns` in `so_far`. Time without a valid state is of no phase."""
    phases = list(truck.so_far.phases_s)
    known_ns = max(truck.phase_since_ns, min(t_ns, valid_until_ns))
    phases[truck.phase] += _s(known_ns - truck.phase_since_ns)
    phases[VisitPhase.UNKNOWN] += _s(t_ns - known_ns)
    in_place_s, faults = truck.so_far.in_place_s, truck.so_far.faults
    if truck.in_place_since_ns is not None:
        in_place_s += _s(known_ns - truck.in_place_since_ns)
    if truck.fault is not None:
        more: tuple[Fault, ...] = ((truck.fault, 0, _s(t_ns - truck.fault_since_ns)),)
        faults = merged(faults, more)
    so_far = replace(truck.so_far, phases_s=tuple(phases), in_place_s=in_place_s, faults=faults)
    since_ns = None if truck.in_place_since_ns is None else t_ns
    return replace(truck, so_far=so_far, phase_since_ns=t_ns, in_place_since_ns=since_ns, fault_since_ns=t_ns)


def _of_times(truck: Truck, old: StateVector, state: StateVector) -> Truck:
    """Phases and faults."""
    phase, fault = state.visit.phase, state.reason if state.reason in FAULTS else None
    if phase is truck.phase and fault is truck.fault and state.t_ns <= old.valid_until_ns:
        return truck
    begins = fault is not None and fault is not truck.fault
    truck = replace(_counted(truck, state.t_ns, old.valid_until_ns), phase=phase, fault=fault)
    if old.t_ns <= old.valid_until_ns < state.t_ns:  # every output has shown a fault since
        silent = (Reason.GATEWAY_FAULT, int(fault is not Reason.GATEWAY_FAULT), _s(state.t_ns - old.valid_until_ns))
        truck = replace(truck, so_far=replace(truck.so_far, faults=merged(truck.so_far.faults, (silent,))))
    if not begins or fault is None:
        return truck
    counted = merged(truck.so_far.faults, ((fault, 1, 0.0),))
    return replace(truck, so_far=replace(truck.so_far, faults=counted))


def _of_stop(truck: Truck, old: StateVector, state: StateVector, limits: VisitLimits) -> Truck:
    """When D became 1 for the first time, how long the decision took, and until the truck stood."""
    so_far, distance_mm = truck.so_far, state.range.distance_mm
    if so_far.at_mark_s is None and state.d is True and distance_mm is not None:
        since_ns = max(state.vision.t_ns, state.range.t_ns)
        if old.memory.pending_since_ns is not None:
            since_ns = min(since_ns, old.memory.pending_since_ns)
        latency_ms = max(0, state.t_ns - since_ns) / NS_PER_MS
        so_far = replace(so_far, at_mark_s=_s(state.t_ns - truck.begun_ns), stop_latency_ms=latency_ms)
        truck = replace(truck, so_far=so_far, stop_ns=state.t_ns, stop_mm=distance_mm)
    speed, stop_ns = state.guidance.closing_mm_s, truck.stop_ns
    if stop_ns is not None:
        if state.d is False:
            truck = replace(truck, stop_ns=None)  # it rolled through
        elif speed is not None and distance_mm is not None and abs(speed) < limits.guidance.still_mm_s:
            so_far = replace(so_far, halt_s=_s(state.t_ns - stop_ns), overrun_mm=truck.stop_mm - distance_mm)
            truck = replace(truck, stop_ns=None, so_far=so_far)
    return truck


def _of_place(truck: Truck, old: StateVector, state: StateVector, unix_ns: int) -> Truck:
    """In place, released, moved."""
    visit, so_far = state.visit, truck.so_far
    since_s = _s(state.t_ns - truck.begun_ns)
    if visit.in_place and truck.in_place_since_ns is None and visit.place is not None:
        so_far = replace(
            so_far,
            times_in_place=so_far.times_in_place + 1,
            to_position_s=since_s if so_far.to_position_s is None else so_far.to_position_s,
            corrections=truck.both_turns.count,
            radius_px=visit.place.circle.radius_px,
            distance_mm=visit.place.distance_mm,
            offset_px=state.guidance.offset_u_px,
            offset_mm=state.guidance.offset_mm,
            frame_id=state.vision.frame_id,
            frame_ms=(unix_ns - (state.t_ns - state.vision.t_ns)) // NS_PER_MS,
            moved=Moved.NO,
        )
        truck = replace(truck, so_far=so_far, in_place_since_ns=state.t_ns)
    elif not visit.in_place and truck.in_place_since_ns is not None:
        truck = replace(_counted(truck, state.t_ns, old.valid_until_ns), in_place_since_ns=None)
    so_far = truck.so_far
    if visit.moved is not Moved.NO and visit.moved is not so_far.moved:
        truck = replace(truck, so_far=replace(so_far, moved=visit.moved))
    if state.unintended_motion and not truck.so_far.unintended:
        truck = replace(truck, so_far=replace(truck.so_far, unintended=True))
    if visit.released and not old.visit.released:
        truck = replace(truck, so_far=replace(truck.so_far, released_s=since_s))
    return truck


def _of_rim(truck: Truck, old: StateVector, state: StateVector) -> Truck:
    """The marker's rim, before loading covers it; not in a picture that is itself at fault."""
    vision = state.vision
    if not state.in_place or len(truck.rims) == RIM_FRAMES or vision.t_ns == old.vision.t_ns:
        return truck
    if vision.visible is None or vision.contrast is None or (state.picture is not None and state.picture.status):
        return truck
    rims = (*truck.rims, (vision.visible, vision.contrast))
    visible, contrast = map(median, zip(*rims, strict=True))
    return replace(truck, rims=rims, so_far=replace(truck.so_far, visible=visible, contrast=contrast))


def _of_motion(truck: Truck, state: StateVector, limits: VisitLimits) -> Truck:
    """Only where both sensors measure it."""
    circle, distance_mm, noise_mm = state.vision.circle, state.range.distance_mm, limits.visit.band_mm
    if state.d is None or distance_mm is None or circle is None:
        return truck
    px_mm = truck.px_mm or circle.radius_px * distance_mm
    turns = truck.turns.step(distance_mm, noise_mm)
    seen_turns = truck.seen_turns.step(px_mm / circle.radius_px, noise_mm)
    if turns is truck.turns and seen_turns is truck.seen_turns:
        return truck
    return replace(truck, turns=turns, seen_turns=seen_turns, px_mm=px_mm)


def _s(ns: int) -> float:
    return ns / NS_PER_S
