"""The compiled firmware on a bad wire and on bad power, in virtual time: what the host accepts is right."""

import random
from itertools import pairwise

import pytest

from gateway.ranger.hcsr04.protocol import NO_FLAGS, Damaged, Event, Hello, Measurement
from tests.firmware.bench_runs import BOOTLOADER, PERIOD_MS, Run, run

MOVING = "track 0 2500\ntrack 30000 200\ntrack 60000 3500\n"
HELLO_MS = 27


def accepted(played: Run) -> list[Measurement]:
    return [event for event in played.events if isinstance(event, Measurement)]


def no_wrong_distance(heard: list[Measurement], said: list[Measurement]) -> None:
    """Every accepted line is one that was said, and in the order in which they were said."""
    truth = {m.seq: m for m in said}
    assert [m for m in heard if truth.get(m.seq) != m] == []
    assert [m.seq for m in heard] == sorted({m.seq for m in heard})


@pytest.mark.parametrize(("for_s", "lines"), [(20, 330), pytest.param(60, 1000, marks=pytest.mark.long)])
def test_an_undamaged_wire_loses_nothing(for_s: int, lines: int) -> None:
    """A moving target."""
    played = run(MOVING, 1000 * for_s + 100)
    assert played.events == [message for _, message in played.lines]
    assert len(played.measurements) >= lines
    assert [round(t / 1e9) for t, _ in played.hellos] == [0, *range(5, for_s + 1, 5)]


@pytest.mark.long
def test_noise_on_the_emulated_wire_yields_no_wrong_distance() -> None:
    """The damage of the bench itself, 3 % of the bytes: over half of the lines are hit."""
    played = run(MOVING + "noise 0.03\n", 60_000)
    heard = accepted(played)
    no_wrong_distance(heard, [m for _, m in played.measurements])
    assert 250 < len(heard) < 600
    assert any(isinstance(event, Damaged) for event in played.events)


def test_the_line_recovers_within_one_cycle_of_the_damages_end() -> None:
    """Bursts of random bytes of 1 to 700 ms: the first line that begins after the burst is heard."""
    draw = random.Random(5)
    bursts = [(1000 * n + draw.uniform(0, 200), draw.choice((1, 5, 30, 100, 700))) for n in range(1, 25)]
    played = run("distance 520\n" + "".join(f"at {at} burst {ms}\n" for at, ms in bursts), 26_000)
    heard = {m.seq for m in accepted(played)}
    no_wrong_distance(accepted(played), [m for _, m in played.measurements])
    for at, ms in bursts:
        end_ns = (at + ms) * 1e6
        whole = [(t, m) for t, m in played.measurements if t - 1.05e6 * m.size > end_ns + 1.1e6]
        assert whole[0][1].seq in heard
        assert whole[0][0] < end_ns + 2 * PERIOD_MS * 1e6  # it began within one cycle, and ends within the next


@pytest.mark.parametrize("baud", [300, 1200, 4800, 19_200, 38_400, 57_600, 115_200])
def test_a_wrong_baud_rate_is_garbage_and_the_right_one_is_heard_at_once(baud: int) -> None:
    played = run(f"distance 520\nbaud {baud}\nat 3000 baud 9600\n", 4000)
    heard = accepted(played)
    assert heard
    good = [m for t, m in played.measurements if t > 3e9 + 35e6]
    assert heard[-len(good) :] == good  # from the first line that began after the change
    assert len(heard) <= len(good) + 1


def test_garbage_has_the_shape_that_copper_gives_it() -> None:
    """At twice the rate a byte is read as about two, at half the rate two or three as one: bits are sampled."""
    right = len(run("distance 520\n", 3000).heard)
    assert 1.5 < len(run("distance 520\nbaud 19200\n", 3000).heard) / right < 2.5
    assert 0.25 < len(run("distance 520\nbaud 4800\n", 3000).heard) / right < 0.55


@pytest.mark.parametrize("baud", [9312, 9400, 9600, 9830])
def test_three_per_cent_of_clock_error_do_not_matter(baud: int) -> None:
    """An Uno's resonator is good to 0.5 %; a receiver that samples mid-bit bears almost 5 % in all."""
    played = run(f"distance 520\nbaud {baud}\n", 2000)
    assert len(accepted(played)) == len(played.measurements)


# -- power, resets, questions -----------------------------------------------------------------------------------------


def resets_of(played: Run) -> list[tuple[int, int]]:
    """Hellos that are the first line of a life: the time in ms, and the cause."""
    first = {next(t for t, _ in played.lines if t > row["t_ns"]) for row in played.of("reset")}
    return [(round(t / 1e6), hello.mcusr) for t, hello in played.hellos if t in first]


@pytest.mark.parametrize("hang", ["hang", "stall"])
def test_each_reset_is_told_with_its_cause_and_begins_at_sequence_0(hang: str) -> None:
    played = run(f"distance 520\nat 1000 reset\nat 2010 {hang}\nat 3000 power off\nat 3500 power on\n", 4500)
    (on, cold), (line, external), (bite, watchdog), (again, cold_again) = resets_of(played)
    assert (cold, external, watchdog, cold_again) == (1, 2, 8, 1)
    assert (on, line, again) == (HELLO_MS, 1000 + HELLO_MS, 3500 + HELLO_MS)
    assert 2010 + 100 < bite < 2010 + 350  # the watchdog's quarter of a second, counted from the last cycle
    starts = [i for i, (_, m) in enumerate(played.measurements) if m.seq == 0]
    assert len(starts) == 4
    assert [m.seq for _, m in played.measurements][starts[1] :][:3] == [0, 1, 2]
    silent = [t for t, _ in played.lines if 3e9 < t < 3.5e9]
    assert silent == []


def test_behind_the_unos_boot_loader_the_causes_are_still_told() -> None:
    """It clears MCUSR and leaves by a watchdog reset of its own, a second after it has blinked three times. A main loop
    that stalls is told from that; what also stops the interrupts (`hang`) is not, and is told as the reset line."""
    played = run(
        "distance 520\nat 1000 reset\nat 3510 stall\nat 5000 power off\nat 5500 power on\n",
        *(7000, "--bootloader", str(BOOTLOADER)),
    )
    told = [(round(t / 1e6), hello.mcusr) for t, hello in played.hellos]
    assert [cause for _, cause in told] == [1, 2, 8, 1]
    assert told[1][0] == pytest.approx(1000 + 375 + 1024 + HELLO_MS, abs=20)
    assert {m.flags for _, m in played.measurements} == {NO_FLAGS}


def test_a_power_cut_in_the_middle_of_a_line_is_damage_not_a_distance() -> None:
    """Thirty cuts, each somewhere else in the cycle."""
    cuts = "".join(f"at {500 * n + 2.1 * n} power off\nat {500 * n + 2.1 * n + 40} power on\n" for n in range(1, 31))
    played = run("track 0 400\ntrack 16000 800\n" + cuts, 16_000)
    said = {(m.seq, m.ticks) for _, m in played.measurements}
    assert {(m.seq, m.ticks) for m in accepted(played)} <= said
    hellos = [event for event in played.events if isinstance(event, Hello)]
    assert [hello.mcusr for hello in hellos] == [1] * len(played.hellos)
    assert len(hellos) >= 31
    assert any(isinstance(event, Damaged) for event in played.events)


def test_a_question_is_answered_at_once_and_a_flood_costs_no_measurement() -> None:
    flood = "".join(f"at {3000 + 2 * n} send ??\n" for n in range(500))
    played = run("distance 520\nat 1010 send ?\nat 2000 send AT+X\n" + flood, 5000)
    asked = [t / 1e6 for t, _ in played.hellos if 1e9 < t < 1.9e9]
    assert len(asked) == 1
    assert asked[0] - 1010 < 1 + HELLO_MS + 32  # at worst it waits for a line that is being sent
    assert [t for t, _ in played.hellos if 2e9 < t < 3e9] == []  # nothing but ? is a question
    sequence = [m.seq for _, m in played.measurements]
    assert sequence == list(range(len(sequence)))
    answers = [t for t, _ in played.hellos if 3e9 < t < 4e9]
    assert 10 <= len(answers) <= 17  # at most one a cycle
    late = [b - a for a, b in pairwise(t / 1e6 for t, _ in played.measurements)]
    assert max(late) < PERIOD_MS + 2 * HELLO_MS


def test_a_question_at_the_wrong_baud_rate_is_not_one() -> None:
    played = run("distance 520\nbaud 19200\nat 1010 send ?\n", 2000)
    assert len(played.hellos) == 1
    heard = [row["byte"] for row in played.of("heard")]
    assert heard != [ord("?")]


def test_another_protocol_version_is_a_hello_of_that_version() -> None:
    played = run("distance 520\nat 1000 version 99\nat 2000 version off\n", 3000)
    hellos = [event for event in played.events if isinstance(event, Hello)]
    assert [hello.version for hello in hellos] == [1, 99, 1]
    assert not any(isinstance(event, Damaged) for event in played.events)


def test_a_mute_wire_and_a_held_reset_button_say_nothing() -> None:
    played = run("distance 520\nat 1000 mute on\nat 2000 mute off\nat 3000 hold on\nat 4000 hold off\n", 5000)
    heard: list[Event] = played.events
    said = [m for _, m in played.measurements]
    assert len(said) - len(accepted(played)) == pytest.approx(1000 / PERIOD_MS, abs=2)
    assert [t for t, _ in played.lines if 3.04e9 < t < 4e9] == []
    assert [event.mcusr for event in heard if isinstance(event, Hello)] == [1, 2]
