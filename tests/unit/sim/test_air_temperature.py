"""A board that measures the air, and loses its thermometer: distance, NE 107 and alarm, in virtual time."""

from collections.abc import Sequence
from statistics import mean

import pytest

from gateway.alarms.engine import AlarmEngine
from gateway.core import ne107
from gateway.core.ne107 import Ne107
from gateway.core.readings import Quality
from tests.visit_bench import Bench, gateway, truck

LOST_S, BACK_S, END_S = 10.0, 40.0, 110.0
WARM_C = 30.0  # 20 is configured: the sound is 1.8 % faster than that
RETURN_S = 21.0  # 0.5 K a second
TRUE_MM = 900.0
FALLEN_BACK_MM = TRUE_MM * (331.3 + 0.606 * 20) / (331.3 + 0.606 * WARM_C)  # 884
QUIET = {"jitter_mm": 0, "step_mm": 0, "temperature_c": WARM_C, "temperature_sensor": True}


def distances_mm(bench: Bench, from_s: float, to_s: float) -> Sequence[float]:
    found = [moment.state.range.distance_mm for moment in bench.moments if from_s <= moment.t_s < to_s]
    return [mm for mm in found if mm is not None]


@pytest.mark.failure_mode("R16")
def test_a_lost_thermometer_changes_the_distance_slowly_and_is_an_alarm_after_7_s() -> None:
    lost = {"kind": "ranger_no_temperature", "at_s": LOST_S, "for_s": BACK_S - LOST_S}
    still = {"vibration": {"amplitude_mm": 0}, "start": {"distance_cm": TRUE_MM / 10}}
    bench = Bench(truck(faults=(lost,), ranger=QUIET, **still), gateway())
    alarms = AlarmEngine({"bay1": bench.config.bays[0]})
    changes, signals = [], []
    while bench.t_s < END_S:
        bench.run(bench.t_s + 0.1)
        changes += [(round(bench.t_s), one.id) for one in alarms.update_bay(bench.state, bench.now_ns)]
        signals.append((bench.t_s, ne107.status(bench.state)))
    assert mean(distances_mm(bench, 5, LOST_S)) == pytest.approx(TRUE_MM, abs=0.2)
    assert mean(distances_mm(bench, LOST_S + RETURN_S, BACK_S)) == pytest.approx(FALLEN_BACK_MM, abs=0.2)
    assert mean(distances_mm(bench, BACK_S + RETURN_S, END_S)) == pytest.approx(TRUE_MM, abs=0.2)
    assert {moment.state.range.quality for moment in bench.moments if moment.t_s > 1} == {Quality.GOOD}
    maintenance = [t_s for t_s, signal in signals if signal is Ne107.MAINTENANCE_REQUIRED]
    assert (min(maintenance), max(maintenance)) == pytest.approx((LOST_S + 5, BACK_S), abs=0.2)
    assert changes == [(17, "bay1.temperature_lost"), (100, "bay1.temperature_lost")]


@pytest.mark.mostly_long
@pytest.mark.parametrize("air_c", [0.0, 40.0])
def test_a_truck_in_place_does_not_seem_to_roll_when_it_is_lost_and_returns(air_c: float) -> None:
    lost = {"kind": "ranger_no_temperature", "at_s": 10.0, "for_s": 10.0}
    warm = QUIET | {"temperature_c": air_c, "jitter_mm": 1.5, "step_mm": 4.0}
    bench = Bench(truck({"distance_cm": 28, "hold_s": 60}, start={"distance_cm": 40}, faults=(lost,), ranger=warm))
    bench.run(40.0)
    during = [moment.state for moment in bench.moments if moment.t_s >= 8]
    assert {(state.in_place, state.visit.rolling) for state in during} == {(True, False)}
    assert any(state.range.temperature_lost for state in during)


def test_a_board_that_has_none_changes_nothing_unless_it_is_configured_to() -> None:
    for configured, signal in ((False, Ne107.GOOD), (True, Ne107.MAINTENANCE_REQUIRED)):
        config = gateway(ranger={"hcsr04": {"temperature_sensor": configured}})
        bench = Bench(truck(), config)
        bench.run(4.0)
        assert (ne107.status(bench.state), bench.state.may_move) == (signal, True)
