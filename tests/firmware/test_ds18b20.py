"""The DS18B20 on D2 of the compiled firmware: what lines carry, and that it disturbs nothing else."""

import random
from itertools import pairwise

import pytest

from gateway.core.readings import RelayOutput
from gateway.ranger.hcsr04.protocol import NO_FLAGS
from gateway.ranger.hcsr04.session import distance_mm
from tests.firmware.bench_runs import PERIOD_MS, Run, run


def temperatures(played: Run) -> list[tuple[float, int | None]]:
    """When, s, a line had another one than the line before."""
    said = [(t / 1e9, m.temperature_dc) for t, m in played.measurements]
    return [said[0], *(b for a, b in pairwise(said) if a[1] != b[1])]


def wrong(played: Run) -> set[str]:
    return {row["wrong"] for row in played.of("wire") if "wrong" in row}


@pytest.mark.mostly_long
@pytest.mark.parametrize(("air_c", "said_dc"), [(40.0, 400), (-12.3, -123)])
def test_the_lines_carry_what_it_measures(air_c: float, said_dc: int) -> None:
    played = run(f"distance 1000\nair {air_c}\nds18b20 {air_c}\n", 1500)
    (_, first), (since_s, then) = temperatures(played)
    assert (first, then, wrong(played)) == (None, said_dc, set())
    assert since_s < 1.0  # it converts for 0.8 s
    last = played.measurements[-1][1]
    assert abs(distance_mm(last.ticks, said_dc / 10) - 1000) < 0.3


def test_a_lost_one_is_left_out_within_ten_seconds_and_comes_back() -> None:
    """One reading begins every 4 s: those at 4 and 8 s fail."""
    played = run("distance 300\nds18b20 21.5\nat 3000 ds18b20 none\nat 11000 ds18b20 21.5\n", 13_500)
    (_, without), (_, before), (lost_s, lost), (back_s, back) = temperatures(played)
    assert (without, before, lost, back) == (None, 215, None, 215)
    assert lost_s == pytest.approx(10.8, abs=0.15)  # it was read at 0.81
    assert back_s == pytest.approx(12.8, abs=0.15)
    assert wrong(played) == set()
    assert {m.flags for _, m in played.measurements} == {NO_FLAGS}


@pytest.mark.mostly_long(short=2)
@pytest.mark.parametrize("fault", ["none", "short", "crc", "85"])
def test_without_a_good_one_lines_are_as_they_ever_were(fault: str) -> None:
    """`85`: it has not converted since its power came back."""
    played = run(f"distance 300\nds18b20 21.5\nds18b20 {fault}\n", 1500)
    assert {m.temperature_dc for _, m in played.measurements} == {None}
    assert {m.flags for _, m in played.measurements} == {NO_FLAGS}


def test_slots_disturb_neither_echoes_nor_cycles_nor_lines_nor_the_relay() -> None:
    """With beacon and relay: no slot while an echo of 18 ms is timed, each echo as it was played, to a tick, cycles of
    60 ms, all commands and lines there."""
    draw = random.Random(4)
    track = "".join(f"track {PERIOD_MS * n} {draw.uniform(2990, 3010)}\n" for n in range(110))
    played = run(f"ds18b20 21.5\n{track}send b\nrenew 1 34000 36000\n", 6500)
    assert [m.seq for _, m in played.measurements] == list(range(len(played.measurements)))
    assert len(played.measurements) >= 106
    triggers = {row["n"]: row["t_ns"] for row in played.of("trigger")}
    pulses = {row["trigger_ns"]: row["ticks"] for row in played.of("echo")}
    assert all(abs(m.ticks - pulses[triggers[m.seq]]) <= 1 for _, m in played.measurements)
    cycles_ms = [(b - a) / 1e6 for a, b in pairwise(triggers.values())]
    assert max(abs(ms - PERIOD_MS) for ms in cycles_ms) < 0.1
    assert wrong(played) == set()
    assert [row["pins"] for row in played.of("relay")] == [RelayOutput.IN_PLACE]  # it never went off
    assert {m.temperature_dc for t, m in played.measurements if t > 1e9} == {215}
    assert max(row["reset_us"] for row in played.of("wire") if "reset_us" in row) < 960
