"""The instruction for the driver: (state, configuration) -> guidance code and the numbers behind it. Pure.

It decides nothing: it follows `stop`. While stop is on, no code ever instructs the truck to approach; nor while it
drives away: one on its way out is told LEAVE, any other STOP, and to approach again once it stands.

Distance to go, until D = 1. Z falls to Z_th, and R, which for a pinhole grows as 1 / Z, reaches R_th at Z R / R_th:

    to_go = max(Z - Z_th, Z - Z R / R_th)

Closing speed: the Theil-Sen slope (median over all pairs) of the newest distances; a third of them may be outliers.
"""

from collections.abc import Sequence
from itertools import combinations
from statistics import median

from gateway.config import FusionConfig, GuidanceConfig
from gateway.core.pose import true_radius_mm
from gateway.core.readings import Quality, RangeReading
from gateway.core.state import FunctionCheck, Guidance, GuidanceCode, StateVector, VisitPhase
from gateway.durations import NS_PER_S

TRACK_NS = 1_000_000_000  # readings older than this show nothing of the speed now
TRACK_MAX = 16  # of them are kept: 120 pairs
SLOW_HELD = 2.0  # SLOW, once shown, ends beyond so many times slow_mm
TRACK_MIN = 4
TRACK_MIN_NS = 150_000_000  # over a shorter time the ranger's 1 mm steps would look like speed

Track = tuple[tuple[int, float], ...]

# What a sensor's quality means to the driver; GOOD is not in the tables, and what is missing is a fault.
_VISION: dict[Quality, GuidanceCode] = {
    Quality.WAITING: GuidanceCode.WAIT,
    Quality.NO_TARGET: GuidanceCode.WAIT,
    Quality.COASTED: GuidanceCode.STOP,
}
_RANGE: dict[Quality, GuidanceCode] = {
    Quality.WAITING: GuidanceCode.WAIT,
    Quality.NO_ECHO: GuidanceCode.WAIT,
    Quality.TOO_FAR: GuidanceCode.WAIT,
    Quality.TOO_NEAR: GuidanceCode.STOP,
    Quality.UNSTABLE: GuidanceCode.STOP,
}
_WORST_FIRST = (GuidanceCode.FAULT, GuidanceCode.STOP, GuidanceCode.WAIT)


def tracked(track: Track, reading: RangeReading, now_ns: int) -> Track:
    """The newest good distances with `reading` among them; anything but a good one ends the track."""
    if reading.quality is not Quality.GOOD or reading.distance_mm is None:
        return ()
    if track and reading.t_ns <= track[-1][0]:
        fresh = track
    else:
        fresh = (*track, (reading.t_ns, reading.distance_mm))[-TRACK_MAX:]
    if now_ns - fresh[0][0] <= TRACK_NS:
        return fresh
    return tuple(point for point in fresh if now_ns - point[0] <= TRACK_NS)


def closing_mm_s(track: Sequence[tuple[int, float]]) -> float | None:
    """Speed of approach; None while there are too few readings."""
    if len(track) < TRACK_MIN or track[-1][0] - track[0][0] < TRACK_MIN_NS:
        return None
    slopes = [
        (later_mm - earlier_mm) / (later_ns - earlier_ns)
        for (earlier_ns, earlier_mm), (later_ns, later_mm) in combinations(track, 2)
        if later_ns > earlier_ns
    ]
    return -median(slopes) * NS_PER_S


def to_go_mm(radius_px: float, distance_mm: float, config: FusionConfig) -> float:
    """Remaining distance until D = 1; negative: it is past that place. Hysteresis left out."""
    by_radius = distance_mm - distance_mm * radius_px / config.radius_threshold_px
    return max(distance_mm - config.distance_threshold_mm, by_radius)


def advise(
    state: StateVector, fusion: FusionConfig, config: GuidanceConfig, *, in_use: bool, broken: bool, speed: float | None
) -> Guidance:
    """`state` with its final stop; `speed` from `closing_mm_s`; `in_use` False: the bay waits for the PLC or a person;
    `broken`: something besides the two sensors is at fault.
    """
    circle, distance_mm = state.vision.circle, state.range.distance_mm
    offset_u = offset_v = offset_mm = go = None
    if circle is not None:
        offset_u = None if config.aim_u_px is None else circle.u_px - config.aim_u_px
        offset_v = None if config.aim_v_px is None else circle.v_px - config.aim_v_px
        true_mm = true_radius_mm(config, fusion.cross_check)
        if offset_u is not None and true_mm is not None and circle.radius_px > 0:
            offset_mm = offset_u * true_mm / circle.radius_px
        if distance_mm is not None:
            go = to_go_mm(circle.radius_px, distance_mm, fusion)
    brakes = _brakes(state, fusion, config)
    past_mm = _past_view_mm(state, fusion, config) if in_use and not broken and not brakes else None
    if past_mm is not None:
        code = _past(-past_mm, speed, config)
        amount = None if code is GuidanceCode.STOP else past_mm
        return Guidance(code, amount, closing_mm_s=speed, to_go_mm=-past_mm)
    code = _code(state, config, go, offset_u, speed, brakes=brakes, in_use=in_use, broken=broken)
    amount = None
    if code in (GuidanceCode.LEFT, GuidanceCode.RIGHT):
        amount = None if offset_mm is None else abs(offset_mm)
    elif code in (GuidanceCode.FORWARD, GuidanceCode.SLOW, GuidanceCode.BACK, GuidanceCode.TOO_FAR):
        amount = None if go is None else abs(go)
    return Guidance(code, amount, offset_u, offset_v, offset_mm, speed, go)


def _code(
    state: StateVector,
    config: GuidanceConfig,
    go_mm: float | None,
    offset_u_px: float | None,
    speed: float | None,
    *,
    brakes: bool,
    in_use: bool,
    broken: bool,
) -> GuidanceCode:
    active = {GuidanceCode.FAULT} if broken or state.memory.disagree else set()
    for quality, table in ((state.vision.quality, _VISION), (state.range.quality, _RANGE)):
        if quality is not Quality.GOOD:
            active.add(table.get(quality, GuidanceCode.FAULT))
    if not in_use:
        active.add(GuidanceCode.WAIT)
    if state.memory.latched and state.d is not True:
        active.add(GuidanceCode.STOP)
    if code := _from_visit(state, active, go_mm, speed, config, brakes=brakes):
        return code
    if found := [code for code in _WORST_FIRST if code in active]:
        return found[0]
    if state.stop or go_mm is None or _backs(speed, config):
        return _at_mark(state, config, go_mm, speed)
    if offset_u_px is not None and abs(offset_u_px) > config.tolerance_px:
        # The marker is right of the aim point: the truck must go to the picture's left.
        return GuidanceCode.LEFT if (offset_u_px > 0) != config.mirrored else GuidanceCode.RIGHT
    closing = max(0.0, speed or 0.0)
    if closing > config.still_mm_s and go_mm <= closing * config.stop_lead_s:
        return GuidanceCode.STOP  # the truck comes to the mark while the driver reacts
    soon = closing > 0 and go_mm <= closing * config.slow_s
    # A truck that has slowed down need not be told to drive on at once: the sign would alternate.
    held = state.guidance.code in (GuidanceCode.SLOW, GuidanceCode.STOP) and go_mm <= SLOW_HELD * config.slow_mm
    return GuidanceCode.SLOW if soon or held or go_mm <= config.slow_mm else GuidanceCode.FORWARD


def _from_visit(
    state: StateVector,
    active: set[GuidanceCode],
    go_mm: float | None,
    speed: float | None,
    config: GuidanceConfig,
    *,
    brakes: bool,
) -> GuidanceCode | None:
    """The visit's instruction, which precedes those of the single sensors: in place, leaving, arriving."""
    if GuidanceCode.FAULT in active or state.function_check is not FunctionCheck.OFF:
        return None
    phase = state.visit.phase
    if brakes or state.in_place:  # the spout covers the marker: no fault, no wait
        return GuidanceCode.BRAKE if brakes else GuidanceCode.OK
    if not state.may_move:
        return None
    if phase is VisitPhase.ARRIVING:
        return GuidanceCode.DRIVE_UP
    # Loaded, it is only sent back to the mark once it drives there: one that stands or creeps is on its way out.
    returns = not state.visit.released and speed is not None and speed > config.still_mm_s
    # One that rolled off before it was loaded is not told to leave while it is near.
    returns |= state.visit.rolled_off and go_mm is not None and go_mm <= config.slow_mm
    if phase is VisitPhase.RELEASED or (phase is VisitPhase.LEAVING and not returns):
        return GuidanceCode.LEAVE
    return None


def _backs(speed: float | None, config: GuidanceConfig) -> bool:
    """Does the truck drive away, beyond the noise of one that stands?"""
    return speed is not None and speed < -config.still_mm_s


def _brakes(state: StateVector, fusion: FusionConfig, config: GuidanceConfig) -> bool:
    """Does it roll, other than back as instructed?"""
    visit, reference = state.visit, state.visit.reference
    brakes = state.unintended_motion
    if not brakes or reference is None or reference.distance_mm is None or state.range.distance_mm is None:
        return brakes
    stood_past = reference.distance_mm < fusion.distance_threshold_mm - config.overshoot_mm
    return not (visit.rolled_off and stood_past and state.range.distance_mm > reference.distance_mm)


def _at_mark(state: StateVector, config: GuidanceConfig, go_mm: float | None, speed: float | None) -> GuidanceCode:
    """Stop is on though nothing is broken: at the mark and not yet in place, or past it; or the truck drives away."""
    if state.d is not True or go_mm is None:
        return GuidanceCode.STOP
    # BACK stays until the middle of what is allowed, where it ends for a truck that goes back, too: noise at the edge
    # would let the sign alternate. A truck that stands within is in place by then, or soon.
    back = state.guidance.code is GuidanceCode.BACK and go_mm < -config.overshoot_mm / 2
    held = back and speed is not None and speed < config.still_mm_s
    return _past(go_mm, speed, config) if held or go_mm < -config.overshoot_mm else GuidanceCode.STOP


def _past(go_mm: float, speed: float | None, config: GuidanceConfig) -> GuidanceCode:
    """Too far in: BACK also while the truck goes back, until it comes to the middle of what is allowed."""
    if speed is None or speed >= config.still_mm_s:
        return GuidanceCode.TOO_FAR
    if _backs(speed, config) and config.stop_lead_s and go_mm - speed * config.stop_lead_s >= -config.overshoot_mm / 2:
        return GuidanceCode.STOP
    return GuidanceCode.BACK


def _past_view_mm(state: StateVector, fusion: FusionConfig, config: GuidanceConfig) -> float | None:
    """How far past the mark a truck is that is too near for the camera to see its marker; None: it is not.

    By the ranger alone, which may only send a truck back: one for which both sensors gave D = 1 just before, and that
    was not in place yet, or was seen to roll off its place before the spout was down.
    """
    sees_nothing = state.vision.quality in (Quality.NO_TARGET, Quality.COASTED) and state.vision.wrong_size is None
    visit = state.visit
    new = (visit.rolled_off or not (visit.monitored or visit.released)) and state.function_check is FunctionCheck.OFF
    if not (sees_nothing and new and state.memory.d and not state.memory.disagree) or state.range.distance_mm is None:
        return None
    past_mm = fusion.distance_threshold_mm - state.range.distance_mm
    return past_mm if past_mm > config.overshoot_mm else None
