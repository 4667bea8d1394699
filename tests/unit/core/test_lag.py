"""How late a vehicle follows and stands, what is known of its movement, and the guard's numbers: each by hand."""

from dataclasses import replace

import pytest

from gateway.config import DriveConfig
from gateway.core import lag, movement, stopping_way
from gateway.core.movement import Cut, DriveMemory, Movement, Told
from gateway.core.setpoint_history import SetpointHistory

MS = 1_000_000
T0 = 1_000_000_000_000
CONFIG = DriveConfig(latency_s=0.3)  # 0.8 s are its longest delay, 30 mm/s its creep speed, 150 mm/s2 its brake
LATE_S = 0.3  # of the vehicle below


def set_to(*speeds: tuple[int, float]) -> SetpointHistory:
    """Each for so many ms, in steps of 20 ms."""
    history, now_ns = SetpointHistory(T0), T0
    for lasts_ms, speed_mm_s in speeds:
        for _ in range(lasts_ms // 20):
            now_ns += 20 * MS
            history = history.advanced(now_ns, speed_mm_s, 1e9, CONFIG.delay_s)
    return history


def falling(until_ms: int) -> SetpointHistory:
    """200 mm/s for 2 s, then less by 2 mm/s each 20 ms."""
    return set_to((2000, 200.0), *((20, 200.0 - 2.0 * n) for n in range(1, (until_ms - 2000) // 20 + 1)))


def begun(at_ms: int, until_ms: int, **memory: object) -> DriveMemory:
    """The lag is measured since `at_ms`, of a vehicle that is 300 ms late and was 1000 mm away then."""
    set_then_mm_s = 200.0 - 2.0 * ((at_ms - 2000) // 20)
    fields = {"speed_mm_s": 200.0 - 2.0 * ((until_ms - 2000) // 20), "peak_mm_s": 200.0, "peak_ns": T0 + 2000 * MS}
    given = {"history": falling(until_ms), "begun": (T0 + at_ms * MS, 1000.0, set_then_mm_s), **fields, **memory}
    return DriveMemory(**given)  # type: ignore[arg-type]


def seen(memory: DriveMemory, from_ms: int, to_ms: int) -> Movement:
    gone_mm = memory.history.moved_mm(T0 + from_ms * MS, T0 + to_ms * MS, LATE_S)
    return Movement(T0 + to_ms * MS, 1000.0 - gone_mm, excess_mm_s=5.0)


def test_a_vehicle_counts_as_late_as_the_longest_delay_until_it_was_measured() -> None:
    assert lag.lag_s(DriveMemory(), CONFIG) == 0.8
    assert lag.lag_s(DriveMemory(lag_s=0.3), CONFIG) == 0.3


@pytest.mark.parametrize(
    ("memory", "slip_s"),
    [
        (DriveMemory(), 0.8),  # nothing was measured
        (DriveMemory(slips_s=(0.1,)), 0.8),
        (DriveMemory(lag_s=0.4, peak_mm_s=30.0), 0.4),  # never faster than creep speed: a drive corrects its speed
        (DriveMemory(lag_s=0.4), 0.34),  # 0.85 of it
        (DriveMemory(lag_s=0.4, peak_mm_s=30.1), 0.34),
        (DriveMemory(lag_s=0.4, peak_mm_s=200.0, slips_s=(0.31, 0.39, 0.35)), 0.35),
        (DriveMemory(lag_s=0.4, peak_mm_s=200.0, slips_s=(0.1, 0.1, 0.39)), 0.3),  # not less than 0.75 of it
        (DriveMemory(lag_s=0.4, peak_mm_s=200.0, slips_s=(0.7, 0.6, 0.1)), 0.4),  # nor more than it
    ],
)
def test_how_late_it_stands_is_the_middle_of_what_was_learned_within_limits(memory: DriveMemory, slip_s: float) -> None:
    assert lag.slip_s(memory, CONFIG) == pytest.approx(slip_s)


def test_the_lag_is_measured_over_a_fall_of_60_mm_s_and_then_averaged() -> None:
    memory = begun(2500, 3100)
    found = seen(memory, 2500, 3100)
    after = lag.measured(memory, found, CONFIG)
    assert after.lag_s == pytest.approx(LATE_S, abs=0.002)
    assert after.begun == (found.t_ns, found.distance_mm, memory.speed_mm_s)
    assert after.movement is not None
    # What acts is not the 170 mm/s of 0.8 s ago but the 120 mm/s of 0.3 s ago: as much more is the vehicle's own.
    acting_mm_s = [memory.history.acting_mm_s(s) for s in (CONFIG.delay_s, LATE_S)]
    assert acting_mm_s == pytest.approx([170.0, 120.0], abs=5.0)
    assert after.movement.excess_mm_s == pytest.approx(5.0 + acting_mm_s[0] - acting_mm_s[1], abs=0.5)
    assert replace(after.movement, excess_mm_s=5.0) == found
    again = lag.measured(replace(memory, lag_s=0.5), found, CONFIG)
    assert again.lag_s == pytest.approx((0.5 + LATE_S) / 2, abs=0.002)


@pytest.mark.parametrize("fell_mm_s", [59.0, 60.0])
def test_a_smaller_fall_is_waited_for(fell_mm_s: float) -> None:
    memory = begun(2500, 3100)
    memory = replace(memory, begun=(T0 + 2500 * MS, 1000.0, memory.speed_mm_s + fell_mm_s))
    after = lag.measured(memory, seen(memory, 2500, 3100), CONFIG)
    assert (after is memory) == (fell_mm_s < 60.0)


@pytest.mark.parametrize(("age_ms", "begins"), [(399, False), (400, True)])
def test_a_measurement_begins_half_the_longest_delay_after_the_setpoint_was_near_its_peak(
    age_ms: int, *, begins: bool
) -> None:
    memory = replace(begun(2500, 3100), begun=None, peak_ns=T0 + (3100 - age_ms) * MS)
    found = seen(memory, 2500, 3100)
    assert (lag.measured(memory, found, CONFIG).begun is not None) == begins
    before = (found.t_ns - 100 * MS, 1000.0, memory.speed_mm_s)
    assert lag.measured(replace(memory, begun=before), found, CONFIG).begun == (before if begins else None)


def test_a_setpoint_of_0_ends_a_measurement() -> None:
    memory = begun(2500, 3100)
    found = seen(memory, 2500, 3100)
    assert lag.measured(replace(memory, speed_mm_s=0.0), found, CONFIG).begun is None
    ended = replace(memory, speed_mm_s=0.0, begun=None)
    assert lag.measured(ended, found, CONFIG) is ended


@pytest.mark.parametrize(("age_ms", "kept"), [(3000, True), (3001, False)])
def test_a_measurement_that_began_3_s_ago_begins_anew(age_ms: int, *, kept: bool) -> None:
    memory = begun(2500, 3100)
    old = (T0 + (3100 - age_ms) * MS, 1000.0, memory.speed_mm_s + 10.0)
    found = seen(memory, 2500, 3100)
    after = lag.measured(replace(memory, begun=old), found, CONFIG)
    assert after.begun == (old if kept else (found.t_ns, found.distance_mm, memory.speed_mm_s))
    assert after.lag_s is None


def test_a_way_that_no_delay_explains_measures_nothing() -> None:
    """500 mm in 0.6 s, where 200 mm/s at most were set: the setpoint did not move it."""
    memory = begun(2500, 3100)
    found = Movement(T0 + 3100 * MS, 500.0)
    after = lag.measured(memory, found, CONFIG)
    assert (after.lag_s, after.begun) == (None, (found.t_ns, 500.0, memory.speed_mm_s))


def ran_out(cut: Cut | None, slips_s: tuple[float, ...] = ()) -> DriveMemory:
    """30 mm/s for 4 s, then 0 for 1 s."""
    return DriveMemory(history=set_to((4000, 30.0), (1000, 0.0)), cut=cut, slips_s=slips_s)


CUT = Cut(T0 + 4000 * MS, 320.0, 30.0, moving=True)


def test_how_late_it_stood_is_learned_from_the_way_after_the_setpoint_became_0() -> None:
    """12 mm at 30 mm/s are 0.4 s, of them half a step of 20 ms for the fall itself. The newest five are kept."""
    after = lag.learned(ran_out(CUT, (0.1, 0.2, 0.3, 0.5, 0.6)), 308.0, CONFIG)
    assert after.cut is None
    assert after.slips_s[:4] == (0.2, 0.3, 0.5, 0.6)
    assert after.slips_s[4:] == pytest.approx((0.39,), abs=0.002)


def test_nothing_is_learned_without_a_run_that_shows_it() -> None:
    memory = ran_out(None, (0.3,))
    assert lag.learned(memory, 308.0, CONFIG) is memory
    for cut in (replace(CUT, moving=False), replace(CUT, speed_mm_s=20.9)):
        assert lag.learned(ran_out(cut, (0.3,)), 308.0, CONFIG) == ran_out(None, (0.3,))
    assert len(lag.learned(ran_out(replace(CUT, speed_mm_s=21.0)), 308.0, CONFIG).slips_s) == 1


def test_what_was_told_moves_a_vehicle_at_once_or_up_to_the_longest_delay_later() -> None:
    """100 mm/s for 1 s, then 0. From 0.9 s to 1.5 s: 10 mm at once, 50 mm 0.4 s later, 60 mm 0.8 s later;
    1 mm more in the step of 20 ms in which it falls."""
    history = set_to((1000, 100.0), (1000, 0.0))
    told = Told(900.0, T0 + 900 * MS, (1.0, 2.0, 3.0)).added(history, T0 + 1500 * MS, CONFIG.delay_s)
    assert (told.distance_mm, told.t_ns) == (900.0, T0 + 1500 * MS)
    assert told.by_mm == pytest.approx((12.0, 53.0, 63.0), abs=0.1)


def test_a_prediction_adds_the_accelerations_that_are_not_known() -> None:
    """0.2 s later at an excess of 50 mm/s; 75 mm/s2 are 15 mm/s then, and 7.5 mm/s on the way."""
    before = Movement(T0, 1000.0, 50.0, 4.0, -10.0, 400.0)
    later = movement.at(before, T0 + 200 * MS, 30.0, 75.0)
    assert (later.t_ns, later.distance_mm, later.excess_mm_s) == (T0 + 200 * MS, 960.0, 50.0)
    assert later.speed_var == pytest.approx(400.0 + 225.0)
    assert later.covariance == pytest.approx(-10.0 - 0.2 * (400.0 + 112.5))
    assert later.distance_var == pytest.approx(4.0 + 0.4 * 10.0 + 0.04 * (400.0 + 56.25))
    assert movement.distance_at(before, T0 + 200 * MS, 30.0) == later.distance_mm


@pytest.mark.parametrize(("off_mm", "anew"), [(69.9, False), (-69.9, False), (70.1, True), (-70.1, True)])
def test_a_reading_that_jumps_begins_anew(off_mm: float, *, anew: bool) -> None:
    """By more than 40 mm and three standard deviations of 10 mm."""
    known = Movement(T0, 1000.0, 0.0, 100.0, 0.0, 0.0)
    found = movement.measured(known, 1000.0 + off_mm, T0, 0.0, 75.0)
    assert (found == Movement(T0, 1000.0 + off_mm)) == anew
    assert anew or found.distance_mm == pytest.approx(1000.0 + off_mm * 100.0 / 106.25)


def test_after_a_time_without_decisions_the_tries_and_what_was_learned_are_known() -> None:
    memory = DriveMemory(speed_mm_s=50.0, tries=2, tried_mm=320.0, lag_s=0.3, slips_s=(0.2,), frozen=True, there=True)
    assert memory.resumed() == DriveMemory(tries=2, tried_mm=320.0, lag_s=0.3, slips_s=(0.2,))


def test_a_vehicle_faster_than_anything_that_was_set_needs_the_excess_in_its_way_and_in_its_brake() -> None:
    """40 mm/s for long: 32 mm are to come in 0.8 s, at worst 35.2 mm. At 104 mm/s it is 60 mm/s faster than at worst
    by the setpoint: 48 mm more in 0.8 s, then 104 mm/s to brake."""
    history = set_to((3000, 40.0))
    way = stopping_way.at_worst(history, 104.0, CONFIG)
    assert (way.coming_mm, way.excess_mm_s) == pytest.approx((32.0, 60.0))
    assert way.mm == pytest.approx(35.2 + 48.0 + 104.0**2 / 300)
    # 150 mm: 8 are the reserve, 35.2 come, 48 are the excess in the delay; in 58.8 mm a vehicle stops from 118.65 mm/s,
    # of which 60 are the excess.
    assert stopping_way.safe_mm_s(way, 150.0, 200.0, CONFIG) == pytest.approx((118.65 - 60.0) / 1.1, abs=0.01)
    # Rising from 40 mm/s: in 106.8 + 44 * 0.8 = 142 mm after a delay of 0.8 s it stops from 118.75 mm/s.
    assert stopping_way.safe_mm_s(way, 150.0, 40.0, CONFIG) == pytest.approx((118.747 - 60.0) / 1.1, abs=0.01)
    assert stopping_way.safe_mm_s(way, way.mm - 0.1, 40.0, CONFIG) == 0.0
