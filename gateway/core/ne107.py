"""The status signals of NAMUR NE 107, derived from a state. Pure.

NE 107 gives a field device four signals besides "good": failure (F), function check (C), out of specification (S) and
maintenance required (M). Several may hold at once; the register names the one that counts most.
"""

from gateway.core.readings import BEYOND_RANGE, DEAD, MEASURED, Quality
from gateway.core.state import FunctionCheck, Reason, Sensed, StateVector
from gateway.explained import ExplainedInt

MAINTENANCE_NS = 600 * 1_000_000_000  # after something was restarted by itself it is reported for this time


class Ne107(ExplainedInt):
    """The numbers are on the wire: never renumber, only add."""

    GOOD = 0, "in order; an empty bay is in order, too"
    FAILURE = 1, "F: not valid: a sensor, a link, the PLC's heartbeat (where required), relay or gateway is broken"
    FUNCTION_CHECK = 2, "C: not valid for the moment, on purpose: starting, shutting down, a technician at work"
    OUT_OF_SPECIFICATION = (
        3,
        "S: beyond what it can measure: out of the ranger's range, jumping distances, marker "
        "hidden, sensors contradict, age not proven",
    )
    MAINTENANCE_REQUIRED = (
        4,
        "M: valid, but see to picture, restart within 10 min, 1 damaged line in 100, "
        "one of several rangers or air temperature",
    )


# A technician at work explains whatever else is seen; only a dead gateway is worse.
ORDER = (Ne107.FAILURE, Ne107.FUNCTION_CHECK, Ne107.OUT_OF_SPECIFICATION, Ne107.MAINTENANCE_REQUIRED)

_OUT = frozenset({Quality.TOO_NEAR, Quality.UNSTABLE, Quality.COASTED})


def active(state: StateVector) -> frozenset[Ne107]:
    """Every signal that holds; empty: good."""
    vision, rng = state.vision.quality, state.range.quality
    qualities = {vision, rng}
    # An ultrasonic ranger that hears nothing is right where no marker is in sight, or where the marker is far off.
    beyond = rng in BEYOND_RANGE and vision is not Quality.NO_TARGET and not state.may_move
    holds = {
        Ne107.FAILURE: bool(qualities & DEAD)
        or state.plc.missed
        or state.relay_fault
        or state.reason is Reason.GATEWAY_FAULT,
        Ne107.FUNCTION_CHECK: state.function_check is not FunctionCheck.OFF
        or Quality.WAITING in qualities
        or state.reason is Reason.SHUTDOWN,
        Ne107.OUT_OF_SPECIFICATION: beyond
        or bool(qualities & _OUT)
        or state.memory.disagree
        or state.vision_age_unproven,
        Ne107.MAINTENANCE_REQUIRED: degraded(state)
        or state.range.temperature_lost
        or (state.marker is not None and state.marker.worn)
        or (state.picture is not None and state.picture.status != 0),
    }
    return frozenset(signal for signal, on in holds.items() if on)


def status(state: StateVector) -> Ne107:
    """The signal that counts most."""
    signals = active(state)
    if state.function_check is not FunctionCheck.OFF and state.reason is not Reason.GATEWAY_FAULT:
        return Ne107.FUNCTION_CHECK
    if state.reason is Reason.SHUTDOWN:
        return Ne107.FUNCTION_CHECK
    return next((signal for signal in ORDER if signal in signals), Ne107.GOOD)


def restarts(state: Sensed) -> int:
    """What was restarted, reopened or lost since the start of the gateway."""
    vision, rng = state.vision.stats, state.range.stats
    return vision.restarts + vision.reopens + vision.lost + rng.reopens


def degraded(state: StateVector) -> bool:
    """Was something restarted lately, do many damaged lines arrive, or does one of several rangers not agree?"""
    if state.range.quality in MEASURED and not all(one.agrees for one in state.range.rangers):
        return True
    since_ns = state.memory.restarted_ns
    if since_ns is not None and state.t_ns - since_ns < MAINTENANCE_NS:
        return True
    lines, damaged = state.range.stats.lines, state.range.stats.damaged
    return lines + damaged >= 100 and damaged * 100 > lines + damaged
