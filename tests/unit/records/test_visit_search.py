"""Visits of weeks by what happened: the same for the page and the command line."""

import csv
import io
import json
import re
import sqlite3
from collections import Counter
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from gateway.cli import records_search, tables
from gateway.cli.main import main
from gateway.core.state import Moved
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.records import kept_pictures, names, picture_search
from gateway.records.index import NAME
from gateway.records.index_reader import IndexReader
from gateway.records.visit_search import VisitKind, VisitSearch
from tests.unit.web.history import HOUR_MS, LATER_MS, VISIT, folder_of, indexed

pytestmark = pytest.mark.one_interpreter

FIRST, SECOND, THIRD = (VISIT.begun_ms - n * HOUR_MS for n in range(3))  # the newest first


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The camera was down before the second visit and until its middle, dust was seen from the middle of the third
    until a start of the gateway, and the picture was blurred in the first."""
    indexed(tmp_path, visits=3)
    changes = (
        (SECOND - 60_000, "alarm", "bay1.camera_down: occurs, now unacknowledged: gone"),
        (SECOND - 30_000, "alarm", "bay1.camera_down: acknowledge, now acknowledged by otto"),
        (SECOND + 20_000, "alarm", "bay1.camera_down: returns, now normal"),
        (THIRD + 20_000, "alarm", "bay1.picture_poor: occurs, now unacknowledged: dusty (veil 61%)"),
        (THIRD + 90_000, "start", ""),
        (FIRST + 1_000, "alarm", "bay1.picture_poor: occurs, now unacknowledged: blurred (sharpness 3%)"),
        (FIRST + 2_000, "alarm", "something of a later version"),
    )
    with closing(sqlite3.connect(folder_of(tmp_path) / NAME)) as db, db:
        for place, (t_ms, kind, detail) in enumerate(changes):
            row = ("bay1", t_ms, 7, place, kind, "", "", detail)
            db.execute("INSERT INTO events VALUES (?, ?, ?, ?, ?, ?, ?, ?)", row)
    return folder_of(tmp_path)


@pytest.mark.parametrize(
    ("search", "begun"),
    [
        (VisitSearch(), [FIRST, SECOND, THIRD]),
        (VisitSearch(alarms=("camera_down",)), [SECOND]),
        (VisitSearch(alarms=("picture_poor",)), [FIRST, THIRD]),
        (VisitSearch(alarms=("camera_down", "picture_poor")), [FIRST, SECOND, THIRD]),
        (VisitSearch((VisitKind.DUST,)), [THIRD]),
        (VisitSearch((VisitKind.DUST, VisitKind.FAULTS)), [THIRD]),
        (VisitSearch((VisitKind.DUST, VisitKind.MOVED)), []),
        (VisitSearch((VisitKind.DUST,), alarms=("camera_down",)), []),
        (VisitSearch(reasons=("no_echo",), alarms=("camera_down",)), [SECOND]),
        (VisitSearch(reasons=("vision_stale",)), []),
    ],
)
def test_a_visit_is_found_by_what_was_so_while_the_truck_was_there(
    folder: Path, search: VisitSearch, begun: list[int]
) -> None:
    found = search.found(IndexReader(folder), "bay1", 0, LATER_MS, 10)
    assert [visit.begun_ms for visit in found] == begun


def test_older_ones_follow_at_the_oldest_that_is_known(folder: Path) -> None:
    search, reader = VisitSearch(), IndexReader(folder)
    pages = [search.found(reader, "bay1", 0, until_ms, 1) for until_ms in (LATER_MS, FIRST, SECOND, THIRD)]
    assert [[visit.begun_ms for visit in page] for page in pages] == [[FIRST], [SECOND], [THIRD], []]


def test_the_command_finds_the_same(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def told(*more: str, code: int = 0) -> str:
        assert main(["records", "search", str(folder), *more]) == code
        return capsys.readouterr().out

    (visit,) = json.loads(told("--alarm", "camera_down", "--json"))["visits"]
    assert (visit["bay"], visit["begun_ms"], visit["picture"]) == ("bay1", SECOND, None)
    every = json.loads(told("--json"))["visits"]
    assert [one["begun_ms"] for one in every] == [FIRST, SECOND, THIRD]
    assert every[0]["picture"] == {"file": 2, "place": 1}
    rows = list(csv.DictReader(io.StringIO(told("--csv", "--what", "faults", "--what", "dust"))))
    assert [(row["bay"], row["begun_ms"]) for row in rows] == [("bay1", str(THIRD))]
    assert told("--what", "moved", "--json", code=1) == '{"visits": []}\n'
    assert told("--what", "moved", code=1).splitlines()[-1] == "0 visits"
    monkeypatch.setattr(tables, "WIDTH", 80)
    lines = told("--bay", "bay1").splitlines()
    assert lines[-1] == "3 visits"
    assert all(len(line) <= 80 for line in lines)
    assert sum(bool(re.match(r"2026-11-2\d \d\d:\d\d:\d\d\.\d{3}[+-]\d\d:\d\d ", line.strip())) for line in lines) == 3
    assert any(line.rstrip().endswith(" 2/1") for line in lines)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--alarm", "rain"), "--alarm rain: no such alarm"),
        (("--bay", "bay9"), "no recording of bay 'bay9'; there: bay1"),
        (("--from", "soon"), "not a time"),
    ],
)
def test_what_is_not_known_is_named(
    folder: Path, capsys: pytest.CaptureFixture[str], more: tuple[str, ...], said: str
) -> None:
    assert main(["records", "search", str(folder), *more]) == 2
    assert said in capsys.readouterr().err


def test_without_an_index_it_says_how_one_is_made(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / NAME).unlink()
    assert main(["records", "search", str(folder)]) == 2
    assert f"`gateway records rebuild {folder}`" in capsys.readouterr().err


def test_csv_reads_no_pictures(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(records_search, "pictures_of", None)
    assert main(["records", "search", str(folder), "--csv"]) == 0
    assert capsys.readouterr().out.count("\nbay1,") == 3


@pytest.mark.parametrize(("unintended", "cell"), [(True, "distance"), (False, "-")])
def test_a_usual_departure_is_no_motion(unintended: bool, cell: str) -> None:
    left = replace(VISIT, moved=Moved.DISTANCE, unintended=unintended)
    assert records_search._cells("bay1", left, None)[4] == cell


def test_names_are_read_once_for_all_visits(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: Counter[str] = Counter()
    parsed = names.parsed

    def counting(name: str) -> names.FileName | None:
        read[name] += 1
        return parsed(name)

    times_ns = [VISIT.begun_ms * NS_PER_MS + n * NS_PER_S for n in range(40)]
    monkeypatch.setattr(kept_pictures, "heads", lambda _: iter(()))
    monkeypatch.setattr(names, "parsed", counting)
    kept_pictures.nearest(folder / "bay1", times_ns, NS_PER_S)
    assert {name: n for name, n in read.items() if name.endswith(".pictures")} == {
        "00000002-20261123T021453Z.pictures": 2,  # in the folder, and for the order
        "00000003-20261123T021454Z.pictures": 2,
    }


def test_files_between_are_those_of_that_time() -> None:
    files = [(unix_s, Path(str(unix_s))) for unix_s in (100, 200, 200, 351, 352)]

    def of(begin_s: int, end_s: int) -> list[int]:
        return [unix_s for unix_s, _ in picture_search.between(files, begin_s * NS_PER_S, end_s * NS_PER_S)]

    assert of(201, 201) == [200, 200, 351]  # one is written for 150 s after its first picture at most
    assert of(202, 202) == [351, 352]
    assert of(0, 10) == [100]
    assert of(900, 910) == []


def test_from_and_to(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["records", "search", str(folder), "--json", "--from", "2026-11-23T02:15:30+00:00"]) == 1
    assert main(["records", "search", str(folder), "--json", "--from", "2026-11-23T02:14:30+00:00"]) == 0
    assert len(json.loads(capsys.readouterr().out.splitlines()[-1])["visits"]) == 1
