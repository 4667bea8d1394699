"""The instruction for the driver: (state, configuration) -> guidance code and the numbers behind it. Pure.

It decides nothing: it follows `stop`. While stop is on, no code ever instructs the truck to approach.

Distance to go, until D = 1. Z falls to Z_th, and R, which for a pinhole grows as 1 / Z, reaches R_th at Z R / R_th:

    to_go = max(Z - Z_th, Z - Z R / R_th)

Closing speed: the Theil-Sen slope (median over all pairs) of the newest distances; a third of them may be outliers.
"""

from collections.abc import Sequence
from itertools import combinations
from statistics import median

from gateway.config import CrossCheck, FusionConfig, GuidanceConfig
from gateway.core.readings import Quality, RangeReading
from gateway.core.state import FunctionCheck, Guidance, GuidanceCode, StateVector, VisitPhase

NS_PER_S = 1_000_000_000
TRACK_NS = 1_000_000_000  # readings older than this show nothing of the speed now
TRACK_MAX = 16  # of them are kept: 120 pairs
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
        true_mm = _marker_radius_mm(config, fusion.cross_check)
        if offset_u is not None and true_mm is not None and circle.radius_px > 0:
            offset_mm = offset_u * true_mm / circle.radius_px
        if distance_mm is not None:
            go = to_go_mm(circle.radius_px, distance_mm, fusion)
    code = _code(state, config, go, offset_u, speed, in_use=in_use, broken=broken)
    amount: float | None = None
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
    if code := _from_visit(state, active, speed, config):
        return code
    if found := [code for code in _WORST_FIRST if code in active]:
        return found[0]
    if state.stop or go_mm is None:
        return _at_mark(state, config, go_mm, speed)
    if offset_u_px is not None and abs(offset_u_px) > config.tolerance_px:
        # The marker is right of the aim point: the truck must go to the picture's left.
        return GuidanceCode.LEFT if (offset_u_px > 0) != config.mirrored else GuidanceCode.RIGHT
    soon = speed is not None and speed > 0 and go_mm <= speed * config.slow_s
    return GuidanceCode.SLOW if soon or go_mm <= config.slow_mm else GuidanceCode.FORWARD


def _from_visit(
    state: StateVector, active: set[GuidanceCode], speed: float | None, config: GuidanceConfig
) -> GuidanceCode | None:
    """The visit's instruction, which precedes those of the single sensors: in place, leaving, arriving."""
    if GuidanceCode.FAULT in active or state.function_check is not FunctionCheck.OFF:
        return None
    phase = state.visit.phase
    if state.in_place:
        return GuidanceCode.OK  # the spout covers the marker: no fault, no wait
    if not state.may_move:
        return None
    if phase is VisitPhase.ARRIVING:
        return GuidanceCode.DRIVE_UP
    backing = speed is not None and speed < -config.still_mm_s
    if phase is VisitPhase.RELEASED or (phase is VisitPhase.LEAVING and (state.visit.released or backing)):
        return GuidanceCode.LEAVE
    return None


def _at_mark(state: StateVector, config: GuidanceConfig, go_mm: float | None, speed: float | None) -> GuidanceCode:
    """Stop is on though nothing is broken: at the mark and not yet in place, or past it."""
    still = speed is not None and abs(speed) < config.still_mm_s
    if state.d is not True or go_mm is None:
        return GuidanceCode.STOP
    if go_mm < -config.overshoot_mm:
        return GuidanceCode.BACK if still else GuidanceCode.TOO_FAR
    return GuidanceCode.STOP


def _marker_radius_mm(config: GuidanceConfig, check: CrossCheck | None) -> float | None:
    if config.marker_radius_mm is not None or check is None:
        return config.marker_radius_mm
    return check.marker_radius_mm
