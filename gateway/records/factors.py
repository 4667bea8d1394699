"""What keeps `stop` on or `may_move` off in one state, in words and with its numbers. Pure.

`causes(state, ...)` names every cause that is present, the one that explains the outputs first. It decides nothing: it
reads what the step (gateway/core/interlock.py) has left in the state.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from gateway.config import FusionConfig
from gateway.core.details import RECOVERING, Detail
from gateway.core.fusion import RANGE_REASON, VISION_REASON
from gateway.core.interlock import Recipe, Rules
from gateway.core.plc import Control, PlcLink
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.shown import valid
from gateway.core.state import FunctionCheck, Moved, Reason, StateVector, TruckPosition, VisitPhase
from gateway.durations import NS_PER_S
from gateway.records import sentences as say


class Factor(StrEnum):
    """A cause by its name; the names are in the JSON output."""

    SHUTDOWN = "shutdown"
    GATEWAY = "gateway"
    MOVED = "moved"
    RESTORED = "restored"
    NO_TRUCK = "no_truck"
    CAMERA = "camera"
    RANGER = "ranger"
    CONTRADICTION = "contradiction"
    PLC_LOST = "plc_lost"
    TARGET = "target"
    IN_PLACE = "in_place"
    LATCH = "latch"
    HOLD = "hold"
    FUNCTION_CHECK = "function_check"
    ENABLE = "enable"
    TRUCK_PRESENT = "truck_present"
    OTHER = "other"
    RELEASED = "released"
    CLEAR = "clear"


@dataclass(frozen=True, slots=True)
class Cause:
    """`since_ns`: monotonic, as far as the state itself says it."""

    factor: Factor
    text: str
    since_ns: int | None = None


def causes(state: StateVector, rules: Rules, now_ns: int | None = None) -> tuple[Cause, ...]:
    """What is present in `state`, the decisive one first. `now_ns`: as it was shown then; None: when it was made.

    The last two factors, RELEASED and CLEAR, say why nothing stops the truck. Never empty.
    """
    if state.reason is Reason.SHUTDOWN:
        return (Cause(Factor.SHUTDOWN, say.SHUT_DOWN(), state.t_ns),)
    if now_ns is not None and not valid(state, now_ns):
        return (_not_valid(state, now_ns),)
    if state.reason is Reason.GATEWAY_FAULT:
        return (Cause(Factor.GATEWAY, say.NOT_TICKED(), state.valid_until_ns),)
    recipe = rules.recipes.get(state.plc.recipe, rules.recipes[0])
    if state.may_move:
        return (_nothing(state, recipe.fusion),)
    found = [*_of_stop(state, rules, recipe), *_of_may_move(state, rules)]
    if not found:  # a version that stops for what is not told apart here
        found = [Cause(Factor.OTHER, state.reason.meaning)]
    return tuple(sorted(found, key=lambda cause: _rank(cause.factor, state)))


def _not_valid(state: StateVector, now_ns: int) -> Cause:
    text = say.STOOD_STILL(f"{(now_ns - state.t_ns) / NS_PER_S:.2f}")
    return Cause(Factor.GATEWAY, text, state.valid_until_ns)


def _rank(factor: Factor, state: StateVector) -> int:
    """The cause that the reported reason stands for comes first; before it only a move without release."""
    of_reason = {
        Reason.TARGET_REACHED: Factor.TARGET,
        Reason.STOP_LATCHED: Factor.LATCH,
        Reason.CLEARING: Factor.HOLD,
        Reason.SENSORS_DISAGREE: Factor.CONTRADICTION,
        Reason.PLC_LOST: Factor.PLC_LOST,
    } | dict.fromkeys(VISION_REASON.values(), Factor.CAMERA)
    of_reason |= dict.fromkeys((*RANGE_REASON.values(), Reason.RANGERS_DISAGREE), Factor.RANGER)
    of_reason |= dict.fromkeys((Reason.VISION_FAULT, Reason.VISION_AGE_UNPROVEN), Factor.CAMERA)
    if state.reason is Reason.STARTING:
        of_reason[Reason.STARTING] = Factor.CAMERA if state.vision.quality is Quality.WAITING else Factor.RANGER
    if factor is Factor.NO_TRUCK or (factor is Factor.MOVED and state.reason is not Reason.PLC_LOST):
        return 0
    if factor is Factor.IN_PLACE and state.in_place and state.d is not True:
        return 1  # held: the covered marker is not a fault then
    return 2 if factor is of_reason.get(state.reason) else 3 + tuple(Factor).index(factor)


def _of_stop(state: StateVector, rules: Rules, recipe: Recipe) -> Iterator[Cause]:
    visit, memory = state.visit, state.memory
    sensors = [c for c in (vision_cause(state, recipe.fusion), range_cause(state, recipe.fusion)) if c is not None]
    if state.stop and visit.moved is not Moved.NO and rules.handshake is not None:
        yield Cause(Factor.MOVED, _moved(state))
    elif state.stop and visit.restored and rules.handshake is not None:
        yield Cause(Factor.RESTORED, say.RESTORED())
    if visit.phase is VisitPhase.EMPTY and len(sensors) == 2:
        yield Cause(Factor.NO_TRUCK, say.NO_TRUCK(), visit.clear_since_ns)
    yield from sensors
    if memory.disagree:
        yield Cause(Factor.CONTRADICTION, say.CONTRADICT(_pair(state)), memory.disagree_since_ns)
    if state.plc.missed:
        yield _plc_lost(state, rules)
    if state.d is True and state.stop:
        yield Cause(Factor.TARGET, _at_mark(state, recipe.fusion))
    if visit.in_place:
        yield _in_place(state)
    if memory.latched and state.d is not True:
        yield Cause(Factor.LATCH, say.LATCHED())
    calm = state.d is False and not sensors and not memory.disagree
    if calm and memory.no_cause_since_ns is not None and not state.may_move:
        gone_s = (state.t_ns - memory.no_cause_since_ns) / NS_PER_S
        if gone_s < recipe.fusion.clear_hold_s and recipe.fusion.decision != "plain":
            text = say.GONE_ONLY(f"{gone_s:.2f}", f"{recipe.fusion.clear_hold_s:g}")
            yield Cause(Factor.HOLD, text, memory.no_cause_since_ns)
    elif calm and memory.disagree_since_ns is not None and state.stop:
        yield Cause(Factor.CONTRADICTION, say.NOT_FITTING(_pair(state)), memory.disagree_since_ns)


def _of_may_move(state: StateVector, rules: Rules) -> Iterator[Cause]:
    if state.function_check is FunctionCheck.MAY_MOVE_OFF:
        yield Cause(Factor.FUNCTION_CHECK, say.WITHHELD())
    handshake, plc = rules.handshake, state.plc
    if handshake is None:
        return
    if handshake.heartbeat_required and plc.link is not PlcLink.ALIVE and not plc.missed:
        yield Cause(Factor.PLC_LOST, say.NO_HEARTBEAT())
    if handshake.enable_required and not plc.on(Control.ENABLE):
        yield Cause(Factor.ENABLE, say.NO_ENABLE())
    if handshake.truck_required and not plc.on(Control.TRUCK_PRESENT):
        yield Cause(Factor.TRUCK_PRESENT, say.NO_TRUCK_BIT())


def vision_cause(state: StateVector, config: FusionConfig) -> Cause | None:
    """None: the camera's value is good."""
    reading, now_ns = state.vision, state.t_ns
    if reading.quality is Quality.GOOD:
        return None
    alive_ns = state.memory.vision_failure.alive_since_ns
    if (recovering := _recovering(say.CAMERA_AGAIN, reading, alive_ns, now_ns, config)) is not None:
        return Cause(Factor.CAMERA, recovering, alive_ns)
    if _aged(reading, now_ns, config.vision_deadline_s):
        text = say.FRAME_OLD(f"{_age_s(reading, now_ns):.2f}", f"{config.vision_deadline_s:g}")
        return Cause(Factor.CAMERA, text, reading.t_ns + round(config.vision_deadline_s * NS_PER_S))
    text = say.OF_CAMERA(_because(reading.quality.meaning, reading.detail))
    if reading.wrong_size is not None:
        text = say.WRONG_SIZE(text, f"{reading.wrong_size.radius_px:.1f}")
    return Cause(Factor.CAMERA, text, state.visit.covered_since_ns)


def range_cause(state: StateVector, config: FusionConfig) -> Cause | None:
    """None: the ranger's value is good."""
    reading, now_ns = state.range, state.t_ns
    if reading.quality is Quality.GOOD:
        return None
    alive_ns = state.memory.range_failure.alive_since_ns
    if (recovering := _recovering(say.RANGER_AGAIN, reading, alive_ns, now_ns, config)) is not None:
        return Cause(Factor.RANGER, recovering, alive_ns)
    if _aged(reading, now_ns, config.range_deadline_s):
        text = say.READING_OLD(f"{_age_s(reading, now_ns):.2f}", f"{config.range_deadline_s:g}")
        return Cause(Factor.RANGER, text, reading.t_ns + round(config.range_deadline_s * NS_PER_S))
    return Cause(Factor.RANGER, say.OF_RANGER(_because(reading.quality.meaning, reading.detail)))


def _recovering(
    again: Detail,
    reading: VisionReading | RangeReading,
    alive_since_ns: int | None,
    now_ns: int,
    config: FusionConfig,
) -> str | None:
    if reading.detail != RECOVERING() or alive_since_ns is None:
        return None
    alive_s = (now_ns - alive_since_ns) / NS_PER_S
    return again(reading.quality.name.lower(), f"{alive_s:.2f}", f"{config.recovery_s:g}")


def _plc_lost(state: StateVector, rules: Rules) -> Cause:
    deadline_s = rules.handshake.heartbeat_deadline_s if rules.handshake is not None else 0.0
    since_ns = state.plc.beat_ns + round(deadline_s * NS_PER_S)
    times = f"{(state.t_ns - state.plc.beat_ns) / NS_PER_S:.2f}", f"{deadline_s:g}"
    text = say.BEAT_STANDS(state.plc.heartbeat, *times) if state.plc.owner_beats else say.NOT_WRITTEN(*times)
    return Cause(Factor.PLC_LOST, text, since_ns)


def _in_place(state: StateVector) -> Cause:
    visit = state.visit
    text = say.IN_PLACE() if visit.place is None else say.IN_PLACE_AT(position(visit.place))
    if visit.covered_since_ns is not None:
        covered_s = (state.t_ns - visit.covered_since_ns) / NS_PER_S
        text = say.COVERED(text, f"{covered_s:.1f}", _mm(state))
    return Cause(Factor.IN_PLACE, text, visit.in_place_since_ns)


def _moved(state: StateVector) -> str:
    place, text = state.visit.place, say.MOVED(state.visit.moved.meaning)
    return text if place is None else say.MOVED_FROM(text, position(place), _mm(state))


def _at_mark(state: StateVector, config: FusionConfig) -> str:
    circle, distance_mm = state.vision.circle, state.range.distance_mm
    if circle is None or distance_mm is None:
        return "D = 1"
    large, near = circle.radius_px >= config.radius_threshold_px, distance_mm <= config.distance_threshold_mm
    now = f"R {circle.radius_px:.1f} px {'>=' if large else '<'} R_th {config.radius_threshold_px:g}, "
    now += f"Z {distance_mm:.0f} mm {'<=' if near else '>'} Z_th {config.distance_threshold_mm:g}"
    if large and near:
        return f"D = 1: {now}"
    mark = state.memory.mark
    return say.STAYS(now) if mark is None else say.STAYS_SINCE(now, position(mark))


def _nothing(state: StateVector, config: FusionConfig) -> Cause:
    if state.visit.released:
        where = say.OFF_MARK() if state.visit.off_mark else say.MAY_LEAVE()
        return Cause(Factor.RELEASED, say.RELEASED(where, _pair(state)))
    thresholds = f"{config.radius_threshold_px:g}", f"{config.distance_threshold_mm:g}"
    text = say.NOTHING_STOPS(_pair(state), *thresholds)
    return Cause(Factor.CLEAR, text, state.memory.no_cause_since_ns)


def position(place: TruckPosition) -> str:
    return f"Z {place.distance_mm:.0f} mm, R {place.circle.radius_px:.1f} px"


def _pair(state: StateVector) -> str:
    circle = state.vision.circle or state.vision.wrong_size
    return say.PAIR("unknown" if circle is None else f"{circle.radius_px:.1f} px", _mm(state))


def _mm(state: StateVector) -> str:
    return "unknown" if state.range.distance_mm is None else f"{state.range.distance_mm:.0f} mm"


def _aged(reading: VisionReading | RangeReading, now_ns: int, deadline_s: float) -> bool:
    """Did the gateway find its age too great? One that a sensor's own side reports STALE has the time of the report."""
    return reading.quality is Quality.STALE and _age_s(reading, now_ns) > deadline_s


def _age_s(reading: VisionReading | RangeReading, now_ns: int) -> float:
    return (now_ns - reading.t_ns) / NS_PER_S


def _because(text: str, detail: str) -> str:
    return say.BECAUSE(text, detail) if detail else text
