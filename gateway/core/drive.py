"""The speed setpoint: (decided state, configuration) -> memory and setpoint. Pure.

It decides nothing: it follows stop and may_move. Any fault or doubt is a setpoint of 0, and so is a distance from which
the vehicle, as fast as it may be by what is known, could not stop before the limit, `guidance.overshoot_mm` past D = 1,
with the worst brake and after the longest delay.

On the way, the setpoint v is the least of

    sqrt(creep^2 + 2 GENTLE b (d - creep T))    to come to the place at creep speed, d after the measured delay T
    v from k W + x D + (k v + x)^2 / (2 b) = d_limit - reserve     to stop before the limit, if the next step sets 0

with D = lag_s + latency_s, b the worst brake, and k = FASTER. At worst the vehicle follows, k times as fast, what was
set up to D ago: the PLC holds an image until its life sign ends, then the drive needs its lag. Set to 0 now, it goes on
by at most k W,

    W = the integral over the last D of the highest setpoint from then until now

and then by its braking way. What it has followed sooner is in the measured distance already, and is not counted again
as v D; only x is, by which it may be faster than k times any setpoint of the last D. A setpoint that falls faster than
b counts as one that falls by b. Before the setpoint rises by dv, W is taken as W + dv D.

A rising setpoint keeps to jerk and acceleration, too. It is 0 so early that the vehicle runs out at the place: how late
it follows is measured while the setpoint falls, and how late it stands is learned from approach to approach, within
what the lag permits. A vehicle that stands short of its place is moved once more,
TRIES times at most; then it stays where it is, and `enable` is off.
"""

from dataclasses import dataclass, replace
from math import sqrt
from statistics import median

from gateway.config import DriveConfig, FusionConfig, GuidanceConfig
from gateway.core import movement
from gateway.core.movement import Cut, DriveMemory, Movement
from gateway.core.readings import Quality
from gateway.core.setpoint import DriveState, Setpoint
from gateway.core.state import FunctionCheck, Reason, StateVector, VisitPhase
from gateway.durations import NS_PER_S

SIGMAS = 3.0  # the worst case is so many standard deviations off
FASTER = 1.1  # times its setpoint: a drive may be so fast
RESERVE_MM = 8.0  # so much nearer it may seem by the next step
GENTLE = 0.8  # of the worst brake: on the way to the place
STILL_MM = 8.0  # a vehicle that stays within this stands: so far the ranger's median moves by itself
STILL_S = 0.5  # for so long, after the longest delay
LONGEST_STEP_S = 0.1  # a setpoint rises for no longer than this at once
TRIES = 4  # of one approach
PULSE_S = 0.6  # a setpoint lasts so long, also for a short way
SOONER = 0.85  # of the lag: a drive that stops needs no time to correct its speed
SOONEST = 0.75  # likewise: what is learned of it is not less
CREEP_S = 0.3  # at creep speed before the setpoint becomes 0
FALLEN = 0.85  # of its highest value: the setpoint has fallen, and half the longest delay later it is measured
FALLS_MM_S = 60.0  # for so much of a fall the lag is measured
KEPT_S = 3.0  # integrals are kept for so long after the longest delay: a fall, and the age of a reading
WAY_NS = 50_000_000  # between two integrals that are kept
SLIPS = 5  # approaches from which the way out is learned


@dataclass(frozen=True, slots=True)
class _Way:
    """What is known of the vehicle now."""

    movement: Movement  # of now
    to_go_mm: float | None  # to the place; None: the camera does not show it
    closing_mm_s: float
    limit_mm: float  # the limit is not nearer than this
    stopping_mm: float
    coming_mm: float  # so far what was set may still move it
    excess_mm_s: float  # so much faster it may be than anything that was set
    stands: bool


def step(
    state: StateVector, config: DriveConfig, fusion: FusionConfig, guidance: GuidanceConfig
) -> tuple[DriveMemory, Setpoint]:
    """Memory and setpoint of a state with its final decision. Never raises."""
    memory, dt_s = _advanced(state.memory.drive, state.t_ns, config)
    memory = _followed(memory, state, config)
    way = _way(state, memory, config, fusion, guidance)
    if way is None:
        memory = _ended(memory)
        waits = DriveState.NO_DISTANCE if state.may_move else DriveState.INHIBITED
        return memory, Setpoint(DriveState.AT_PLACE if state.in_place else waits)
    if _doubt(state):
        return _stopped(state, memory, way, config)
    if way.to_go_mm is None or not way.movement.known:
        memory = replace(memory, speed_mm_s=0.0, rise_mm_s2=0.0)
        return memory, Setpoint(DriveState.NO_DISTANCE, stopping_mm=way.stopping_mm)
    return _driven(state, memory, way, way.to_go_mm, dt_s, config)


def slip_s(memory: DriveMemory, config: DriveConfig) -> float:
    """So late the vehicle comes to a standstill, compared with the worst brake that acts at once."""
    lag_s = _lag_s(memory, config)
    if memory.lag_s is None or 0 < memory.peak_mm_s <= config.creep_speed_mm_s:
        return lag_s
    learned_s = median(memory.slips_s) if memory.slips_s else SOONER * lag_s
    return min(max(learned_s, SOONEST * lag_s), lag_s)


def _lag_s(memory: DriveMemory, config: DriveConfig) -> float:
    """So late the vehicle follows its setpoint: as measured while it slowed down, else at the longest."""
    return config.delay_s if memory.lag_s is None else memory.lag_s


def _acting_mm_s(memory: DriveMemory, lag_s: float) -> float:
    """The setpoint that acts now."""
    then_ns = memory.t_ns - lag_s * NS_PER_S
    return (memory.way_at(then_ns) - memory.way_at(then_ns - WAY_NS)) * NS_PER_S / WAY_NS


def _moved_mm(memory: DriveMemory, from_ns: int, to_ns: int, config: DriveConfig) -> float:
    """By the setpoint, as late as it acts."""
    lag_ns = _lag_s(memory, config) * NS_PER_S
    return memory.way_at(to_ns - lag_ns) - memory.way_at(from_ns - lag_ns)


def _at(memory: DriveMemory, found: Movement, t_ns: int, config: DriveConfig) -> Movement:
    moved_mm = _moved_mm(memory, found.t_ns, t_ns, config)
    return movement.at(found, t_ns, moved_mm, _acceleration_sd(config))


def _followed(memory: DriveMemory, state: StateVector, config: DriveConfig) -> DriveMemory:
    """The memory with the newest reading, and whether the vehicle stays where it is."""
    reading, old = state.range, memory.movement
    if reading.quality is not Quality.GOOD or reading.distance_mm is None:
        return replace(memory, movement=None, still_mm=None, begun=None)
    moved_mm = 0.0 if old is None else _moved_mm(memory, old.t_ns, reading.t_ns, config)
    sd = _acceleration_sd(config)
    found = movement.measured(old, reading.distance_mm, reading.t_ns, moved_mm, sd)
    if found is not old:
        memory = _lag_measured(replace(memory, movement=found), found, config)
    now_mm = _at(memory, found, state.t_ns, config).distance_mm
    if memory.still_mm is None or abs(now_mm - memory.still_mm) > STILL_MM:
        memory = replace(memory, still_mm=now_mm, still_ns=state.t_ns)
    return memory


def _lag_measured(memory: DriveMemory, found: Movement, config: DriveConfig) -> DriveMemory:
    """While the setpoint falls, and only it limits the vehicle: how late does it act for the way that was gone?"""
    speed_mm_s, begun = memory.speed_mm_s, memory.begun
    if speed_mm_s == 0 or found.t_ns - memory.peak_ns < config.delay_s / 2 * NS_PER_S:
        return replace(memory, begun=None)
    begins = (found.t_ns, found.distance_mm, speed_mm_s)
    if begun is None or found.t_ns - begun[0] > KEPT_S * NS_PER_S:
        return replace(memory, begun=begins)
    if speed_mm_s > begun[2] - FALLS_MM_S:
        return memory
    gone_mm, longest_ns = begun[1] - found.distance_mm, config.delay_s * NS_PER_S
    if memory.way_at(found.t_ns - longest_ns) - memory.way_at(begun[0] - longest_ns) < gone_mm:
        return replace(memory, begun=begins)  # a rise, too, may have moved it so far
    lag_s = _late_s(memory, begun[0], found.t_ns, gone_mm, config)
    lag_s = lag_s if memory.lag_s is None else (memory.lag_s + lag_s) / 2
    changed_mm_s = _acting_mm_s(memory, _lag_s(memory, config)) - _acting_mm_s(memory, lag_s)
    found = replace(found, excess_mm_s=found.excess_mm_s + changed_mm_s)
    return replace(memory, lag_s=lag_s, begun=begins, movement=found)


def _late_s(memory: DriveMemory, from_ns: int, to_ns: int, gone_mm: float, config: DriveConfig) -> float:
    """By so much was a falling setpoint late that moved the vehicle so far."""
    short_s, long_s = 0.0, config.delay_s
    for _ in range(10):
        late_s = (short_s + long_s) / 2
        late_ns = late_s * NS_PER_S
        if memory.way_at(to_ns - late_ns) - memory.way_at(from_ns - late_ns) < gone_mm:
            short_s = late_s
        else:
            long_s = late_s
    return (short_s + long_s) / 2


def _acceleration_sd(config: DriveConfig) -> float:
    """Of what the vehicle does otherwise than it is told: SIGMAS of the speed's deviations then cover a brake that
    does not act."""
    return max(config.acceleration_mm_s2, config.brake_mm_s2) / SIGMAS


def _way(
    state: StateVector, memory: DriveMemory, config: DriveConfig, fusion: FusionConfig, guidance: GuidanceConfig
) -> _Way | None:
    if memory.movement is None or state.range.distance_mm is None:
        return None
    now = _at(memory, memory.movement, state.t_ns, config)
    closing_mm_s = max(0.0, _acting_mm_s(memory, _lag_s(memory, config)) + now.excess_mm_s)
    age_s = max(0.0, (state.t_ns - state.range.t_ns) / NS_PER_S)
    worst_mm_s = max(0.0, closing_mm_s + SIGMAS * now.speed_sd_mm_s)
    nearest_mm = min(
        now.distance_mm - SIGMAS * now.distance_sd_mm,
        state.range.distance_mm - max(worst_mm_s, FASTER * memory.follows_mm_s) * age_s,
    )
    coming_mm, told_mm_s = _coming(memory, config.delay_s)
    excess_mm_s = max(0.0, worst_mm_s - FASTER * told_mm_s)
    still_ns = state.t_ns - memory.still_ns
    return _Way(
        now,
        _to_go_mm(state, memory, now, config, fusion),
        closing_mm_s,
        nearest_mm - (fusion.distance_threshold_mm - guidance.overshoot_mm),
        FASTER * coming_mm
        + excess_mm_s * config.delay_s
        + (FASTER * memory.follows_mm_s + excess_mm_s) ** 2 / (2 * config.brake_mm_s2),
        coming_mm,
        excess_mm_s,
        still_ns >= (config.delay_s + STILL_S) * NS_PER_S,
    )


def _to_go_mm(
    state: StateVector, memory: DriveMemory, now: Movement, config: DriveConfig, fusion: FusionConfig
) -> float | None:
    """As guidance has it, but now: R of the frame belongs to where the vehicle was then."""
    circle = state.vision.circle
    if circle is None or state.vision.quality is not Quality.GOOD or memory.movement is None:
        return None
    then_mm = _at(memory, memory.movement, state.vision.t_ns, config).distance_mm
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
    if not at_mark:
        memory = _ended(memory)
        reached = DriveState.AT_PLACE if state.in_place else DriveState.INHIBITED
        return memory, Setpoint(reached, stopping_mm=way.stopping_mm)
    if memory.speed_mm_s > 0:
        memory = _cut(memory, way, state.t_ns)
        return memory, Setpoint(DriveState.SETTLE, stopping_mm=way.stopping_mm)
    if memory.cut is not None and not way.stands:
        return memory, Setpoint(DriveState.SETTLE, stopping_mm=way.stopping_mm)
    memory = _learned(memory, way, config)
    there = state.in_place or (way.stands and way.to_go_mm is not None and abs(way.to_go_mm) <= config.dead_band_mm)
    return memory, Setpoint(DriveState.AT_PLACE if there else DriveState.INHIBITED, stopping_mm=way.stopping_mm)


def _driven(
    state: StateVector, memory: DriveMemory, way: _Way, to_go_mm: float, dt_s: float, config: DriveConfig
) -> tuple[DriveMemory, Setpoint]:
    """May move, and the distance is known."""
    raw_mm = state.guidance.to_go_mm
    there = to_go_mm <= config.dead_band_mm or (raw_mm is not None and raw_mm + config.place_mm <= config.dead_band_mm)
    if memory.cut is not None:
        if not way.stands:
            return memory, Setpoint(DriveState.SETTLE, True, 0.0, way.stopping_mm)
        memory = _learned(memory, way, config)
    slip = slip_s(memory, config)
    ahead_mm = to_go_mm - _coming_mm(memory, slip) - memory.follows_mm_s**2 / (2 * config.brake_mm_s2)
    if memory.speed_mm_s > 0 and (there or ahead_mm <= 0):
        return _cut(memory, way, state.t_ns), Setpoint(DriveState.SETTLE, True, 0.0, way.stopping_mm)
    if there:
        return memory, Setpoint(DriveState.AT_PLACE if way.stands else DriveState.SETTLE, False, 0.0, way.stopping_mm)
    if memory.tries >= TRIES:
        return memory, Setpoint(DriveState.SETTLE, False, 0.0, way.stopping_mm)
    if ahead_mm <= 0:
        return memory, Setpoint(DriveState.SETTLE, True, 0.0, way.stopping_mm)
    if memory.run_mm_s is None:
        run_mm_s = max(config.min_speed_mm_s, min(config.creep_speed_mm_s, ahead_mm / (slip + PULSE_S)))
        memory = replace(memory, run_mm_s=run_mm_s, peak_mm_s=0.0)
    run_mm_s = memory.run_mm_s or 0.0
    comfortable_mm_s = min(config.max_speed_mm_s, _comfortable(ahead_mm, run_mm_s, config))
    safe_mm_s = _safe(way, memory, config)
    creeps = comfortable_mm_s <= config.creep_speed_mm_s
    if creeps and memory.speed_mm_s > 0 and safe_mm_s < config.min_speed_mm_s:
        memory, driving = _cut(memory, way, state.t_ns), DriveState.SETTLE
    else:
        memory = _ramped(memory, min(comfortable_mm_s, safe_mm_s), dt_s, config)
        driving = DriveState.CREEP if creeps else DriveState.APPROACH
    return memory, Setpoint(driving, True, memory.speed_mm_s, way.stopping_mm)


def _comfortable(ahead_mm: float, run_mm_s: float, config: DriveConfig) -> float:
    """Comes to `run_mm_s`, CREEP_S before the place. A run that is too short for creep speed is not faster."""
    if run_mm_s < config.creep_speed_mm_s:
        return run_mm_s
    gentle_mm_s2 = GENTLE * config.brake_mm_s2
    return sqrt(run_mm_s**2 + 2 * gentle_mm_s2 * max(0.0, ahead_mm - CREEP_S * run_mm_s))


def _safe(way: _Way, memory: DriveMemory, config: DriveConfig) -> float:
    """A setpoint from which the vehicle can still stop before the limit when the next step sets 0."""
    if way.stopping_mm > way.limit_mm:
        return 0.0
    brake_mm_s2, delay_s, follows_mm_s = config.brake_mm_s2, config.delay_s, memory.follows_mm_s
    left_mm, excess_mm_s = way.limit_mm - RESERVE_MM - FASTER * way.coming_mm, way.excess_mm_s
    falling_mm_s = (_fastest(left_mm - excess_mm_s * delay_s, LONGEST_STEP_S, brake_mm_s2) - excess_mm_s) / FASTER
    if falling_mm_s <= follows_mm_s:
        return falling_mm_s
    rising_mm_s = _fastest(left_mm + FASTER * follows_mm_s * delay_s, delay_s, brake_mm_s2) - excess_mm_s
    return max(follows_mm_s, rising_mm_s / FASTER)


def _coming(memory: DriveMemory, delay_s: float) -> tuple[float, float]:
    """How far what was set in the last `delay_s` may still move the vehicle, each setpoint until a lower one acts; and
    the highest of them."""
    since_ns = memory.t_ns - delay_s * NS_PER_S
    way_mm, fastest_mm_s = 0.0, memory.follows_mm_s
    later_ns, later_mm = memory.t_ns, memory.way_mm
    for t_ns, mm in reversed(memory.ways):
        if later_ns > t_ns:
            fastest_mm_s = max(fastest_mm_s, (later_mm - mm) * NS_PER_S / (later_ns - t_ns))
        way_mm += fastest_mm_s * (later_ns - max(t_ns, since_ns)) / NS_PER_S
        later_ns, later_mm = t_ns, mm
        if t_ns <= since_ns:
            return way_mm, fastest_mm_s
    return way_mm + fastest_mm_s * (later_ns - since_ns) / NS_PER_S, fastest_mm_s


def _coming_mm(memory: DriveMemory, delay_s: float) -> float:
    """How far the setpoints of the last `delay_s` will still move a vehicle that follows them so late."""
    return memory.way_mm - memory.way_at(memory.t_ns - delay_s * NS_PER_S)


def _advanced(memory: DriveMemory, now_ns: int, config: DriveConfig) -> tuple[DriveMemory, float]:
    """The memory with its setpoint's integral until now; and the time since the step before, s."""
    dt_s = max(0, now_ns - memory.t_ns) / NS_PER_S
    follows_mm_s = max(memory.speed_mm_s, memory.follows_mm_s - config.brake_mm_s2 * dt_s)
    way_mm, ways = memory.way_mm + (memory.follows_mm_s + follows_mm_s) / 2 * dt_s, memory.ways
    if not ways or now_ns - ways[-1][0] >= WAY_NS:
        oldest_ns = now_ns - (config.delay_s + KEPT_S) * NS_PER_S
        first = next((n for n, (t_ns, _) in enumerate(ways) if t_ns > oldest_ns), len(ways))
        ways = (*ways[max(0, first - 1) :], (now_ns, way_mm))
        if ways[0][1] == way_mm:  # nothing was set meanwhile
            ways = ways[-1:]
    advanced = replace(memory, t_ns=now_ns, way_mm=way_mm, ways=ways, follows_mm_s=follows_mm_s)
    return advanced, min(dt_s, LONGEST_STEP_S)


def _fastest(way_mm: float, delay_s: float, brake_mm_s2: float) -> float:
    """From which a vehicle stops within this way."""
    return brake_mm_s2 * (sqrt(delay_s**2 + 2 * max(0.0, way_mm) / brake_mm_s2) - delay_s)


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
    peak_ns = memory.t_ns if speed_mm_s >= FALLEN * peak_mm_s else memory.peak_ns
    follows_mm_s = max(memory.follows_mm_s, speed_mm_s)
    return replace(
        memory, speed_mm_s=speed_mm_s, rise_mm_s2=rise, peak_mm_s=peak_mm_s, peak_ns=peak_ns, follows_mm_s=follows_mm_s
    )


def _ended(memory: DriveMemory) -> DriveMemory:
    """This approach is over; the next one begins anew."""
    return replace(memory, speed_mm_s=0.0, rise_mm_s2=0.0, run_mm_s=None, cut=None, tries=0)


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
        still_mm=way.movement.distance_mm,
        still_ns=now_ns,
    )


def _learned(memory: DriveMemory, way: _Way, config: DriveConfig) -> DriveMemory:
    """It stands: how late it followed. A slower run than creep speed does not show it well."""
    cut = memory.cut
    if cut is None:
        return memory
    memory = replace(memory, cut=None)
    if not cut.moving or cut.speed_mm_s < 0.7 * config.creep_speed_mm_s:
        return memory
    ran_mm = cut.distance_mm - way.movement.distance_mm
    late_s = _late_s(memory, cut.t_ns, memory.t_ns, ran_mm, config)
    return replace(memory, slips_s=(*memory.slips_s, late_s)[-SLIPS:])
