"""Days of the plant's calendar: their lengths, where clocks are changed, and that none overlap."""

import itertools
import os
import time
from collections.abc import Iterator
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.records.days import LocalDay, known_zone, local_date, local_days, machine_zone_name, shown

BERLIN = ZoneInfo("Europe/Berlin")
HOUR_MS = 3_600_000


@pytest.fixture
def new_york(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", "America/New_York")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


def hours(days: list[LocalDay]) -> list[float]:
    return [(day.end_ms - day.begin_ms) / HOUR_MS for day in days]


def test_a_day_has_23_or_25_hours_where_clocks_are_changed() -> None:
    spring = local_days(date(2026, 3, 28), date(2026, 3, 30), BERLIN)
    assert hours(spring) == [24, 23, 24]
    assert [shown(day.begin_ms, BERLIN) for day in spring] == [
        "2026-03-28T00:00:00+01:00",
        "2026-03-29T00:00:00+01:00",
        "2026-03-30T00:00:00+02:00",
    ]
    assert hours(local_days(date(2026, 10, 24), date(2026, 10, 26), BERLIN)) == [24, 25, 24]


def test_a_midnight_that_the_clocks_leave_out_is_when_they_are_put_forward() -> None:
    days = local_days(date(2024, 9, 7), date(2024, 9, 9), ZoneInfo("America/Santiago"))
    assert hours(days) == [24, 23, 24]
    assert shown(days[1].begin_ms, ZoneInfo("America/Santiago")) == "2024-09-08T01:00:00-03:00"


def test_a_day_that_a_country_left_out_has_no_length() -> None:
    assert hours(local_days(date(2011, 12, 29), date(2011, 12, 31), ZoneInfo("Pacific/Apia"))) == [24, 0, 24]


def test_how_much_of_a_day_is_over() -> None:
    (day,) = local_days(date(2026, 3, 29), date(2026, 3, 29), BERLIN)
    assert day.passed_s(day.begin_ms - 1) == 0
    assert day.passed_s(day.begin_ms + 90_500) == 90.5
    assert day.passed_s(day.end_ms + 1) == 23 * 3600


ZONES = ("UTC", "Europe/Berlin", "America/Sao_Paulo", "Asia/Kathmandu", "Australia/Lord_Howe", "Pacific/Apia")
DATES = st.dates(date(2000, 1, 1), date(2037, 1, 1))


@given(DATES, st.integers(0, 40), st.sampled_from(ZONES))
def test_days_follow_each_other_without_gap(first: date, count: int, name: str) -> None:
    zone = ZoneInfo(name)
    days = local_days(first, first + timedelta(days=count), zone)
    assert [day.date for day in days] == [first + timedelta(days=n) for n in range(count + 1)]
    assert all(before.end_ms == after.begin_ms for before, after in itertools.pairwise(days))
    for day in days:
        if day.end_ms > day.begin_ms:
            assert local_date(day.begin_ms, zone) == local_date(day.end_ms - 1, zone) == day.date
            assert local_date(day.begin_ms - 1, zone) < day.date


def test_without_a_zone_it_is_that_of_the_machine(new_york: None) -> None:
    zone = ZoneInfo("America/New_York")
    span = date(2026, 3, 1), date(2026, 11, 30)
    assert local_days(*span) == local_days(*span, zone)
    moment = round(datetime(2026, 7, 1, 12, tzinfo=UTC).timestamp() * 1000)
    assert shown(moment) == "2026-07-01T08:00:00-04:00"
    assert local_date(moment - 9 * HOUR_MS) == date(2026, 6, 30)
    assert machine_zone_name() == "America/New_York"


@pytest.mark.parametrize(("written", "name"), [(":/usr/share/zoneinfo/Asia/Tokyo", "Asia/Tokyo"), ("UTC", "UTC")])
def test_the_zone_is_named_as_people_know_it(monkeypatch: pytest.MonkeyPatch, written: str, name: str) -> None:
    monkeypatch.setenv("TZ", written)
    assert machine_zone_name() == name


def test_without_a_variable_it_is_the_one_that_etc_localtime_links(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TZ", raising=False)
    monkeypatch.setattr(os.path, "realpath", lambda _: "/usr/share/zoneinfo/Europe/Berlin")
    assert machine_zone_name() == "Europe/Berlin"
    monkeypatch.setattr(os.path, "realpath", lambda path: path)
    monkeypatch.setattr(Path, "read_text", lambda *_, **__: "Asia/Tokyo\n")
    assert machine_zone_name() == "Asia/Tokyo"


@pytest.mark.parametrize(
    ("written", "named"), [("Europe/Berlin", "Europe/Berlin"), ("Nowhere/Never", "+00:00"), ("<+0530>-5:30", "+05:30")]
)
def test_the_pages_are_told_a_zone_that_is_known(monkeypatch: pytest.MonkeyPatch, written: str, named: str) -> None:
    with monkeypatch.context() as changed:
        changed.setenv("TZ", written)
        time.tzset()
        assert known_zone() == named
    time.tzset()
