"""In trials the truck stands until it is let go, in every process that computes the world."""

from pathlib import Path

import pytest

from gateway.processes.codec import record_of, record_packed
from gateway.sim.scenario import Scenario, parse
from gateway.sim.world import Motion, TruckHold, World

LEGS = [
    {"distance_cm": 50, "speed_cm_s": 50, "hold_s": 1},
    {"distance_cm": 150, "speed_cm_s": 50, "hold_s": 1},
    {"distance_cm": 60, "speed_cm_s": 50, "hold_s": 1},
    {"distance_cm": 150, "speed_cm_s": 50, "hold_s": 1},
]
SHOW: Scenario = parse({"vibration": {"amplitude_mm": 0}, "legs": LEGS})
PLAN = World(SHOW)
IN_S = PLAN._segments[0].end_s  # the first stand is over, after the plan
LIMIT_S = 20.0


@pytest.fixture
def hold(tmp_path: Path) -> TruckHold:
    return TruckHold(str(tmp_path / "bay1"), (0, 2), LIMIT_S)


def world(hold: TruckHold) -> World:
    return World(SHOW, hold=hold)


def test_nobody_lets_it_go_and_it_leaves_at_the_limit(hold: TruckHold) -> None:
    stands = world(hold)
    for t_s in (IN_S - 0.5, IN_S, IN_S + 10, IN_S + LIMIT_S - 1e-6):
        assert (stands.truth(t_s).distance_mm, stands.truth(t_s).leg, stands.truth(t_s).phase) == (500, 0, Motion.HOLD)
    for t_s in (0.3, IN_S + LIMIT_S + 0.5, IN_S + LIMIT_S + 2):
        waited_s = 0 if t_s < IN_S else LIMIT_S
        assert stands.distance_mm(t_s) == pytest.approx(PLAN.distance_mm(t_s - waited_s))
        assert stands.planned_s(t_s) == pytest.approx(t_s - waited_s)
    assert stands.planned_s(PLAN.plan_s + 2 * LIMIT_S) == pytest.approx(PLAN.plan_s)


def test_it_leaves_when_it_is_let_go(hold: TruckHold) -> None:
    stands = world(hold)
    hold.leave(0, IN_S + 3)
    hold.leave(2, IN_S)  # decided before it has stood as planned: that is no reason to leave early
    assert stands.truth(IN_S + 2.99).phase is Motion.HOLD
    assert stands.truth(IN_S + 3.5).phase is Motion.RETREAT
    for t_s in (IN_S + 3.5, IN_S + 5, PLAN.plan_s + 3 - 2):
        assert stands.distance_mm(t_s) == pytest.approx(PLAN.distance_mm(t_s - 3))
    assert stands.planned_s(PLAN.plan_s + 3) == pytest.approx(PLAN.plan_s)


def test_let_go_in_time_it_keeps_to_the_plan(hold: TruckHold) -> None:
    hold.leave(0, IN_S - 0.1)
    hold.leave(2, IN_S - 0.1)
    for k in range(200):
        assert world(hold).truth(k * 0.1) == PLAN.truth(k * 0.1)


def test_both_processes_see_the_same_truck(hold: TruckHold) -> None:
    here, there = world(hold), world(record_of(TruckHold, record_packed(hold)))
    assert there.truth(IN_S + 2).phase is Motion.HOLD
    hold.leave(0, IN_S + 2.1)
    for t_s in (IN_S + 2, IN_S + 2.2, IN_S + 4, IN_S + 30):
        assert there.truth(t_s) == here.truth(t_s)


def test_half_a_line_is_none(hold: TruckHold) -> None:
    Path(hold.path).write_text(f"0 {IN_S + 1}\n2 17")
    assert hold.departures() == {0: IN_S + 1}
