"""The setpoint's guard: how far the vehicle goes on at worst, and the setpoint from which it still stops. Pure.

With D = lag_s + latency_s, b the worst brake, and k = FASTER: at worst the vehicle follows, k times as fast, what was
set up to D ago: the PLC holds an image until its life sign ends, then the drive needs its lag. Set to 0 now, it goes on
by at most k W,

    W = the integral over the last D of the highest setpoint from then until now

and then by its braking way. What it has followed sooner is in the measured distance already, and is not counted again
as v D; only x is, by which it may be faster than k times any setpoint of the last D. So the setpoint v is at most

    v from k W + x D + (k v + x)^2 / (2 b) = d_limit - reserve     to stop before the limit, if the next step sets 0

A setpoint that falls faster than b counts as one that falls by b. Before it rises by dv, W is taken as W + dv D.
"""

from dataclasses import dataclass
from math import sqrt

from gateway.config import DriveConfig
from gateway.core.setpoint_history import SetpointHistory

FASTER = 1.1  # times its setpoint: a drive may be so fast
RESERVE_MM = 8.0  # so much nearer it may seem by the next step
LONGEST_STEP_S = 0.1  # a setpoint rises for no longer than this at once


@dataclass(frozen=True, slots=True)
class StoppingWay:
    """At worst, from now."""

    mm: float  # until standstill
    coming_mm: float  # so far what was set may still move it
    excess_mm_s: float  # so much faster it may be than anything that was set


def at_worst(history: SetpointHistory, worst_mm_s: float, config: DriveConfig) -> StoppingWay:
    """Of a vehicle that may be as fast as `worst_mm_s`."""
    delay_s = config.delay_s
    coming_mm, told_mm_s = history.worst(delay_s)
    excess_mm_s = max(0.0, worst_mm_s - FASTER * told_mm_s)
    brakes_mm = (FASTER * history.follows_mm_s + excess_mm_s) ** 2 / (2 * config.brake_mm_s2)
    return StoppingWay(FASTER * coming_mm + excess_mm_s * delay_s + brakes_mm, coming_mm, excess_mm_s)


def safe_mm_s(way: StoppingWay, limit_mm: float, follows_mm_s: float, config: DriveConfig) -> float:
    """A setpoint from which the vehicle can still stop before the limit when the next step sets 0."""
    if way.mm > limit_mm:
        return 0.0
    brake_mm_s2, delay_s = config.brake_mm_s2, config.delay_s
    left_mm, excess_mm_s = limit_mm - RESERVE_MM - FASTER * way.coming_mm, way.excess_mm_s
    falling_mm_s = (_fastest(left_mm - excess_mm_s * delay_s, LONGEST_STEP_S, brake_mm_s2) - excess_mm_s) / FASTER
    if falling_mm_s <= follows_mm_s:
        return falling_mm_s
    rising_mm_s = _fastest(left_mm + FASTER * follows_mm_s * delay_s, delay_s, brake_mm_s2) - excess_mm_s
    return max(follows_mm_s, rising_mm_s / FASTER)


def _fastest(way_mm: float, delay_s: float, brake_mm_s2: float) -> float:
    """From which a vehicle stops within this way."""
    return brake_mm_s2 * (sqrt(delay_s**2 + 2 * max(0.0, way_mm) / brake_mm_s2) - delay_s)
