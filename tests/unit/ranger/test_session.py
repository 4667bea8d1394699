"""The session: bytes and times in, dated readings with a quality out. No clock, no port."""

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.config import RangerConfig
from gateway.config.sections.ranger import Hcsr04Config
from gateway.core.readings import Quality, RangeReading
from gateway.ranger.arrival_times import Arrival
from gateway.ranger.hcsr04.protocol import (
    NO_FLAGS,
    Damage,
    Flags,
    Hello,
    Measurement,
    encode_hello,
    encode_measurement,
    frame,
)
from gateway.ranger.hcsr04.session import Hcsr04Session, distance_mm, speed_of_sound_m_s
from tests.examples import examples

MS = 1_000_000
S = 1000 * MS
T0 = 77 * S
BYTE_NS = S * 10 // 9600
HELLO = encode_hello(Hello("uno", 1, 60, 2))
OTHER = encode_hello(Hello("uno", 2))


def ticks(mm: float, air_c: float = 20.0) -> int:
    return round(2 * mm / (331.3 + 0.606 * air_c) / 1000 / 0.5e-6)


class Bench:
    """A session with a ranger that keeps its 60 ms and a wire that takes no more than its time."""

    def __init__(self, **config: Any) -> None:
        self.session = Hcsr04Session(RangerConfig(**config))
        self.now_ns = T0
        self.seq = 0
        self.readings: list[RangeReading] = self.session.opened(T0)

    def receives(self, line: bytes) -> list[RangeReading]:
        return self._keep(self.session.feed(line, self.now_ns))

    def measures(self, mm: float | None, flags: Flags = NO_FLAGS, **message: Any) -> list[RangeReading]:
        """One cycle later: one line, complete when it arrives."""
        self.now_ns += 60 * MS
        line = encode_measurement(Measurement(self.seq, 0 if mm is None else ticks(mm), flags, **message))
        self.seq = (self.seq + 1) & 0xFFFF
        return self.receives(line)

    def waits(self, ms: int) -> list[RangeReading]:
        """Nothing comes, though the ranger counts on; the owner ticks every 100 ms."""
        readings: list[RangeReading] = []
        self.seq = (self.seq + ms // 60) & 0xFFFF
        for _ in range(ms // 100):
            self.now_ns += 100 * MS
            readings += self._keep(self.session.tick(self.now_ns))
        return readings

    def skips(self, cycles: int) -> None:
        self.now_ns += cycles * 60 * MS
        self.seq = (self.seq + cycles) & 0xFFFF

    def _keep(self, readings: list[RangeReading]) -> list[RangeReading]:
        self.readings += readings
        return readings


def settled(mm: float = 500.0, **config: Any) -> Bench:
    """A bench whose session is live, its median full of `mm`."""
    bench = Bench(**config)
    bench.receives(HELLO)
    for _ in range(6):
        bench.measures(mm)
    assert bench.readings[-1].quality is Quality.GOOD
    return bench


def qualities(readings: list[RangeReading]) -> list[Quality]:
    return [r.quality for r in readings]


# -- distance and date ------------------------------------------------------------------------------------------------


def test_speed_of_sound_and_equation_12() -> None:
    assert speed_of_sound_m_s(20.0) == pytest.approx(343.42)
    assert distance_mm(2912, 20.0) == pytest.approx(250.01, abs=0.005)
    assert distance_mm(6057, 10.0) - distance_mm(6057, 20.0) == pytest.approx(-9.18, abs=0.01)  # 10 K at 52 cm


@pytest.mark.parametrize("mm", [20.1, 250.0, 520.0, 3999.9])
def test_a_distance_comes_through_within_a_tick(mm: float) -> None:
    (reading,) = settled(mm).measures(mm)
    assert reading.quality is Quality.GOOD
    assert reading.distance_mm == pytest.approx(mm, abs=0.05)


def test_the_configured_temperature_is_used_unless_the_ranger_measures_it() -> None:
    bench = settled(median=1, hcsr04=Hcsr04Config(temperature_c=30.0))
    (reading,) = bench.measures(500.0)
    assert reading.distance_mm == pytest.approx(500.0 * speed_of_sound_m_s(30) / 343.42, abs=0.05)
    (reading,) = bench.measures(500.0, temperature_dc=-95)
    assert reading.distance_mm == pytest.approx(500.0 * speed_of_sound_m_s(-9.5) / 343.42, abs=0.05)


@pytest.mark.parametrize(
    ("measured_dc", "believed_c"), [(850, 20), (-400, 20), (600, 60), (601, 20), (-200, -20), (-201, 20)]
)
def test_a_broken_thermometer_bends_no_distance(measured_dc: int, believed_c: float) -> None:
    """85 is what a DS18B20 reports after power on: 300 mm would read 334 mm, and stop would be late."""
    bench = settled(300.0, median=1)
    (reading,) = bench.measures(300.0, temperature_dc=measured_dc)
    assert reading.distance_mm == pytest.approx(300.0 * speed_of_sound_m_s(believed_c) / 343.42, abs=0.05)
    assert bench.session.implausible_temperatures == (measured_dc != believed_c * 10)


def losses(bench: Bench, cycles: int, temperature_dc: int | None) -> list[bool]:
    return [bench.measures(300.0, temperature_dc=temperature_dc)[0].temperature_lost for _ in range(cycles)]


@pytest.mark.parametrize("lost_dc", [None, 850])
def test_a_temperature_that_is_measured_no_more_is_lost_after_5_s_and_the_distance_goes_back_slowly(
    lost_dc: int | None,
) -> None:
    bench = settled(300.0, median=1)
    (warm,) = bench.measures(300.0, temperature_dc=400)
    assert (warm.air_c, warm.temperature_lost) == (40.0, False)
    assert warm.distance_mm == pytest.approx(300 * 355.54 / 343.42, abs=0.05)
    (fallen_back,) = bench.measures(300.0, temperature_dc=lost_dc)
    assert fallen_back.air_c is None
    assert fallen_back.distance_mm == pytest.approx(300 * 355.52 / 343.42, abs=0.05)  # 0.5 K a second: 39.97 °C
    assert losses(bench, 84, lost_dc) == [False] * 82 + [True] * 2  # of 60 ms
    losses(bench, 582, lost_dc)  # 40 s for 20 K
    mm = [reading.distance_mm for reading in bench.readings[-600:] if reading.distance_mm is not None]
    assert max(a - b for a, b in pairwise(mm)) < 0.06  # less than 1 mm a second, which would be a truck that rolls
    assert mm[-1] == pytest.approx(300, abs=0.05)
    assert losses(bench, 2, 400) == [False] * 2
    assert bench.session.tick(bench.now_ns + 2 * S)[0].temperature_lost is False  # nothing is known of it


@pytest.mark.parametrize(("before_dc", "then_dc"), [(None, -100), (-100, None)])
@pytest.mark.parametrize("between", ["nothing", "gap", "reboot", "port reopened"])
def test_no_temperature_that_comes_late_or_goes_makes_the_distance_jump(
    between: str, before_dc: int | None, then_dc: int | None
) -> None:
    """1100 mm at -10 instead of 20 °C is 1042 mm: the truck would seem to have driven 58 mm."""
    bench = settled(1100.0, median=1)
    for _ in range(100):
        (before,) = bench.measures(1100.0, temperature_dc=before_dc)
    if between != "nothing":
        bench.skips(1000)  # 60 s
    if between == "port reopened":
        bench.session.lost(bench.now_ns, "pulled")
        bench.session.opened(bench.now_ns)
    if between in ("reboot", "port reopened"):
        bench.seq = 0
        bench.receives(HELLO)
    found = [reading for _ in range(6) for reading in bench.measures(1100.0, temperature_dc=then_dc)]
    mm = [one.distance_mm for one in (before, *found) if one.distance_mm is not None]
    assert len(mm) >= 4
    assert max(abs(a - b) for a, b in pairwise(mm)) < 1.2  # 0.5 K is 1 mm


def test_one_that_never_came_is_missed_only_where_it_is_configured() -> None:
    assert not any(losses(settled(300.0), 200, None))
    assert not any(losses(settled(300.0), 200, 850))
    configured = {"hcsr04": Hcsr04Config(temperature_sensor=True)}
    bench = settled(300.0, **configured)
    assert losses(bench, 80, None) == [False] * 77 + [True] * 3  # 5 s since the port was opened, six lines before
    bench.session.opened(bench.now_ns)
    bench.seq = 0
    bench.receives(HELLO)
    after = [reading.temperature_lost for _ in range(90) for reading in bench.measures(300.0)]
    assert (after[0], after[-1], after.count(True)) == (False, True, 7)  # a reset: the sensor has time to convert


def test_a_reading_is_dated_back_to_the_echo() -> None:
    bench = settled(500.0, median=1)
    trigger_ns = bench.now_ns + 7 * MS
    line = encode_measurement(Measurement(bench.seq, ticks(500.0)))
    flight_ns = ticks(500.0) * 500
    fell_ns = trigger_ns + 450_000 + flight_ns
    (reading,) = bench.session.feed(line, fell_ns + len(line) * BYTE_NS + 1 * MS)
    assert reading.t_ns == fell_ns - flight_ns // 2


def test_what_follows_in_the_same_delivery_was_later_on_the_wire() -> None:
    alone, together = settled(500.0, median=1), settled(500.0, median=1)
    (a,) = alone.measures(500.0)
    together.now_ns += 60 * MS
    line = encode_measurement(Measurement(together.seq, ticks(500.0)))
    (b,) = together.receives(line + b"$HCM,12")
    assert a.t_ns - b.t_ns == 7 * BYTE_NS
    slow = Hcsr04Session(RangerConfig(baud=1200))
    assert slow._byte_ns == 8 * BYTE_NS + 5


def test_the_median_keeps_value_and_date_together_on_a_moving_target() -> None:
    bench = Bench()
    bench.receives(HELLO)
    for n in range(20):
        bench.measures(1000.0 - 12.0 * n)
    good = [r for r in bench.readings if r.distance_mm is not None]
    assert len(good) == 17  # two lines for the pace, one held back by the gate
    for reading in good:
        line_ns = 29 * BYTE_NS + 1 * MS
        cycles = (reading.t_ns + line_ns - T0) / (60 * MS) - 1  # in which cycle the sound was under way
        assert reading.distance_mm == pytest.approx(1000.0 - 12.0 * cycles, abs=1.5)
    assert bench.now_ns - good[-1].t_ns == pytest.approx(60 * MS + 31 * MS, abs=2 * MS)


def test_dates_never_step_back_and_never_lie_ahead() -> None:
    bench = settled()
    for n in range(200):
        bench.measures(500.0 + 300 * (n % 37 == 5), Flags.NO_ECHO if n % 23 == 0 else NO_FLAGS)
        if n % 41 == 0:
            bench.skips(2)
    dates = [r.t_ns for r in bench.readings if r.quality is not Quality.WAITING]
    assert dates == sorted(dates)
    assert dates[-1] < bench.now_ns


# -- quality ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mm", "flags", "quality"),
    [
        (None, Flags.NO_ECHO, Quality.NO_ECHO),
        (None, Flags.NO_RISING_EDGE, Quality.STUCK),
        (None, Flags.STUCK_HIGH, Quality.STUCK),
        (500, Flags.STUCK_HIGH | Flags.NO_ECHO, Quality.STUCK),
        (12, Flags.TOO_NEAR, Quality.TOO_NEAR),
        (4200, Flags.TOO_FAR, Quality.TOO_FAR),
        (500, Flags.NO_ECHO, Quality.NO_ECHO),
        (None, NO_FLAGS, Quality.TOO_NEAR),  # a firmware that forgets its flag: never a distance of 0
        (19.8, NO_FLAGS, Quality.TOO_NEAR),
        (4000.5, NO_FLAGS, Quality.TOO_FAR),
        (33_000, NO_FLAGS, Quality.TOO_FAR),  # the 3300 cm of clones
    ],
)
def test_a_fault_is_a_quality_and_never_a_distance(mm: float | None, flags: Flags, quality: Quality) -> None:
    bench = settled(30.0 if mm and mm < 100 else 500.0)
    assert bench.measures(mm, flags) == []  # one is ridden out: the last value ages
    for _ in range(3):
        (reading,) = bench.measures(mm, flags)
        assert reading.quality is quality
        assert reading.distance_mm is None
    assert reading.seq == bench.seq - 1


def test_a_fault_is_reported_at_once_where_there_is_nothing_to_ride_on() -> None:
    bench = Bench()
    bench.receives(HELLO)
    for _ in range(2):
        bench.measures(None, Flags.NO_ECHO)
    assert qualities(bench.measures(None, Flags.NO_ECHO)) == [Quality.NO_ECHO]
    plain = settled(glitch_gate_mm=0)
    assert qualities(plain.measures(None, Flags.NO_ECHO)) == [Quality.NO_ECHO]
    assert qualities(plain.measures(500)) == [Quality.GOOD]


def test_one_glitch_never_shows_and_is_counted() -> None:
    bench = settled(500.0)
    rejected = bench.session.stats.rejected
    assert bench.measures(3000.0) == []
    (reading,) = bench.measures(500.0)
    assert reading.distance_mm == pytest.approx(500.0, abs=0.05)
    assert reading.stats.rejected == rejected + 1


def test_alternating_values_are_unstable() -> None:
    bench = settled(500.0)
    for _ in range(3):
        bench.measures(2500.0)
        bench.measures(500.0)
    for _ in range(5):
        assert qualities(bench.measures(2500.0) + bench.measures(500.0)) == [Quality.UNSTABLE] * 2
    assert bench.readings[-1].distance_mm is None


@pytest.mark.parametrize("between", ["gap", "fault", "silence", "reboot"])
def test_the_median_never_mixes_across_a_break(between: str) -> None:
    bench = settled(500.0, median=5)
    match between:
        case "gap":
            bench.skips(1)
        case "fault":
            bench.measures(None, Flags.NO_ECHO)
        case "silence":
            bench.waits(2000)
            bench.measures(600.0)  # held back: too long ago to be compared
        case _:
            bench.now_ns += 3 * S
            bench.seq = 0
            bench.receives(HELLO)
            for _ in range(3):  # two for the pace, one for the gate
                assert bench.measures(600.0) == []
    (reading,) = bench.measures(600.0)
    assert reading.distance_mm == pytest.approx(600.0, abs=0.05)


# -- version and hello -------------------------------------------------------------------------------------------------


def test_nothing_is_believed_before_the_hello() -> None:
    bench = Bench()
    for _ in range(20):
        assert bench.measures(500.0) == []
    (waiting,) = bench.waits(100)
    assert waiting.quality is Quality.WAITING
    assert waiting.detail == "waiting for the ranger's hello"
    bench.receives(HELLO)
    bench.skips(1)
    bench.measures(500.0)
    assert qualities(bench.measures(500.0)) == [Quality.GOOD]


def test_another_version_gives_no_distance_until_a_right_hello() -> None:
    bench = settled()
    (reading,) = bench.receives(OTHER)
    assert (reading.quality, reading.distance_mm) == (Quality.WRONG_VERSION, None)
    assert reading.detail == "uno uses protocol version 2, this gateway 1"
    for _ in range(10):
        bench.measures(500.0)
    assert set(qualities(bench.readings[-5:])) == {Quality.WRONG_VERSION}
    assert qualities(bench.waits(300)) == [Quality.WRONG_VERSION] * 3  # reported again, for lines it cannot read
    bench.skips(5)
    bench.receives(HELLO)
    bench.measures(500.0)
    assert qualities(bench.measures(500.0)) == [Quality.GOOD]


def test_another_version_that_falls_silent_is_not_reported_for_ever() -> None:
    bench = Bench()
    bench.receives(OTHER)
    found = bench.waits(8000)
    assert found[59].quality is Quality.WRONG_VERSION
    assert found[-1].quality is Quality.STALE


def test_troubles_are_repeated_ten_times_a_second_and_no_faster() -> None:
    bench = Bench()
    bench.receives(OTHER)
    found = [r for n in range(1000) for r in bench.session.feed(OTHER, T0 + n * MS)]
    assert len(found) == 9


def test_a_hello_is_requested_at_opening_and_while_it_is_missing() -> None:
    bench = Bench()
    ask = bench.session.request
    assert ask(T0) == b"?"
    assert not ask(T0 + 999 * MS)
    assert ask(T0 + S) == b"?"
    bench.receives(HELLO)
    bench.now_ns = T0 + S
    bench.measures(500.0)
    assert not ask(T0 + 2 * S)
    assert ask(bench.now_ns + S) == b"?"  # silence
    assert not ask(bench.now_ns + S + 1)


def test_the_identity_is_that_of_the_newest_hello_of_this_connection() -> None:
    bench = Bench()
    assert bench.session.identity == ""
    bench.receives(encode_hello(Hello("uno", 1, 60, 8)))
    assert bench.session.identity == "uno, protocol version 1, a measurement every 60 ms, last reset: watchdog"
    bench.receives(OTHER)
    assert bench.session.identity == "uno, protocol version 2"
    bench.session.opened(bench.now_ns)
    assert bench.session.identity == ""


# -- gaps, silence, backlog -------------------------------------------------------------------------------------------


@pytest.mark.failure_mode("R11")
def test_a_reboot_is_no_gap() -> None:
    bench = settled()
    bench.now_ns += 2 * S
    bench.seq = 0
    bench.receives(HELLO)
    for _ in range(12):
        bench.measures(500.0)
    assert bench.session.stats.gaps == 0
    assert bench.session.reboots == 1
    assert bench.readings[-1].quality is Quality.GOOD


def test_the_hello_of_every_five_seconds_changes_nothing() -> None:
    bench = settled()
    for n in range(100):
        if n % 10 == 0:
            assert bench.receives(HELLO) == []
        assert qualities(bench.measures(500.0)) == [Quality.GOOD]
    assert (bench.session.reboots, bench.session.stats.gaps) == (0, 0)


def test_the_hello_sets_the_pace() -> None:
    """A ranger of 300 ms a cycle: its lines are not late, and the gate remembers five of its cycles."""
    session, readings = Hcsr04Session(RangerConfig(median=1)), []
    session.feed(encode_hello(Hello("slow", 1, 300, 1)), T0)
    for n in range(12):
        seq = n if n < 9 else n + 2  # two lines lost
        readings += session.feed(encode_measurement(Measurement(seq, ticks(500.0))), T0 + seq * 300 * MS)
    assert qualities(readings) == [Quality.GOOD] * 9
    assert session.unused == {Arrival.BACKLOG: 2}
    assert session.stats.gaps == 2


def test_silence_is_reported_after_a_second_and_repeated() -> None:
    bench = settled()
    found = bench.waits(1500)
    assert [(r.quality, r.t_ns - bench.now_ns) for r in found] == [
        (Quality.STALE, -(500 - 100 * n) * MS) for n in range(6)
    ]
    assert found[0].detail == "nothing received for 1 s"


def test_an_uno_may_boot_for_two_seconds_after_opening() -> None:
    bench = Bench()
    assert set(qualities(bench.waits(1900))) == {Quality.WAITING}
    (reading,) = bench.waits(100)
    assert reading.quality is Quality.STALE


@pytest.mark.failure_mode("R14")
def test_bytes_without_lines_hint_at_the_baud_rate() -> None:
    bench = Bench()
    for _ in range(30):
        bench.waits(100)
        bench.receives(bytes(range(128, 228)))
    assert "wrong baud rate" in bench.readings[-1].detail
    assert bench.session.damage == {Damage.NOISE: 45}  # runs of 64, but for the first
    assert bench.session.stats.damaged == 45


def test_a_hello_without_measurements_is_silence() -> None:
    bench = settled()
    for _ in range(20):
        bench.waits(100)
        bench.receives(HELLO)
    assert bench.readings[-1].quality is Quality.STALE
    assert bench.readings[-1].detail == "no measurement for 2 s"


def test_a_stale_backlog_after_opening_is_never_dated_as_fresh() -> None:
    bench = Bench()
    old = b"".join(encode_measurement(Measurement(n, ticks(300.0))) for n in range(500))
    assert bench.receives(old[17:9000]) == []  # what a serial server had stored, in one piece ...
    assert bench.receives(old[9000:] + HELLO) == []  # ... or two
    bench.seq = 900
    bench.now_ns -= 40 * MS
    assert bench.measures(500.0) == []  # 20 ms after the burst
    assert bench.measures(500.0) == []
    assert bench.measures(500.0) == []  # the gate wants a second one
    (reading,) = bench.measures(500.0)
    assert reading.distance_mm == pytest.approx(500.0, abs=0.05)
    assert bench.session.unused[Arrival.BACKLOG] == 2  # the rest came before the hello
    assert bench.session.stats.gaps == 0


@pytest.mark.failure_mode("R12")
def test_a_stalled_network_gives_no_old_distance() -> None:
    bench = settled(500.0)
    burst = b"".join(encode_measurement(Measurement(bench.seq + n, ticks(300.0))) for n in range(50))
    bench.now_ns += 3 * S
    bench.seq += 50
    found = bench.receives(burst)
    assert all(bench.now_ns - r.t_ns < 250 * MS for r in found)
    assert [r.distance_mm for r in found] == [pytest.approx(300.0, abs=0.05)] * 4  # and nothing of before the stall
    assert bench.session.unused[Arrival.BACKLOG] == 47


def test_counters_outlive_connections() -> None:
    bench = settled()
    lines = bench.session.stats.lines
    down = bench.session.lost(bench.now_ns, "pulled")
    assert (down.quality, down.detail, down.stats.rate_hz) == (Quality.LINK_DOWN, "pulled", 0.0)
    (waiting,) = bench.session.opened(bench.now_ns + S)
    assert waiting.quality is Quality.WAITING
    assert (waiting.stats.lines, waiting.stats.reopens) == (lines, 1)
    assert bench.session.hello is None


def test_rate_is_that_of_the_last_second() -> None:
    bench = settled()
    for _ in range(30):
        bench.measures(500.0)
    assert bench.readings[-1].stats.rate_hz == pytest.approx(1000 / 60)
    for _ in range(12):
        bench.skips(1)
        bench.measures(500.0)
    assert bench.readings[-1].stats.rate_hz == pytest.approx(1000 / 120)
    bench.waits(2000)
    assert bench.readings[-1].stats.rate_hz == 0.0


def test_damaged_lines_are_counted_and_cost_only_themselves() -> None:
    bench = settled()
    bench.receives(b"$HCM,1,2,3\r\n")
    bench.receives(frame(b"HCM,1,2000,3,0"))
    assert bench.session.stats.damaged == 2
    assert bench.session.damage == {Damage.NO_CHECKSUM: 1, Damage.MISMATCH: 1}
    assert qualities(bench.measures(500.0)) == [Quality.GOOD]


# -- anything ---------------------------------------------------------------------------------------------------------

wire = st.one_of(
    st.binary(max_size=40),
    st.just(HELLO),
    st.just(OTHER),
    st.builds(
        Measurement, st.integers(0, 0xFFFF), st.integers(0, 60_000), st.sampled_from((0, 0, 0, 1, 16)).map(Flags)
    ).map(encode_measurement),
)


@pytest.mark.long
@pytest.mark.one_interpreter
@settings(max_examples=examples(150))
@given(st.lists(st.tuples(wire, st.integers(0, 2 * S), st.booleans()), max_size=40))
@pytest.mark.failure_mode("R7")
def test_whatever_comes_a_distance_is_good_recent_and_possible(steps: list[tuple[bytes, int, bool]]) -> None:
    session, now_ns = Hcsr04Session(RangerConfig()), T0
    for data, wait_ns, tick in steps:
        now_ns += wait_ns
        readings = session.feed(data, now_ns) + (session.tick(now_ns) if tick else [])
        for r in readings:
            assert (r.distance_mm is not None) == (r.quality is Quality.GOOD)
            assert r.distance_mm is None or 20 <= r.distance_mm <= 4000
            assert r.t_ns <= now_ns


@pytest.mark.one_interpreter
@given(st.lists(st.integers(1, 30)), st.integers(0, 3))
def test_how_the_bytes_are_cut_changes_no_value(cuts: list[int], glitch: int) -> None:
    """Dates may differ by a few bytes, values and qualities not."""

    def run(cut: list[int]) -> list[tuple[Quality, float | None, int]]:
        session, out, now_ns = Hcsr04Session(RangerConfig()), [], T0
        session.opened(now_ns)
        for n in range(12):
            now_ns += 60 * MS
            mm = 3000.0 if n == 5 + glitch else 500.0 + n
            line = (HELLO if n == 0 else b"") + encode_measurement(Measurement(n, ticks(mm)))
            at = 0
            for size in [*cut, len(line)]:
                part = line[at : at + size]
                at += size
                left_ns = max(0, len(line) - at) * BYTE_NS
                out += session.feed(part, now_ns - left_ns)
        return [(r.quality, r.distance_mm, r.seq) for r in out]

    assert run(cuts) == run([])
