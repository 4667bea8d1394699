"""Visits as they come, shipped and made up by chance, on the real step in virtual time, judged by the truth."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.config import GatewayConfig, load
from gateway.core.state import Moved
from gateway.sim import scenario as scenarios
from tests.examples import examples
from tests.long import mostly_long
from tests.visit_bench import Bench, Levels, gateway, truck
from tests.visit_judge import NEARER, Row, complaints
from tests.visit_stories import play

pytestmark = pytest.mark.one_interpreter

ROOT = Path(__file__).parents[3] / "config"
VISITS = sorted(path.stem for path in (ROOT / "scenarios").glob("visit*.toml"))
CONFIGS: dict[str, GatewayConfig] = {
    "nothing known of the lens": gateway(writes=False),
    "as simulate.toml": load(ROOT / "simulate.toml"),
}


def rows(bench: Bench) -> list[Row]:
    return [Row.of(moment.state, moment.truth, moment.heard_mm) for moment in bench.moments]


@pytest.mark.parametrize("config", mostly_long(CONFIGS))
@pytest.mark.parametrize("name", VISITS)
def test_no_output_is_ever_wrong(name: str, config: str) -> None:
    scenario = scenarios.load(ROOT / "scenarios" / f"{name}.toml")
    bench = Bench(scenario, CONFIGS[config])
    bench.run(scenario.duration_s)
    assert complaints(rows(bench), bench.config) == []
    assert any(moment.state.in_place for moment in bench.moments)


@pytest.mark.parametrize("name", mostly_long(["dusk", "day", "approach"]))
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
@pytest.mark.failure_mode("T2")
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
