"""Do the pictures show the present? An LED in the camera's view blinks a code, which the ranger's board reports. Pure.

The board chooses the LED's state at random for every cycle and reports it in its lines (docs/beacon.md). Here the
brightness at the LED's place in each frame, at the time that the camera claims for it, is correlated with the reported
code:

    r(lag) = correlation of brightness(t) with code(t - lag), over the frames of the last seconds

Pictures of the present show the code at one lag: by how much they are older than the camera says. Pictures that are
frozen, repeated, recorded or of another camera show it at none.

The lag is found over SEARCH_NS, by the significance of the best r: atanh(r) sqrt(n - 3) is a standard normal number
where the brightness has nothing to do with the code. n counts frames, but no more than the cycles, which alone are
independent. It is then followed over FOLLOW_NS, and given up as soon as r falls below KEEP_R. Numbers and odds:
bench/beacon.py.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import mul

from gateway.explained import ExplainedInt
from gateway.replacing import replace

STEP_NS = 10_000_000  # of lags
EARLIEST, LATEST = -10, 200  # lags searched, in steps: -0.1 to 2 s
SEARCH_STEPS = 2
SEARCH_NS = 4_000_000_000
FOLLOW_NS = 1_600_000_000
FOLLOW_STEPS = 3  # the lag may change by so many between two looks
LOOK_NS, SEARCH_LOOK_NS = 100_000_000, 500_000_000
FOUND_Z = 7.0
KEEP_R = 0.6
LEAST_FRAMES = 10  # of FOLLOW_NS: slower cameras are not followed
FOUND_FRAMES = 32  # of SEARCH_NS, in as many cycles: fewer bits of another code are equal by chance
EXPIRES_NS = 1_000_000_000  # without a frame that confirms it
CLOSEST_NS = 12_000_000  # frames closer than this to the one before are not used


class BeaconStatus(ExplainedInt):
    """Do the pictures show the code? The numbers are on the wire: never renumber, only add."""

    OFF = 0, "no beacon is configured"
    SEARCHING = 1, "the code was not found in the pictures yet"
    PROVEN = 2, "the pictures show the code: they are of the present, and as old as the camera says"
    LATE = 3, "the pictures show the code, but are older than the camera says by more than the tolerance"
    LOST = 4, "the pictures no longer show the code"


FOUND = frozenset({BeaconStatus.PROVEN, BeaconStatus.LATE})


@dataclass(frozen=True, slots=True)
class BeaconLight:
    """How much brighter the LED's place is than what is around it, in one frame, and that frame's claimed time."""

    t_ns: int
    level: float


@dataclass(frozen=True, slots=True)
class BeaconCode:
    """The LED in the newest cycles of the board, oldest first. `t_ns`: the newest one began."""

    t_ns: int
    period_ns: int
    lit: tuple[bool, ...]


@dataclass(frozen=True, slots=True)
class Beacon:
    """What is known of a bay's beacon. `lag_ns`: by how much the pictures are older than the camera says."""

    status: BeaconStatus = BeaconStatus.OFF
    lag_ns: int | None = None
    latency_ns: int | None = None  # from the light to the step that its frame entered
    found_ns: int = 0  # when the code was last seen
    looked_ns: int = 0  # time of the frame that was looked at last
    light: tuple[BeaconLight, ...] = ()
    code: tuple[tuple[int, bool], ...] = ()  # begin of each cycle, and the LED in it
    period_ns: int = 0
    unproven: bool = False  # frames arrive in time, but it does not prove them: set by fusion, the one rule


def told(beacon: Beacon, code: BeaconCode) -> Beacon:
    """A line has arrived. Of its older cycles those that are missing are added, where only a few lines were lost."""
    last_ns = beacon.code[-1][0] if beacon.code else code.t_ns - code.period_ns
    count = round((code.t_ns - last_ns) / code.period_ns)
    if count < 1:
        return beacon
    lit = code.lit[-count:] if count <= len(code.lit) else code.lit[-1:]
    first_ns = code.t_ns - (len(lit) - 1) * code.period_ns
    added = [(first_ns + n * code.period_ns, on) for n, on in enumerate(lit)]
    since_ns = code.t_ns - SEARCH_NS - (LATEST + 2) * STEP_NS
    kept = [cycle for cycle in beacon.code if cycle[0] >= since_ns]
    return replace(beacon, code=(*kept, *added), period_ns=code.period_ns)


def seen(beacon: Beacon, light: BeaconLight | None, now_ns: int, tolerance_ns: int) -> Beacon:
    """A frame has arrived, or a fault instead (None). `tolerance_ns`: so much older than claimed pictures may be."""
    if light is None or not math.isfinite(light.level):
        return replace(_lost(beacon), light=())  # a source that is opened anew begins anew
    if beacon.light and light.t_ns < beacon.light[-1].t_ns + CLOSEST_NS:
        return aged(beacon, now_ns)
    since_ns = light.t_ns - SEARCH_NS
    lights = (*(one for one in beacon.light if one.t_ns >= since_ns), light)
    beacon = replace(beacon, light=lights)
    if light.t_ns - beacon.looked_ns < (SEARCH_LOOK_NS if beacon.lag_ns is None else LOOK_NS):
        return aged(beacon, now_ns)
    beacon = replace(beacon, looked_ns=light.t_ns)
    lag_ns = _found(beacon) if beacon.lag_ns is None else beacon.lag_ns
    lag_ns = None if lag_ns is None else _followed(beacon, lag_ns)
    if lag_ns is None:
        return _lost(beacon)
    status = BeaconStatus.PROVEN if lag_ns <= tolerance_ns else BeaconStatus.LATE
    latency_ns = max(0, now_ns - light.t_ns + lag_ns)
    return replace(beacon, status=status, lag_ns=lag_ns, latency_ns=latency_ns, found_ns=now_ns)


def aged(beacon: Beacon, now_ns: int) -> Beacon:
    """Time has passed."""
    return _lost(beacon) if beacon.lag_ns is not None and now_ns - beacon.found_ns > EXPIRES_NS else beacon


def _lost(beacon: Beacon) -> Beacon:
    ended = BeaconStatus.LOST if beacon.status in FOUND | {BeaconStatus.LOST} else BeaconStatus.SEARCHING
    return replace(beacon, status=ended, lag_ns=None, latency_ns=None)


def _found(beacon: Beacon) -> int | None:
    """The lag at which the code is in the pictures beyond doubt."""
    z, _, lag = best(beacon, SEARCH_NS, range(EARLIEST, LATEST + 1, SEARCH_STEPS), FOUND_FRAMES)
    return lag * STEP_NS if z >= FOUND_Z else None


def _followed(beacon: Beacon, lag_ns: int) -> int | None:
    """The lag now; None: the newest frames no longer show the code there."""
    lag = lag_ns // STEP_NS
    lags = range(max(EARLIEST, lag - FOLLOW_STEPS), min(LATEST, lag + FOLLOW_STEPS) + 1)
    _, r, lag = best(beacon, FOLLOW_NS, lags, LEAST_FRAMES)
    return lag * STEP_NS if r >= KEEP_R else None


def best(beacon: Beacon, span_ns: int, lags: Sequence[int], least: int) -> tuple[float, float, int]:
    """Of the lag with the most significant correlation, over the frames of the newest `span_ns`: its significance, the
    correlation, and the lag. `least`: so many frames and cycles it takes."""
    since_ns = beacon.light[-1].t_ns - span_ns
    frames = [one for one in beacon.light if one.t_ns >= since_ns]
    times = [one.t_ns // STEP_NS for one in frames]
    mean = sum(one.level for one in frames) / len(frames)
    levels = [one.level - mean for one in frames]
    power = sum(level * level for level in levels)
    first = times[0] - lags[-1]
    code = _in_steps(beacon, first, times[-1] - lags[0])
    cycles = (times[-1] - times[0]) * STEP_NS / beacon.period_ns if beacon.period_ns else 0.0
    best = (0.0, 0.0, lags[0])
    for lag in lags:
        lit = [code[t - lag - first] for t in times]
        known, total = sum(map(abs, lit)), sum(lit)
        if (independent := min(known, cycles)) < least:
            continue
        spread = power * (known - total * total / len(lit))
        r = sum(map(mul, levels, lit)) / math.sqrt(spread) if spread > 1e-9 else 0.0
        z = math.atanh(min(r, 0.999999)) * math.sqrt(independent - 3)
        best = max(best, (z, r, lag))
    return best


def _in_steps(beacon: Beacon, first: int, last: int) -> list[int]:
    """The code at each step of time: 1 lit, -1 dark, 0 not known, which correlates with nothing."""
    steps = [0] * (last - first + 1)
    for t_ns, lit in beacon.code:
        begin, end = t_ns // STEP_NS - first, (t_ns + beacon.period_ns) // STEP_NS - first
        for n in range(max(0, begin), min(len(steps), end)):
            steps[n] = 1 if lit else -1
    return steps
