"""When a line was on the wire: backlogs, stalls, gaps and restarts, from sequence numbers and arrival times."""

from hypothesis import given
from hypothesis import strategies as st

from gateway.ranger.arrival_times import LATE_LINES, Arrival, ArrivalTracker, TimedLine

MS = 1_000_000
LIVE, BACKLOG, DUPLICATE = Arrival.LIVE, Arrival.BACKLOG, Arrival.DUPLICATE


def at(pace: ArrivalTracker, seq: int, ms: float, *, after_hello: bool = False) -> TimedLine:
    t_ns = round(ms * MS)
    return pace.judge(seq & 0xFFFF, t_ns, t_ns, after_hello=after_hello)


def running(seq: int = 100, ms: float = 0.0) -> ArrivalTracker:
    """A connection that is live; the newest line is `seq` at `ms`."""
    pace = ArrivalTracker(60 * MS)
    at(pace, seq - 2, ms - 120)
    at(pace, seq - 1, ms - 60)
    assert LIVE is at(pace, seq, ms).arrival
    return pace


def test_a_burst_after_opening_is_a_backlog_until_the_pace_is_the_sensors() -> None:
    pace = ArrivalTracker(60 * MS)
    places = [at(pace, n, 0.1 * n).arrival for n in range(50)]
    assert places == [BACKLOG] * 50
    assert BACKLOG is at(pace, 50, 5 + 20).arrival  # the first live one, but it came 20 ms after an old one
    assert BACKLOG is at(pace, 51, 5 + 80).arrival  # the pause before it could be one between two bursts
    assert LIVE is at(pace, 52, 5 + 140).arrival


def test_a_pause_between_two_bursts_ends_no_backlog() -> None:
    """A long way to the serial server: window by window, one round trip apart, comes what it had stored."""
    pace = ArrivalTracker(60 * MS)
    places = [at(pace, 100 * window + n, 100 * window + 0.1 * n).arrival for window in range(5) for n in range(100)]
    assert places == [BACKLOG] * 500
    assert [at(pace, 499 + n, 410 + 60 * n).arrival for n in (1, 2, 3)] == [BACKLOG, LIVE, LIVE]


def test_lines_before_their_time_show_that_those_before_were_late() -> None:
    """Two short bursts with long pauses look like the sensor's pace; the third, long one cannot."""
    pace = ArrivalTracker(60 * MS)
    assert {at(pace, n, 230 * (n // 4)).arrival for n in range(8)} == {BACKLOG}
    third = [at(pace, 8 + n, 460).arrival for n in range(20)]
    assert third == [LIVE] * 3 + [BACKLOG] * 17  # 60, 120, 180 ms before its time
    assert [at(pace, 27 + n, 460 + 60 * n).arrival for n in (1, 2, 3)] == [BACKLOG, LIVE, LIVE]


def test_lines_that_arrive_in_twos_are_no_backlog() -> None:
    """A serial server that packs what came within 120 ms."""
    pace = ArrivalTracker(60 * MS)
    places = [at(pace, n, 120 * (n // 2)).arrival for n in range(20)]
    assert places == [BACKLOG] * 4 + [LIVE] * 16


def test_a_restart_in_the_middle_of_a_backlog_makes_nothing_live() -> None:
    """Ten seconds of nothing, in which the board was reset, then everything at once."""
    pace = running(100)
    assert {at(pace, 100 + n, 10_000).arrival for n in range(1, 31)} == {BACKLOG}
    assert TimedLine(BACKLOG, 10_000 * MS, restarted=True) == at(pace, 0, 10_000, after_hello=True)
    assert {at(pace, n, 10_000 + 0.1 * n).arrival for n in range(1, 100)} == {BACKLOG}
    assert [at(pace, 99 + n, 10_010 + 60 * n).arrival for n in (1, 2, 3)] == [BACKLOG, LIVE, LIVE]


def test_backlog_with_a_hole_before_the_live_lines() -> None:
    pace = ArrivalTracker(60 * MS)
    for n in range(10):
        at(pace, n, 0)
    assert TimedLine(BACKLOG, 30 * MS) == at(pace, 500, 30)  # neither live nor a restart
    assert TimedLine(BACKLOG, 90 * MS) == at(pace, 501, 90)
    assert TimedLine(LIVE, 150 * MS) == at(pace, 502, 150)


def test_half_a_cycle_is_the_limit() -> None:
    pace = ArrivalTracker(60 * MS)
    at(pace, 1, 0)
    assert BACKLOG is at(pace, 2, 30).arrival
    assert BACKLOG is at(pace, 3, 59.9).arrival
    assert BACKLOG is at(pace, 4, 89.9).arrival
    assert LIVE is at(pace, 5, 119.9).arrival


def test_gaps_are_counted_and_wrap_at_16_bits() -> None:
    pace = running(65_534)
    assert TimedLine(LIVE, 60 * MS) == at(pace, 65_535, 60)
    assert TimedLine(LIVE, 120 * MS) == at(pace, 0, 120)
    assert TimedLine(LIVE, 360 * MS, missing=3) == at(pace, 4, 360)


def test_the_same_number_twice_is_a_duplicate_even_after_a_hello() -> None:
    pace = running(7)
    assert DUPLICATE is at(pace, 7, 30).arrival
    assert DUPLICATE is at(pace, 7, 60, after_hello=True).arrival
    assert TimedLine(LIVE, 61 * MS) == at(pace, 8, 61)


def test_a_number_that_cannot_have_been_reached_is_a_restart() -> None:
    pace = running(30_000)
    assert TimedLine(BACKLOG, 2000 * MS, restarted=True) == at(pace, 0, 2000)
    assert TimedLine(BACKLOG, 2060 * MS) == at(pace, 1, 2060)
    assert TimedLine(LIVE, 2120 * MS) == at(pace, 2, 2120)


def test_zero_after_a_hello_is_a_restart_even_where_the_number_would_fit() -> None:
    assert TimedLine(LIVE, 500 * MS, missing=5) == at(running(65_530), 0, 500)
    assert TimedLine(BACKLOG, 500 * MS, restarted=True) == at(running(65_530), 0, 500, after_hello=True)
    assert TimedLine(LIVE, 60 * MS) == at(running(65_535), 0, 60, after_hello=True)  # the hello of every 5 s


def test_jitter_is_dated_by_arrival() -> None:
    pace = running(100)
    assert TimedLine(LIVE, 210 * MS) == at(pace, 101, 210)  # 150 ms late
    assert TimedLine(LIVE, 211 * MS) == at(pace, 102, 211)


def test_lines_held_up_are_not_live_until_they_catch_up() -> None:
    """Three seconds of nothing, then everything at once, then the normal pace."""
    pace = running(100)
    held = [at(pace, 100 + n, 3000) for n in range(1, 51)]
    assert [p.arrival for p in held[:47]] == [BACKLOG] * 47
    assert [n * 60 * MS for n in range(1, 48)] == [p.end_ns for p in held[:47]]
    assert [p.arrival for p in held[47:]] == [LIVE] * 3  # due at 2880, 2940, 3000: within the 150 ms
    assert TimedLine(LIVE, 3060 * MS) == at(pace, 151, 3060)


def test_a_sensor_that_paused_is_live_again_after_some_lines() -> None:
    pace = running(100)
    got = [at(pace, 101 + n, 3000 + 60 * n).arrival for n in range(12)]
    assert got == [BACKLOG] * LATE_LINES + [LIVE] * 4


def test_a_sensor_slower_than_its_hello_states_stays_live() -> None:
    pace = running(0)
    assert all(at(pace, n, 100 * n) == TimedLine(LIVE, 100 * n * MS) for n in range(1, 200))


def test_a_resonator_off_by_one_percent_stays_live() -> None:
    for cycle_ms in (59.4, 60.6):
        pace = running(0)
        assert all(at(pace, n, cycle_ms * n).arrival is LIVE for n in range(1, 2000))


@given(st.lists(st.tuples(st.integers(0, 0xFFFF), st.integers(0, 10**10), st.booleans()), max_size=60))
def test_no_date_is_later_than_the_arrival(lines: list[tuple[int, int, bool]]) -> None:
    pace, now_ns, live = ArrivalTracker(60 * MS), 0, 0
    for seq, step_ns, after_hello in lines:
        now_ns += step_ns
        placed = pace.judge(seq, now_ns, now_ns - 5 * MS, after_hello=after_hello)
        assert placed.end_ns <= now_ns - 5 * MS
        assert placed.missing >= 0
        live += placed.arrival is LIVE
    assert live <= max(0, len(lines) - 2)
