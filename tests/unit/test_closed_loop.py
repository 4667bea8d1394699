"""The closed loop's bench: the PLC's programs, the judge, and a few approaches of each vehicle."""

import json
import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from bench.closed_loop import campaign, report
from bench.closed_loop.approach import Aid, Approach, Result, limits, optimal_s, settings
from bench.closed_loop.campaign import KINDS, faulty, figures
from bench.closed_loop.faults import AMOUNTS, Failure, Fault, failures
from bench.closed_loop.plc import (
    SCAN_S,
    START_AGAIN_S,
    ApproachBlock,
    Image,
    Place,
    PlainProgram,
    PlainTrolleyProgram,
    Program,
    TrolleyProgram,
)
from bench.closed_loop.trolley import TrolleyRun, disc_mm
from gateway.core.detection import Circle
from gateway.core.pose import MetricPose
from gateway.core.state import Reason
from gateway.core.stopping_way import FASTER
from gateway.modbus.exports.approach import ApproachEnd
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
    """The third heartbeat, after 0.2 s, is the second that was seen to change."""
    block = ApproachBlock(100.0, 300.0)
    assert played(block, 0, 0.2 + START_AGAIN_S, MOVES) == 0
    assert played(block, 0.2 + START_AGAIN_S, 2.2, MOVES) == pytest.approx(100.0, abs=3)
    assert played(block, 2.2, 5.0, MOVES) == 200
    assert played(block, 5.0, 5.2, replace(MOVES, speed_mm_s=30)) == 30  # down at once
    assert played(block, 5.2, 5.4, replace(MOVES, drive_enable=False)) == 0


def test_without_polls_the_block_ramps_down_by_itself_and_waits_for_another_start() -> None:
    block = ApproachBlock(100.0, 300.0)
    played(block, 0, 5.0, MOVES)
    assert played(block, 5.0, 5.4, None) == 200
    assert played(block, 5.4, 5.74, None) == pytest.approx(200 - 300 * 0.34, abs=10)  # since 4.9 s + LIFE_MS
    assert (block.sequence.busy, block.sequence.fault, block.sequence.cause) == (False, True, ApproachEnd.LIFE)
    assert played(block, 5.74, 7.0, None) == 0
    assert played(block, 7.0, 8.1, MOVES) == 0
    assert played(block, 8.1, 12.0, MOVES) == 200
    assert not block.sequence.fault


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


def test_an_approach_that_waits_for_too_long_ends_and_one_in_place_is_done() -> None:
    block = ApproachBlock(100.0, 300.0)
    played(block, 0, 5.0, MOVES)
    assert played(block, 5.0, 14.9, replace(MOVES, speed_mm_s=0)) == 0
    assert block.sequence.busy
    causes = []
    for scan in range(745, 755):
        block.scan(scan * SCAN_S, replace(MOVES, heartbeat=scan, speed_mm_s=0))
        causes.append(block.sequence.cause)
    assert causes.count(ApproachEnd.WAIT) == 1, "the next start is there at once"
    played(block, 15.1, 18.0, MOVES)
    placed = replace(MOVES, may_move=False, in_place=True, reason=Reason.TARGET_REACHED, drive_enable=False)
    assert played(block, 18.0, 18.5, placed) == 0
    assert (block.sequence.busy, block.sequence.done, block.sequence.fault) == (False, True, False)


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


def test_blocks_of_faulty_approaches_are_merged_to_one() -> None:
    def block(first: int, approaches: int, collisions: int, in_place: float, deepest_mm: float) -> dict[str, Any]:
        row = {
            "approaches": approaches,
            "collisions": collisions,
            "collided_with": {"NO_ECHO": collisions},
            "seeds": [f"winch {first}"] * collisions,
            "faults": {"NO_ECHO": 3, f"ONLY_{first}": 1},
            "in_place": in_place,
            "deepest_mm": deepest_mm,
        }
        return {"first_seed": first, "rows": [{"kind": "vehicles", "aid": aid.value, **row} for aid in Aid]}

    found = campaign.merged([block(2000, 2000, 0, 0.5, 30.0), block(0, 1000, 2, 0.8, 12.5)])
    assert found["first_seed"] == 0
    assert [row["aid"] for row in found["rows"]] == [aid.value for aid in Aid]
    row = found["rows"][0]
    assert (row["approaches"], row["collisions"], row["in_place"], row["deepest_mm"]) == (3000, 2, 0.6, 30.0)
    assert row["seeds"] == ["winch 0", "winch 0"]
    assert row["faults"] == {"NO_ECHO": 6, "ONLY_2000": 1, "ONLY_0": 1}


class Reckless:
    """Drives whatever is read."""

    def scan(self, now_s: float, image: Image | None) -> float:
        return 300.0


POSE = MetricPose(40.0, -12.0, -3.0, 0.4, 0.3, 1.3)


def moved(program: TrolleyProgram, from_s: float, to_s: float, image: Image, at: Place = (0.0, 0.0)) -> Place:
    """With a poll at each fifth scan. The last place."""
    for scan in range(round(from_s / SCAN_S), round(to_s / SCAN_S)):
        goal = program.scan(scan * SCAN_S, None if scan % 5 else replace(image, heartbeat=scan), at)
    return goal


def test_a_trolley_moves_while_the_vehicle_is_in_place_by_poses_that_are_known_well_enough() -> None:
    program = TrolleyProgram()
    placed = replace(MOVES, may_move=False, in_place=True, pose=POSE)
    assert moved(program, 0, 1.0, replace(placed, in_place=False)) == (0, 0)
    assert moved(program, 1.0, 2.0, replace(placed, pose=None)) == (0, 0)
    assert moved(program, 2.0, 3.0, replace(placed, pose=replace(POSE, x_sd_mm=6.7))) == (0, 0)
    assert moved(program, 3.0, 4.0, placed) == (40.0, -12.0)
    assert moved(program, 4.0, 4.2, replace(placed, pose=replace(POSE, x_mm=60.0)), (20.0, -12.0)) == (40.0, -12.0)
    lowered = [program.lowered]
    moved(program, 4.2, 4.3, placed, (39.5, -12.5))
    lowered.append(program.lowered)
    assert moved(program, 4.3, 4.5, replace(placed, in_place=False), (39.0, -12.0)) == (39.0, -12.0)  # stays there
    assert [*lowered, program.lowered] == [False, True, False]


def test_a_plain_trolley_takes_pixels_for_millimetres_by_one_factor() -> None:
    program = PlainTrolleyProgram((320.0, 240.0), 0.5)
    placed = replace(MOVES, may_move=False, in_place=True, circle=Circle(400.0, 220.0, 186.0))
    assert moved(program, 0, 1.0, placed) == (40.0, -10.0)
    assert moved(PlainTrolleyProgram((320.0, 240.0), 0.5), 0, 1.0, replace(placed, circle=None)) == (0, 0)


def test_a_marker_that_leans_is_seen_as_an_ellipse_beside_its_centre() -> None:
    """Towards the near side, by the square of r / Z times the sine, in focal lengths."""
    one = TrolleyRun(Aid.SETPOINT, 3)
    one.start_mm, one.marker_mm, one.focal_px, one.centre_px = 290.0, [0, 0], 600.0, (320, 240)
    one.disc_mm = disc_mm(0.0, 0.1)
    rim = one.rim()
    assert (rim.u_px, rim.v_px) == pytest.approx((320.0, 240 + 600 * 90**2 * 0.1 / 290**2), abs=0.1)
    assert rim.semi_major_px == pytest.approx(600 * 90 / 290, abs=0.5)
    assert math.sin(rim.angle_rad) == pytest.approx(0, abs=0.02)


@pytest.mark.parametrize(("aid", "seed"), [(Aid.SETPOINT, 22), (Aid.PLAIN, 23)])
def test_a_spout_comes_to_its_marker(aid: Aid, seed: int) -> None:
    found = TrolleyRun(aid, seed).run()
    assert found.in_place
    assert found.error_mm < 10
    assert -found.deepest_mm < 10
    assert found.optimal_s < found.time_s < found.optimal_s + 3


def test_the_judge_sees_a_spout_that_is_lowered_beside_its_marker() -> None:
    one = TrolleyRun(Aid.PLAIN, 3)
    one.over = PlainTrolleyProgram((260.0, 240.0), 0.5)
    found = one.run()
    assert found.collided
    assert found.error_mm > 15


def test_the_judge_sees_a_collision() -> None:
    one = Approach(VehicleKind.TRACTOR, Aid.PLAIN, 3, settings(VehicleKind.TRACTOR, Aid.PLAIN))
    one.program = Reckless()
    found = one.run()
    assert found.collided
    assert found.deepest_mm < -100


def test_a_drive_may_be_faster_than_its_reference() -> None:
    one = Approach(VehicleKind.TRACTOR, Aid.PLAIN, 3, settings(VehicleKind.TRACTOR, Aid.PLAIN))
    one.program = Reckless()
    one.failures = (Failure(Fault.DRIVE_FASTER, 0.0, 3.0, FASTER),)
    fastest_mm_s = 0.0
    while one.t_s < 5.0:
        one.step()
        fastest_mm_s = max(fastest_mm_s, one.vehicle.speed_mm_s)
    assert 315 < fastest_mm_s <= 330
    assert one.vehicle.speed_mm_s == pytest.approx(300, abs=0.1)


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
    job = ("winch", Aid.SETPOINT, 11)
    assert faulty(job) == faulty(job)


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_no_vehicle_collides_whatever_fails(kind: str) -> None:
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


@pytest.mark.parametrize("seed", [9103, 9110])
def test_dust_on_the_way_and_a_new_start_are_no_sensors_that_freeze(seed: int) -> None:
    """The vehicle stops, and stands while the setpoint rises again: the PLC's program starts 1 s later. Where what
    moved it before counted as following, it was 0 for good."""
    kind = VehicleKind.TRACTOR
    drives = Approach(kind, Aid.SETPOINT, seed, settings(kind, Aid.SETPOINT))
    assert drives.dust
    assert drives.run().in_place
