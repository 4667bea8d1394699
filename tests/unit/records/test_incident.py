"""Which pictures are kept round what happened, and how many a day."""

import numpy as np
import pytest

from gateway.records.incident import DAY_NS, IncidentPictures, budget_left
from gateway.records.names import PICTURES, FileName
from gateway.records.retention import StoredFile
from gateway.vision.pixels import Image
from gateway.vision.transport.ring import Snapshot

S = 1_000_000_000
IMAGE = np.zeros((10, 10, 3), np.uint8)


def picture(t_s: float) -> Snapshot:
    return Snapshot(IMAGE, round(10 * t_s), round(t_s * S))


def filmed(pictures: IncidentPictures, begin_s: float, end_s: float, step_s: float = 0.5) -> None:
    t_s = begin_s
    while t_s <= end_s:
        pictures.add(picture(t_s))
        t_s += step_s


def times(found: object) -> list[float]:
    return [p.t_capture_ns / S for p in found.pictures]  # type: ignore[attr-defined]


def test_from_before_to_after() -> None:
    pictures = IncidentPictures(2.0, 1.0, 10**9)
    filmed(pictures, 0, 10)
    pictures.happened(10 * S, "stop_raised")
    filmed(pictures, 10.5, 10.5)
    assert pictures.due(round(10.9 * S)) is None
    assert pictures.pending
    filmed(pictures, 11, 12)
    found = pictures.due(11 * S)
    assert found is not None
    assert (found.t_ns, found.why) == (10 * S, ("stop_raised",))
    assert times(found) == [8, 8.5, 9, 9.5, 10, 10.5, 11]
    assert pictures.due(20 * S) is None


def test_moments_close_to_each_other_are_one_incident() -> None:
    pictures = IncidentPictures(1.0, 1.0, 10**9)
    filmed(pictures, 0, 5)
    pictures.happened(5 * S, "stop_raised")
    filmed(pictures, 5.5, 5.5)
    pictures.happened(round(5.5 * S), "in_place")
    pictures.happened(round(5.5 * S), "in_place")
    filmed(pictures, 6, 7)
    assert pictures.due(6 * S) is None
    found = pictures.due(7 * S)
    assert found is not None
    assert found.why == ("stop_raised", "in_place")
    assert times(found) == [4, 4.5, 5, 5.5, 6, 6.5]


def test_what_never_ends_is_written_after_half_a_minute() -> None:
    pictures = IncidentPictures(1.0, 5.0, 10**9)
    t_s, found = 0.0, None
    while found is None and t_s < 100:
        pictures.happened(round(t_s * S), "sensor_fault")
        pictures.add(picture(t_s))
        found = pictures.due(round(t_s * S))
        t_s += 0.5
    assert found is not None
    assert t_s == 30.5


def test_memory_is_bounded() -> None:
    pictures = IncidentPictures(30.0, 1.0, 10**9)
    large = np.zeros((4000, 4000, 3), np.uint8)
    for n in range(10):
        pictures.add(Snapshot(large, n, n * S))
    pictures.happened(9 * S, "mark")
    found = pictures.due(20 * S)
    assert found is not None
    assert times(found) == [9]  # 48 MB each, 64 allowed


def test_one_picture_that_stands_still_is_one_picture() -> None:
    pictures = IncidentPictures(5.0, 1.0, 10**9)
    for _ in range(10):
        pictures.add(picture(3))
    pictures.happened(3 * S, "sensor_fault")
    found = pictures.due(5 * S)
    assert found is not None
    assert times(found) == [3]


def kept(pictures: IncidentPictures, at_s: float, size: int, why: str = "stop_raised") -> int:
    """How many of five pictures of an incident the budget allows."""
    filmed(pictures, at_s, at_s + 2)
    pictures.happened(round((at_s + 1) * S), why)
    found = pictures.due(round((at_s + 3) * S))
    assert found is not None
    assert len(found.pictures) == 5
    return len(pictures.kept(found, round((at_s + 3) * S), lambda image: bytes(size)))


def test_a_day_costs_no_more_than_its_budget() -> None:
    pictures = IncidentPictures(
        1.0, 1.0, 172_800
    )  # two bytes a second; a quarter at once, half of it for routine: 21,600
    numbers = [kept(pictures, 10 * n, 1000) for n in range(60)]
    assert numbers[:4] == [5, 5, 5, 1]  # 15,000 gone; less than twice five pictures are left
    total = sum(numbers)
    assert total <= 21.6 + 1.2 + 1
    assert numbers[-1] == 0


def test_it_fills_again() -> None:
    pictures = IncidentPictures(1.0, 1.0, 172_800)
    for n in range(60):
        kept(pictures, 10 * n, 1000)
    assert kept(pictures, DAY_NS / S, 1000) == 5


def test_the_one_picture_is_that_next_to_the_moment() -> None:
    pictures = IncidentPictures(1.0, 1.0, 8000)  # 1000 at once
    filmed(pictures, 0, 4)
    pictures.happened(2 * S + 1, "stop_raised")
    found = pictures.due(10 * S)
    assert found is not None
    kept = pictures.kept(found, 10 * S, lambda image: bytes(900))
    assert [found.pictures[n].t_capture_ns for n in kept] == [2 * S]


def test_what_the_budget_will_refuse_is_not_encoded() -> None:
    """A camera that flickers all day costs one encoding of each picture that is kept, and no more."""
    pictures, encoded = IncidentPictures(1.0, 1.0, 172_800), 0

    def encode(image: Image) -> bytes:
        nonlocal encoded
        encoded += 1
        return bytes(1000)

    total = 0
    for n in range(60):
        filmed(pictures, 10 * n, 10 * n + 2)
        pictures.happened((10 * n + 1) * S, "sensor_fault")
        found = pictures.due((10 * n + 3) * S)
        assert found is not None
        total += len(pictures.kept(found, (10 * n + 3) * S, encode))
    assert encoded == total
    assert 20 < total < 24


def test_pictures_that_became_smaller_are_found_out() -> None:
    pictures = IncidentPictures(1.0, 1.0, 172_800)
    assert [kept(pictures, 10 * n, 4000) for n in range(6)] == [1, 1, 1, 1, 1, 0]
    numbers = [kept(pictures, 60 + 10 * n, 10) for n in range(600)]
    first = next(n for n, number in enumerate(numbers) if number)
    assert numbers[first : first + 2] == [1, 5], "one as large as expected fits again, and shows that it is small"
    assert set(numbers[first + 2 : first + 50]) == {5}


def test_pictures_that_became_larger_stay_within_the_budget() -> None:
    pictures = IncidentPictures(1.0, 1.0, 172_800)
    numbers = [kept(pictures, 10 * n, size) for n, size in enumerate([10, 2000, 2000, 2000, 2000, 20_000])]
    assert numbers == [5, 5, 1, 1, 1, 0]


@pytest.mark.parametrize("why", ["moved", "rolling", "alarm camera_down", "operator_mark"])
def test_what_matters_has_its_pictures_after_any_number_of_routine_stops(why: str) -> None:
    pictures = IncidentPictures(1.0, 1.0, 172_800)
    for n in range(200):
        kept(pictures, 10 * n, 1000)
    assert kept(pictures, 2000, 1000) <= 1
    assert [kept(pictures, 2010 + 10 * n, 1000, why) for n in range(6)] == [5, 5, 5, 5, 1, 1]


def test_a_restart_does_not_refill_the_budget() -> None:
    """What is on the disk tells what of the day is used up."""
    now = 1_800_000_000

    def stored(number: int, ago_s: int, size: int) -> StoredFile:
        return StoredFile(FileName(number, now - ago_s, PICTURES), size)

    assert budget_left([], now, 86_400) == 21_600
    assert budget_left([stored(1, 100, 10_000), stored(2, 50, 5000)], now, 86_400) == 21_600 - 15_000 + 100
    assert budget_left([stored(1, 86_400, 20_000), stored(2, 50, 5000)], now, 86_400) == 21_600 - 5000 + 50
    assert budget_left([stored(1, -9000, 5000)], now, 86_400) == 21_600 - 5000, "a clock that was put back"
    larger = [stored(n, 30 * 86_400 - n * 8640, 50_000) for n in range(300)]
    assert budget_left(larger, now, 86_400) == 8640, "a budget that was lowered since is empty, and fills again"


def test_what_did_not_come_to_the_disk_costs_nothing() -> None:
    pictures = IncidentPictures(1.0, 1.0, 172_800)
    filmed(pictures, 0, 2)
    pictures.happened(S, "stop_raised")
    found = pictures.due(3 * S)
    assert found is not None
    for _ in range(10):
        encoded = pictures.kept(found, 3 * S, lambda image: bytes(1000))
        assert len(encoded) == 5
        pictures.not_written(encoded)


def test_an_incident_says_what_had_no_place_in_memory_and_keeps_each_reason() -> None:
    pictures = IncidentPictures(3.0, 1.0, 10**9)
    large = np.zeros((4000, 4000, 3), np.uint8)
    for n in range(6):
        pictures.add(Snapshot(large, n, n * S))
    for n in range(300):
        pictures.happened(5 * S + n, "sensor_fault")
    pictures.happened(5 * S + 300, "moved")
    found = pictures.due(20 * S)
    assert found is not None
    assert (len(found.pictures), found.dropped, found.why) == (1, 3, ("sensor_fault", "moved"))
