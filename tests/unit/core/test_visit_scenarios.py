"""Visits as they come, shipped and made up by chance, on the real step in virtual time, judged by the truth."""

from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.config import GatewayConfig, load
from gateway.core.events import EventKind
from gateway.core.readings import Quality
from gateway.core.state import Moved, Reason
from gateway.sim import scenario as scenarios
from gateway.sim.scenario import FaultKind
from tests.examples import examples
from tests.long import mostly_long
from tests.visit_bench import MOMENTS_HZ, Bench, Levels, Moment, gateway, truck
from tests.visit_judge import NEARER, Row, complaints
from tests.visit_stories import play

pytestmark = pytest.mark.one_interpreter

ROOT = Path(__file__).parents[3] / "config"
VISITS = sorted(path.stem for path in (ROOT / "scenarios").glob("visit*.toml"))
CONFIGS: dict[str, GatewayConfig] = {
    "nothing known of the lens": gateway(writes=False),
    "as simulate.toml": load(ROOT / "simulate.toml"),
}


def played(name: str, config: str = "nothing known of the lens") -> Bench:
    return _played(name, config)


@cache
def _played(name: str, config: str) -> Bench:
    scenario = scenarios.load(ROOT / "scenarios" / f"{name}.toml")
    bench = Bench(scenario, CONFIGS[config])
    bench.run(scenario.duration_s)
    return bench


def rows(bench: Bench) -> list[Row]:
    return [Row.of(moment.state, moment.truth, moment.heard_mm) for moment in bench.moments]


def during(bench: Bench, kind: FaultKind, late_s: float = 0.0) -> list[Moment]:
    """From `late_s` after each such fault has come, to its end."""
    faults = [fault for fault in bench.scenario.faults if fault.kind is kind]
    return [m for m in bench.moments if any(f.active(m.t_s) and m.t_s >= f.at_s + late_s for f in faults)]


def kinds(bench: Bench) -> list[EventKind]:
    visit = (EventKind.IN_PLACE, EventKind.IN_PLACE_ENDED, EventKind.MOVED, EventKind.RELEASED, EventKind.VISIT_ENDED)
    return [event.kind for event in bench.events if event.kind in visit]


@pytest.mark.parametrize("config", mostly_long(CONFIGS))
@pytest.mark.parametrize("name", VISITS)
def test_no_output_is_ever_wrong(name: str, config: str) -> None:
    bench = played(name, config)
    assert complaints(rows(bench), bench.config) == []
    assert any(moment.state.in_place for moment in bench.moments)


def test_visit_holds_in_place_through_two_minutes_of_loading() -> None:
    bench = played("visit")
    placed = [moment.t_s for moment in bench.moments if moment.state.in_place]
    assert placed[0] == pytest.approx(8.4, abs=0.3)
    assert placed[-1] == pytest.approx(134.2, abs=0.5)
    assert len(placed) == round((placed[-1] - placed[0]) * MOMENTS_HZ) + 1, "without a gap"
    assert any(moment.state.visit.held for moment in during(bench, FaultKind.DUST_CLOUD))
    assert kinds(bench)[0] is EventKind.IN_PLACE
    assert set(kinds(bench)[1:3]) == {EventKind.IN_PLACE_ENDED, EventKind.MOVED}  # D = 0 and the band, in any order
    assert kinds(bench)[3:] == [EventKind.VISIT_ENDED]


@pytest.mark.failure_mode("M2")
def test_visit_lamp_never_lets_the_truck_go() -> None:
    bench = played("visit-lamp")
    lit = during(bench, FaultKind.RED_LAMP)
    assert all(moment.state.stop and not moment.state.may_move for moment in lit)
    assert not any(moment.state.in_place for moment in during(bench, FaultKind.RED_LAMP, late_s=1.0))
    assert lit[-1].state.reason is Reason.SENSORS_DISAGREE
    assert bench.state.visit.place is None


@pytest.mark.failure_mode("T1")
def test_visit_creep_reports_the_roll_at_the_edge_of_the_band() -> None:
    bench = played("visit-creep")
    moved = next(moment for moment in bench.moments if moment.state.visit.moved is not Moved.NO)
    assert moved.truth.distance_mm == pytest.approx(280 + 40, abs=17)
    assert all(moment.state.stop for moment in bench.moments if moment.truth.spout == 1)


@pytest.mark.failure_mode("T2")
def test_visit_drive_away_is_reported_within_half_a_second_and_lets_nobody_go_unseen() -> None:
    bench = played("visit-drive-away")
    left_s = next(m.t_s for m in bench.moments if m.t_s > 10 and m.truth.distance_mm > 320)
    moved_s = next(m.t_s for m in bench.moments if m.state.visit.moved is not Moved.NO)
    assert 0 < moved_s - left_s < 0.5
    unseen = [m for m in bench.moments if m.t_s > left_s and m.state.vision.quality is not Quality.GOOD]
    assert not any(moment.state.may_move for moment in unseen)


@pytest.mark.failure_mode("R9")
def test_visit_echo_ends_in_place_and_never_stop() -> None:
    bench = played("visit-echo")
    echoes = during(bench, FaultKind.RANGER_ECHO, late_s=0.8)
    assert not any(moment.state.in_place for moment in echoes)
    assert all(moment.state.stop for moment in during(bench, FaultKind.RANGER_ECHO))
    assert [event.detail for event in bench.events if event.kind is EventKind.IN_PLACE_ENDED][:2] == [
        "contradiction",
        "moved",
    ]


@pytest.mark.failure_mode("R9")
def test_visit_person_is_a_contradiction_that_ends_with_the_person() -> None:
    bench = played("visit-person")
    stops = [m for m in bench.moments if m.t_s < 13 and m.state.stop]
    assert 9.3 < stops[0].t_s < 10.5
    assert stops[-1].t_s < 12.8
    assert {moment.state.reason for moment in stops} == {Reason.SENSORS_DISAGREE, Reason.CLEARING}
    cleared = [m.t_s for m in stops if m.state.reason is Reason.CLEARING]
    assert cleared[-1] == stops[-1].t_s


@pytest.mark.parametrize("name", mostly_long(["day", "dusk", "approach"]))
def test_no_truck_that_drives_away_is_told_to_come_nearer(name: str) -> None:
    """Seven departures of `day`, none of them released."""
    scenario = scenarios.load(ROOT / "scenarios" / f"{name}.toml")
    bench = Bench(scenario, gateway(writes=False, guidance={"aim_u_px": 319.5}))
    bench.run(200.0 if scenario.repeat else scenario.duration_s)
    speeds = [moment.state.guidance.closing_mm_s or 0.0 for moment in bench.moments]
    away = [moment for moment, speed in zip(bench.moments, speeds, strict=True) if speed < -100.0]
    assert len(away) > 50
    assert not {moment.state.guidance.code.name.lower() for moment in away} & NEARER
    assert complaints(rows(bench), bench.config) == []


@pytest.mark.failure_mode("T3")
def test_visit_two_trucks_makes_the_second_earn_it() -> None:
    bench = played("visit-two-trucks")
    assert [kind for kind in kinds(bench) if kind is not EventKind.IN_PLACE_ENDED] == [
        EventKind.IN_PLACE,
        EventKind.MOVED,
        EventKind.IN_PLACE,
        EventKind.MOVED,
        EventKind.VISIT_ENDED,
    ]
    second = [m for m in bench.moments if m.truth.truck == 1 and m.state.in_place]
    places = {m.state.visit.place.distance_mm for m in second if m.state.visit.place is not None}
    assert len(places) == 1
    assert places.pop() == pytest.approx(270, abs=17)


@pytest.mark.mostly_long
@pytest.mark.parametrize("name", ["visit-drive-away", "visit-two-trucks"])
@pytest.mark.failure_mode("P10")
def test_a_plc_that_holds_its_release_bit_all_day_gains_nothing(name: str) -> None:
    """With the bit on from the start to the end, every output is as without it."""
    scenario = scenarios.load(ROOT / "scenarios" / f"{name}.toml")
    said = []
    for on in (False, True):
        bench = Bench(scenario, gateway())
        Levels(bench).release(on)
        bench.run(scenario.duration_s)
        said.append([(m.state.stop, m.state.may_move, m.state.in_place, m.state.visit.moved) for m in bench.moments])
    assert said[0] == said[1]


@pytest.mark.long
@given(st.integers(0, 2**31))
@settings(max_examples=examples(12), suppress_health_check=[HealthCheck.too_slow])
def test_in_random_visits_no_output_is_ever_wrong(seed: int) -> None:
    """Trucks that roll, drive off or change; lamps, echoes, dead sensors, restarts, and a PLC that writes at random."""
    bench = play(seed)
    assert complaints(rows(bench), bench.config) == []


@pytest.mark.long
def test_the_stories_are_not_about_nothing() -> None:
    benches = [play(seed) for seed in range(4)]
    assert sum(any(m.state.in_place for m in bench.moments) for bench in benches) >= 3
    assert sum(any(m.state.visit.released for m in bench.moments) for bench in benches) >= 2
    assert sum(bench.state.plc.writes for bench in benches) > 1000


# The judge itself.


def broken(bench: Bench, **change: Any) -> list[str]:
    wrong = [Row(**{name: getattr(row, name) for name in Row.__slots__} | change) for row in rows(bench)]
    return complaints(wrong, bench.config)


def test_the_judge_sees_what_is_wrong() -> None:
    bench = Bench(truck({"distance_cm": 28, "speed_cm_s": 40, "hold_s": 2}, {"distance_cm": 60, "speed_cm_s": 40}))
    bench.run(9)
    assert complaints(rows(bench), bench.config) == []
    for change, said in (
        ({"may_move": True}, "may_move beside stop"),
        ({"in_place": True}, "in_place beside may_move"),
        ({"stop": False}, "no stop, though the truck stands at 280 mm"),
        ({"stop": False, "d": None}, "no stop, though D is None"),
        ({"guidance": "slow"}, "stop is on, and the driver is told slow"),
        ({"in_place": True, "stop": True, "may_move": False}, "still in place, -"),
        ({"moved": "no"}, "not reported as moved"),
        ({"released": True, "stop": False, "d": None}, "let go, though it comes nearer"),
    ):
        assert any(said in line for line in broken(bench, **change)), (change, said, broken(bench, **change)[:3])


# How late.


@pytest.mark.mostly_long
@pytest.mark.parametrize("speed_cm_s", [5.0, 20.0, 60.0])
def test_a_move_is_reported_within_the_sensors_delay(speed_cm_s: float) -> None:
    """From the truth's leaving the band to `moved`: a ranger cycle, a median, the wire, a tick; less what noise brings.

    A jump larger than the glitch gate needs a second reading; a truck makes none.
    """
    late_s = []
    for n in range(8):
        legs = (
            {"distance_cm": 28, "hold_s": 1 + n * 0.011},  # at any moment of the ranger's cycle of 60 ms
            {"distance_cm": 60, "speed_cm_s": speed_cm_s, "acceleration_cm_s2": 200},
        )
        bench = Bench(truck(*legs, start={"distance_cm": 28}, seed=n), seed=n)
        bench.run(0.9)
        assert bench.state.in_place
        bench.run_until(lambda state: state.visit.moved is not Moved.NO, 10)
        left = next(m.t_s for m in bench.moments if m.t_s > 1 and m.truth.distance_mm > 280 + 40)
        late_s.append(bench.t_s - left)
    assert max(late_s) < 0.2, late_s
