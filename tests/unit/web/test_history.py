"""What was recorded, as programs get it: known numbers from files on a disk; and what is answered without any."""

import csv
import io
import re
import sqlite3
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gateway.core.visit_summary import VisitEnd
from gateway.errors import LinkError
from gateway.records import kept_pictures, visit_search
from gateway.records.index import NAME
from gateway.records.index_reader import IndexReader
from gateway.records.segment import PictureHead
from gateway.web.auth.access import Level
from gateway.web.auth.sessions import Caller
from gateway.web.history import records_thread, routes
from tests.unit.web.gateway_client import plant
from tests.unit.web.history import (
    BEGIN_MS,
    BEGIN_NS,
    HOUR_MS,
    LATER_MS,
    MS,
    VISIT,
    S,
    config,
    folder_of,
    indexed,
    recorded,
)
from tests.unit.web.programs import ApiClient, api_client
from tests.unit.web.test_api import fitting, wrong
from tests.virtual_time import in_virtual_time

MINUTE = 60_000
BAY = "/api/bays/bay1"
AT = f"since_ms={BEGIN_MS}&until_ms={LATER_MS + HOUR_MS}"
VIEWER = Caller("otto", Level.VIEWER, "10.0.0.8", "token")


@asynccontextmanager
async def client(folder: Path, **records: Any) -> AsyncIterator[ApiClient]:
    async with plant(config=config(folder, **records)) as made:
        yield api_client(made)


@in_virtual_time
async def test_visits_are_told_with_their_pictures(tmp_path: Path) -> None:
    indexed(tmp_path, visits=3)
    async with client(tmp_path) as api:
        view = fitting(await api.get(f"{BAY}/visits?{AT}"), "VisitsView")
        (one,) = view["visits"]  # the others ended before
        assert (one["begun_ms"], one["length_s"], one["end"]) == (VISIT.begun_ms, 42.5, "clear")
        assert one["phases_s"]["IN_PLACE"] == 20.0
        assert one["faults"] == [{"reason": "NO_ECHO", "times": 2, "seconds": 1.25}]
        # Kept 0.3 s after the frame of the visit, and 1 s before it.
        assert one["picture"] == {
            "file": 2, "place": 1, "t_ms": BEGIN_MS + 22_300, "frame_id": 78, "why": ["in_place"], "changed": "",
        }  # fmt: skip
        assert view["more"] is False
        alone = fitting(await api.get(f"{BAY}/visits/{VISIT.begun_ms}"), "RecordedVisitView")
        assert alone == one
        every = f"{BAY}/visits?since_ms=0&until_ms={LATER_MS}"
        newest = fitting(await api.get(f"{every}&limit=2"), "VisitsView")
        assert [visit["begun_ms"] for visit in newest["visits"]] == [VISIT.begun_ms, VISIT.begun_ms - HOUR_MS]
        assert [visit["picture"] is None for visit in newest["visits"]] == [False, True]
        assert newest["more"] is True
        assert fitting(await api.get(f"{every}&limit=3"), "VisitsView")["more"] is False
        wrong(await api.get(f"{BAY}/visits/{VISIT.begun_ms + 1}"), 404, "visit")
        assert fitting(await api.get(f"/api/bays/bay2/visits?{AT}"), "VisitsView")["visits"] == []
        wrong(await api.get(f"/api/bays/bay3/visits?{AT}"), 404, "bay")


@in_virtual_time
async def test_visits_as_a_file(tmp_path: Path) -> None:
    indexed(tmp_path, visits=2)
    async with client(tmp_path) as api:
        answer = await api.get(f"{BAY}/visits.csv?since_ms=0&until_ms={LATER_MS}")
        assert answer.headers["content-type"] == "text/csv; charset=utf-8"
        assert answer.headers["content-disposition"] == 'attachment; filename="visits-bay1.csv"'
        first, second = csv.DictReader(io.StringIO(answer.text))
        assert (first["bay"], first["begun_ms"], first["length_s"]) == ("bay1", str(VISIT.begun_ms), "42.5")
        assert (first["end"], first["moved"], first["overrun_mm"]) == ("clear", "no", "")
        assert (first["faults"], first["in_place_s"]) == ("no_echo 2 1.25", "20.0")
        assert second["begun_ms"] == str(VISIT.begun_ms - HOUR_MS)
        assert len({first["begun"], first["ended"], second["begun"], second["ended"]}) == 4
        assert first["begun"][-6] in "+-"  # its zone
        assert len(answer.text.splitlines()) == 3
        one = await api.get(f"{BAY}/visits.csv?since_ms=0&until_ms={LATER_MS}&limit=1")
        assert len(one.text.splitlines()) == 2


@in_virtual_time
async def test_visits_of_weeks_are_searched_by_what_happened(tmp_path: Path) -> None:
    indexed(tmp_path, visits=3)
    span = f"since_ms=0&until_ms={LATER_MS}"
    async with client(tmp_path) as api:
        for query, count in (
            ("", 3), ("&what=faults", 3), ("&what=faults&what=corrected", 3), ("&what=moved", 0),
            ("&reason=no_echo", 3), ("&reason=vision_stale&reason=no_echo", 3), ("&reason=vision_stale", 0),
            ("&alarm=camera_down", 0), ("&what=dust", 0),
            ("&what=faults&limit=2", 2),
        ):  # fmt: skip
            view = fitting(await api.get(f"{BAY}/visits?{span}{query}"), "VisitsView")
            assert (len(view["visits"]), view["more"]) == (count, "limit" in query), query
            answer = await api.get(f"{BAY}/visits.csv?{span}{query}")
            assert len(answer.text.splitlines()) == 1 + count
        wrong(await api.get(f"{BAY}/visits?{span}&reason=rain"), 400, "query")
        wrong(await api.get(f"{BAY}/visits.csv?{span}&what=rain"), 400, "query")
        wrong(await api.get(f"{BAY}/visits.csv?{span}&alarm=rain"), 400, "query")


@pytest.mark.parametrize(
    ("change", "kinds"),
    [
        ({"faults": ()}, {"corrected"}),
        ({"faults": (), "corrections": 0, "unintended": True}, {"moved", "odd"}),
        ({"faults": (), "corrections": 0, "to_position_s": None}, {"never", "odd"}),
        ({"faults": (), "corrections": 0, "interruptions": 1}, {"interrupted", "odd"}),
        ({"faults": (), "corrections": 0, "end": VisitEnd.GATEWAY_OFF}, {"odd"}),
        ({}, {"faults", "odd", "corrected"}),
    ],
)
def test_what_happened_in_a_visit(change: dict[str, Any], kinds: set[str]) -> None:
    visit = replace(VISIT, **change)
    assert {kind.value for kind, fits in visit_search.OF_KIND.items() if fits(visit)} == kinds
    assert set(visit_search.VisitKind) == {*visit_search.OF_KIND, "dust"}
    page = (Path(routes.__file__).parents[1] / "static" / "lib" / "history.js").read_text(encoding="utf-8")
    (shown,) = re.findall(r"export const VISIT_KINDS = \{(.*?)\n\};", page, re.DOTALL)
    assert {*re.findall(r"^  (\w+):", shown, re.MULTILINE)} == {"all", *map(str, visit_search.VisitKind)}


@in_virtual_time
async def test_the_trend_is_merged_and_gaps_stay_gaps(tmp_path: Path) -> None:
    indexed(tmp_path)
    async with client(tmp_path) as api:
        fine = fitting(await api.get(f"{BAY}/trend?{AT}"), "TrendView")
        assert fine["bucket_ms"] == MINUTE
        assert [bucket["t_ms"] for bucket in fine["buckets"]] == [BEGIN_MS, LATER_MS, LATER_MS + MINUTE]
        first, blind, _ = fine["buckets"]
        assert (first["recorded_s"], first["may_move_s"], first["in_place_s"]) == (59.5, 30.0, 29.5)
        assert first["stop_s"] == {"target_reached": 29.5}
        assert (first["r_min"], first["r_mean"], first["r_max"]) == (100.0, 154.5, 180.0)
        assert (first["z_min"], first["z_mean"], first["z_max"]) == (300.0, 600.0, 900.0)
        assert (first["frames"], first["faults"], blind["faults"]) == (60, 0, 1)
        assert (blind["stop_s"], blind["r_mean"]) == ({"vision_stale": 59.5}, None)

        # 71 minutes in at most 7 parts: 11 minutes each, the second of them is without a record.
        merged = fitting(await api.get(f"{BAY}/trend?{AT}&points=7"), "TrendView")
        assert merged["bucket_ms"] == 11 * MINUTE
        assert [bucket["t_ms"] for bucket in merged["buckets"]] == [BEGIN_MS, LATER_MS]
        together = fitting(await api.get(f"{BAY}/trend?{AT}&points=1"), "TrendView")
        (all_of_it,) = together["buckets"]
        assert all_of_it["stop_s"] == {"target_reached": 29.5, "vision_stale": 59.5}
        assert (all_of_it["recorded_s"], all_of_it["may_move_s"], all_of_it["frames"]) == (119.0, 30.0, 60)
        assert (all_of_it["r_min"], all_of_it["r_max"], all_of_it["z_mean"]) == (100.0, 180.0, 600.0)
        empty = fitting(await api.get(f"{BAY}/trend?since_ms=0&until_ms={BEGIN_MS}"), "TrendView")
        assert empty["buckets"] == []


@in_virtual_time
async def test_events_are_the_newest_in_their_order(tmp_path: Path) -> None:
    indexed(tmp_path)
    async with client(tmp_path) as api:
        view = fitting(await api.get(f"{BAY}/history-events?{AT}"), "MarkedEventsView")
        assert view["events"] == [
            {
                "t_ms": LATER_MS,
                "kind": "sensor_fault",
                "sensor": "vision",
                "quality": "LINK_DOWN",
                "detail": "gone",
                "said": [],
            },
            {
                "t_ms": LATER_MS + 59_000,
                "kind": "operator_mark",
                "sensor": "",
                "quality": "",
                "detail": "look here",
                "said": [],
            },
        ]
        assert view["more"] is False
        newest = fitting(await api.get(f"{BAY}/history-events?{AT}&limit=1"), "MarkedEventsView")
        assert ([event["kind"] for event in newest["events"]], newest["more"]) == (["operator_mark"], True)
        only = fitting(
            await api.get(f"{BAY}/history-events?{AT}&kind=sensor_fault&kind=moved&kind=alarm_action"),
            "MarkedEventsView",
        )
        assert [event["kind"] for event in only["events"]] == ["sensor_fault"]
        wrong(await api.get(f"{BAY}/history-events?kind=nothing"), 400, "query")


@in_virtual_time
async def test_kept_pictures_are_listed_once_and_given(tmp_path: Path) -> None:
    bay = indexed(tmp_path)
    async with client(tmp_path) as api:
        view = fitting(await api.get(f"{BAY}/kept-pictures?{AT}"), "KeptPicturesView")
        assert [(p["file"], p["place"], p["frame_id"]) for p in view["pictures"]] == [
            (2, 0, 70), (2, 1, 78), (2, 2, 90), (3, 1, 91),
        ]  # fmt: skip
        newest = fitting(await api.get(f"{BAY}/kept-pictures?{AT}&limit=2"), "KeptPicturesView")
        assert ([p["frame_id"] for p in newest["pictures"]], newest["more"]) == ([90, 91], True)
        some = f"since_ms={BEGIN_MS + 22_000}&until_ms={BEGIN_MS + 23_000}"
        assert len((await api.get(f"{BAY}/kept-pictures?{some}")).json["pictures"]) == 1

        png = await api.get(f"{BAY}/kept-pictures/3/1.png")
        assert (png.status, png.headers["content-type"]) == (200, "image/png")
        assert png.headers["x-picture-time-ms"] == str(BEGIN_MS + 51_000)
        image = cv2.imdecode(np.frombuffer(png.body, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        assert (image.shape, int(image[0, 0, 0])) == ((48, 64, 3), 91)
        jpeg = await api.get(f"{BAY}/kept-pictures/2/0.jpg?width=64")
        assert (jpeg.headers["content-type"], jpeg.body[:2]) == ("image/jpeg", b"\xff\xd8")
        for name in ("3/2", "9/0"):
            wrong(await api.get(f"{BAY}/kept-pictures/{name}.jpg"), 404, "picture")
        wrong(await api.get(f"{BAY}/kept-pictures/1/0.png"), 404, "picture")  # a segment
        wrong(await api.get("/api/bays/bay2/kept-pictures/2/0.png"), 404, "picture")

        (path,) = bay.glob("00000002-*.pictures")
        damaged = bytearray(path.read_bytes())
        damaged[-200] ^= 1  # in the last picture
        path.write_bytes(damaged)
        wrong(await api.get(f"{BAY}/kept-pictures/2/2.png"), 503, "records")
        assert (await api.get(f"{BAY}/kept-pictures/2/1.png")).status == 200


@pytest.mark.parametrize(
    ("least", "caller", "seen"),
    [
        ("viewer", VIEWER, True),
        ("technician", VIEWER, False),
        ("technician", replace(VIEWER, level=Level.TECHNICIAN), True),
        ("nobody", replace(VIEWER, level=Level.TECHNICIAN), False),
    ],
)
def test_pictures_are_for_those_whom_the_configuration_names(
    tmp_path: Path, least: str, caller: Caller, seen: bool
) -> None:
    @in_virtual_time
    async def asked() -> None:
        indexed(tmp_path)
        async with client(tmp_path, pictures_for=least) as made:
            api = replace(made, caller=caller)
            view = fitting(await api.get(f"{BAY}/records"), "RecordsView")
            assert view["pictures"] == ("shown" if seen else "not_for_you")
            (visit,) = fitting(await api.get(f"{BAY}/visits?{AT}"), "VisitsView")["visits"]
            assert (visit["picture"] is not None) == seen
            alone = fitting(await api.get(f"{BAY}/visits/{VISIT.begun_ms}"), "RecordedVisitView")
            assert (alone["picture"] is not None) == seen
            for path in ("kept-pictures", "kept-pictures/2/0.jpg", "kept-pictures/2/0.png"):
                answer = await api.get(f"{BAY}/{path}")
                assert answer.status == (200 if seen else 403)
                if not seen:
                    assert f"records.pictures_for = {least}" in wrong(answer, 403, "pictures")

    asked()


@in_virtual_time
async def test_what_there_is(tmp_path: Path) -> None:
    indexed(tmp_path)
    async with client(tmp_path, pictures=False) as api:
        view = fitting(await api.get(f"{BAY}/records"), "RecordsView")
        assert view.pop("alarms")["camera_down"] == "Camera down"
        assert view == {
            "bay": "bay1", "recorded": True, "why": "", "first_ms": BEGIN_MS, "last_ms": LATER_MS + 2 * MINUTE,
            "pictures": "not_kept",
        }  # fmt: skip
        other = fitting(await api.get("/api/bays/bay2/records"), "RecordsView")
        assert (other["recorded"], other["why"], other["first_ms"], other["last_ms"]) == (True, "", None, None)


@in_virtual_time
async def test_where_nothing_is_recorded_the_key_is_named(tmp_path: Path) -> None:
    async with client(tmp_path, enabled=False) as api:
        view = fitting(await api.get(f"{BAY}/records"), "RecordsView")
        assert (view["recorded"], view["first_ms"]) == (False, None)
        assert "state_dir" in view["why"]
        for path in ("visits", "visits.csv", "visits/5", "trend", "history-events", "kept-pictures"):
            assert "state_dir" in wrong(await api.get(f"{BAY}/{path}"), 503, "not_recorded")


@in_virtual_time
async def test_a_missing_a_damaged_and_an_unreadable_index_are_told_apart(tmp_path: Path) -> None:
    recorded(tmp_path)
    path = folder_of(tmp_path) / NAME
    async with client(tmp_path) as api:
        assert "is not there yet" in wrong(await api.get(f"{BAY}/visits"), 503, "index")
        assert "is not there yet" in fitting(await api.get(f"{BAY}/records"), "RecordsView")["why"]
        # Pictures do not need it.
        assert len((await api.get(f"{BAY}/kept-pictures?{AT}")).json["pictures"]) == 4
        path.write_bytes(b"no database" * 1000)
        assert "not a database" in wrong(await api.get(f"{BAY}/trend"), 503, "index")
        path.unlink()
        path.mkdir()
        assert "cannot be read" in wrong(await api.get(f"{BAY}/trend"), 503, "index")


@in_virtual_time
async def test_numbers_out_of_range_are_refused(tmp_path: Path) -> None:
    indexed(tmp_path)
    async with client(tmp_path) as api:
        for query in (
            "trend?points=0",
            "trend?points=2001",
            "visits?limit=501",
            "visits?since_ms=-1",
            "trend?until_ms=x",
        ):
            wrong(await api.get(f"{BAY}/{query}"), 400, "query")
        # The span may be the wrong way round.
        assert (await api.get(f"{BAY}/trend?since_ms={LATER_MS}&until_ms={BEGIN_MS}")).json["buckets"] == []


def test_minutes_are_merged_by_their_least_largest_and_mean(tmp_path: Path) -> None:
    indexed(tmp_path)
    with closing(sqlite3.connect(folder_of(tmp_path) / NAME)) as db, db:
        columns = "bay, minute, segment, stop_s, recorded_s, r_min, r_mean, r_max, z_min, z_mean, z_max"
        for row in (
            (0, '{"no_echo": 2.5}', 60.0, 10.0, 20.0, 30.0, 500.0, 600.0, 900.0),
            (1, '{"no_echo": 1.0, "plc_lost": 4.0}', 30.0, 5.0, 40.0, 50.0, 400.0, 700.0, 800.0),
            (2, "{}", 60.0, None, None, None, None, None, None),
        ):
            marks = ", ".join("?" * len(row[1:]))
            db.execute(f"INSERT INTO minutes({columns}) VALUES ('bay1', {row[0]}, 1, {marks})", row[1:])
    length_ms, (found,) = IndexReader(folder_of(tmp_path)).trend("bay1", 0, 3 * MINUTE, 1)
    assert (length_ms, found.t_ms, found.recorded_s) == (3 * MINUTE, 0, 150.0)
    assert (found.r_min, found.r_mean, found.r_max) == (5.0, 30.0, 50.0)
    assert (found.z_min, found.z_mean, found.z_max) == (400.0, 650.0, 900.0)
    assert found.stop_s == {"no_echo": 3.5, "plc_lost": 4.0}


def test_a_question_that_takes_too_long_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    indexed(tmp_path)
    with closing(sqlite3.connect(folder_of(tmp_path) / NAME)) as db, db:
        rows = [(n,) for n in range(20_000)]
        db.executemany("INSERT INTO minutes(bay, minute, segment, stop_s) VALUES ('bay1', ?, 1, '{}')", rows)
    reader = IndexReader(folder_of(tmp_path))
    assert len(reader.trend("bay1", 0, 20_000 * MINUTE, 5)[1]) == 5
    monkeypatch.setattr("gateway.records.index_reader.MOST_NS", 0)
    with pytest.raises(LinkError, match="interrupted"):
        reader.trend("bay1", 0, 20_000 * MINUTE, 5)


@in_virtual_time
async def test_too_many_who_wait_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    indexed(tmp_path)
    monkeypatch.setattr(records_thread, "MAX_WAITING", 0)
    async with client(tmp_path) as api:
        answer = await api.get(f"{BAY}/visits")
        wrong(answer, 503, "busy")
        assert answer.headers["retry-after"] == "2"


def test_the_nearest_picture_is_within_what_was_asked(tmp_path: Path) -> None:
    bay = recorded(tmp_path)
    at_ns = BEGIN_NS + 22 * S

    def frames(within_ns: int, *times_ns: int | None) -> list[int | None]:
        found = kept_pictures.nearest(bay, times_ns, within_ns)
        return [None if picture is None else picture.head.frame_id for picture in found]

    assert frames(2 * S, at_ns, None, at_ns - 600 * MS, at_ns + 10 * S) == [78, None, 70, None]
    assert frames(300 * MS, at_ns) == [78]
    assert frames(299 * MS, at_ns) == [None]
    assert kept_pictures.nearest(tmp_path / "nowhere", [at_ns], S) == [None]
    assert kept_pictures.kept(tmp_path / "nowhere", 0, 10**19, 5) == []
    assert kept_pictures.picture(tmp_path / "nowhere", 2, 0) is None


@pytest.mark.one_interpreter
def test_a_file_that_was_cut_off_lists_what_is_before(tmp_path: Path) -> None:
    bay = recorded(tmp_path)
    (path,) = bay.glob("00000003-*.pictures")
    whole = path.read_bytes()
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        found = kept_pictures.kept(bay, BEGIN_NS + 51 * S, BEGIN_NS + 52 * S, 10)
        assert [picture.head for picture in found] in (
            [],
            [PictureHead(91, BEGIN_NS + 51 * S, BEGIN_NS + 51 * S, "png", ("in_place",))],
        )
