"""The beacon of the compiled firmware: its pin shows the code of the lines, and pictures of it are proven."""

from bisect import bisect_right
from functools import cache

import numpy as np

from gateway.config import BeaconConfig, parse
from gateway.core import interlock
from gateway.core.beacon import BeaconLight, BeaconStatus
from gateway.core.detection import Circle
from gateway.core.interlock import Rules
from gateway.core.readings import Quality, VisionReading
from gateway.core.state import StateVector, Tick
from gateway.ranger.hcsr04.protocol import BEACON_CYCLES
from gateway.ranger.hcsr04.session import Hcsr04Session
from gateway.vision.picture.beacon import BeaconMeter
from tests.firmware.bench_runs import PERIOD_MS, Run, run

MS = 1_000_000
S = 1000 * MS
RESET_S = 14
PLACE = BeaconConfig(u_px=20.0, v_px=20.0)
CONFIG = parse(
    {
        "camera": {"beacon": PLACE.model_dump()},
        "ranger": {"hcsr04": {"beacon": True}},
        "fusion": {"recovery_s": 0.0, "clear_hold_s": 0.0},
    }
)


@cache
def played() -> Run:
    """Asked for the beacon after 1 s; reset, and asked anew 1 s later."""
    return run(f"distance 520\nat 1000 send b\nat {RESET_S}000 reset\nat {RESET_S + 1}000 send b\n", 21_000)


def lit(t_ns: float) -> bool:
    """The pin."""
    changes = played().of("led")
    n = bisect_right([row["t_ns"] for row in changes], t_ns)
    return n > 0 and changes[n - 1]["lit"]


def test_the_pin_shows_what_the_lines_say_of_it() -> None:
    """Each bit of each line, in the middle of its cycle."""
    triggers = [row["t_ns"] for row in played().of("trigger")]
    told = [(max(t for t in triggers if t < end_ns), m.beacon) for end_ns, m in played().measurements]
    codes = [(begin_ns, code) for begin_ns, code in told if code is not None]
    assert len(codes) > 300
    for begin_ns, code in codes:
        for n in range(BEACON_CYCLES):
            then_ns = begin_ns + (PERIOD_MS // 2 - n * PERIOD_MS) * MS
            assert bool(code >> n & 1) == lit(then_ns), (begin_ns, n)
    bits = [code & 1 for _, code in codes]
    assert 0.4 < sum(bits) / len(bits) < 0.6
    first, second = ([code & 1 for t, code in codes if (t < RESET_S * S) is old][:90] for old in (True, False))
    assert first != second
    silent = [m.beacon for end_ns, m in played().measurements if end_ns < S or RESET_S * S < end_ns < RESET_S * S + S]
    assert set(silent) == {None}
    assert not lit(RESET_S * S + 500 * MS)


def test_pictures_of_the_pin_are_proven_until_they_show_another_time() -> None:
    """15 frames a second, 80 ms on their way; from 9 s on they are those of 6 s before."""
    assert status(6 * S).beacon.status is BeaconStatus.PROVEN
    lag_ns = status(8 * S).beacon.lag_ns
    assert lag_ns is not None
    assert 60 * MS <= lag_ns <= 100 * MS
    assert status(11 * S).beacon.status is BeaconStatus.LOST
    assert status(11 * S).stop


@cache
def course() -> list[StateVector]:
    bay = CONFIG.bays[0]
    rules, meter = Rules.of(bay, CONFIG), BeaconMeter(PLACE)
    session, found = Hcsr04Session(bay.ranger), [interlock.initial("bay1", 0, rules)]
    session.opened(0)
    lines = [(row["t_ns"], row["text"].encode()) for row in played().of("line")]
    frames = [n * S // 15 for n in range(12 * 15)]
    ticks = [n * 20 * MS for n in range(12 * 50)]
    due = [*((t, 0, text) for t, text in lines if t < 12 * S)]
    due += [*((t, 1, b"") for t in frames), *((t, 2, b"") for t in ticks)]
    for now_ns, kind, text in sorted(due):
        state = found[-1]
        if kind == 0:
            for reading in session.feed(text, now_ns):
                state = interlock.step(state, reading, now_ns, rules)
        elif kind == 1:
            shown_ns = now_ns - 80 * MS - (6 * S if now_ns >= 9 * S else 0)
            image = np.full((40, 40, 3), 60, np.uint8)
            image[17:24, 17:24] = 180 if lit(shown_ns) else 30
            level = meter.level(image)
            assert level is not None
            seen = VisionReading(now_ns, Quality.GOOD, Circle(9.0, 9.0, 5.0), beacon=BeaconLight(now_ns, level))
            state = interlock.step(state, seen, now_ns, rules)
        else:
            state = interlock.step(state, Tick(), now_ns, rules)
        found.append(state)
    return found


def status(t_ns: int) -> StateVector:
    return next(state for state in reversed(course()) if state.t_ns <= t_ns)
