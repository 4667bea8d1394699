"""The closed loop's bench: the PLC's programs, the judge, and a few approaches of each vehicle."""

import json
from dataclasses import replace
from itertools import pairwise

import pytest

from bench.closed_loop import campaign, report
from bench.closed_loop.approach import Aid, Approach, Result, limits, optimal_s, settings
from bench.closed_loop.campaign import faulty, figures
from bench.closed_loop.faults import AMOUNTS, failures
from bench.closed_loop.plc import LIFE_S, SCAN_S, START_AGAIN_S, ApproachBlock, Image, PlainProgram, Program
from gateway.core.state import Reason
from gateway.sim.vehicles import VehicleKind

pytestmark = pytest.mark.one_interpreter

MOVES = Image(0, may_move=True, reason=Reason.NONE, distance_mm=2000.0, drive_enable=True, speed_mm_s=200)


def played(program: Program, from_s: float, to_s: float, image: Image | None) -> float:
    """With a poll at each fifth scan, whose heartbeat goes on; None: the polls are lost. The last reference."""
    reference = 0.0
    for scan in range(round(from_s / SCAN_S), round(to_s / SCAN_S)):
        polled = None if image is None or scan % 5 else replace(image, heartbeat=scan)
        reference = program.scan(scan * SCAN_S, polled)
    return reference


def test_the_block_starts_with_an_edge_and_never_exceeds_the_setpoint() -> None:
    block = ApproachBlock(100.0, 300.0)
    assert played(block, 0, START_AGAIN_S - 0.02, MOVES) == 0
    assert played(block, START_AGAIN_S - 0.02, 2.0, MOVES) == pytest.approx(100.0, abs=3)
    assert played(block, 2.0, 5.0, MOVES) == 200
    assert played(block, 5.0, 5.2, replace(MOVES, speed_mm_s=30)) == 30  # down at once
    assert played(block, 5.2, 5.4, replace(MOVES, drive_enable=False)) == 0


def test_without_polls_the_block_ramps_down_by_itself_and_waits_for_another_start() -> None:
    block = ApproachBlock(100.0, 300.0)
    played(block, 0, 5.0, MOVES)
    assert played(block, 5.0, 5.4, None) == 200
    assert played(block, 5.4, 4.9 + LIFE_S + 0.34, None) == pytest.approx(200 - 300 * 0.34, abs=10)
    assert played(block, 5.74, 7.0, None) == 0
    assert played(block, 7.0, 7.9, MOVES) == 0
    assert played(block, 7.9, 12.0, MOVES) == 200


def test_a_frozen_image_is_no_life_sign() -> None:
    block = ApproachBlock(100.0, 300.0)
    played(block, 0, 5.0, MOVES)
    for scan in range(250, 400):
        reference = block.scan(scan * SCAN_S, replace(MOVES, heartbeat=245))
    assert reference == 0


@pytest.mark.parametrize(("reason", "waits"), [(Reason.TARGET_REACHED, False), (Reason.TARGET_COASTED, True)])
def test_a_stop_at_the_mark_does_not_end_an_approach_and_another_does(reason: Reason, waits: bool) -> None:
    block = ApproachBlock(100.0, 300.0)
    played(block, 0, 5.0, MOVES)
    assert played(block, 5.0, 5.5, replace(MOVES, may_move=False, reason=reason, drive_enable=False)) == 0
    assert (played(block, 5.5, 6.0, MOVES) == 0) is waits


def test_the_plain_program_is_fast_then_slow_then_stops() -> None:
    program = PlainProgram(500.0, 30.0, 1500.0, 100.0)
    assert played(program, 0, 10.0, MOVES) == 500
    assert played(program, 10.0, 11.0, replace(MOVES, distance_mm=1500.0)) == 30
    stopped = replace(MOVES, distance_mm=299.0, may_move=False, reason=Reason.TARGET_REACHED)
    assert played(program, 11.0, 12.0, stopped) == 0
    assert played(program, 12.0, 13.0, replace(MOVES, distance_mm=None)) == 0


def test_the_shortest_time_to_a_stop() -> None:
    of = {"acceleration_mm_s2": 100.0, "brake_mm_s2": 100.0, "max_speed_mm_s": 500.0, "lag_s": 1.0}
    assert optimal_s(1000.0, of) == pytest.approx(1 + 2 * 10**0.5)  # never at full speed
    assert optimal_s(5000.0, of) == pytest.approx(1 + 5 + 5 + 2500 / 500)


def test_faults_are_drawn_within_their_ranges() -> None:
    assert failures(7, 8.0) == failures(7, 8.0) != failures(8, 8.0)
    drawn = [one for seed in range(300) for one in failures(seed, 8.0)]
    assert {one.fault for one in drawn} >= set(AMOUNTS)
    for one in drawn:
        low, high = AMOUNTS.get(one.fault, (0.0, 0.0))
        assert low <= one.amount <= high
        assert 0.5 <= one.at_s <= 8.0
        assert 0.1 <= one.for_s <= 45.0


def result(seed: int, error_mm: float, **more: object) -> Result:
    known = Result(seed, "winch", "setpoint", error_mm, error_mm - 10, 12.0, 10.0, True, False, False)
    return replace(known, **more)  # type: ignore[arg-type]


def test_the_figures_of_known_results() -> None:
    results = [result(n, float(n - 10)) for n in range(20)]
    results[19] = replace(results[19], in_place=False, error_mm=400.0, time_s=60.0)
    results[0] = replace(results[0], deepest_mm=-101.0, collided=True)
    found = figures(results, dead_band_mm=9.0, overshoot_mm=100.0)
    assert (found["approaches"], found["in_place"], found["collisions"], found["past_tolerance"]) == (20, 0.95, 1, 1)
    assert found["error_mm"] == [-0.5, 400.0]
    assert found["past_band"] == 0.05  # -10 only
    assert (found["time_s"], found["ratio"]) == ([12.0, 12.0], [1.2, 1.2])


class Reckless:
    """Drives whatever is read."""

    def scan(self, now_s: float, image: Image | None) -> float:
        return 300.0


def test_the_judge_sees_a_collision() -> None:
    one = Approach(VehicleKind.TRACTOR, Aid.PLAIN, 3, settings(VehicleKind.TRACTOR, Aid.PLAIN))
    one.program = Reckless()
    found = one.run()
    assert found.collided
    assert found.deepest_mm < -100


@pytest.mark.parametrize(
    ("kind", "seed"), [(VehicleKind.SHUNTER, 22), (VehicleKind.WINCH, 2), (VehicleKind.TRACTOR, 23)]
)
def test_a_vehicle_comes_to_its_place_and_never_past_the_tolerance(kind: VehicleKind, seed: int) -> None:
    """Two of them first stand short of it, and must be seen to stand through the ranger's noise."""
    trace: list[tuple[float, ...]] = []
    one = Approach(kind, Aid.SETPOINT, seed, settings(kind, Aid.SETPOINT), trace=trace)
    found = one.run()
    assert found.in_place
    assert abs(found.error_mm) < 30
    assert -found.deepest_mm < 100
    up_mm_s = limits(kind)["acceleration_mm_s2"] * SCAN_S
    assert all(after[3] - before[3] <= up_mm_s + 1e-6 for before, after in pairwise(trace))


@pytest.mark.long
def test_equal_seeds_give_equal_results() -> None:
    job = (VehicleKind.WINCH, Aid.SETPOINT, 11)
    assert faulty(job) == faulty(job)


@pytest.mark.long
@pytest.mark.parametrize("kind", list(VehicleKind))
def test_no_vehicle_collides_whatever_fails(kind: VehicleKind) -> None:
    """Replay one: python -m bench.closed_loop.campaign --faults 1 --seed N --kind KIND."""
    results = [one for seed in range(12) for one in faulty((kind, Aid.SETPOINT, seed))]
    assert [one.seed for one in results if one.collided] == []


def test_tables_and_figure_follow_from_the_results() -> None:
    found = json.loads(campaign.RESULTS.read_text(encoding="utf-8"))
    assert report.comparison().count("\n| ") == len(found["comparison"]["rows"])
    assert f"{found['faults']['rows'][0]['approaches']:,}" in report.faults()
    picture = report.figures()["closed-loop-approach"]
    assert picture.startswith("<svg")
    assert picture.count('stroke="#0072B2"') == 4
