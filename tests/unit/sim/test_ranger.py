"""The simulated sensor and board: plausible errors, exact bytes, the pace of the wire, every fault. No pty here."""

from collections.abc import Callable
from itertools import pairwise
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.config import RangerConfig
from gateway.core.readings import Quality, RangeReading
from gateway.ranger.hcsr04.protocol import Decoder, Event, Flags, Hello, Measurement
from gateway.ranger.hcsr04.session import Hcsr04Session, distance_mm
from gateway.sim.hcsr04 import SensorErrors, measure, no_echo, ticks_of
from gateway.sim.ranger import faults_of
from gateway.sim.ranger_board import POWER_ON, Faults, RangerBoard, RangerFault
from gateway.sim.scenario import parse

MS = 1_000_000
S = 1000 * MS
PERFECT = SensorErrors(0.0, 0.0, 0.0)

Truth = Callable[[int], float | None]


def standing(mm: float | None) -> Truth:
    return lambda t_ns: mm


def board(truth: Truth, **options: object) -> RangerBoard:
    made = RangerBoard(truth, **options)  # type: ignore[arg-type]  # options of the test at hand
    made.boot(0, POWER_ON)
    return made


def run(made: RangerBoard, until_ns: int, step_ns: int = 5 * MS, start_ns: int = 0) -> list[tuple[int, bytes]]:
    """What left the wire, by time."""
    return [(t, data) for t in range(start_ns, until_ns, step_ns) if (data := made.advance(t))]


def events(sent: list[tuple[int, bytes]]) -> list[Event]:
    decoder = Decoder()
    return [e for _, data in sent for e in decoder.feed(data)]


def measured(sent: list[tuple[int, bytes]]) -> list[Measurement]:
    return [e for e in events(sent) if isinstance(e, Measurement)]


def heard_by_host(
    made: RangerBoard, seconds: float, faults: Callable[[int], Faults] = lambda t: {}
) -> list[RangeReading]:
    """Board and session end to end, without a port."""
    session = Hcsr04Session(RangerConfig())
    readings = session.opened(0)
    for t_ns in range(0, round(seconds * S), 4 * MS):
        made.faults = faults(t_ns)
        made.hear(session.request(t_ns), t_ns)
        readings += session.feed(made.advance(t_ns), t_ns) + session.tick(t_ns)
    return readings


# -- the sensor -------------------------------------------------------------------------------------------------------


def test_a_perfect_sensor_is_exact_to_a_tick_at_any_temperature() -> None:
    for air_c in (-10.0, 20.0, 35.0):
        for mm in (20.0, 250.0, 520.0, 4000.0):
            echo = measure(mm, air_c, PERFECT, Random(1))
            assert echo.flags == 0
            assert abs(distance_mm(echo.ticks, air_c) - mm) <= 0.045


def test_steps_are_4_mm_and_jitter_is_as_wide_as_it_says() -> None:
    random = Random(5)
    stepped = SensorErrors(jitter_mm=3.0, step_mm=4.0, dropout=0.0)
    values = [distance_mm(measure(400.0, 20.0, stepped, random).ticks, 20.0) for _ in range(4000)]
    assert all(abs(v / 4 - round(v / 4)) < 0.02 for v in values)
    mean = sum(values) / len(values)
    assert mean == pytest.approx(400.0, abs=0.2)
    sigma = (sum((v - mean) ** 2 for v in values) / len(values)) ** 0.5
    assert sigma == pytest.approx((3.0**2 + 4.0**2 / 12) ** 0.5, rel=0.05)


def test_default_errors_stay_within_what_the_paper_saw() -> None:
    """1.7 cm at most between 25 and 52 cm."""
    errors, random = SensorErrors(), Random(2)
    worst = 0.0
    for n in range(20_000):
        true_mm = 250.0 + 270.0 * (n % 1000) / 1000
        echo = measure(true_mm, 20.0, errors, random)
        if not echo.flags:
            worst = max(worst, abs(distance_mm(echo.ticks, 20.0) - true_mm))
    assert 8.0 < worst <= 12.05


def test_dropouts_come_as_often_as_they_should() -> None:
    random = Random(3)
    lost = sum(measure(300.0, 20.0, SensorErrors(dropout=0.1), random) == no_echo() for _ in range(5000))
    assert lost == pytest.approx(500, rel=0.15)


@pytest.mark.parametrize(
    ("mm", "flags"),
    [
        (None, Flags.NO_ECHO),
        (19.0, Flags.TOO_NEAR),
        (0.0, Flags.TOO_NEAR),
        (-5.0, Flags.TOO_NEAR),
        (4001.0, Flags.TOO_FAR),
    ],
)
def test_the_limits_are_flagged(mm: float | None, flags: Flags) -> None:
    assert measure(mm, 20.0, PERFECT, Random(1)).flags is flags


@given(st.floats(20, 4000), st.integers(0, 1000))
def test_no_error_is_larger_than_its_bound(mm: float, seed: int) -> None:
    errors = SensorErrors(jitter_mm=5.0, step_mm=4.0, dropout=0.0)
    echo = measure(mm, 20.0, errors, Random(seed))
    assert abs(distance_mm(echo.ticks, 20.0) - mm) <= 4 * 5.0 + 4.0 / 2 + 0.05


# -- the board --------------------------------------------------------------------------------------------------------


def test_an_echo_is_heard_of_what_is_nearer() -> None:
    def heard(truth_mm: float | None, echo_mm: float) -> float:
        made = board(standing(truth_mm), errors=PERFECT)
        made.faults = {RangerFault.ECHO: echo_mm}
        return distance_mm(measured(run(made, S))[-1].ticks, 20.0)

    assert heard(280.0, 200.0) == pytest.approx(200.0, abs=0.1)
    assert heard(280.0, 450.0) == pytest.approx(280.0, abs=0.1)
    assert heard(None, 450.0) == pytest.approx(450.0, abs=0.1)


def test_of_several_echoes_of_a_scenario_the_nearest_is_heard() -> None:
    scenario = parse(
        {
            "faults": [
                {"kind": "ranger_echo", "distance_cm": 30, "at_s": 1, "for_s": 4},
                {"kind": "ranger_echo", "distance_cm": 12, "at_s": 2, "for_s": 1},
                {"kind": "ranger_echo", "distance_cm": 50, "at_s": 2, "for_s": 1},
                {"kind": "camera_black", "at_s": 2, "for_s": 1},
            ]
        }
    )
    found = [faults_of(scenario, t) for t in (0.5, 1.5, 2.5, 3.5)]

    assert found == [{}, {RangerFault.ECHO: 300.0}, {RangerFault.ECHO: 120.0}, {RangerFault.ECHO: 300.0}]


def test_it_sends_hello_first_then_a_measurement_every_60_ms() -> None:
    sent = events(run(board(standing(250.0), errors=PERFECT), 3 * S))
    assert sent[0] == Hello("hcsr04-sim", 1, 60, 1)
    assert sent[1:3] == [Measurement(0, 2912), Measurement(1, 2912)]
    assert len(sent) == 1 + 50


def test_bytes_leave_at_the_pace_of_the_wire() -> None:
    made = board(standing(250.0), errors=PERFECT)
    byte_ns = 10 * S // 9600
    hello = b"$HCI,hcsr04-sim,1,60,1*"
    assert made.advance(byte_ns - 1) == b""
    assert made.advance(byte_ns) == hello[:1]
    assert made.advance(5 * byte_ns) == hello[1:5]
    got = run(made, 60 * S, step_ns=997_003, start_ns=6 * byte_ns)
    gaps = [b[0] - a[0] for a, b in pairwise(got)]
    assert max(len(data) for _, data in got) == 1
    assert min(gaps) >= 997_003
    rate = 5 * 1000 + sum(len(data) for _, data in got)
    assert 24 * 1000 < rate < 36 * 1000  # 480 bytes a second of the wire's 960


def test_a_line_ends_its_wire_time_after_the_echo() -> None:
    made = board(standing(500.0), errors=PERFECT)
    ends = [t for t, data in run(made, 2 * S, step_ns=100_000) if b"\n" in data]
    length = len(b"$HCM,10,5824,5000,0*FFFF\r\n")
    expected = 600 * MS + 450_000 + ticks_of(500.0, 20.0) * 500 + length * (10 * S // 9600)
    assert min(abs(t - expected) for t in ends) <= 100_000


def test_hello_is_sent_every_five_seconds_and_on_request() -> None:
    made = board(standing(250.0))
    assert sum(isinstance(e, Hello) for e in events(run(made, 15 * S))) == 3
    made.hear(b"??x?", 15 * S)
    asked = events(run(made, 19 * S, start_ns=15 * S))
    assert sum(isinstance(e, Hello) for e in asked) == 1  # and the next one 5 s after it


def test_the_boot_loader_waits_and_hears_nothing() -> None:
    made = board(standing(250.0), boot_ns=2 * S)
    made.hear(b"?", S)
    assert run(made, 2 * S) == []
    said = events(run(made, 3 * S, start_ns=2 * S))
    assert [isinstance(e, Hello) for e in said[:3]] == [True, False, False]


def test_sequence_numbers_wrap() -> None:
    made = board(standing(250.0), air_c=-3.4)
    made._seq = 65_535
    assert [m.seq for m in measured(run(made, S))][:3] == [65_535, 0, 1]


def test_the_same_seed_gives_the_same_bytes_whatever_the_steps() -> None:
    def bytes_of(step_ns: int, seed: int = 9) -> bytes:
        made = board(lambda t: 900.0 - t / S * 50, seed=seed)
        return b"".join(data for _, data in run(made, 6 * S + 1, step_ns))

    whole = bytes_of(MS)
    assert bytes_of(7 * MS)[:2000] == whole[:2000]
    assert bytes_of(MS, seed=10) != whole


def test_a_stopped_process_loses_cycles_but_no_time() -> None:
    made = board(standing(250.0))
    run(made, S)
    after = measured([(0, made.advance(100 * S)), (0, made.advance(101 * S))])
    assert 1660 <= after[-1].seq <= 1684


@pytest.mark.parametrize(
    ("fault", "amount", "quality"),
    [
        (RangerFault.NO_ECHO, 0.0, Quality.NO_ECHO),
        (RangerFault.STUCK, 0.0, Quality.STUCK),
        (RangerFault.TOO_NEAR, 0.0, Quality.TOO_NEAR),
        (RangerFault.TOO_FAR, 0.0, Quality.TOO_FAR),
        (RangerFault.WILD, 2500.0, Quality.UNSTABLE),
        (RangerFault.WRONG_VERSION, 99.0, Quality.WRONG_VERSION),
        (RangerFault.SILENT, 0.0, Quality.STALE),
    ],
)
def test_each_fault_becomes_its_quality_and_passes(fault: RangerFault, amount: float, quality: Quality) -> None:
    made = board(standing(500.0), seed=1)
    said = heard_by_host(made, 9, lambda t: {fault: amount} if 3 * S <= t < 6 * S else {})
    before = [r for r in said if S < r.t_ns < 3 * S]
    during = [r for r in said if 4500 * MS < r.t_ns < 5900 * MS]
    after = [r for r in said if r.t_ns > 7500 * MS]
    assert {r.quality for r in before} == {Quality.GOOD}
    assert {r.quality for r in during} == {quality}
    assert len(during) >= 10
    assert {r.quality for r in after} == {Quality.GOOD}
    assert all(r.distance_mm is None for r in during)


def test_line_noise_damages_lines_but_makes_no_distance() -> None:
    made = board(standing(500.0), seed=1)
    said = heard_by_host(made, 60, lambda t: {RangerFault.LINE_NOISE: 0.03})
    distances = [r.distance_mm for r in said if r.distance_mm is not None]
    assert len(distances) > 200
    assert all(abs(mm - 500.0) <= 12.1 for mm in distances)
    assert said[-1].stats.damaged > 300
    assert said[-1].stats.gaps > 300


def test_scatter_widens_the_readings() -> None:
    made = board(standing(500.0), seed=1)
    made.faults = {RangerFault.SCATTER: 60.0}
    values = [distance_mm(m.ticks, 20.0) for m in measured(run(made, 20 * S)) if not m.flags]
    assert max(values) - min(values) > 150


def test_an_approach_is_followed_within_the_sensors_error() -> None:
    """52 to 25 cm at 3 cm/s, every reading against the truth at its own time."""

    def truth(t_ns: int) -> float:
        return 520.0 - 30.0 * t_ns / S

    said = heard_by_host(board(truth, seed=11), 9)
    good = [r for r in said if r.distance_mm is not None]
    assert len(good) > 140
    worst = max(abs(r.distance_mm - truth(r.t_ns)) for r in good if r.distance_mm is not None)
    assert worst <= 12.5
