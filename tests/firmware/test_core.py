"""The firmware's state machine in simulated time: every flag, every edge, every wrap, and it never falls silent."""

from collections.abc import Callable, Iterator

import pytest

from gateway.ranger.hcsr04.protocol import MAX_SEQ, Decoder, Flags, Hello, Measurement, tenths_at_20c
from tests.firmware.core import CYCLE, MS, RISE, Answer, Core

HELLO = Hello("hcsr04", 1, 60, 1)
S = 1000 * MS
NEAREST, FARTHEST = 233, 46_590  # ticks: the first and the last between 2 cm and 4 m
MEASUREMENT_MAX = 52
MS_STEP = 4

Maker = Callable[..., Core]


@pytest.fixture
def make_core() -> Iterator[Maker]:
    """Cores whose whole life is replayed under the address sanitizer afterwards, with the same answers."""
    cores: list[Core] = []

    def make(**options: int | str) -> Core:
        cores.append(Core(**options))  # type: ignore[arg-type]  # mypy cannot match ** against keywords
        return cores[-1]

    yield make
    for core in cores:
        assert core.replay() == core.journal
        core.close()


@pytest.fixture
def core(make_core: Maker) -> Core:
    return make_core()


# -- one cycle ---------------------------------------------------------------------------------------------------------


def test_it_says_hello_at_boot_and_triggers_one_period_later(core: Core) -> None:
    assert core.first.said == [HELLO]
    assert core.first.pulses == 0
    assert core.poll(CYCLE - 1) == Answer(False, 0, False, 0, 0, 0, b"")
    assert core.poll(CYCLE) == Answer(True, 1, True, 0, 0, 0, b"")


def test_an_echo_is_reported_the_moment_it_falls(core: Core) -> None:
    core.begin()
    assert core.poll(CYCLE + RISE).sent == b""
    assert core.edge(CYCLE + RISE, True).sent == b""
    assert core.edge(CYCLE + RISE + 2912, False).sent == b"$HCM,0,2912,2500,0*4134\r\n"
    assert core.poll(CYCLE + RISE + 3000).sent == b""
    assert core.cycle(2913) == Measurement(1, 2913)


def test_every_cycle_gives_one_pulse_of_trig_and_one_line(core: Core) -> None:
    pulses = lines = 0
    for now in range(0, 20 * CYCLE, MS):
        answer = core.poll(now)
        pulses += answer.pulses
        lines += sum(isinstance(event, Measurement) for event in answer.said)
        core.space(255)
    assert (pulses, lines) == (19, 19)  # the twentieth begins now


@pytest.mark.parametrize(
    ("width", "flags"),
    [
        (0, Flags.TOO_NEAR),
        (1, Flags.TOO_NEAR),
        (NEAREST - 1, Flags.TOO_NEAR),
        (NEAREST, Flags(0)),
        (FARTHEST, Flags(0)),
        (FARTHEST + 1, Flags.TOO_FAR),
        (30 * MS - 1, Flags.TOO_FAR),
    ],
)
def test_outside_the_sensors_range_is_flagged_and_still_shows_its_ticks(core: Core, width: int, flags: Flags) -> None:
    assert core.cycle(width) == Measurement(0, width, flags)


def test_the_limits_are_those_of_the_printed_distance() -> None:
    assert [tenths_at_20c(n) for n in (NEAREST - 1, NEAREST, FARTHEST, FARTHEST + 1)] == [199, 200, 40_000, 40_001]


@pytest.mark.parametrize("width", [30 * MS, 38 * MS, 58 * MS])
def test_a_pulse_too_long_for_any_echo_is_no_echo_and_no_distance(core: Core, width: int) -> None:
    assert core.cycle(width) == Measurement(0, 0, Flags.NO_ECHO)


def test_without_a_rising_edge_the_fault_is_said_after_10_ms(core: Core) -> None:
    start = core.due
    core.begin()
    assert core.poll(start + 10 * MS - 1).sent == b""
    assert core.poll(start + 10 * MS).said == [Measurement(0, 0, Flags.NO_RISING_EDGE)]
    assert core.edge(start + 11 * MS, True).sent == b""  # too late, and not mixed into the next cycle
    assert core.edge(start + 12 * MS, False).sent == b""
    assert core.cycle(2912) == Measurement(1, 2912)


def test_a_rise_just_in_time_is_measured(core: Core) -> None:
    start = core.due
    core.begin()
    core.edge(start + 10 * MS - 1, True)
    assert core.poll(start + 10 * MS).sent == b""
    assert core.edge(start + 12 * MS - 1, False).said == [Measurement(0, 2 * MS)]


def test_edges_that_make_no_sense_are_ignored(core: Core) -> None:
    assert core.edge(100, True).sent == core.edge(200, False).sent == b""  # before the first trigger
    start = core.due
    core.begin()
    assert core.edge(start + 100, False).sent == b""  # a fall without a rise
    core.edge(start + RISE, True)
    core.edge(start + RISE + 500, True)  # a second rise does not move the first
    assert core.edge(start + RISE + 2912, False).said == [Measurement(0, 2912)]
    core.edge(start + RISE + 5000, True)  # ghost echoes behind the first one
    assert core.edge(start + RISE + 6000, False).sent == b""


def test_edges_handed_over_late_are_dated_by_the_hardware(core: Core) -> None:
    start = core.due
    core.begin()
    late = start + 55 * MS  # the main loop was busy since the trigger
    core.edge(start + RISE, True)
    assert core.edge(start + RISE + 2912, False).said == [Measurement(0, 2912)]
    assert core.poll(late) == Answer(False, 0, True, 0, 0, 0, b"")


# -- stuck and healed --------------------------------------------------------------------------------------------------


def test_an_echo_across_the_cycles_end_is_stuck_and_never_a_distance(core: Core) -> None:
    start = core.due
    core.begin()
    core.edge(start + RISE, True)
    assert core.poll(start + CYCLE - 1, True).sent == b""
    second = core.begin(high=True)
    assert second.said == [Measurement(0, 0, Flags.STUCK_HIGH)]
    assert second.pulses == 0  # the sensor is still busy
    assert core.edge(start + CYCLE + 5 * MS, False).sent == b""  # falls in the next cycle
    third = core.begin()
    assert third.said == [Measurement(1, 0, Flags.STUCK_HIGH)]
    assert third.pulses == 1
    core.edge(third_rise := start + 2 * CYCLE + RISE, True)
    assert core.edge(third_rise + 2912, False).said == [Measurement(2, 2912)]


def test_stuck_for_ever_is_said_every_cycle_and_nudged_after_eight(core: Core) -> None:
    core.begin(high=True)
    answers = [core.begin(high=True) for _ in range(300)]  # more than an 8 bit counter holds
    assert [answer.pulses for answer in answers] == [0] * 7 + [1] * 293
    said = [event for answer in answers for event in answer.said if isinstance(event, Measurement)]
    assert said == [Measurement(n, 0, Flags.STUCK_HIGH) for n in range(300)]
    healed = core.begin()
    assert healed.said == [Measurement(300, 0, Flags.STUCK_HIGH)]
    start = core.due - CYCLE
    core.edge(start + RISE, True)
    assert core.edge(start + RISE + 6057, False).said == [Measurement(301, 6057)]
    assert core.begin(high=True).pulses == 0  # the count began anew


def test_a_nudged_module_that_lets_go_is_not_measured_in_the_same_cycle(core: Core) -> None:
    for _ in range(9):
        last = core.begin(high=True)
    assert last.pulses == 1
    start = core.due - CYCLE
    for ticks, high in ((1000, False), (1900, True), (4812, False)):
        assert core.edge(start + ticks, high).sent == b""
    assert core.begin().said == [Measurement(8, 0, Flags.STUCK_HIGH)]


def test_a_fall_that_nobody_saw_is_no_echo(core: Core) -> None:
    core.begin()
    core.edge(CYCLE + RISE, True)
    assert core.begin(high=False).said == [Measurement(0, 0, Flags.NO_ECHO)]


def test_a_dead_sensor_never_silences_the_board(core: Core) -> None:
    faults = [core.cycle() for _ in range(100)]
    assert faults == [Measurement(n, 0, Flags.NO_RISING_EDGE) for n in range(100)]
    assert core.cycle(2912) == Measurement(100, 2912)


# -- time --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("into", [0, 450, RISE, RISE + 1, RISE + 1456, RISE + 2912, RISE + 2913, 10 * MS, 59 * MS])
def test_the_clocks_wrap_falls_anywhere_into_a_cycle(make_core: Maker, into: int) -> None:
    core = make_core(now=2**32 - 3 * CYCLE - into)  # the third cycle begins `into` ticks before the wrap
    assert [core.cycle(2912) for _ in range(6)] == [Measurement(n, 2912) for n in range(6)]


def test_the_clocks_lower_half_overflows_within_a_pulse(make_core: Maker) -> None:
    core = make_core(now=2**16 - CYCLE - RISE - 1000)
    assert core.cycle(2912) == Measurement(0, 2912)


def test_the_sequence_number_wraps(core: Core) -> None:
    for _ in range(MAX_SEQ):
        core.begin()
        core.poll(core.due - CYCLE + 10 * MS)
        core.space(255)
    assert core.cycle(2912).seq == MAX_SEQ
    assert core.cycle(2912).seq == 0


def test_a_cycle_up_to_1_ms_late_does_not_move_the_others(core: Core) -> None:
    assert not core.poll(CYCLE - 1).began
    assert core.poll(CYCLE + 2000) == Answer(True, 1, True, 0, 0, 0, b"")
    core.poll(CYCLE + 30 * MS)
    assert not core.poll(2 * CYCLE - 1).began
    assert core.poll(2 * CYCLE).began


def test_a_later_one_does_so_that_no_two_begin_too_close_together(core: Core) -> None:
    late = CYCLE + 2001
    assert core.poll(late) == Answer(True, 1, True, 0, 0, 1, b"")
    core.poll(late + 30 * MS)
    assert not core.poll(late + CYCLE - 1).began
    assert core.poll(late + CYCLE) == Answer(True, 1, True, 2, 0, 1, b"")


def test_a_stall_of_seconds_costs_cycles_not_numbers(core: Core) -> None:
    assert core.cycle(2912).seq == 0
    core.due += 2 * S
    assert core.cycle(2912) == Measurement(1, 2912)
    assert core.poll(core.due - 1).late_cycles == 1


@pytest.mark.parametrize("period_ms", [10, 500])
def test_the_period_is_the_callers(make_core: Maker, period_ms: int) -> None:
    core = make_core(period_ms=period_ms)
    assert core.first.said == [Hello("hcsr04", 1, period_ms, 1)]
    core.begin()
    assert core.edge(core.due - core.period + RISE, True).sent == b""
    assert core.edge(core.due - core.period + RISE + 2912, False).said == [Measurement(0, 2912)]
    assert not core.poll(core.due - 1).began
    silent = core.begin()
    assert silent.said == []
    assert core.begin().said == [Measurement(1, 0, Flags.NO_RISING_EDGE)]  # also where the limit is the whole cycle


# -- hello -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mcusr", [0, 1, 2, 4, 8, 10, 255])
def test_the_hello_says_why_the_board_was_reset(make_core: Maker, mcusr: int) -> None:
    assert make_core(mcusr=mcusr).first.said == [Hello("hcsr04", 1, 60, mcusr)]


def test_a_hello_every_5_s_right_behind_a_measurement(core: Core) -> None:
    greeted = []
    for n in range(260):
        start = core.due
        core.begin()
        core.edge(start + RISE, True)
        assert core.edge(start + RISE + 2912, False).said == [Measurement(n, 2912)]
        if core.poll(start + RISE + 2913).said == [HELLO]:
            greeted.append(n + 1)
    assert greeted == [84, 168, 252]  # 84 cycles are 5.04 s: the first measurement 5 s or more after the last hello


def test_a_hello_that_is_due_waits_for_the_measurement(core: Core) -> None:
    core.due = 100 * CYCLE
    start = core.due
    assert core.begin().sent == b""
    core.edge(start + RISE, True)
    assert core.poll(start + RISE + 5).sent == b""
    core.edge(start + RISE + 2912, False)
    assert core.poll(start + RISE + 2913).said == [HELLO]


def test_a_hello_is_due_after_5_s_and_not_a_tick_earlier(core: Core) -> None:
    core.begin()
    core.edge(CYCLE + RISE, True)
    core.edge(CYCLE + RISE + 2912, False)
    core.receive(b"?")
    asked = CYCLE + 20 * MS
    assert core.poll(asked).said == [HELLO]
    core.poll(asked + 5 * S - 20 * MS)  # a late cycle begins
    core.edge(asked + 5 * S - 19 * MS, True)
    core.edge(asked + 5 * S - 18 * MS, False)
    assert core.poll(asked + 5 * S - 1).sent == b""
    assert core.poll(asked + 5 * S).said == [HELLO]


def test_a_question_is_answered_at_once_even_within_a_measurement(core: Core) -> None:
    start = core.due
    core.begin()
    core.edge(start + RISE, True)
    core.receive(b"?")
    assert core.poll(start + RISE + 1).said == [HELLO]
    assert core.edge(start + RISE + 2912, False).said == [Measurement(0, 2912)]


def test_several_questions_get_one_answer_and_the_next_one_in_the_next_cycle(core: Core) -> None:
    core.begin()
    core.receive(b"xx??\r\n?\x00\xff")
    assert core.poll(CYCLE + 1).said == [HELLO]
    core.receive(b"?")
    assert core.poll(CYCLE + 2).sent == b""
    assert core.begin().said[-1] == HELLO
    assert core.poll(core.due - CYCLE + 1).sent == b""


def test_other_bytes_are_no_question(core: Core) -> None:
    core.begin()
    core.receive(bytes(byte for byte in range(256) if byte != ord("?")))
    assert core.poll(CYCLE + 1).sent == b""


def test_an_answer_puts_the_timed_hello_off(core: Core) -> None:
    core.due = 50 * CYCLE
    core.receive(b"?")
    assert core.begin().said == [HELLO]
    core.due = 100 * CYCLE
    assert core.cycle(2912) == Measurement(1, 2912)
    assert HELLO not in core.poll(core.due - 1).said


# -- a full transmit ring ----------------------------------------------------------------------------------------------


def test_a_line_is_sent_whole_or_not_at_all_and_counted(core: Core) -> None:
    start = core.due
    line = b"$HCM,0,2912,2500,0*4134\r\n"
    for n, (space, sent, lost) in enumerate(((len(line) - 1, b"", 1), (0, b"", 2))):
        core.begin()
        core.space(space)
        core.edge(start + RISE, True)
        answer = core.edge(start + RISE + 2912, False)
        assert (answer.sent, answer.lost_lines) == (sent, lost), n
        start += CYCLE
    core.begin()
    core.space(len(line))
    core.edge(start + RISE, True)
    assert core.edge(start + RISE + 2912, False).said == [Measurement(2, 2912)]  # the gap shows in the numbers


def test_a_hello_waits_until_it_leaves_room_for_a_measurement(core: Core) -> None:
    size = len(core.first.sent)
    core.begin()
    core.receive(b"?")
    core.space(size + MEASUREMENT_MAX - 1)
    assert core.poll(CYCLE + 1).sent == b""
    core.space(size + MEASUREMENT_MAX)
    assert core.poll(CYCLE + 2).said == [HELLO]


def test_a_boot_hello_that_finds_no_room_comes_later(make_core: Maker) -> None:
    core = make_core(space=0)
    assert core.first.sent == b""
    assert core.poll(5).sent == b""
    core.space(255)
    assert core.poll(6).said == [HELLO]
    assert core.poll(7).lost_lines == 0


def test_a_flood_of_questions_costs_no_measurement(core: Core) -> None:
    """Through a ring of 127 bytes and a wire of 9600 baud, with the longest lines a sensor can cause."""
    core.temperature(-400)
    queued, heard = 0.0, b""

    def take(answer: Answer) -> None:
        nonlocal queued, heard
        queued, heard = queued + len(answer.sent), heard + answer.sent
        core.space(int(127 - queued))

    for ms in range(60 * 1000 // MS_STEP):
        queued = max(0.0, queued - MS_STEP * 0.96)
        core.space(int(127 - queued))
        core.receive(b"?")
        now = ms * MS_STEP * MS
        take(answer := core.poll(now))
        if answer.began:
            core.due = now
        elif now == core.due + 24 * MS:
            take(core.edge(core.due + RISE, True))
            take(core.edge(core.due + RISE + FARTHEST, False))
    assert core.poll(now).lost_lines == 0
    said = Decoder().feed(heard)
    seqs = [event.seq for event in said if isinstance(event, Measurement)]
    assert seqs == list(range(999))
    assert said.count(HELLO) == len(said) - 999 > 900


# -- temperature -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "sent"),
    [(215, 215), (0, 0), (-1, -1), (-400, -400), (850, 850), (-401, None), (851, None), (-32768, None)],
)
def test_a_temperature_is_sent_if_it_can_be_one(core: Core, given: int, sent: int | None) -> None:
    core.temperature(given)
    assert core.cycle(2912) == Measurement(0, 2912, temperature_dc=sent)


def test_a_thermometer_that_dies_takes_the_field_with_it(core: Core) -> None:
    core.temperature(215)
    assert core.cycle().temperature_dc == 215
    core.temperature(900)
    assert core.cycle().temperature_dc is None


def test_it_is_quiet_while_no_echo_is_timed_and_no_cycle_is_near(core: Core) -> None:
    """A slot of the thermometer's line fits into 1 ms."""
    assert [core.quiet(core.due - before) for before in (MS, MS - 1, -MS)] == [True, False, False]
    start = core.due
    core.begin()
    assert not core.quiet(start + 1)
    core.edge(start + RISE, True)
    assert not core.quiet(start + RISE + 1)
    core.edge(start + RISE + 2912, False)
    assert core.quiet(start + RISE + 2913)
    core.begin(high=True)  # blocked: nothing is timed
    assert core.quiet(core.due - 2 * MS)


# -- the LED -----------------------------------------------------------------------------------------------------------


def blinks(core: Core, cycle: Callable[[], object]) -> str:
    """The LED over 60 cycles, one character each, after the row that was under way."""
    out = ""
    for _ in range(120):
        cycle()
        out += ".#"[core.poll(core.due - 1).light]
        core.space(255)
    return out


def test_the_led_is_on_while_measurements_are_valid(core: Core) -> None:
    assert blinks(core, lambda: core.cycle(2912)) == "#" * 120


@pytest.mark.parametrize(("width", "count"), [(38 * MS, 1), (None, 2), (100, 3), (28 * MS, 4)])
def test_the_led_blinks_the_number_of_the_fault(core: Core, width: int | None, count: int) -> None:
    row = "####...." * count + "." * 18
    assert blinks(core, lambda: core.cycle(width)) == ("#" + row * 10)[:120]


def test_the_led_blinks_five_times_for_a_stuck_echo(core: Core) -> None:
    row = "####...." * 5 + "." * 18
    core.begin(high=True)
    assert blinks(core, lambda: core.begin(high=True)) == (row * 10)[:120]


def test_the_led_ends_its_row_before_it_says_something_else(core: Core) -> None:
    core.cycle(38 * MS)
    assert blinks(core, lambda: core.cycle(2912)) == "####...." + "." * 18 + "#" * 94


def test_the_beacon_blinks_a_code_from_the_next_cycle_on_and_its_lines_carry_it(make_core: Maker) -> None:
    core = make_core()
    assert core.cycle(2912).beacon is None
    core.receive(b"b")
    shown, told = 0, []
    for n in range(200):
        measured = core.cycle(2912 if n % 3 else None)
        shown = (shown << 1 | core.poll(core.due - 1).light) % 256
        assert measured.beacon == shown
        told.append(shown & 1)
    assert 70 < sum(told) < 130
    assert max(len(run) for run in "".join(map(str, told)).replace("01", "0 1").replace("10", "1 0").split()) < 13


def test_the_beacons_code_depends_on_when_it_was_asked_for(make_core: Maker) -> None:
    codes = set()
    for late in range(8):
        core = make_core(now=late)
        core.receive(b"b")
        codes.add(tuple(core.cycle(2912).beacon for _ in range(24))[-1])
    assert len(codes) > 4
