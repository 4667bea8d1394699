"""How the fleet's demonstration counts. The course itself: tests/e2e/test_fleet_demonstration.py."""

from itertools import pairwise
from pathlib import Path

from bench.fleet import box
from bench.fleet.judge import Arrived, Made, judge, made_by

MADE = {
    "bay-001": [Made("a-1", False, 1000), Made("a-2", True, 2000), Made("b-1", True, 3000)],
    "bay-002": [Made("c-1", True, 1500)],
}


def arrived(*names: str, at_ms: float = 3010.0) -> list[Arrived]:
    return [Arrived(name, at_ms) for name in names]


def test_all_in_order() -> None:
    verdict = judge(MADE, arrived("c-1", "a-1", "a-2", "b-1"), late_ms=1000)
    assert verdict.good
    assert str(verdict) == ("stops: made 3, received 3, lost 0, late 2; all events: made 4, lost 0, out of order 0")
    assert (verdict.age_p50_ms, verdict.age_max_ms) == (1010.0, 1510.0)


def test_one_that_never_came_is_lost_whether_a_stop_or_not() -> None:
    verdict = judge(MADE, arrived("c-1", "a-2", "b-1"), late_ms=5000)
    assert (verdict.lost, verdict.stops_received, verdict.late, verdict.good) == (1, 3, 0, False)
    verdict = judge(MADE, arrived("c-1", "a-1", "b-1"), late_ms=5000)
    assert (verdict.lost, verdict.stops_received) == (1, 2)
    assert "stops: made 3, received 2, lost 1, " in str(verdict)


def test_order_counts_within_a_gateway_and_over_its_restarts() -> None:
    assert judge(MADE, arrived("a-1", "b-1", "c-1", "a-2"), late_ms=5000).out_of_order == 1
    assert judge(MADE, arrived("a-2", "a-1", "b-1", "c-1"), late_ms=5000).out_of_order == 1
    assert not judge(MADE, arrived("a-2", "a-1", "b-1", "c-1"), late_ms=5000).good


def test_what_is_sent_again_or_made_later_does_not_count() -> None:
    verdict = judge(MADE, arrived("a-1", "a-2", "a-1", "b-1", "d-1", "c-1", "b-1"), late_ms=5000)
    assert (verdict.lost, verdict.out_of_order, verdict.events_made) == (0, 0, 4)


def test_where_nothing_came_nothing_is_shown_to_be_good() -> None:
    assert not judge({}, [], late_ms=1000).good


def test_notes_of_a_box(tmp_path: Path) -> None:
    assert made_by(tmp_path) == []
    (tmp_path / box.MADE).write_text("a-1 0 1000\na-2 1 2000\n")
    assert made_by(tmp_path) == MADE["bay-001"][:2]


def test_a_truck_comes_and_goes() -> None:
    """The same seed, the same way; only from one end to the other."""
    truck, twin = box.Truck("bay-001"), box.Truck("bay-001")
    way = []
    for _ in range(400):
        truck.roll()
        twin.roll()
        way.append(truck.distance_mm)
        assert twin.distance_mm == truck.distance_mm
    assert (min(way), max(way)) == (box.NEAR_MM, box.FAR_MM)
    turns = sum(before != after for before, after in pairwise(way))
    assert 10 < turns < 60
