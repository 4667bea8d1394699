"""Glitch gate and median, on the sequences real sensors produce."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.config import RangerConfig
from gateway.core.readings import Quality
from gateway.ranger.conditioning import Conditioner, GlitchGate, MedianFilter, ReadingVerdict

MS = 1_000_000
P, H, U = ReadingVerdict.PASS, ReadingVerdict.HOLD, ReadingVerdict.UNSTABLE
FAULT = None


def verdicts(readings: list[float | None], gate: GlitchGate | None = None, cycle_ms: int = 60) -> list[ReadingVerdict]:
    gate = gate or GlitchGate(150.0, 300 * MS)
    out = []
    for n, mm in enumerate(readings):
        t_ns = n * cycle_ms * MS
        out.append(gate.fault(t_ns) if mm is None else gate.distance(mm, t_ns))
    return out


@pytest.mark.parametrize(
    ("readings", "expected"),
    [
        ([500, 502, 498], [H, P, P]),  # the first one has nothing to be compared with
        ([500, 502, 900, 504, 505], [H, P, H, P, P]),  # one glitch
        ([500, 502, 900, 905, 910], [H, P, H, P, P]),  # a jump, confirmed
        ([500, 502, 652, 802], [H, P, P, P]),  # exactly the gate is let pass
        ([500, 502, 652.1, 500], [H, P, H, P]),
        ([500, 502, 900, 2000, 503], [H, P, H, U, P]),  # two odd ones that contradict each other
        ([500, 502, 900, 2000, 2010], [H, P, H, U, P]),  # ... and the second is confirmed
        ([500, 2000, 500, 2000, 500], [H, U, U, U, U]),  # which is true is not known
        ([500, 500, FAULT, 500, 500], [H, P, H, P, P]),  # one lost echo is ridden out
        ([500, 500, FAULT, FAULT, FAULT], [H, P, H, P, P]),  # a second one is reported
        ([500, 500, FAULT, FAULT, 500, 500], [H, P, H, P, H, P]),  # afterwards two must agree again
        ([500, 500, FAULT, 900, 900], [H, P, H, U, P]),
        ([500, 500, 900, FAULT, 500], [H, P, H, P, H]),
        ([FAULT, FAULT], [P, P]),  # nothing to ride on: reported at once
        ([500, FAULT, 500, FAULT], [H, P, H, P]),
    ],
)
def test_one_odd_reading_is_held_back(readings: list[float | None], expected: list[ReadingVerdict]) -> None:
    assert expected == verdicts(readings)


def test_alternating_clones_become_unstable_and_recover() -> None:
    got = verdicts([500, 500, *[2500, 500] * 6, *[500] * 9])
    assert got[:6] == [H, P, H, P, H, P]
    assert got[6:16] == [U] * 10  # until fewer than three of the last eight were odd
    assert got[16:] == [P] * 7


def test_an_echo_lost_every_other_time_is_reported() -> None:
    got = verdicts([500, 500, *[FAULT, 500] * 4])
    assert got[:6] == [H, P, H, P, H, P]
    assert P is got[6]  # the third: "no echo" is reported
    assert H is got[7]  # and one echo is not enough to take it back


def test_a_distance_is_only_compared_with_recent_ones() -> None:
    gate = GlitchGate(150.0, 300 * MS)
    assert [gate.distance(500, 0), gate.distance(500, 60 * MS)] == [H, P]
    assert P is gate.distance(500, 360 * MS)
    assert H is gate.distance(500, 661 * MS)


def test_gate_of_zero_lets_everything_pass() -> None:
    assert verdicts([500, 2000, FAULT, 20, 500, FAULT], GlitchGate(0.0, 300 * MS)) == [P] * 6


def test_reset_forgets_the_level() -> None:
    gate = GlitchGate(150.0, 300 * MS)
    assert [gate.distance(500, 0), gate.distance(500, 60 * MS)] == [H, P]
    gate.reset()
    assert H is gate.distance(500, 120 * MS)


@given(st.lists(st.none() | st.floats(20, 4000), max_size=60))
def test_no_passed_distance_is_far_from_both_its_neighbours(readings: list[float | None]) -> None:
    """What passes agrees with a reading of the last five cycles."""
    got = verdicts(readings)
    for n, (mm, verdict) in enumerate(zip(readings, got, strict=True)):
        if mm is not None and verdict is P:
            assert any(other is not None and abs(other - mm) <= 150 for other in readings[max(0, n - 5) : n])


# -- median -----------------------------------------------------------------------------------------------------------


def test_median_and_the_time_it_belongs_to() -> None:
    median = MedianFilter(3)
    assert median.push(10.0, 100) == (10.0, 100)
    assert median.push(12.0, 200) == (11.0, 150)
    assert median.push(90.0, 300) == (12.0, 200)
    assert median.push(13.0, 400) == (13.0, 300)
    assert median.push(14.0, 500) == (14.0, 400)


def test_median_adds_no_error_on_a_moving_target_only_age() -> None:
    for size, delay in ((1, 0), (3, 1), (5, 2), (15, 7)):
        median = MedianFilter(size)
        for n in range(40):
            value, t_ns = median.push(1000.0 - 3.0 * n, n)
            assert pytest.approx(1000.0 - 3.0 * t_ns, abs=1.5) == value
            if n >= size:
                assert n - delay == t_ns
                assert 1000.0 - 3.0 * t_ns == value


def test_reset_empties_the_window() -> None:
    median = MedianFilter(5)
    assert median.oldest_ns is None
    for n in range(5):
        median.push(100.0, n)
    median.reset()
    assert median.push(300.0, 9) == (300.0, 9)
    assert median.oldest_ns == 9


@given(st.lists(st.floats(20, 4000), min_size=1, max_size=40), st.sampled_from((1, 3, 5, 15)))
def test_median_is_one_of_the_window_and_its_time_never_steps_back(values: list[float], size: int) -> None:
    median, last_ns = MedianFilter(size), -1
    for n, value in enumerate(values):
        window = values[max(0, n + 1 - size) : n + 1]
        mm, t_ns = median.push(value, n)
        assert min(window) <= mm <= max(window)
        assert len(window) % 2 == 0 or mm in window
        assert last_ns <= t_ns <= n
        last_ns = t_ns


def test_a_distance_comes_with_its_newest_echo() -> None:
    conditioner = Conditioner(RangerConfig(glitch_gate_mm=0), 60)
    readings = [conditioner.measured(mm, Quality.GOOD, n, n) for n, mm in enumerate((300.0, 310.0, 290.0, 305.0))]
    assert [(r.distance_mm, r.echo_mm) for (r,) in readings] == [(300, 300), (305, 310), (300, 290), (305, 305)]
    (lost,) = conditioner.measured(0.0, Quality.NO_ECHO, 5, 5)
    assert (lost.distance_mm, lost.echo_mm) == (None, None)
