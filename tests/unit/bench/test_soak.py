"""How growth is measured, and that a soak's scenario is one."""

import tomllib

import pytest

from bench.soak import SENSOR_FAULTS, growth, scenario
from gateway.sim.scenario import parse


def test_a_steady_growth_is_found_and_a_level_with_noise_is_none() -> None:
    at_s = [10.0 * n for n in range(360)]
    slope, error = growth(at_s, [80 + 24 * t / 86_400 for t in at_s])
    assert slope == pytest.approx(24)
    assert error == pytest.approx(0, abs=1e-6)
    slope, error = growth(at_s, [80 + (n * 7919 % 13) / 13 for n in range(360)])
    assert abs(slope) < 3 * error


def test_what_happens_while_warming_up_is_left_out() -> None:
    at_s = [10.0 * n for n in range(360)]
    slope, error = growth(at_s, [min(80.0, 60 + t / 30) for t in at_s])
    assert slope == pytest.approx(0, abs=1e-6)
    assert error == pytest.approx(0, abs=1e-6)


def test_the_scenario_is_the_day_with_each_way_a_sensor_fails() -> None:
    made = parse(tomllib.loads(scenario(3, 1.0)))
    assert made.repeat
    assert made.seed == 3
    assert {fault.kind.value for fault in made.faults} == set(SENSOR_FAULTS)
    assert scenario(3, 1.0) == scenario(3, 1.0) != scenario(4, 1.0)
    assert max(fault.at_s for fault in made.faults) > 3500
    assert len(parse(tomllib.loads(scenario(3, 1000.0))).faults) == 1000
