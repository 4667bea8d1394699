"""Visits cut out of states: expected numbers on the real step in virtual time, and what makes no visit."""

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.core import visit_progress
from gateway.core.readings import PictureFault, PictureHealth, Quality, VisionReading
from gateway.core.state import Moved, Reason, VisitPhase
from gateway.core.visit_progress import RESUME_S, Turns, VisitProgress
from gateway.core.visit_summary import VisitEnd, VisitSummary, joined, merged
from gateway.sim import scenario as scenarios
from tests.examples import examples
from tests.long import mostly_long
from tests.visit_bench import UNIX_NS, Bench, Levels, gateway, truck
from tests.visit_stories import play

pytestmark = pytest.mark.one_interpreter

SCENARIOS = Path(__file__).parents[3] / "config" / "scenarios"
ARRIVAL = {"distance_cm": 28, "speed_cm_s": 20, "hold_s": 10}
AWAY = {"distance_cm": 150, "speed_cm_s": 30, "hold_s": 20}
GONE = {"distance_cm": 400, "speed_cm_s": 60, "hold_s": 20}
NO_MARKER = {"kind": "marker_hidden", "at_s": 0, "for_s": 1000}
AN_HOUR_NS = 3600 * 10**9


@cache
def shipped(name: str) -> tuple[VisitSummary, ...]:
    scenario = scenarios.load(SCENARIOS / f"{name}.toml")
    bench = Bench(scenario, gateway(writes=False))
    bench.run(scenario.duration_s)
    return tuple(bench.visits)


def driven(*legs: dict[str, Any], for_s: float = 60, **more: Any) -> Bench:
    bench = Bench(truck(*legs, **({"start": {"distance_cm": 115}} | more)))
    bench.run(for_s)
    return bench


def restart(bench: Bench, off_s: float = 0.0, drive: bool = True) -> VisitSummary | None:
    """The gateway ends, `off_s` pass, and it begins; with what was recorded last. Returns a visit that has ended."""
    earlier = bench.progress.open(bench.now_ns)
    assert earlier is not None
    bench._ticks += round(off_s * 100)
    bench.power_on()
    bench.progress, ended = visit_progress.resumed(bench.progress, earlier, bench.unix_ns)
    return ended


@pytest.mark.long
def test_the_shipped_visit_has_these_numbers() -> None:
    (visit,) = shipped("visit")
    assert visit.end is VisitEnd.CLEAR
    assert visit.begun_ms == pytest.approx((UNIX_NS // 10**6) + 1000_000 - 4000, abs=100)  # in sight from the start
    assert visit.length_s == pytest.approx(140.5, abs=0.3)
    assert visit.to_position_s == pytest.approx(12.2, abs=0.3)
    assert visit.at_mark_s == pytest.approx(10.3, abs=0.2)
    assert visit.in_place_s == pytest.approx(125.9, abs=0.5)
    assert (visit.times_in_place, visit.corrections, visit.interruptions, visit.faults) == (1, 0, 0, ())
    assert visit.distance_mm == pytest.approx(280, abs=4)
    assert visit.radius_px == pytest.approx(193, abs=1)
    assert visit.moved is Moved.DISTANCE  # a gateway without writes can release no truck
    assert visit.released_s is None
    assert visit.stop_latency_ms is not None
    assert 20 <= visit.stop_latency_ms <= 120
    assert visit.halt_s == pytest.approx(0.8, abs=0.2)  # by the speed over the last second
    assert visit.overrun_mm == pytest.approx(20, abs=8)
    assert sum(visit.phases_s) == pytest.approx(visit.length_s, abs=0.001)
    placed_s = visit.phases_s[VisitPhase.IN_PLACE] + visit.phases_s[VisitPhase.HELD]
    assert placed_s == pytest.approx(visit.in_place_s, abs=0.001)
    assert visit.frame_ms is not None
    assert visit.to_position_s is not None
    assert 0 <= visit.begun_ms + visit.to_position_s * 1000 - visit.frame_ms < 150
    assert visit.frame_id == round((visit.frame_ms - UNIX_NS // 10**6 - 1000_000) / 1000 * 30)


@pytest.mark.mostly_long
@pytest.mark.parametrize(
    ("name", "times", "faults"),
    [
        ("visit-creep", 1, ()),
        ("visit-drive-away", 1, ()),
        ("visit-echo", 3, (Reason.SENSORS_DISAGREE,)),
        ("visit-lamp", 2, (Reason.SENSORS_DISAGREE,)),
        ("visit-person", 1, (Reason.SENSORS_DISAGREE,)),
    ],
)
def test_what_goes_wrong_is_in_it_and_makes_no_corrections(name: str, times: int, faults: tuple[Reason, ...]) -> None:
    (visit,) = shipped(name)
    assert visit.times_in_place == times
    assert tuple(reason for reason, _, _ in visit.faults) == faults
    assert all(count == 1 and 2 < seconds < 20 for _, count, seconds in visit.faults)
    assert visit.corrections == 0, "an echo, a lamp and a person are no motion of the truck"


def test_two_trucks_without_a_clear_bay_between_them_are_one_visit_where_nobody_releases() -> None:
    (visit,) = shipped("visit-two-trucks")
    assert (visit.times_in_place, visit.corrections) == (2, 2)
    assert visit.distance_mm == pytest.approx(268, abs=10)


def test_a_released_truck_and_the_one_that_closes_up_are_two() -> None:
    bench = Bench(
        truck(
            ARRIVAL,
            {"distance_cm": 70, "speed_cm_s": 30, "hold_s": 0.5},
            {"another_truck": True, "distance_cm": 45, "hold_s": 0.5},
            ARRIVAL,
            GONE,
        )
    )
    plc = Levels(bench)
    bench.run_until(lambda state: state.in_place, 20)
    plc.release()
    bench.run_until(lambda state: state.visit.off_mark, 20)
    plc.release(on=False)
    bench.run(60)
    first, second = bench.visits
    assert (first.end, second.end) == (VisitEnd.NEXT_TRUCK, VisitEnd.CLEAR)
    assert first.released_s is not None
    assert second.released_s is None
    assert (first.times_in_place, second.times_in_place) == (1, 1)
    assert (first.moved, second.moved) == (Moved.NO, Moved.DISTANCE)
    assert second.begun_ms == pytest.approx(first.last_seen_ms, abs=2)


@pytest.mark.long
def test_the_way_back_and_forth_is_counted() -> None:
    back = {"distance_cm": 60, "speed_cm_s": 20, "hold_s": 1}
    (visit,) = driven({**ARRIVAL, "distance_cm": 40, "hold_s": 1}, back, ARRIVAL, AWAY).visits
    assert visit.corrections == 2
    (visit,) = driven({**ARRIVAL, "distance_cm": 40, "hold_s": 1}, back, AWAY).visits
    assert (visit.corrections, visit.times_in_place, visit.to_position_s) == (0, 0, None), "the way out is none"


@pytest.mark.parametrize(
    ("distances", "expected"),
    [
        ((1000, 800, 600, 400), (0, 0)),
        ((1000, 800, 600, 640, 600), (0, 0)),  # within the noise
        ((1000, 800, 600, 641, 600, 590), (2, 2)),
        ((1000, 600, 700, 500, 900), (3, 2)),
        ((500, 545, 700), (0, 0)),
        ((), (0, 0)),
    ],
)
def test_turns_are_counted_beyond_the_noise(distances: tuple[float, ...], expected: tuple[int, int]) -> None:
    turns = Turns()
    for distance_mm in distances:
        turns = turns.step(distance_mm, 40)
    assert expected in ((turns.count, turns.count), (turns.count, turns.corrections))
    assert (turns.count, turns.corrections) == (expected if expected[0] != 2 else (2, 2))


@given(st.lists(st.floats(20, 5000), max_size=60), st.floats(5, 200))
@settings(max_examples=examples(200))
def test_a_turn_needs_a_way_longer_than_the_noise(distances: list[float], noise_mm: float) -> None:
    turns = Turns()
    for distance_mm in distances:
        turns = turns.step(distance_mm, noise_mm)
    way_mm = sum(abs(b - a) for a, b in pairwise(distances))
    assert turns.count * noise_mm <= way_mm
    assert 0 <= turns.corrections <= turns.count


# No visit.


@pytest.mark.parametrize(
    "faults",
    [
        ({"kind": "red_lamp", "at_s": 2, "for_s": 20},),
        ({"kind": "ranger_echo", "at_s": 2, "for_s": 20, "distance_cm": 60},),
    ],
    ids=["a lamp", "a person"],
)
def test_one_sensor_alone_makes_no_visit(faults: tuple[dict[str, Any], ...]) -> None:
    bench = driven(
        {"distance_cm": 450, "hold_s": 40}, start={"distance_cm": 450}, faults=(*faults, NO_MARKER), for_s=30
    )
    assert bench.visits == []
    assert bench.progress.open(bench.now_ns) is None


@pytest.mark.mostly_long
@pytest.mark.parametrize("sensor", ["vision_fault", "range_fault"])
def test_a_truck_that_only_one_sensor_sees_is_no_visit(sensor: str) -> None:
    bench = Bench(truck(ARRIVAL, GONE))
    setattr(bench, sensor, Quality.LINK_DOWN)
    bench.run(20)
    assert bench.progress.open(bench.now_ns) is None
    setattr(bench, sensor, None)
    bench.run(70)
    assert len(bench.visits) <= 1


@pytest.mark.long
def test_a_truck_that_waits_beyond_the_leave_distance_is_not_in_the_bay() -> None:
    bench = driven({"distance_cm": 200, "speed_cm_s": 20, "hold_s": 400}, start={"distance_cm": 260}, for_s=320)
    assert (bench.visits, bench.progress.open(bench.now_ns)) == ([], None)
    assert bench.progress.truck is not None
    assert bench.now_ns - bench.progress.truck.begun_ns < 300 * 10**9


def test_the_truck_that_drives_away_in_sight_is_not_the_next_visit() -> None:
    bench = driven(ARRIVAL, {"distance_cm": 350, "speed_cm_s": 20, "hold_s": 5}, ARRIVAL, AWAY, for_s=85)
    first, second = bench.visits
    gap_s = (second.begun_ms - first.last_seen_ms) / 1000
    assert 5 < gap_s < 15, "it begins where the truck was farthest away"
    assert first.times_in_place == second.times_in_place == 1


# Length without limits.


def test_a_truck_that_is_parked_for_long_takes_no_more_memory() -> None:
    bench = driven({**ARRIVAL, "hold_s": 60}, for_s=20)
    before = bench.progress
    for hour in range(24):
        later = replace(bench.state, t_ns=bench.now_ns + hour * AN_HOUR_NS)
        bench.progress, ended = visit_progress.step(
            bench.progress, bench.state, later, bench.rules.limits(0), bench.unix_ns + hour * AN_HOUR_NS
        )
        assert ended is None
        bench.state = later
    visit = bench.progress.open(bench.state.t_ns)
    assert visit is not None
    assert visit.length_s == pytest.approx(23 * 3600 + 24, abs=10)
    assert visit.phases_s[VisitPhase.UNKNOWN] == pytest.approx(23 * 3600, abs=10), "no valid state, no phase"
    assert visit.in_place_s < 70
    assert len(repr(bench.progress)) < len(repr(before)) + 200


# A restart.


def test_a_visit_across_a_restart_is_one_and_marked() -> None:
    bench = Bench(truck({**ARRIVAL, "hold_s": 40}, AWAY))
    bench.run(15)
    begun = bench.progress.open(bench.now_ns)
    assert begun is not None
    assert begun.times_in_place == 1
    assert restart(bench, off_s=5.0) is None
    bench.run(70)
    (visit,) = bench.visits
    assert visit.begun_ms == begun.begun_ms
    assert (visit.interruptions, visit.interrupted, visit.end) == (1, True, VisitEnd.CLEAR)
    assert visit.off_s == pytest.approx(5.2, abs=0.3)
    assert visit.to_position_s == begun.to_position_s
    assert visit.times_in_place == 2
    assert visit.in_place_s < 39
    assert visit.length_s == pytest.approx(4 + 4.4 + 40 + 4, abs=2)


def test_a_truck_that_stands_under_the_spout_at_the_restart_is_the_same() -> None:
    bench = Bench(truck({**ARRIVAL, "hold_s": 40}, AWAY, faults=({"kind": "spout_down", "at_s": 9, "for_s": 60},)))
    bench.run(15)
    assert bench.state.visit.held
    assert restart(bench, off_s=5.0) is None
    bench.run(70)
    (visit,) = bench.visits
    assert (visit.end, visit.interruptions, visit.times_in_place) == (VisitEnd.CLEAR, 1, 1)


def test_a_truck_that_left_while_the_gateway_was_off_ended_when_it_was_last_seen() -> None:
    bench = Bench(truck(ARRIVAL, GONE))
    bench.run(12)
    before = bench.progress.open(bench.now_ns)
    assert before is not None
    assert restart(bench, off_s=15.0) is None
    bench.run(70)
    (visit,) = bench.visits
    assert (visit.end, visit.interruptions) == (VisitEnd.GATEWAY_OFF, 1)
    assert (visit.begun_ms, visit.length_s) == (before.begun_ms, before.length_s)
    assert bench.progress.open(bench.now_ns) is None


@pytest.mark.parametrize("off_s", [RESUME_S + 1, -10.0])
def test_after_hours_or_by_a_clock_that_was_set_back_it_has_ended(off_s: float) -> None:
    earlier = VisitSummary(1000, 60.0)
    progress, ended = visit_progress.resumed(VisitProgress(), earlier, round((61 + off_s) * 10**9))
    assert progress == VisitProgress()
    assert ended == replace(earlier, end=VisitEnd.GATEWAY_OFF, interruptions=1)


def test_a_bay_that_was_clear_since_the_start_can_not_hold_the_truck_from_before() -> None:
    earlier = VisitSummary(1000, 60.0)
    bench = driven({"distance_cm": 450, "hold_s": 40}, start={"distance_cm": 450}, faults=(NO_MARKER,), for_s=8)
    assert bench.progress.was_clear
    _, ended = visit_progress.resumed(bench.progress, earlier, 62 * 10**9)
    assert ended is not None
    assert ended.end is VisitEnd.GATEWAY_OFF


@pytest.mark.parametrize("writes", [True, False])
def test_a_truck_that_leaves_was_to_stand_only_where_a_plc_could_have_released_it(writes: bool) -> None:
    legs = [{"distance_cm": 28, "speed_cm_s": 25, "hold_s": 6}, {"distance_cm": 130, "speed_cm_s": 40, "hold_s": 30}]
    bench = Bench(truck(*legs, start={"distance_cm": 115}), gateway(writes=writes))
    bench.run(25)
    (visit,) = bench.visits
    assert (visit.moved, visit.unintended) == (Moved.DISTANCE, writes)


def test_two_parts_of_a_visit_add_up() -> None:
    phases = (0.0,) * len(VisitPhase)
    earlier = VisitSummary(
        10_000, 30.0, phases_s=phases, at_mark_s=8.0, to_position_s=10.0, in_place_s=20.0, times_in_place=1,
        corrections=2, stop_latency_ms=50.0, halt_s=1.0, overrun_mm=5.0, radius_px=190.0, distance_mm=280.0,
        frame_id=7, frame_ms=20_000, unintended=True, faults=((Reason.NO_TARGET, 1, 2.0),),
    )  # fmt: skip
    later = VisitSummary(
        50_000, 25.0, VisitEnd.CLEAR, phases, at_mark_s=1.0, to_position_s=2.0, released_s=9.0, in_place_s=4.0,
        stop_latency_ms=99.0, moved=Moved.MARKER, faults=((Reason.NO_TARGET, 2, 1.0), (Reason.PLC_LOST, 1, 3.0)),
    )  # fmt: skip
    both = joined(earlier, later)
    assert (both.begun_ms, both.length_s, both.end) == (10_000, 65.0, VisitEnd.CLEAR)
    assert (both.at_mark_s, both.to_position_s, both.released_s) == (8.0, 10.0, 49.0)
    assert (both.in_place_s, both.times_in_place, both.corrections) == (24.0, 1, 2)
    assert (both.stop_latency_ms, both.radius_px, both.frame_id) == (50.0, 190.0, 7)
    assert (both.moved, both.unintended) == (Moved.MARKER, True)
    assert both.faults == ((Reason.NO_TARGET, 3, 3.0), (Reason.PLC_LOST, 1, 3.0))
    assert (both.interruptions, both.off_s) == (1, 10.0)
    assert merged((), ()) == ()


def test_the_rim_of_a_visit_in_two_parts_is_that_of_the_first_which_measured_it() -> None:
    measured, later = VisitSummary(0, 60.0, visible=0.9, contrast=1.2), VisitSummary(90_000, 5.0, visible=0.4)
    assert (joined(measured, later).visible, joined(measured, later).contrast) == (0.9, 1.2)
    assert joined(VisitSummary(0, 60.0), later).visible == 0.4


# The marker's rim.


def crust(share: float, at_s: float, for_s: float = 100) -> dict[str, Any]:
    return {"kind": "marker_crusted", "at_s": at_s, "for_s": for_s, "share": share}


class Dusty(Bench):
    """Each picture is itself at fault, with one exception each second."""

    def _picture(self, t_ns: int) -> VisionReading | None:
        reading = super()._picture(t_ns)
        status = 0 if self._frame % 30 == 0 else 1 << PictureFault.DUSTY
        return reading and replace(reading, picture=PictureHealth(0.4, 0.0, 0.5, 0.5, 0.8, None, status=status))


def test_the_rim_is_that_of_the_first_pictures_in_place_before_loading_covers_it() -> None:
    # In place after 7.7 s; from 9 s on half of the rim is covered.
    (visit,) = driven(ARRIVAL, AWAY, faults=(crust(0.2, 0, 9), crust(0.5, 9))).visits
    assert (visit.visible, visit.contrast) == (0.8, 1.4)
    (covered,) = driven(ARRIVAL, AWAY, faults=(crust(0.5, 0),)).visits
    assert covered.visible == 0.5


def test_of_fifteen_pictures_seven_odd_ones_do_not_count() -> None:
    clean = driven(ARRIVAL, AWAY)
    (visit,) = clean.visits
    assert visit.frame_ms is not None
    in_place_s = (visit.frame_ms - UNIX_NS // 10**6) / 1000 - 1000
    (odd,) = driven(ARRIVAL, AWAY, faults=(crust(0.5, in_place_s, 0.2),)).visits  # six or seven pictures of 30 a second
    assert (visit.visible, odd.visible) == (1.0, 1.0)
    (mostly,) = driven(ARRIVAL, AWAY, faults=(crust(0.5, in_place_s, 0.4),)).visits
    assert mostly.visible == 0.5


def test_a_picture_that_is_itself_at_fault_says_nothing_of_the_marker() -> None:
    legs = (ARRIVAL, AWAY)
    bench = Dusty(truck(*legs, start={"distance_cm": 115}, faults=(crust(0.5, 0),)))
    bench.run(9.0)
    assert bench.progress.truck is not None
    assert 1 <= len(bench.progress.truck.rims) <= 3  # of 1.3 s
    assert bench.progress.truck.so_far.visible == 0.5


def test_of_a_visit_of_an_older_gateway_any_departure_without_release_counts() -> None:
    old = VisitSummary(0, 60.0, moved=Moved.DISTANCE)
    assert (old.unintended, old.rolled, replace(old, moved=Moved.NO).rolled) == (None, True, False)
    assert (replace(old, unintended=False).rolled, replace(old, unintended=True).rolled) == (False, True)


# Wild visits.


@pytest.mark.parametrize("seed", mostly_long([1, 2, 3, 5, 8]))
def test_every_visit_made_up_by_chance_adds_up(seed: int) -> None:
    bench = play(seed)
    still = bench.progress.open(bench.now_ns)
    visits = [*bench.visits, *([still] if still else [])]
    ends_ms = 0
    for visit in visits:
        assert visit.begun_ms >= ends_ms, "one after the other"
        ends_ms = visit.last_seen_ms - 2
        assert sum(visit.phases_s) == pytest.approx(visit.length_s, abs=0.01)
        assert 0 <= visit.in_place_s <= visit.length_s
        assert (visit.times_in_place > 0) == (visit.to_position_s is not None) == (visit.radius_px is not None)
        assert all(0 <= seconds <= visit.length_s + 0.01 and count > 0 for _, count, seconds in visit.faults)
        assert (visit.end is VisitEnd.OPEN) == (visit is still)
    placed_s = sum(moment.state.in_place for moment in bench.moments) * 0.02
    assert sum(visit.in_place_s for visit in visits) <= placed_s + 4.1, "the bench has no moments of its first 4 s"
