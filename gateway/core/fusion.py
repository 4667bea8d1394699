"""Fold one observation, or the mere passing of time, into what both sensors show, and what they ask for. Pure.

Equation 13 is the state, equation 14 the decision:

    D = 1 when R >= R_th and Z <= Z_th, else 0

computed only from values that are fresh and good. Where one of them is not, D is unknowable (None), and `stop` is on
unless `fail_safe` has been switched off. `calm` requires more than `not stop`: both sensors good, no contradiction.
Nothing of the PLC, the visit or a technician is in it: gateway/core/interlock.py makes the state of it.
One exception: with `arrive_by_camera` D is 0 for a truck that is too far away for the ranger.

Stop is set at once. By default (`decision = "held"`) it ends later than by equation 14: D
ends only when both sensors show that the truck moved away from where equation 14 last held; a sensor that was dead must
be alive for `recovery_s`; and every cause must be gone for `clear_hold_s`. With `decision = "plain"` the equation
decides at every step.

A circle that does not fit the ranger's distance is a contradiction, and a cause: gateway/core/agreement.py.
"""

from gateway.config import FusionConfig
from gateway.core import agreement, beacon, details
from gateway.core.agreement import FAR_SHARE, in_range
from gateway.core.beacon import Beacon, BeaconStatus
from gateway.core.detection import Circle
from gateway.core.marker_wear import MarkerWear
from gateway.core.plc import PlcConnection, PlcWrite
from gateway.core.readings import (
    BEYOND_RANGE,
    DEAD,
    FRESH_FRAME,
    VISION_FINE,
    AgeProof,
    Quality,
    RangeReading,
    VisionReading,
)
from gateway.core.scale import distance_of
from gateway.core.state import (
    Failure,
    FunctionCheck,
    Fused,
    FusionMemory,
    Guidance,
    GuidanceCode,
    Reason,
    StateVector,
    Tick,
    TruckPosition,
)
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.replacing import replace

Observation = VisionReading | RangeReading | Tick | PlcWrite | PlcConnection | FunctionCheck | MarkerWear
BEYOND_SHARE = 0.9  # of the ranger's range: what was learned of the marker may be off by a tenth

VISION_REASON: dict[Quality, Reason] = {
    Quality.WAITING: Reason.STARTING,
    Quality.STALE: Reason.VISION_STALE,
    Quality.LINK_DOWN: Reason.CAMERA_DOWN,
    Quality.NO_TARGET: Reason.NO_TARGET,
    Quality.COASTED: Reason.TARGET_COASTED,
}
RANGE_REASON: dict[Quality, Reason] = {
    Quality.WAITING: Reason.STARTING,
    Quality.STALE: Reason.RANGE_STALE,
    Quality.LINK_DOWN: Reason.RANGER_DOWN,
    Quality.NO_ECHO: Reason.NO_ECHO,
    Quality.TOO_NEAR: Reason.RANGE_TOO_NEAR,
    Quality.TOO_FAR: Reason.RANGE_TOO_FAR,
    Quality.STUCK: Reason.RANGER_STUCK,
    Quality.UNSTABLE: Reason.RANGE_UNSTABLE,
    Quality.WRONG_VERSION: Reason.RANGER_VERSION,
}
# Where several faults are present, the one that needs a repair is reported first.
_REPAIR_FIRST = {Reason.BEACON_LOST: 1, Reason.STARTING: 1, Reason.NO_TARGET: 2, Reason.TARGET_COASTED: 2}


def step(
    state: StateVector,
    observation: Observation,
    now_ns: int,
    config: FusionConfig,
    *,
    stopped: bool,
    monitored: bool,
    max_range_mm: float | None,
    beacon_tolerance_ns: int | None = None,
) -> Fused:
    """What the sensors show after `observation`, as of `now_ns` (monotonic, the clock that stamped the observations).

    Of `state`, the readings and the memory go on. `stopped`: the truck has had to stand until now, whatever for;
    `monitored`: one is or was in place, so that none arrives. `max_range_mm`: the ranger's; None: not known, and no
    truck arrives by the camera alone. `beacon_tolerance_ns`: as in core/beacon.py; None: no beacon. Readings older
    than the one held are ignored but for their counters; damaged ones (GOOD without a finite value) become a fault.
    Never raises on any observation.
    """
    vision, rng = state.vision, state.range
    match observation:
        case VisionReading():
            vision = _newest_vision(vision, _checked_vision(observation, now_ns))
        case RangeReading():
            rng = newest_range(rng, checked_range(observation, now_ns))
        case Tick() | PlcWrite() | PlcConnection() | FunctionCheck() | MarkerWear():
            pass  # requests of people and of the PLC, and what is only shown: core/interlock.py
    vision = _aged_vision(vision, now_ns, config)
    rng = aged_range(rng, now_ns, config)
    memory = state.memory
    if beacon_tolerance_ns is not None:
        watched = _watched(memory.beacon, observation, now_ns, beacon_tolerance_ns)
        young = now_ns - vision.t_ns <= config.vision_deadline_s * NS_PER_S
        watched = replace(watched, unproven=young and watched.status is not BeaconStatus.PROVEN)
        memory, vision = replace(memory, beacon=watched), _proven(vision, watched)
    memory, vision, rng = _recovering(memory, state, vision, rng, now_ns, config)
    new = vision is not state.vision or rng is not state.range
    memory, z_vision_mm = agreement.checked(memory, vision, rng, now_ns, config, new=new)
    memory = _decide(memory, vision, rng, now_ns, config, stopped=stopped)
    seen = vision.quality is Quality.GOOD
    if seen != memory.target_seen and vision.quality in (Quality.GOOD, Quality.NO_TARGET):
        memory = replace(memory, target_seen=seen)
    known = vision.quality is Quality.GOOD and rng.quality is Quality.GOOD
    d = memory.d if known else None
    fault = _fault(vision, rng, memory)
    if not monitored and _arrives(memory, vision, rng, config, max_range_mm):
        d, fault = False, Reason.NONE
    stop = bool(d) or (config.fail_safe and fault is not Reason.NONE)
    reason = Reason.NONE
    if stop:
        reason = fault if fault is not Reason.NONE and config.fail_safe else Reason.TARGET_REACHED
    calm = not stop and fault is Reason.NONE
    # Sensors that contradict each other do not end a stop, even before that is a fault.
    sure = memory.disagree_since_ns is None or not stopped or config.decision == "plain"
    memory = _no_cause_since(memory, now_ns if calm and sure else None)
    if calm and not _no_cause_for_long(memory, now_ns, config):
        calm = False
        if stopped and config.fail_safe:  # what has just gone may be back in a moment: stop must not flicker
            stop, reason = True, Reason.CLEARING
    return Fused(now_ns, vision, rng, d, z_vision_mm, stop, calm, reason, memory)


def _watched(seen: Beacon, observation: Observation, now_ns: int, tolerance_ns: int) -> Beacon:
    if seen.status is BeaconStatus.OFF:
        seen = replace(seen, status=BeaconStatus.SEARCHING)
    match observation:
        case VisionReading():
            return beacon.seen(seen, observation.beacon, now_ns, tolerance_ns)
        case RangeReading() if observation.beacon is not None:
            seen = beacon.told(seen, observation.beacon)
    return beacon.aged(seen, now_ns)


def _proven(vision: VisionReading, watched: Beacon) -> VisionReading:
    """Pictures that the beacon does not prove are as good as old ones."""
    if watched.status is BeaconStatus.PROVEN or vision.quality not in FRESH_FRAME:
        return vision
    late_ns = watched.lag_ns
    why = details.BEACON_NOT_SEEN() if late_ns is None else details.BEACON_LATE(f"{late_ns / NS_PER_MS:.0f}")
    return replace(_without_circle(vision, Quality.STALE), detail=why)


def initial(bay: str, now_ns: int) -> StateVector:
    """The state before any observation: nothing known, `stop` on."""
    return StateVector(
        bay=bay,
        t_ns=now_ns,
        vision=VisionReading(now_ns, Quality.WAITING),
        range=RangeReading(now_ns, Quality.WAITING),
    )


def forced_stop(state: StateVector, reason: Reason, now_ns: int) -> StateVector:
    """The state with every value withdrawn and `stop` on: for a dead control task, and for the final state at exit."""
    return replace(
        state,
        t_ns=now_ns,
        seq=state.seq + 1,
        vision=_without_circle(state.vision, not_good(state.vision.quality)),
        range=_without_board(state.range, not_good(state.range.quality)),
        d=None,
        stop=True,
        may_move=False,
        reason=reason,
        z_vision_mm=None,
        plc=state.plc.withdrawn(),
        guidance=Guidance(GuidanceCode.FAULT),
        visit=state.visit.withdrawn(),
        setpoint=state.setpoint.withdrawn(),
        pose=None,
    )


def not_good(quality: Quality) -> Quality:
    """The quality once its value has ended: STALE instead of GOOD or COASTED (a prediction ends, too)."""
    return Quality.STALE if quality in (Quality.GOOD, Quality.COASTED) else quality


def _without_circle(reading: VisionReading, quality: Quality) -> VisionReading:
    """`predicted` is kept with COASTED only: it is for display, and nothing is decided on it.

    `wrong_size` is kept with each quality that means a processed frame: it can only contradict.
    """
    return replace(
        reading,
        quality=quality,
        circle=None,
        x_n=None,
        y_n=None,
        ellipse=None,
        confidence=None,
        visible=None,
        frames=1,
        predicted=reading.predicted if quality is Quality.COASTED else None,
        wrong_size=reading.wrong_size if quality in (Quality.COASTED, Quality.NO_TARGET) else None,
        age_proof=reading.age_proof if quality is reading.quality else None,
    )


def _checked_vision(reading: VisionReading, now_ns: int) -> VisionReading:
    """No stamp from the future, no GOOD without a circle that can exist, and no coordinates without it."""
    predicted = reading.predicted if reading.quality is Quality.COASTED else None
    if reading.t_ns > now_ns or reading.predicted is not predicted:
        reading = replace(reading, t_ns=min(reading.t_ns, now_ns), predicted=predicted)
    circle = reading.circle
    if reading.quality is not Quality.GOOD:
        return _without_circle(reading, reading.quality)
    if circle is None or not all(map(in_range, (circle.u_px, circle.v_px, circle.radius_px))) or circle.radius_px < 0:
        return replace(_without_circle(reading, Quality.PROCESS_FAULT), detail=details.NO_CIRCLE())
    if all(n is None or in_range(n) for n in (reading.x_n, reading.y_n)):
        return reading
    return replace(reading, x_n=None, y_n=None)


def checked_range(reading: RangeReading, now_ns: int) -> RangeReading:
    """No stamp from the future, and no GOOD without a distance that can exist."""
    if reading.t_ns > now_ns:
        reading = replace(reading, t_ns=now_ns)
    z, echo_mm = reading.distance_mm, reading.echo_mm
    if echo_mm is not None and not (reading.quality is Quality.GOOD and in_range(echo_mm) and echo_mm > 0):
        reading = replace(reading, echo_mm=None)
    if reading.quality is not Quality.GOOD:
        return _without_distance(reading, reading.quality) if z is not None else reading
    if z is not None and in_range(z) and z > 0:
        return reading
    return replace(_without_distance(reading, Quality.UNSTABLE), detail=details.NO_DISTANCE())


def _without_distance(reading: RangeReading, quality: Quality) -> RangeReading:
    return replace(reading, quality=quality, distance_mm=None, echo_mm=None, farthest_mm=None)


def _without_board(reading: RangeReading, quality: Quality) -> RangeReading:
    gone = _without_distance(reading, quality)
    return replace(gone, rangers=(), relay=None, air_c=None, temperature_lost=False)


def _newest_vision(held: VisionReading, new: VisionReading) -> VisionReading:
    return new if new.t_ns >= held.t_ns else replace(held, stats=new.stats)


def newest_range(held: RangeReading, new: RangeReading) -> RangeReading:
    """An older reading of one ranger counts only by its counters. Votes of several count in their order, instead.

    A vote's time goes back when older readings agree than before: to keep the former one would show a distance that
    the rangers no longer agree on.
    """
    # A reopened port without data has not cleared the fault: it remains until a reading arrives.
    lifts_a_fault = new.quality is Quality.WAITING and held.quality not in (Quality.GOOD, Quality.WAITING)
    newest = new.t_ns >= held.t_ns or new.rangers
    return new if newest and not lifts_a_fault else replace(held, stats=new.stats)


def _aged_vision(reading: VisionReading, now_ns: int, config: FusionConfig) -> VisionReading:
    refused = reading.quality is Quality.STALE and reading.age_proof is not None  # for its age, but it came
    deadline_s = config.start_grace_s if reading.quality is Quality.WAITING else config.vision_deadline_s
    if (refused or reading.quality in VISION_FINE) and now_ns - reading.t_ns > deadline_s * NS_PER_S:
        stale = _without_circle(reading, Quality.STALE)
        return replace(stale, detail=details.NO_RESULT(f"{deadline_s:g}"), age_proof=None)
    return reading


def aged_range(reading: RangeReading, now_ns: int, config: FusionConfig) -> RangeReading:
    """What is older than its deadline is STALE and has no value."""
    # A fault of a live sensor (no echo, too far) ages like a value: silence after it makes it stale.
    ages = reading.quality not in (Quality.LINK_DOWN, Quality.WRONG_VERSION, Quality.STALE)
    deadline_s = config.start_grace_s if reading.quality is Quality.WAITING else config.range_deadline_s
    if ages and now_ns - reading.t_ns > deadline_s * NS_PER_S:
        late = details.NO_READING(f"{deadline_s:g}")
        return replace(_without_board(reading, Quality.STALE), detail=late)
    return reading


def _recovering(
    memory: FusionMemory,
    state: StateVector,
    vision: VisionReading,
    rng: RangeReading,
    now_ns: int,
    config: FusionConfig,
) -> tuple[FusionMemory, VisionReading, RangeReading]:
    """Of a sensor that was dead, nothing counts until it has been alive for recovery_s: it must not flicker."""
    new_vision, new_range = vision is not state.vision, rng is not state.range
    of_vision = _failure(memory.vision_failure, vision, now_ns, config.vision_deadline_s, config, new=new_vision)
    of_range = _failure(memory.range_failure, rng, now_ns, config.range_deadline_s, config, new=new_range)
    if (of_vision, of_range) != (memory.vision_failure, memory.range_failure):
        memory = replace(memory, vision_failure=of_vision, range_failure=of_range)
    if of_vision.quality is not None and vision.quality in FRESH_FRAME:
        vision = replace(_without_circle(vision, of_vision.quality), detail=details.RECOVERING())
    if of_range.quality is not None and rng.quality not in DEAD and rng.quality is not Quality.WAITING:
        rng = replace(_without_distance(rng, of_range.quality), detail=details.RECOVERING())
    return memory, vision, rng


def _failure(
    old: Failure,
    reading: VisionReading | RangeReading,
    now_ns: int,
    deadline_s: float,
    config: FusionConfig,
    *,
    new: bool,
) -> Failure:
    if new and reading.quality in DEAD:
        return Failure(reading.quality, None)
    if old.quality is None or not new:
        # A value held back is in the state as dead; only its age shows whether another has arrived since.
        gap = old.alive_since_ns is not None and now_ns - reading.t_ns > deadline_s * NS_PER_S
        return Failure(old.quality, None) if gap else old
    if reading.quality is Quality.WAITING:
        return Failure(old.quality, None)
    since_ns = now_ns if old.alive_since_ns is None else old.alive_since_ns
    return Failure(None, None) if now_ns - since_ns >= config.recovery_s * NS_PER_S else Failure(old.quality, since_ns)


def _decide(
    memory: FusionMemory, vision: VisionReading, rng: RangeReading, now_ns: int, config: FusionConfig, *, stopped: bool
) -> FusionMemory:
    """Equation 14, then hysteresis, `decision` and debounce. `stopped`: was stop on, whatever for?"""
    circle, distance_mm = vision.circle, rng.distance_mm
    if circle is None or distance_mm is None:
        return _settled(memory)
    radius_th = config.radius_threshold_px - (config.radius_hysteresis_px if memory.d else 0.0)
    distance_th = config.distance_threshold_mm + (config.distance_hysteresis_mm if memory.d else 0.0)
    raw = circle.radius_px >= radius_th and distance_mm <= distance_th
    if config.decision == "held":
        memory, raw = _held(memory, circle, distance_mm, config, raw=raw)
    if raw == memory.d:
        return _settled(memory)
    since_ns = now_ns if memory.pending_since_ns is None else memory.pending_since_ns
    wait_s = config.raise_debounce_s if raw else config.clear_debounce_s
    if raw and stopped:
        wait_s = 0.0  # what delays a stop must not end one: after a fault, D = 1 would first let the truck go on
    if now_ns - since_ns >= wait_s * NS_PER_S:
        return replace(memory, d=raw, pending_since_ns=None, mark=memory.mark if raw else None)
    return replace(memory, pending_since_ns=since_ns)


def _held(
    memory: FusionMemory, circle: Circle, distance_mm: float, config: FusionConfig, *, raw: bool
) -> tuple[FusionMemory, bool]:
    """D = 1 ends only when both sensors show that the truck has moved away, by a ratio of R and Z that fits.

    A red lamp for the covered marker, or an echo from the spout, changes only one of them.
    """
    if circle.radius_px >= config.radius_threshold_px and distance_mm <= config.distance_threshold_mm:
        mark = TruckPosition(distance_mm, circle)
        return memory if mark == memory.mark else replace(memory, mark=mark), raw
    if raw or not memory.d or memory.mark is None:
        return memory, raw
    away = distance_mm >= memory.mark.distance_mm + config.away_mm
    smaller = circle.radius_px <= memory.mark.circle.radius_px - config.away_px
    fitting = memory.disagree_since_ns is None and not memory.disagree
    return memory, not (away and smaller and fitting)


def _no_cause_since(memory: FusionMemory, now_ns: int | None) -> FusionMemory:
    """`now_ns` None: there is a cause for a stop now."""
    if (now_ns is None) == (memory.no_cause_since_ns is None):
        return memory
    return replace(memory, no_cause_since_ns=now_ns)


def _no_cause_for_long(memory: FusionMemory, now_ns: int, config: FusionConfig) -> bool:
    hold_s = 0.0 if config.decision == "plain" else config.clear_hold_s
    return memory.no_cause_since_ns is not None and now_ns - memory.no_cause_since_ns >= hold_s * NS_PER_S


def _arrives(
    memory: FusionMemory, vision: VisionReading, rng: RangeReading, config: FusionConfig, max_range_mm: float | None
) -> bool:
    """Is D surely 0 though the ranger sees nothing yet? A small marker, beyond the range from which echoes return.

    A ranger without echoes is detected when the marker, by its R Z, is within the ranger's range.
    """
    if not config.arrive_by_camera or max_range_mm is None or memory.d or memory.disagree or vision.circle is None:
        return False
    radius_px = vision.circle.radius_px
    beyond = rng.quality in BEYOND_RANGE
    small = 0 < radius_px <= FAR_SHARE * config.radius_threshold_px
    return beyond and small and _distance_mm(memory, radius_px, config) >= BEYOND_SHARE * max_range_mm


def _distance_mm(memory: FusionMemory, radius_px: float, config: FusionConfig) -> float:
    """How far away the marker is by its radius alone: as learned, else as configured, else as if both thresholds held
    at one place. A marker larger than that seems nearer, and waits for the ranger."""
    check = config.cross_check
    if memory.scale is not None:
        return distance_of(memory.scale, radius_px)
    if check is not None:
        return check.focal_px * check.marker_radius_mm / radius_px - check.camera_offset_mm
    return config.radius_threshold_px * config.distance_threshold_mm / radius_px


def _settled(memory: FusionMemory) -> FusionMemory:
    """No change of D is pending."""
    return memory if memory.pending_since_ns is None else replace(memory, pending_since_ns=None)


def _fault(vision: VisionReading, rng: RangeReading, memory: FusionMemory) -> Reason:
    """The one reason, if any, for which the state must not be trusted."""
    if vision.quality is Quality.GOOD and rng.quality is Quality.GOOD and not memory.disagree:
        return Reason.NONE
    reasons: list[Reason] = []
    if vision.quality is Quality.STALE and vision.age_proof is AgeProof.UNPROVEN:
        reasons.append(Reason.VISION_AGE_UNPROVEN)  # refused when it arrived; what has aged since has no proof
    elif vision.quality is Quality.STALE and memory.beacon.unproven:
        reasons.append(Reason.BEACON_LOST)
    elif vision.quality is not Quality.GOOD:
        reasons.append(VISION_REASON.get(vision.quality, Reason.VISION_FAULT))
    if rng.quality is not Quality.GOOD:
        own = RANGE_REASON.get(rng.quality, Reason.RANGER_DOWN)
        reasons.append(Reason.RANGERS_DISAGREE if rng.rangers_disagree else own)
    if memory.disagree:
        reasons.append(Reason.SENSORS_DISAGREE)
    return min(reasons, key=lambda reason: _REPAIR_FIRST.get(reason, 0), default=Reason.NONE)
