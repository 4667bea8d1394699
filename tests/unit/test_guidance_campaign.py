"""The simulated drivers: what guidance must be worth, on few approaches; the truck's and the driver's own rules."""

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from bench.guidance import campaign
from bench.guidance.approach import Result, approach, settings
from bench.guidance.campaign import best, figures
from bench.guidance.driver import Aid, Driver, Person, Profile, Sign
from bench.guidance.report import mcnemar
from bench.guidance.truck import Dynamics, Truck
from gateway.core.state import GuidanceCode

pytestmark = pytest.mark.one_interpreter


def played(aid: Aid, **changed: float) -> list[Result]:
    return [approach(Profile.ATTENTIVE, aid, seed, settings(changed)) for seed in range(6)]


@pytest.mark.long
def test_an_attentive_driver_comes_to_stand_in_place_with_the_display_and_not_with_the_bell() -> None:
    shown, late, bell = played(Aid.DISPLAY), played(Aid.DISPLAY, stop_lead_s=0.0), played(Aid.BELL)
    assert sum(result.in_place for result in shown) == 6
    assert all(-100 <= result.error_mm <= 0 for result in shown)
    assert sum(result.in_place for result in bell) == 4
    assert sum(r.overshoots for r in shown) < sum(r.overshoots for r in late)


@pytest.mark.long
def test_equal_seeds_give_equal_results() -> None:
    one, other = (approach(Profile.ROLLING, Aid.DISPLAY, 2, settings()) for _ in range(2))
    assert one == other


def test_a_truck_on_a_slope_reaches_its_speed_and_is_held_by_its_brake() -> None:
    truck = Truck(Dynamics(slope=0.01), 5000.0)
    for _ in range(1000):
        truck.step(100.0, brake_off=False, dt_s=0.01)
    assert truck.speed_mm_s == pytest.approx(100, abs=3)
    for _ in range(200):
        truck.step(0.0, brake_off=False, dt_s=0.01)
    assert truck.speed_mm_s == 0
    for _ in range(100):
        truck.step(0.0, brake_off=True, dt_s=0.01)
    assert truck.speed_mm_s == pytest.approx(98.1, rel=0.02)


@pytest.mark.parametrize(
    ("aid", "code", "brakes_s"),
    [
        (Aid.DISPLAY, GuidanceCode.OK, 1.5),  # by himself
        (Aid.DISPLAY, GuidanceCode.BRAKE, 0.2 + 0.6),
        (Aid.BELL, GuidanceCode.BRAKE, 1.5),  # he sees no display
    ],
)
def test_a_driver_whose_truck_rolls_brakes_at_once_when_he_notices_it(
    aid: Aid, code: GuidanceCode, brakes_s: float
) -> None:
    """The display changes 0.2 s after his foot has left the brake; he reacts in 0.6 s."""
    person = replace(Person.drawn(Profile.ROLLING, 1), reaction_s=0.6, slips=(2.0,), slip_s=1.5)
    driver, truck = Driver(person, aid), Truck(Dynamics(slope=0.01), 300.0)
    off = []
    for step in range(500):
        t_s = step * 0.01
        before_mm_s = truck.speed_mm_s
        driver.drive(Sign(t_s, code if t_s >= 2.2 else GuidanceCode.OK, bell=True), truck, 0.0, 0.01)
        if truck.speed_mm_s > before_mm_s and t_s > 1.5:  # until he hears the bell, who has only that drives on
            off.append(t_s)
    assert off[-1] - off[0] == pytest.approx(brakes_s, abs=0.1)
    assert truck.speed_mm_s == 0


@pytest.mark.long
def test_the_objective_is_overshoot_first_then_time() -> None:
    rows = [{"overshot": 0.30, "time_s": [9]}, {"overshot": 0.11, "time_s": [10]}, {"overshot": 0.10, "time_s": [12]}]
    assert best(rows) is rows[1]
    assert figures(played(Aid.DISPLAY)[:2])["approaches"] == 2


def test_each_point_of_the_grid_is_compared_driver_by_driver_with_the_best(monkeypatch: pytest.MonkeyPatch) -> None:
    past = {300.0: (1, 1, 1, 0), 600.0: (0, 1, 0, 1)}  # overshoots of the four drivers

    def driven(todo: Sequence[campaign.Job], *_: object) -> list[Result]:
        drivers = [(profile, past[changed["slow_mm"]][n % 4]) for n, (profile, _, _, changed) in enumerate(todo)]
        return [Result(0, profile, "display", 0, 0, 9, 0, 0, o, True, True, 1, 9) for profile, o in drivers]

    monkeypatch.setattr(campaign, "GRID", {"slow_mm": (300.0, 600.0)})
    monkeypatch.setattr(campaign, "played", driven)
    rows = campaign.grid(range(1), 1)["rows"]
    assert [(row["slow_mm"], row["overshot"]) for row in rows] == [(300.0, 0.75), (600.0, 0.5)]
    assert [(row["past_only_here"], row["past_only_there"]) for row in rows] == [(2, 1), (0, 0)]
    assert [mcnemar(1, 9), mcnemar(9, 1), mcnemar(0, 0)] == pytest.approx([22 / 1024, 22 / 1024, 1])


def test_what_was_driven_is_kept_for_this_code_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = tmp_path / "kept.jsonl"
    assert campaign.read(kept) == {}
    result = Result(7, "attentive", "bell", -12.5, -13.0, None, 0, 0, 1, d=False, in_place=False, signs=3, way_s=9.5)
    line = json.dumps([campaign.name((Profile.ATTENTIVE, Aid.BELL, 7, {"slow_s": 2.0})), asdict(result)])
    with kept.open("a", encoding="ascii") as file:
        file.write(f"{line}\n{line[:40]}")  # it was killed here
    assert campaign.read(kept) == {"attentive bell 7 slow_s=2": result}
    with kept.open("a", encoding="ascii") as file:
        file.write(f"{line.replace('bell 7', 'bell 8')}\n")
    assert sorted(campaign.read(kept)) == ["attentive bell 7 slow_s=2", "attentive bell 8 slow_s=2"]
    monkeypatch.setattr(campaign, "SIMULATED", ("bench/guidance/truck.py",))
    assert campaign.read(kept) == {}
