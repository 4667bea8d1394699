"""The compiled firmware against the truth that was played, in virtual time: error, flags, lines, budget."""

import random
from itertools import pairwise

import pytest

from gateway.ranger.hcsr04.protocol import BURST_NS, NO_FLAGS, TICK_NS, Flags
from gateway.ranger.hcsr04.session import distance_mm
from tests.firmware.bench_runs import PERIOD_MS, Run, run, with_thermometer
from tools.hcsr04 import wire_ms

TIMING_CHAIN_MM = 0.2
STEP_MM = 4.0
PAPER_MM = 17.0


def errors_mm(played: Run, against: str) -> list[float]:
    """Measured less `against` (true_mm or played_mm), of every valid line; its trigger has its sequence number."""
    triggers = {row["n"]: row for row in played.of("trigger")}
    return [
        distance_mm(m.ticks, 20.0) - triggers[m.seq][against] for _, m in played.measurements if m.flags == NO_FLAGS
    ]


@pytest.mark.long
def test_the_timing_chain_is_good_to_a_fifth_of_a_millimetre_from_5_to_400_cm() -> None:
    """200 distances from a seeded draw, four cycles each; the module itself is exact."""
    draw = random.Random(1)
    wanted = [50.0, *(draw.uniform(50, 3999) for _ in range(198)), 3999.0]
    scenario = "".join(f"track {4 * PERIOD_MS * n} {mm}\ntrack {4 * PERIOD_MS * (n + 1) - 1} {mm}\n"
                       for n, mm in enumerate(wanted))  # fmt: skip
    played = run(scenario, 4 * PERIOD_MS * len(wanted))
    assert [m.seq for _, m in played.measurements] == list(range(len(played.measurements)))
    assert len(played.measurements) >= 795
    errors = errors_mm(played, "played_mm")
    assert len(errors) >= 795
    assert max(map(abs, errors)) < TIMING_CHAIN_MM
    assert abs(sum(errors) / len(errors)) < 0.06  # the truncation to whole ticks: no more


@pytest.mark.long
def test_the_modules_own_steps_are_what_is_left() -> None:
    """4 mm steps on a moving target: at most half a step and the chain; its scatter is a tenth of the paper's error."""
    played = run(f"step {STEP_MM}\ntrack 0 250\ntrack 30000 520\n", 30_000)
    errors = errors_mm(played, "true_mm")
    assert len(errors) > 480
    assert max(map(abs, errors)) < STEP_MM / 2 + TIMING_CHAIN_MM
    rms = (sum(e * e for e in errors) / len(errors)) ** 0.5
    assert 1.0 < rms < PAPER_MM / 10


def test_a_moving_target_is_measured_where_the_sound_met_it() -> None:
    played = run("track 0 2000\ntrack 10000 100\n", 9500)
    assert max(map(abs, errors_mm(played, "true_mm"))) < TIMING_CHAIN_MM


FAULTS = {
    "sensor no_echo": Flags.NO_ECHO,
    "sensor dead": Flags.NO_RISING_EDGE,
    "sensor stuck": Flags.STUCK_HIGH,
    "sensor at 10": Flags.TOO_NEAR,
    "sensor at 4200": Flags.TOO_FAR,
    "distance none": Flags.NO_ECHO,
    "dropout 1": Flags.NO_ECHO,
    "spike 60 1": Flags.TOO_NEAR,  # a pulse of 60 us is 1 cm
    "sensor at 33000": Flags.STUCK_HIGH,  # a clone that says 3300 cm: its pulse outlasts the cycle
}
CURES = {"distance none": "distance 400", "dropout 1": "dropout 0", "spike 60 1": "spike 60 0"}


@pytest.mark.mostly_long(short=3)
@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_has_its_flag_and_ends_with_its_cause(fault: str) -> None:
    """One line in every cycle, the flag from the first whole cycle on, a good line two cycles after the end."""
    cure = CURES.get(fault, "sensor ok")
    played = run(f"distance 400\nat 600 {fault}\nat 1500 {cure}\n", 2500)
    sequence = [m.seq for _, m in played.measurements]
    assert sequence == list(range(len(sequence)))
    assert len(sequence) >= 40
    assert played.flags_between(0, 590) == {NO_FLAGS}
    settled = {Flags(0), FAULTS[fault]} if "33000" in fault else {FAULTS[fault]}
    assert played.flags_between(760, 1490) <= settled
    assert FAULTS[fault] in played.flags_between(760, 1490)
    assert played.flags_between(1500 + 4 * PERIOD_MS, 2500) == {NO_FLAGS}
    valid = [m for _, m in played.measurements if m.flags == NO_FLAGS]
    assert {round(distance_mm(m.ticks, 20.0)) for m in valid} == {400}


def test_a_module_that_holds_echo_for_ever_is_triggered_again_and_reported_all_the_while() -> None:
    """As an HC-SR04P does after a lost echo; it begins anew only without power."""
    played = run("distance 400\nno_echo_ms 0\nat 600 sensor no_echo\nat 660 sensor ok\n", 6000)
    assert played.flags_between(800, 6000) == {Flags.STUCK_HIGH}
    assert len(played.measurements) >= 98
    nudges = [row for row in played.of("trigger") if row.get("ignored") == "busy"]
    assert len(nudges) > 60


def test_wild_values_ghosts_and_jitter_are_reported_as_they_were_heard() -> None:
    """The firmware reports, the host judges: each line says the pulse of its own cycle, to half a tick."""
    clone = "distance 800\njitter 30\nat 2000 wild 2500\nat 4000 wild 0\n"
    played = run(clone + "at 4000 ghost 300 0.3\nat 6000 spike 250 0.2\n", 8000)
    triggered = {row["t_ns"]: row["n"] for row in played.of("trigger") if "ignored" not in row}
    pulses = {triggered[row["trigger_ns"]]: row["ticks"] for row in played.of("echo") if row["trigger_ns"] in triggered}
    said = {m.seq: m for _, m in played.measurements}
    spiked = [n for n, m in said.items() if m.ticks and abs(m.ticks - 500) < 10]
    assert 3 <= len(spiked) <= 15  # a spike of 250 us is an echo at 4 cm, as far as anybody can tell
    assert all(abs(said[n].ticks - pulses[n]) <= 1 for n in said if n in pulses and n not in spiked)
    near = {n: distance_mm(m.ticks, 20.0) for n, m in said.items() if n not in spiked}
    assert sum(mm > 2400 for mm in near.values()) == pytest.approx(16.5, abs=1.5)
    assert sum(abs(mm - 300) < 1 for mm in near.values()) == pytest.approx(20, abs=10)


def test_the_trigger_is_long_enough_and_comes_every_60_ms() -> None:
    played = run("distance 520\n", 6000)
    triggers = played.of("trigger")
    assert min(row["us"] for row in triggers) >= 10.0  # HC-SR04 data sheet
    starts = [row["t_ns"] / 1e6 for row in triggers]
    cycles = [b - a for a, b in pairwise(starts)]
    assert min(cycles) > PERIOD_MS - 0.1
    assert max(cycles) < PERIOD_MS + 0.1
    assert sum(cycles) / len(cycles) == pytest.approx(PERIOD_MS, rel=1e-4)


@pytest.mark.mostly_long
@pytest.mark.parametrize("mm", [20.5, 520.0, 3990.0])
def test_a_line_is_whole_when_the_budget_says(mm: float) -> None:
    """docs/ranger.md: burst, flight, then the line's bytes back to back at 9600 baud (9615 as an Uno makes it)."""
    played = run(f"distance {mm}\n", 3000)
    triggers = {row["n"]: row["t_ns"] for row in played.of("trigger")}
    lines = {m.seq: (t, m) for t, m in played.measurements}
    assert len(lines) >= 48
    for seq, (t_ns, m) in lines.items():
        budget_ms = BURST_NS / 1e6 + m.ticks * 0.0005 + wire_ms(m.size, 9600)
        took_ms = (t_ns - triggers[seq]) / 1e6
        assert budget_ms + 0.5 < took_ms < budget_ms + 1.0  # the line is written in 0.7 to 0.9 ms


@pytest.mark.mostly_long
@pytest.mark.parametrize("air_c", [-10.0, 20.0, 50.0])
def test_the_thermometer_tells_the_true_speed_of_sound(air_c: float) -> None:
    """Air and TMP36 at the same temperature: field 5 corrects what 20 degrees would get wrong by up to 5 %."""
    played = run(f"distance 1000\nair {air_c}\ntemperature {air_c}\n", 2000, elf=with_thermometer())
    warm = [m for _, m in played.measurements if m.temperature_dc is not None]
    assert len(warm) > 25
    for m in warm:
        assert m.temperature_dc is not None
        assert abs(m.temperature_dc / 10 - air_c) <= 0.25
        assert abs(distance_mm(m.ticks, m.temperature_dc / 10) - 1000) < 1.0


def test_an_unconnected_thermometer_is_left_out() -> None:
    played = run("distance 1000\nadc 0\n", 1500, elf=with_thermometer())
    assert {m.temperature_dc for _, m in played.measurements} == {None}


def test_the_bench_plays_what_it_is_told() -> None:
    """The truth itself: commanded distance, steps, jitter and the burst's 450 us come out of the records."""
    played = run("distance 1234\nat 1000 step 4\nat 2000 step 0\nat 2000 jitter 5\n", 12_000, "--seed", "7")
    rows = played.of("trigger")
    exact = {row["played_mm"] for row in rows if row["t_ns"] < 1e9}
    stepped = {row["played_mm"] for row in rows if 1e9 < row["t_ns"] < 2e9}
    assert (exact, stepped) == ({1234.0}, {1236.0})
    stray = [row["played_mm"] - 1234 for row in rows if row["t_ns"] > 2e9]
    assert 3.5 < (sum(s * s for s in stray) / len(stray)) ** 0.5 < 6.5
    for row in played.of("echo"):
        assert (row["t_ns"] - row["trigger_ns"]) - row["ticks"] * TICK_NS == pytest.approx(BURST_NS, abs=1000)
