"""A bay's statistics, as programs get them: known numbers from files on a disk, days of the plant's calendar."""

import csv
import io
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from gateway.core.state import Reason
from gateway.records.index import Index
from gateway.records.record import AnyRecord, EventRecord, TickRecord, VisitRecord
from gateway.web.manager import collected
from gateway.web.manager.views import HEADER
from tests.unit.web import history
from tests.unit.web.gateway_client import plant
from tests.unit.web.history import BEGIN_MS, BEGIN_NS, LATER_MS, MS, VISIT, S, config, indexed, recorded
from tests.unit.web.programs import ApiClient, api_client
from tests.unit.web.test_api import fitting, wrong
from tests.virtual_time import LoopClock, in_virtual_time

STATISTICS = "/api/bays/bay1/statistics"
THREE = "from=2026-11-22&to=2026-11-24"
HOUR_MS = 3_600_000


@pytest.fixture(autouse=True)
def berlin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The plant's calendar, whatever that of this machine is."""
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


class DatedClock(LoopClock):
    """Its Unix time is always the same."""

    def __init__(self, unix_ns: int) -> None:
        self.unix_ns = unix_ns

    def wall_ns(self) -> int:
        return self.unix_ns


@asynccontextmanager
async def client(folder: Path, wall_ms: int = BEGIN_MS + 9 * 24 * HOUR_MS) -> AsyncIterator[ApiClient]:
    """At that moment."""
    async with plant(config=config(folder)) as made:
        made.client.clock = DatedClock(wall_ms * MS)
        yield api_client(made)


def alarm(at_ms: int, text: str) -> EventRecord:
    return EventRecord(t_ns=at_ms * MS, kind="alarm", detail=text)


@in_virtual_time
async def test_three_days_of_which_one_was_recorded(tmp_path: Path) -> None:
    indexed(tmp_path)
    async with client(tmp_path) as api:
        view = fitting(await api.get(f"{STATISTICS}?{THREE}"), "StatisticsView")
    assert (view["site"], view["bay"], view["time_zone"]) == ("site", "bay1", "Europe/Berlin")
    assert (view["first"], view["last"]) == ("2026-11-22", "2026-11-24")
    assert view["recorded_from"] == "2026-11-23T03:14:00+01:00"
    assert [day["begin"] for day in view["days"]] == [f"2026-11-{n}T00:00:00+01:00" for n in (22, 23, 24)]
    empty, full, _ = view["days"]
    assert (empty["times"]["recorded_s"], empty["times"]["unrecorded_s"]) == (0, 86_400)
    assert (empty["times"]["availability"], empty["positions"]["trucks"], empty["alarms"]) == (None, 0, 0)
    times = full["times"]
    assert times == view["times"] | {"passed_s": 86_400, "unrecorded_s": times["unrecorded_s"]} | {
        "recorded_share": times["recorded_share"]
    }, "the other days add nothing"
    assert times["recorded_s"] == pytest.approx(119, abs=1)
    assert times["unrecorded_s"] == pytest.approx(86_400 - times["recorded_s"])
    assert times["may_move_s"] == pytest.approx(30, abs=0.5)
    assert times["in_place_s"] == pytest.approx(29.5, abs=0.5)
    assert times["stop_s"] == pytest.approx({"at_mark": 29.5, "no_measurement": 0, "fault": 60}, abs=0.6)
    assert [(cause["reason"], cause["kind"], cause["times"]) for cause in times["causes"]] == [
        ("vision_stale", "fault", 1),
        ("target_reached", "at_mark", 1),
    ]
    assert times["good_s"] == pytest.approx(times["recorded_s"] - times["stop_s"]["fault"])
    assert times["availability"] == pytest.approx(0.5, abs=0.01)
    positions = view["positions"]
    assert positions == full["positions"]
    assert (positions["trucks"], positions["placed"], positions["corrections"]) == (1, 1, 2)
    assert (positions["to_position_s"]["median"], positions["distance_mm"]["mean"]) == (14.0, 301.0)
    assert positions["offset_mm"] is None
    assert view["aim"] is False
    assert view["alarms"]["announced"] == 0
    assert view["alarms"]["benchmarks"][0]["value"] == 0
    assert {one["verdict"] for one in view["alarms"]["benchmarks"]} == {None}, "of two minutes nothing is judged"
    assert view["remarks"] == []


@in_virtual_time
async def test_a_truck_at_midnight_is_of_the_day_on_which_it_arrived(tmp_path: Path) -> None:
    """It arrives at 23:59:50 of the 22nd and leaves on the 23rd."""
    bay = recorded(tmp_path)
    midnight_ms = BEGIN_MS - 3 * HOUR_MS - 14 * 60_000
    visit = VisitRecord(t_ns=BEGIN_NS, visit=replace(VISIT, begun_ms=midnight_ms - 10_000))
    history._segment(bay, 9, LATER_MS * MS + 90 * S, [visit])
    Index(bay.parent).rebuild()
    async with client(tmp_path) as api:
        view = fitting(await api.get(f"{STATISTICS}?{THREE}"), "StatisticsView")
        assert [day["positions"]["trucks"] for day in view["days"]] == [1, 1, 0]
        assert view["positions"]["trucks"] == 2
        one = fitting(await api.get(f"{STATISTICS}?from=2026-11-23&to=2026-11-23"), "StatisticsView")
        assert one["positions"]["trucks"] == 1


@in_virtual_time
async def test_alarms_of_the_days(tmp_path: Path) -> None:
    """One from before goes on; one comes three times within a minute."""
    bay = recorded(tmp_path)
    since_ms = LATER_MS - 26 * HOUR_MS
    history._segment(bay, 0, since_ms * MS, [alarm(since_ms, "broker_lost: occurs, now unacknowledged: refused")])
    found: list[AnyRecord] = [TickRecord(t_ns=(LATER_MS + 90_000) * MS)]
    for n in range(3):
        at_ms = LATER_MS + 100_000 + n * 20_000
        found.append(alarm(at_ms, "bay1.camera_stale: occurs, now unacknowledged"))
        found.append(alarm(at_ms + 5_000, "bay1.camera_stale: returns, now returned"))
    history._segment(bay, 9, (LATER_MS + 90_000) * MS, found)
    Index(bay.parent).rebuild()
    async with client(tmp_path) as api:
        view = fitting(await api.get(f"{STATISTICS}?from=2026-11-23&to=2026-11-24"), "StatisticsView")
    alarms = view["alarms"]
    assert (alarms["announced"], [day["alarms"] for day in view["days"]]) == (3, [3, 0])
    assert alarms["by_priority"] == {"high": 3}
    assert alarms["chattering"] == ["bay1.camera_stale"]
    assert alarms["frequent"] == [
        {"id": "bay1.camera_stale", "title": "Camera without new pictures", "times": 3, "share": 1.0}
    ]
    (standing,) = alarms["standing"]
    assert (standing["id"], standing["title"], standing["over"]) == ("broker_lost", "MQTT broker lost", False)
    assert standing["since"] == "2026-11-22T01:25:00+01:00"
    assert alarms["stale"] == [standing]
    values = {one["figure"]: one["value"] for one in alarms["benchmarks"]}
    assert (values["chattering"], values["stale_most"], values["peak_10_min"]) == (1, 1, 3)


@in_virtual_time
async def test_the_newest_days_by_default_and_today_is_not_over(tmp_path: Path) -> None:
    indexed(tmp_path)
    async with client(tmp_path, BEGIN_MS + HOUR_MS) as api:
        view = fitting(await api.get(STATISTICS), "StatisticsView")
        assert (view["first"], view["last"], len(view["days"])) == ("2026-11-17", "2026-11-23", 7)
        assert view["days"][-1]["times"]["passed_s"] == pytest.approx(4 * 3600 + 14 * 60, abs=1)
        assert view["made"].startswith("2026-11-23T04:14:0")
        later = fitting(await api.get(f"{STATISTICS}?to=2026-11-24"), "StatisticsView")
        assert later["first"] == "2026-11-18"
        assert later["days"][-1]["times"]["passed_s"] == 0
        assert later["days"][-1]["times"]["recorded_share"] is None


@in_virtual_time
async def test_a_file_has_a_row_for_each_day(tmp_path: Path) -> None:
    indexed(tmp_path)
    async with client(tmp_path) as api:
        answer = await api.get(f"{STATISTICS}.csv?{THREE}")
    assert answer.status == 200
    assert answer.headers["content-type"] == "text/csv; charset=utf-8"
    name = "statistics-bay1-2026-11-22-to-2026-11-24.csv"
    assert answer.headers["content-disposition"] == f'attachment; filename="{name}"'
    header, *rows = csv.reader(io.StringIO(answer.body.decode()))
    assert tuple(header) == HEADER
    assert [len(row) for row in rows] == [len(HEADER)] * 3
    before, day, _ = (dict(zip(header, row, strict=True)) for row in rows)
    assert (day["date"], day["begin"]) == ("2026-11-23", "2026-11-23T00:00:00+01:00")
    assert (day["trucks"], day["to_position_s_median"], day["offset_mm_median"]) == ("1", "14.0", "")
    assert float(day["stop_vision_stale_s"]) == pytest.approx(60, abs=0.6)
    assert (day["stop_vision_stale_times"], before["stop_vision_stale_times"]) == ("1", "0")
    assert (before["recorded_s"], before["unrecorded_s"], before["to_position_s_median"]) == ("0.0", "86400.0", "")


@pytest.mark.one_interpreter
@in_virtual_time
async def test_days_that_cannot_be_answered(tmp_path: Path) -> None:
    indexed(tmp_path)
    async with client(tmp_path) as api:
        for query in (
            "from=yesterday", "from=2026-02-30", "to=1999-12-31", "from=1700000000", "to=2026-11-2", "to=",
            "from=2026-11-24&to=2026-11-23", "from=2026-01-01&to=2026-04-03", "from=٢٠٢٦-01-01",
        ):  # fmt: skip
            wrong(await api.get(f"{STATISTICS}?{query}"), 400, "query")
            wrong(await api.get(f"{STATISTICS}.csv?{query}"), 400, "query")
        quarter = fitting(await api.get(f"{STATISTICS}?from=2026-01-01&to=2026-04-02"), "StatisticsView")
        assert len(quarter["days"]) == 92
        hours = {day["date"]: day["times"]["passed_s"] / 3600 for day in quarter["days"]}
        assert hours.pop("2026-03-29") == 23
        assert set(hours.values()) == {24}
        wrong(await api.get("/api/bays/bay3/statistics"), 404, "bay")


@in_virtual_time
async def test_without_an_index_it_says_why(tmp_path: Path) -> None:
    async with client(tmp_path) as api:
        wrong(await api.get(STATISTICS), 503, "index")
    async with plant() as made:
        made_api = api_client(made)
        made_api.app.state.services.records.folder = None
        wrong(await made_api.get(STATISTICS), 503, "not_recorded")


@in_virtual_time
async def test_what_is_too_much_is_remarked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bay = recorded(tmp_path, visits=2)
    flicker: list[AnyRecord] = [EventRecord(t_ns=LATER_MS * MS + n, kind="sensor_fault") for n in range(1003)]
    flicker += [alarm(LATER_MS + n, "broker_lost: occurs, now unacknowledged") for n in range(2)]
    history._segment(bay, 9, LATER_MS * MS, flicker)
    Index(bay.parent).rebuild()
    monkeypatch.setattr(collected, "MAX_VISITS", 1)
    monkeypatch.setattr(collected, "MAX_EVENTS", 2)
    async with client(tmp_path) as api:
        view = fitting(await api.get(f"{STATISTICS}?{THREE}"), "StatisticsView")
    assert view["positions"]["trucks"] == 1
    assert view["remarks"] == [
        "more than 1 visits, of which the newest count: 2026-11-23",
        "more than 2 changes of alarms, of which the oldest count: choose fewer days",
        "3 events came so often that they are not in the index: alarms may be missing here",
    ]


def test_every_reason_has_its_columns() -> None:
    assert len(set(HEADER)) == len(HEADER)
    assert {f"stop_{reason.name.lower()}_s" for reason in Reason} - set(HEADER) == {"stop_none_s"}
    assert msgspec.json.encode(HEADER)
