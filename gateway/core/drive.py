"""The speed setpoint: (decided state, configuration) -> memory and setpoint. Pure.

It decides nothing: it follows stop and may_move. Any fault or doubt is a setpoint of 0, and so is a distance from which
the vehicle, as fast as it may be by what is known, could not stop before the limit, `guidance.overshoot_mm` past D = 1,
with the worst brake and after the longest delay (core/stopping_way.py).

On the way, the setpoint is the least of what is safe by that, and of

    sqrt(creep^2 + 2 GENTLE b (d - creep T))    to come to the place at creep speed, d after the measured delay T

with b the worst brake. A rising setpoint keeps to jerk and acceleration, too. It is 0 so early that the vehicle runs
out at the place (core/lag.py). A vehicle that stands short of its place is moved once more, TRIES times at most; then
it stays where it is, and `enable` is off. No doubt in between gives it more.

The setpoint is that of the newest control tick, unless something is against it since.
"""

from dataclasses import dataclass
from math import inf, sqrt

from gateway.config import DriveConfig, FusionConfig, GuidanceConfig
from gateway.core import lag, movement, stopping_way
from gateway.core.movement import Cut, DriveMemory, Movement, Same, Told
from gateway.core.readings import Quality, VisionReading
from gateway.core.setpoint import DriveState, Setpoint
from gateway.core.state import FunctionCheck, Reason, StateVector, VisitPhase
from gateway.core.stopping_way import FASTER, LONGEST_STEP_S, StoppingWay
from gateway.durations import NS_PER_S
from gateway.replacing import replace

SIGMAS = 3.0  # the worst case is so many standard deviations off
GENTLE = 0.8  # of the worst brake: on the way to the place
STILL_MM = 8.0  # a vehicle that stays within this stands: so far the ranger's median moves by itself
STILL_S = 0.5  # for so long, after the longest delay
TRIES = 4  # of one approach
PULSE_S = 0.6  # a setpoint lasts so long, also for a short way
CREEP_S = 0.3  # at creep speed before the setpoint becomes 0
EDGE_MM = 4.0  # a vehicle that was at the place leaves it so far beyond the dead band: a step of the ranger
ANEW_MM = 300.0  # so much farther than where its last run ended it is on another approach
SAME_PX = 0.01  # R of live pictures varies by more, though nothing moves,
SAME_S, SAME_PICTURES = 0.5, 6  # within so long, and so many of them
UNMOVED_MM, UNMOVED = 60.0, 0.6  # what was set must have moved it so far, the latter of the overshoot; it has stayed
APART_MM = 10.0  # by so much the marker's size may show the vehicle nearer than the ranger does


@dataclass(frozen=True, slots=True)
class _Way:
    """What is known of the vehicle now."""

    movement: Movement  # of now
    to_go_mm: float | None  # to the place; None: the camera does not show it
    closing_mm_s: float
    limit_mm: float  # the limit is not nearer than this
    stopping: StoppingWay
    stands: bool


def step(
    state: StateVector, config: DriveConfig, fusion: FusionConfig, guidance: GuidanceConfig
) -> tuple[DriveMemory, Setpoint]:
    """Memory and setpoint of a state with its final decision. Never raises."""
    dt_s = min(max(0, state.t_ns - state.memory.drive.history.t_ns) / NS_PER_S, LONGEST_STEP_S)
    memory, now = _followed(state.memory.drive, state, config, guidance)
    doubt = _doubt(state) or memory.frozen
    if memory.tries and _anew(state, memory, None if doubt else now):
        memory = replace(memory, tries=0)
    if now is None:
        waits = DriveState.NO_DISTANCE if state.may_move else DriveState.INHIBITED
        return _ended(memory), Setpoint(DriveState.AT_PLACE if state.in_place else waits)
    way = _way(state, memory, now, config, fusion, guidance)
    if doubt:
        return _stopped(state, memory, way, config)
    if way.to_go_mm is None or not now.known:
        memory = replace(memory, speed_mm_s=0.0, rise_mm_s2=0.0)
        return memory, Setpoint(DriveState.NO_DISTANCE, stopping_mm=way.stopping.mm)
    return _driven(state, memory, way, way.to_go_mm, dt_s, config)


def stays(
    state: StateVector, setpoint: Setpoint, config: DriveConfig, fusion: FusionConfig, guidance: GuidanceConfig
) -> bool:
    """Between two control ticks: is nothing against the setpoint of the former?"""
    if not setpoint.enable:
        return True
    to_go_mm, distance_mm = state.guidance.to_go_mm, state.range.distance_mm
    if _doubt(state) or to_go_mm is None or distance_mm is None or setpoint.stopping_mm is None:
        return False
    limit_mm = distance_mm - fusion.distance_threshold_mm + guidance.overshoot_mm
    return to_go_mm + config.place_mm > config.dead_band_mm and setpoint.stopping_mm <= limit_mm


def _followed(
    memory: DriveMemory, state: StateVector, config: DriveConfig, guidance: GuidanceConfig
) -> tuple[DriveMemory, Movement | None]:
    """The memory with the newest reading, and whether the vehicle stays where it is; and its movement now."""
    reading, found = state.range, memory.movement
    history = memory.history.advanced(state.t_ns, memory.speed_mm_s, config.brake_mm_s2, config.delay_s)
    if reading.quality is not Quality.GOOD or reading.distance_mm is None:
        return replace(memory, history=history, movement=None, still_mm=None, begun=None), None
    sd, late_s = _acceleration_sd(config), lag.lag_s(memory, config)
    if found is None or found.t_ns != reading.t_ns:
        moved_mm = 0.0 if found is None else history.moved_mm(found.t_ns, reading.t_ns, late_s)
        found = movement.measured(found, reading.distance_mm, reading.t_ns, moved_mm, sd)
        memory = replace(memory, history=history, movement=found)
        unmoved_mm = min(UNMOVED_MM, UNMOVED * guidance.overshoot_mm)
        memory = _seen(memory, reading.distance_mm, reading.t_ns, state.vision, config.delay_s, unmoved_mm)
        memory = lag.measured(memory, found, config)
        found, late_s = memory.movement or found, lag.lag_s(memory, config)
    else:
        memory = replace(memory, history=history)
    now = movement.at(found, state.t_ns, history.moved_mm(found.t_ns, state.t_ns, late_s), sd)
    if memory.still_mm is None or abs(now.distance_mm - memory.still_mm) > STILL_MM:
        memory = replace(memory, still_mm=now.distance_mm, still_ns=state.t_ns)
    return memory, now


def _seen(
    memory: DriveMemory, distance_mm: float, t_ns: int, seen: VisionReading, delay_s: float, unmoved_mm: float
) -> DriveMemory:
    """Notes where both sensors have frozen, so that they agree with each other: R is the same from picture to picture,
    the distance stays, and each delay up to the longest would have moved the vehicle. In live pictures R varies by its
    noise, also before the PLC's program starts, or when the vehicle is held.
    """
    start, same = Told(distance_mm, t_ns), _same(memory.same, seen)
    unmoved = (memory.unmoved or start).added(memory.history, t_ns, delay_s)
    if same is None or same.pictures == 1 or abs(unmoved.distance_mm - distance_mm) > STILL_MM:
        unmoved = start
    dead = same is not None and same.pictures >= SAME_PICTURES and same.t_ns - same.first_ns >= SAME_S * NS_PER_S
    return replace(memory, unmoved=unmoved, same=same, frozen=dead and min(unmoved.by_mm) > unmoved_mm)


def _same(same: Same | None, seen: VisionReading) -> Same | None:
    if seen.circle is None:
        return None
    radius_px = seen.circle.radius_px
    if same is None or abs(radius_px - same.radius_px) > SAME_PX:
        return Same(radius_px, seen.t_ns, seen.t_ns)
    return same if seen.t_ns == same.t_ns else Same(same.radius_px, same.first_ns, seen.t_ns, same.pictures + 1)


def _acceleration_sd(config: DriveConfig) -> float:
    """Of what the vehicle does otherwise than it is told: SIGMAS of the speed's deviations then cover a brake that
    does not act."""
    return max(config.acceleration_mm_s2, config.brake_mm_s2) / SIGMAS


def _way(
    state: StateVector,
    memory: DriveMemory,
    now: Movement,
    config: DriveConfig,
    fusion: FusionConfig,
    guidance: GuidanceConfig,
) -> _Way:
    history, measured_mm = memory.history, state.range.distance_mm or 0.0
    closing_mm_s = max(0.0, history.acting_mm_s(lag.lag_s(memory, config)) + now.excess_mm_s)
    age_s = max(0.0, (state.t_ns - state.range.t_ns) / NS_PER_S)
    worst_mm_s = max(0.0, closing_mm_s + SIGMAS * now.speed_sd_mm_s)
    fastest_mm_s = max(worst_mm_s, FASTER * history.follows_mm_s)
    nearest_mm = min(
        now.distance_mm - SIGMAS * now.distance_sd_mm,
        measured_mm - fastest_mm_s * age_s,
        _seen_mm(state, fastest_mm_s, fusion),
    )
    return _Way(
        now,
        _to_go_mm(state, memory, now, config, fusion),
        closing_mm_s,
        nearest_mm - (fusion.distance_threshold_mm - guidance.overshoot_mm),
        stopping_way.at_worst(history, worst_mm_s, config),
        state.t_ns - memory.still_ns >= (config.delay_s + STILL_S) * NS_PER_S,
    )


def _seen_mm(state: StateVector, fastest_mm_s: float, fusion: FusionConfig) -> float:
    """Nearer the vehicle is not by the marker's size, which is R_th where it was taught: a ranger may have frozen."""
    circle = state.vision.circle
    if circle is None or circle.radius_px <= 0:
        return inf
    age_s = max(0.0, (state.t_ns - state.vision.t_ns) / NS_PER_S)
    taught_mm = fusion.distance_threshold_mm * fusion.radius_threshold_px / circle.radius_px
    return taught_mm + APART_MM - fastest_mm_s * age_s


def _to_go_mm(
    state: StateVector, memory: DriveMemory, now: Movement, config: DriveConfig, fusion: FusionConfig
) -> float | None:
    """As guidance has it, but now: R of the frame belongs to where the vehicle was then."""
    circle, found = state.vision.circle, memory.movement
    if circle is None or state.vision.quality is not Quality.GOOD or found is None:
        return None
    moved_mm = memory.history.moved_mm(found.t_ns, state.vision.t_ns, lag.lag_s(memory, config))
    then_mm = movement.distance_at(found, state.vision.t_ns, moved_mm)
    by_radius_mm = then_mm * circle.radius_px / fusion.radius_threshold_px
    return now.distance_mm - min(fusion.distance_threshold_mm, by_radius_mm) + config.place_mm


def _doubt(state: StateVector) -> bool:
    """Anything for which nobody may be driven towards the spout."""
    memory, visit = state.memory, state.visit
    return (
        state.stop
        or not state.may_move
        or state.d is not False
        or state.vision.quality is not Quality.GOOD
        or state.range.quality is not Quality.GOOD
        or memory.disagree
        or memory.disagree_since_ns is not None
        or state.vision_age_unproven
        or state.beacon_unproven
        or state.function_check is not FunctionCheck.OFF
        or state.plc.missed
        or visit.monitored
        or visit.released
        or visit.phase in (VisitPhase.RELEASED, VisitPhase.LEAVING)
    )


def _stopped(state: StateVector, memory: DriveMemory, way: _Way, config: DriveConfig) -> tuple[DriveMemory, Setpoint]:
    """Stop is on, or something is in doubt. By D alone, the vehicle runs out, and its way is learned."""
    at_mark = state.d is True and state.reason is Reason.TARGET_REACHED
    if not at_mark and not (memory.there and state.reason is Reason.CLEARING):
        reached = DriveState.AT_PLACE if state.in_place else DriveState.INHIBITED
        return _ended(memory), Setpoint(reached, stopping_mm=way.stopping.mm)
    if memory.speed_mm_s > 0:
        memory = _cut(memory, way, state.t_ns)
        return memory, Setpoint(DriveState.SETTLE, stopping_mm=way.stopping.mm)
    if memory.cut is not None and not way.stands:
        return memory, Setpoint(DriveState.SETTLE, stopping_mm=way.stopping.mm)
    memory = lag.learned(memory, way.movement.distance_mm, config)
    inside = way.to_go_mm is not None and abs(way.to_go_mm) <= _band_mm(memory, config)
    memory = _there(memory, there=state.in_place or (inside and (memory.there or way.stands)))
    return memory, Setpoint(DriveState.AT_PLACE if memory.there else DriveState.INHIBITED, stopping_mm=way.stopping.mm)


def _band_mm(memory: DriveMemory, config: DriveConfig) -> float:
    """So near is at the place; one that was there must not flicker at its edge."""
    return config.dead_band_mm + (EDGE_MM if memory.there else 0.0)


def _there(memory: DriveMemory, *, there: bool) -> DriveMemory:
    return memory if memory.there == there else replace(memory, there=there)


def _driven(
    state: StateVector, memory: DriveMemory, way: _Way, to_go_mm: float, dt_s: float, config: DriveConfig
) -> tuple[DriveMemory, Setpoint]:
    """May move, and the distance is known."""
    raw_mm, band_mm = state.guidance.to_go_mm, _band_mm(memory, config)
    there = to_go_mm <= band_mm or (raw_mm is not None and raw_mm + config.place_mm <= band_mm)
    if memory.cut is not None:
        if not way.stands:
            return memory, Setpoint(DriveState.SETTLE, True, 0.0, way.stopping.mm)
        memory = lag.learned(memory, way.movement.distance_mm, config)
    slip = lag.slip_s(memory, config)
    ahead_mm = to_go_mm - memory.history.left_mm(slip) - memory.history.follows_mm_s**2 / (2 * config.brake_mm_s2)
    if memory.speed_mm_s > 0 and (there or ahead_mm <= 0):
        return _cut(memory, way, state.t_ns), Setpoint(DriveState.SETTLE, True, 0.0, way.stopping.mm)
    memory = _there(memory, there=there and (memory.there or way.stands))
    if there:
        reached = DriveState.AT_PLACE if memory.there else DriveState.SETTLE
        return memory, Setpoint(reached, False, 0.0, way.stopping.mm)
    if memory.tries >= TRIES:
        return memory, Setpoint(DriveState.SETTLE, False, 0.0, way.stopping.mm)
    if ahead_mm <= 0:
        return memory, Setpoint(DriveState.SETTLE, True, 0.0, way.stopping.mm)
    if memory.run_mm_s is None:
        run_mm_s = max(config.min_speed_mm_s, min(config.creep_speed_mm_s, ahead_mm / (slip + PULSE_S)))
        memory = replace(memory, run_mm_s=run_mm_s, peak_mm_s=0.0)
    run_mm_s = memory.run_mm_s or 0.0
    comfortable_mm_s = min(config.max_speed_mm_s, _comfortable(ahead_mm, run_mm_s, config))
    follows_mm_s = memory.history.follows_mm_s
    safe_mm_s = stopping_way.safe_mm_s(way.stopping, way.limit_mm, follows_mm_s, config)
    creeps = comfortable_mm_s <= config.creep_speed_mm_s
    if creeps and memory.speed_mm_s > 0 and safe_mm_s < config.min_speed_mm_s:
        memory, driving = _cut(memory, way, state.t_ns), DriveState.SETTLE
    else:
        memory = _ramped(memory, min(comfortable_mm_s, safe_mm_s), dt_s, config)
        driving = DriveState.CREEP if creeps else DriveState.APPROACH
    return memory, Setpoint(driving, True, memory.speed_mm_s, way.stopping.mm)


def _comfortable(ahead_mm: float, run_mm_s: float, config: DriveConfig) -> float:
    """Comes to `run_mm_s`, CREEP_S before the place. A run that is too short for creep speed is not faster."""
    if run_mm_s < config.creep_speed_mm_s:
        return run_mm_s
    gentle_mm_s2 = GENTLE * config.brake_mm_s2
    return sqrt(run_mm_s**2 + 2 * gentle_mm_s2 * max(0.0, ahead_mm - CREEP_S * run_mm_s))


def _ramped(memory: DriveMemory, goal_mm_s: float, dt_s: float, config: DriveConfig) -> DriveMemory:
    """The setpoint goes to its goal: at once where it falls, by jerk and acceleration where it rises."""
    speed_mm_s, rise = memory.speed_mm_s, 0.0
    if goal_mm_s < max(config.min_speed_mm_s, 1.0):
        speed_mm_s = 0.0
    elif goal_mm_s <= speed_mm_s:
        speed_mm_s = goal_mm_s
    else:
        speed_mm_s = max(speed_mm_s, min(config.min_speed_mm_s, goal_mm_s))
        to_rise = sqrt(2 * config.jerk_mm_s3 * (goal_mm_s - speed_mm_s))
        rise = min(memory.rise_mm_s2 + config.jerk_mm_s3 * dt_s, config.acceleration_mm_s2, to_rise)
        speed_mm_s = min(goal_mm_s, speed_mm_s + rise * dt_s)
    peak_mm_s = max(memory.peak_mm_s, speed_mm_s)
    peak_ns = memory.history.t_ns if speed_mm_s >= lag.FALLEN * peak_mm_s else memory.peak_ns
    return replace(memory, speed_mm_s=speed_mm_s, rise_mm_s2=rise, peak_mm_s=peak_mm_s, peak_ns=peak_ns)


def _anew(state: StateVector, memory: DriveMemory, now: Movement | None) -> bool:
    """Is the approach over, and has the next one all of its tries? The vehicle has arrived or left, or a person is at
    work."""
    return (
        state.in_place
        or state.function_check is not FunctionCheck.OFF
        or state.visit.phase in (VisitPhase.EMPTY, VisitPhase.LEAVING)
        or (now is not None and now.distance_mm > memory.tried_mm + ANEW_MM)
    )


def _ended(memory: DriveMemory) -> DriveMemory:
    """This run is over."""
    if memory.speed_mm_s == 0 and memory.run_mm_s is None and memory.cut is None and not memory.there:
        return memory
    return replace(memory, speed_mm_s=0.0, rise_mm_s2=0.0, run_mm_s=None, cut=None, there=False)


def _cut(memory: DriveMemory, way: _Way, now_ns: int) -> DriveMemory:
    """The setpoint becomes 0, and the vehicle runs out."""
    moving = abs(way.closing_mm_s - memory.speed_mm_s) <= memory.speed_mm_s / 2
    return replace(
        memory,
        speed_mm_s=0.0,
        rise_mm_s2=0.0,
        run_mm_s=None,
        begun=None,
        cut=Cut(now_ns, way.movement.distance_mm, memory.speed_mm_s, moving),
        tries=memory.tries + 1,
        tried_mm=way.movement.distance_mm,
        still_mm=way.movement.distance_mm,
        still_ns=now_ns,
    )
