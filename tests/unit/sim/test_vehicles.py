"""The vehicles that a PLC moves: expected ways and speeds."""

from random import Random

import pytest

from gateway.sim.vehicles import (
    Shunter,
    ShunterData,
    SpoutTrolley,
    Tractor,
    TractorData,
    Vehicle,
    VehicleKind,
    Winch,
    WinchData,
    drawn,
    drive_keys,
    typical,
    worst,
)


def run_out_mm(vehicle: Vehicle) -> float:
    """From its present speed, with reference 0, until it stands."""
    from_mm = vehicle.way_mm
    vehicle.drive(0.0, 30.0)
    assert vehicle.speed_mm_s == 0
    return vehicle.way_mm - from_mm


def test_a_shunter_moves_after_its_lag_as_fast_as_its_force_allows() -> None:
    shunter = Shunter(ShunterData(mass_t=90, lag_s=1.0, force_kn=6))
    shunter.drive(500.0, 0.7)
    assert shunter.speed_mm_s == 0
    shunter.drive(500.0, 3.0)
    assert shunter.speed_mm_s == pytest.approx(3.0 * 6000 / 90)


@pytest.mark.parametrize(("slope", "brake"), [(0.0, 150.0), (0.005, 150 - 49.05), (-0.005, 150 + 49.05)])
def test_a_shunter_runs_out_with_its_brake_and_the_gradient(slope: float, brake: float) -> None:
    shunter = Shunter(ShunterData(mass_t=20, lag_s=1.5, slope=slope))
    shunter.drive(300.0, 30.0)
    assert shunter.speed_mm_s == pytest.approx(300.0, abs=0.5)  # the drive has learned the gradient
    assert run_out_mm(shunter) == pytest.approx(300 * 1.2 + 300**2 / 2 / brake, rel=0.005)


def swing_mm(hz: float) -> tuple[float, float]:
    """A stop from 300 mm/s: the farthest way, and how far it then swings back."""
    winch = Winch(WinchData(rope_hz=hz, damping=0.08))
    winch.drive(300.0, 30.0)
    from_mm, farthest_mm = winch.way_mm, 0.0
    for _ in range(3000):
        winch.drive(0.0, 0.01)
        farthest_mm = max(farthest_mm, winch.way_mm - from_mm)
    assert winch.speed_mm_s == 0
    return farthest_mm, farthest_mm - (winch.way_mm - from_mm)


def test_a_wagon_on_a_rope_swings_past_and_back_and_less_on_a_stiffer_one() -> None:
    """The drum stops within 2 s: after 1.5 and 2.5 periods of the rope, so that both swing on as far as they can."""
    soft, stiff = swing_mm(0.75), swing_mm(1.25)
    # The drum's way is 300 * 0.3 + 300^2 / (2 * 150) = 390 mm; its brake stretches the rope by 150 / omega^2.
    assert list(soft) == [pytest.approx(390 + 6.8, abs=3), pytest.approx(9, abs=2)]
    assert list(stiff) == [pytest.approx(390 + 2.4, abs=3), pytest.approx(2.5, abs=1)]


@pytest.mark.parametrize(("reference", "speed"), [(39.0, 20.0), (40.0, 40.0), (19.0, 0.0), (-39.0, -20.0)])
def test_a_tractor_drives_whole_steps_of_speed(reference: float, speed: float) -> None:
    tractor = Tractor(TractorData(step_mm_s=20))
    tractor.drive(reference, 10.0)
    assert tractor.speed_mm_s == pytest.approx(speed, abs=1e-6)


def test_a_tractor_stops_within_its_lag_and_brake() -> None:
    tractor = Tractor(TractorData(step_mm_s=20))
    tractor.drive(500.0, 10.0)
    assert 500 * 0.2 + 500**2 / 800 < run_out_mm(tractor) < 500 * 0.3 + 500**2 / 800


@pytest.mark.parametrize("kind", list(VehicleKind))
def test_without_a_reference_it_stands_on_any_gradient(kind: VehicleKind) -> None:
    for vehicle in (typical(kind), worst(kind)):
        vehicle.drive(0.0, 20.0)
        assert vehicle.speed_mm_s == 0
        assert vehicle.way_mm == 0


def test_equal_seeds_draw_equal_vehicles_within_what_is_found_in_plants() -> None:
    ways = []
    for seed in (1, 1, 2):
        vehicle = drawn(VehicleKind.SHUNTER, Random(seed), Random(seed + 1))
        vehicle.drive(200.0, 5.0)
        ways.append(vehicle.way_mm)
    assert ways[0] == ways[1] != ways[2]


@pytest.mark.parametrize("kind", list(VehicleKind))
def test_the_worst_vehicle_keeps_what_is_configured_for_its_kind(kind: VehicleKind) -> None:
    keys, vehicle = drive_keys(kind), worst(kind)
    for reference in (100.0, 300.0, 500.0):
        vehicle.drive(reference, 30.0)
        speed = vehicle.speed_mm_s
        assert run_out_mm(vehicle) <= speed * keys["lag_s"] + speed**2 / 2 / keys["brake_mm_s2"] + 0.01


def test_a_trolley_moves_both_axes_to_their_places_after_its_lag() -> None:
    trolley = SpoutTrolley(speed_mm_s=50, lag_s=0.3)
    trolley.move(20.0, -100.2, 0.3)
    assert (trolley.x_mm, trolley.y_mm) == (0, 0)
    trolley.move(20.0, -100.2, 1.0)
    assert (trolley.x_mm, trolley.y_mm) == pytest.approx((20.0, -50.0))
    trolley.move(20.0, -100.2, 2.0)
    assert (trolley.x_mm, trolley.y_mm) == pytest.approx((20.0, -100.0))  # whole steps of 0.5 mm
