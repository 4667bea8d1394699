"""The index of the recordings: what it holds, that it can be made anew, and that no fault of it stops anything."""

import multiprocessing
import sqlite3
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import pytest

from gateway.cli.main import main
from gateway.core.events import Event, EventKind
from gateway.core.state import Reason, StateVector, Tick
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.errors import LinkError
from gateway.processes import seccomp
from gateway.records import recording
from gateway.records.collector import Collector
from gateway.records.index import NAME, Index
from gateway.records.index_reader import IndexReader
from gateway.records.index_rows import MAX_EVENTS, SegmentRows
from gateway.records.index_tables import TABLES
from gateway.records.record import (
    Checkpoint,
    Decision,
    EventRecord,
    Gap,
    RegisterImage,
    TickRecord,
    VisitRecord,
    packed,
)
from gateway.records.retention import RetentionLimits
from gateway.records.segment import Head, records_block
from gateway.records.store import SEGMENT_NS, Store
from tests.unit.records.test_segment import HEAD
from tests.visit_bench import UNIX_NS, Bench, truck

pytestmark = pytest.mark.one_interpreter

S = 10**9
BEGUN_NS = 996 * S  # of the bench's clock
VISIT = VisitSummary(1_800_000_000_000, 60.0, VisitEnd.CLEAR, in_place_s=30.0, times_in_place=1)
LONG_NS = 10**12


def store(folder: Path, boot: str = "a", t_ns: int = BEGUN_NS) -> Store:
    def head(number: int) -> Head:
        return msgspec.structs.replace(HEAD, number=number, boot=boot, t_ns=t_ns, unix_ns=t_ns + UNIX_NS)

    return Store(folder, RetentionLimits(10**15, 0, 0), 0.0, head)


@cache
def _recorded() -> tuple[Bench, dict[str, bytes]]:
    """What is copied to the folders of the tests."""
    with TemporaryDirectory() as folder:
        bench = _record(Path(folder))
        files = {str(path.relative_to(folder)): path.read_bytes() for path in sorted(Path(folder).glob("*/*"))}
    return bench, files


def recorded(folder: Path) -> Bench:
    bench, files = _recorded()
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return bench


def _record(folder: Path) -> Bench:
    """A visit of a minute in two segments of one bay, and a small one in another."""
    kept = store(folder / "bay1")
    legs = ({"distance_cm": 28, "speed_cm_s": 20, "hold_s": 30}, {"distance_cm": 150, "speed_cm_s": 30, "hold_s": 60})
    bench = Bench(truck(*legs, start={"distance_cm": 115}))
    bench.record = collector = Collector(lambda: bench.unix_ns)
    collector(None, bench.state, [])
    bench.open_visit = lambda: bench.progress.open(bench.now_ns)
    number = 0
    for until_s in (10, 40, 70):
        bench.run(until_s)
        while (chunk := collector.take()) is not None:
            number += 1
            late_ns = SEGMENT_NS if until_s == 70 else 0
            kept.append(records_block(number, chunk.records), bench.now_ns + late_ns, begins=chunk.begins)
    kept.close()
    other = store(folder / "bay2")
    other.append(records_block(1, [packed(VisitRecord(t_ns=BEGUN_NS, visit=VISIT))]), 0, begins=True)
    other.close()
    return bench


def content(folder: Path) -> dict[str, list[Any]]:
    with closing(sqlite3.connect(folder / NAME)) as db, db:
        rows = {table: db.execute(f"SELECT * FROM {table}").fetchall() for table in TABLES}
    db.close()
    return rows


def work(index: Index) -> None:
    index._due_ns = 0
    while index.work(LONG_NS):
        pass


def test_it_holds_visits_events_minutes_and_files(tmp_path: Path) -> None:
    bench = recorded(tmp_path)
    Index(tmp_path).rebuild()
    reader = IndexReader(tmp_path)
    ended = [event.summary for event in bench.events if event.summary is not None]
    assert ended == []  # the bench makes no events of visits: see below
    assert reader.visits("bay2", 0, 2 * VISIT.begun_ms, 10) == [VISIT]
    assert reader.visits("bay2", VISIT.last_seen_ms + 1, 2 * VISIT.begun_ms, 10) == []
    assert reader.visits("bay2", 0, VISIT.begun_ms, 10) == []
    assert reader.visit("bay2", VISIT.begun_ms) == VISIT
    assert reader.visit("bay1", VISIT.begun_ms) is None

    begun_ms = (BEGUN_NS + UNIX_NS) // 10**6
    minutes = reader.minutes("bay1", begun_ms, begun_ms + 200_000, 10)
    numbers = [int(str(minute["minute"])) for minute in minutes]
    assert numbers == sorted(numbers)
    assert sum(float(str(minute["recorded_s"])) for minute in minutes) == pytest.approx(74, abs=0.5)
    moments = [moment.state for moment in bench.moments]
    placed_s = sum(state.in_place for state in moments) * 0.02
    assert sum(float(str(minute["in_place_s"])) for minute in minutes) == pytest.approx(placed_s, abs=0.2)
    free_s = sum(state.may_move for state in moments) * 0.02
    assert sum(float(str(minute["may_move_s"])) for minute in minutes) == pytest.approx(free_s, abs=4.1)
    assert sum(int(str(minute["frames"])) for minute in minutes) == pytest.approx(74 * 30, abs=5)
    assert min(float(str(minute["z_min"])) for minute in minutes) == pytest.approx(276, abs=5)
    assert max(float(str(minute["r_max"])) for minute in minutes) == pytest.approx(193, abs=1.5)
    stopped = msgspec.json.decode(str(minutes[1]["stop_s"]))
    assert set(stopped) <= {"target_reached", "stop_latched", "moved", "no_target", "no_echo", "starting"}

    events = reader.events("bay1", begun_ms, begun_ms + 200_000, 1000)
    assert [event["kind"] for event in events] == [event.kind.value for event in bench.events]
    placed = next(event for event in bench.events if event.kind.value == "in_place")
    told = next(event for event in events if event["kind"] == "in_place")
    assert told["t_ms"] == (placed.t_ns + UNIX_NS) // 10**6
    assert told["detail"] == placed.detail
    assert str(told["file"]).startswith("00000001-")
    with closing(sqlite3.connect(tmp_path / NAME)) as db, db:
        files = db.execute("SELECT bay, number, complete, lost, damaged FROM files ORDER BY bay, number").fetchall()
    assert files == [("bay1", 1, 1, 0, 0), ("bay1", 2, 1, 0, 0), ("bay2", 1, 1, 0, 0)]


def test_made_while_it_was_written_and_made_anew_it_is_the_same(tmp_path: Path) -> None:
    whole, live = tmp_path / "whole", tmp_path / "live"
    recorded(whole)
    Index(whole).rebuild()
    index = Index(live)
    for bay in ("bay1", "bay2"):
        (live / bay).mkdir(parents=True)
        for source in sorted((whole / bay).glob("*.seg")):
            data = source.read_bytes()
            for end in range(0, len(data), 7001):
                (live / bay / source.name).write_bytes(data[:end])
                work(index)
                assert index.fault == ""
            (live / bay / source.name).write_bytes(data)
            work(index)
    assert len(content(live)["minutes"]) == len(content(whole)["minutes"]) - 2, "the newest minutes are not over"
    index.close()
    Index(live).rebuild()
    assert content(live) == content(whole)


def test_after_a_crash_it_goes_on_and_no_row_is_twice(tmp_path: Path) -> None:
    recorded(tmp_path)
    index = Index(tmp_path)
    work(index)
    index.close()  # without its newest minutes
    again = Index(tmp_path)
    work(again)
    again.close()
    before = content(tmp_path)
    Index(tmp_path).rebuild()
    after = content(tmp_path)
    assert before["events"] == after["events"]
    assert before["visits"] == after["visits"]
    assert set(before["minutes"]) < set(after["minutes"])


def test_a_batch_that_was_written_twice_counts_once(tmp_path: Path) -> None:
    event = [packed(EventRecord(t_ns=BEGUN_NS, kind="start"))]
    for boot, number in (("a", 1), ("a", 1), ("a", 2), ("b", 1)):
        kept = store(tmp_path / "bay1", boot)
        kept.append(records_block(number, event), 0, begins=True)
        kept.close()
    Index(tmp_path).rebuild()
    assert [row[2] for row in content(tmp_path)["events"]] == [1, 3, 4]


def test_of_what_is_deleted_visits_and_minutes_stay_until_their_file_of_rows_goes(tmp_path: Path) -> None:
    recorded(tmp_path)
    index = Index(tmp_path)
    work(index)
    before = content(tmp_path)
    (first, _) = sorted((tmp_path / "bay1").glob("*.seg"))
    (rows_file,) = (tmp_path / "bay1").glob("*.rows")
    assert not list((tmp_path / "bay2").glob("*.rows")), "its segment is not over"
    first.unlink()
    for path in (tmp_path / "bay2").iterdir():
        path.unlink()
    (tmp_path / "bay2").rmdir()
    work(index)
    after = content(tmp_path)
    assert {(row[0], row[1]) for row in after["files"]} == {("bay1", 2)}
    assert after["visits"] == []
    assert {row[2] for row in after["events"]} <= {2}
    assert after["minutes"] == [row for row in before["minutes"] if row[0] == "bay1"]
    assert {row[-1] for row in after["minutes"]} == {1, 2}
    rows_file.unlink()
    work(index)
    index.close()
    gone = content(tmp_path)
    assert {row[-1] for row in gone["minutes"]} == {2}
    assert (gone["kept"], gone["row_files"]) == ([], [])
    assert gone["files"] == after["files"]


def test_the_end_of_a_visit_is_read_at_once_and_only_in_its_bay(tmp_path: Path) -> None:
    index = Index(tmp_path)
    for bay in ("bay1", "bay2"):
        kept = store(tmp_path / bay)
        kept.append(records_block(1, [packed(TickRecord(t_ns=BEGUN_NS))]), 0, begins=True)
        kept.close()
    work(index)
    for bay in ("bay1", "bay2"):
        (path,) = (tmp_path / bay).iterdir()
        with path.open("ab") as file:
            file.write(records_block(2, [packed(VisitRecord(t_ns=BEGUN_NS, visit=VISIT))]))
    assert not index.work(LONG_NS)
    assert content(tmp_path)["visits"] == [], "its minute is not over"
    index.soon("bay2")
    assert not index.work(LONG_NS)
    assert [row[0] for row in content(tmp_path)["visits"]] == ["bay2"]
    index.soon("unknown")
    assert not index.work(LONG_NS)
    work(index)
    index.close()
    assert [row[0] for row in content(tmp_path)["visits"]] == ["bay1", "bay2"]


def test_a_visit_that_ends_while_the_index_is_read_is_not_forgotten(tmp_path: Path) -> None:
    recorded(tmp_path)
    index = Index(tmp_path)
    assert index.work(0), "there is more"
    index.soon("bay2")
    while index._work is not None:
        more = index.work(LONG_NS)
    assert more, "and no pause before it"
    assert not index.work(LONG_NS)
    index.close()


@pytest.mark.parametrize("rubbish", [b"", b"no database", b"SQLite format 3\0" + b"\xff" * 5000])
def test_a_damaged_index_is_set_aside_and_made_anew(tmp_path: Path, rubbish: bytes) -> None:
    recorded(tmp_path)
    (tmp_path / NAME).write_bytes(rubbish)
    index = Index(tmp_path)
    work(index)
    work(index)
    assert index.fault == ""
    assert index.set_aside == bool(rubbish)
    index.close()
    assert content(tmp_path)["visits"]


def test_pages_overwritten_in_the_middle_are_noticed_at_the_next_start(tmp_path: Path) -> None:
    recorded(tmp_path)
    Index(tmp_path).rebuild()
    whole = content(tmp_path)
    path = tmp_path / NAME
    data = bytearray(path.read_bytes())
    data[4096 : 4096 * 4] = b"\xee" * 4096 * 3
    path.write_bytes(data)
    index = Index(tmp_path)
    work(index)
    work(index)
    index.close()
    assert index.set_aside == 1
    assert content(tmp_path)["visits"] == whole["visits"]


def test_an_index_of_another_version_is_set_aside(tmp_path: Path) -> None:
    recorded(tmp_path)
    with closing(sqlite3.connect(tmp_path / NAME)) as db, db:
        db.execute("PRAGMA user_version = 99")
    db.close()
    with pytest.raises(LinkError, match="another version"):
        IndexReader(tmp_path).visits("bay1", 0, 1, 1)
    index = Index(tmp_path)
    work(index)
    work(index)
    index.close()
    assert (index.fault, index.set_aside) == ("", 1)


def test_one_that_is_locked_waits_and_catches_up(tmp_path: Path) -> None:
    recorded(tmp_path)
    index = Index(tmp_path)
    work(index)
    for path in (tmp_path / "bay1").iterdir():
        path.unlink()
    other = sqlite3.connect(tmp_path / NAME, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    work(index)
    assert "locked" in index.fault
    other.execute("ROLLBACK")
    other.close()
    work(index)
    assert (index.fault, index.set_aside) == ("", 0)
    index.close()
    assert {row[0] for row in content(tmp_path)["files"]} == {"bay2"}


def test_two_never_write_it(tmp_path: Path) -> None:
    recorded(tmp_path)
    first, second = Index(tmp_path), Index(tmp_path)
    work(first)
    work(second)
    assert second.fault != ""
    with pytest.raises(BlockingIOError):
        second.rebuild()
    assert main(["records", "rebuild", str(tmp_path)]) == 1
    first.close()
    work(second)
    assert second.fault == ""
    second.close()


def test_where_no_file_can_be_made_nothing_is_raised(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    index = Index(tmp_path / "file")
    work(index)
    assert index.fault
    with pytest.raises(LinkError):
        IndexReader(tmp_path / "file").visits("bay1", 0, 1, 1)


def test_what_flickers_does_not_fill_it() -> None:
    rows = SegmentRows(HEAD)
    for n in range(MAX_EVENTS + 5):
        rows.add(EventRecord(t_ns=HEAD.t_ns + n, kind="sensor_fault", sensor="range"))
    rows.finish()
    assert (len(rows.events), rows.events_left_out) == (MAX_EVENTS, 5)
    assert rows.minutes[0][7] == MAX_EVENTS + 5
    for n in range(MAX_EVENTS + 2):
        rows.add(EventRecord(t_ns=HEAD.t_ns + n, kind="alarm", detail="bay1.camera_down: occurs, now unacknowledged"))
    assert [kind for _, kind, *_ in rows.events].count("alarm") == MAX_EVENTS, "those that flicker leave room for them"
    assert rows.events_left_out == 7
    rows = SegmentRows(HEAD)
    for kind in ("alarm", "sensor_fault"):
        for n in range(MAX_EVENTS):
            rows.add(EventRecord(t_ns=HEAD.t_ns + n, kind=kind))
    assert (len(rows.events), rows.events_left_out) == (2 * MAX_EVENTS, 0)


def test_a_clock_that_was_set_dates_what_follows() -> None:
    rows = SegmentRows(HEAD)
    rows.add(RegisterImage(t_ns=HEAD.t_ns + S, unix_ns=HEAD.unix_ns + 3600 * S, words=b""))
    rows.add(EventRecord(t_ns=HEAD.t_ns + 2 * S, kind="start"))
    assert rows.events[0][0] == (HEAD.unix_ns + 3601 * S) // 10**6


def test_time_of_which_nothing_is_known_is_of_no_output() -> None:
    rows = SegmentRows(HEAD)
    t_ns = HEAD.t_ns
    rows.add(TickRecord(t_ns=t_ns))
    rows.add(TickRecord(t_ns=t_ns + S // 2))
    rows.add(Gap(t_ns=t_ns + S, lost=7, why="not written in time"))
    rows.add(TickRecord(t_ns=t_ns + S + S // 2))
    rows.finish()
    assert rows.lost == 7
    assert [minute[1:6] for minute in rows.minutes] == [(0.0, 0.0, 0.0, "{}", "{}")]


def _decided(t_ns: int, reason: Reason) -> Decision:
    outputs = Decision.of(replace(Bench(truck()).state, stop=reason is not Reason.NONE, reason=reason))
    return msgspec.structs.replace(outputs, t_ns=t_ns)


def test_how_often_each_reason_became_that_of_stop() -> None:
    """The segment goes on where the one before ended: that stop was counted there."""
    rows, t_ns = SegmentRows(HEAD), HEAD.t_ns
    stopped = replace(Bench(truck()).state, stop=True, reason=Reason.NO_TARGET, t_ns=t_ns)
    story = (Reason.NO_TARGET, Reason.TARGET_REACHED, Reason.NONE, Reason.TARGET_REACHED, Reason.NO_TARGET)
    rows.add(Checkpoint(t_ns=t_ns, state=stopped, follows=True))
    for n, reason in enumerate(story):
        rows.add(_decided(t_ns + n * S, reason))
    rows.add(Gap(t_ns=t_ns + 6 * S, lost=7, why="not written in time"))
    rows.add(Checkpoint(t_ns=t_ns + 6 * S, state=stopped))
    rows.add(Checkpoint(t_ns=t_ns + 7 * S, state=stopped, follows=True))
    rows.add(_decided(t_ns + 8 * S, Reason.NO_TARGET))
    rows.finish()
    assert [minute[5] for minute in rows.minutes] == ['{"no_target":2,"target_reached":2}']


def test_a_stop_whose_begin_was_damaged_counts_at_the_next_checkpoint() -> None:
    rows, t_ns = SegmentRows(HEAD), HEAD.t_ns
    rows.add(_decided(t_ns, Reason.NONE))
    stopped = replace(Bench(truck()).state, stop=True, reason=Reason.NO_TARGET, t_ns=t_ns + S)
    rows.add(Checkpoint(t_ns=t_ns + S, state=stopped, follows=True))
    rows.finish()
    assert rows.minutes[0][5] == '{"no_target":1}'


def test_the_first_stop_of_a_start_counts() -> None:
    rows, state = SegmentRows(HEAD), Bench(truck()).state
    rows.add(Checkpoint(t_ns=HEAD.t_ns, state=state))
    rows.add(msgspec.structs.replace(Decision.of(state), t_ns=HEAD.t_ns))
    rows.finish()
    assert rows.minutes[0][5] == '{"starting":1}'


def test_events_of_some_kinds_only_and_how_many_are_left_out(tmp_path: Path) -> None:
    recorded(tmp_path)
    Index(tmp_path).rebuild()
    reader, begun_ms = IndexReader(tmp_path), (BEGUN_NS + UNIX_NS) // 10**6
    some = reader.events("bay1", begun_ms, begun_ms + 200_000, 1000, ("in_place", "stop_raised"))
    assert {event["kind"] for event in some} == {"in_place", "stop_raised"}
    assert reader.events_left_out("bay1", 0, 2 * begun_ms) == 0
    with closing(sqlite3.connect(tmp_path / NAME)) as db, db:
        db.execute("UPDATE files SET events_left_out = number + 2 WHERE bay = 'bay1'")
    db.close()
    assert reader.events_left_out("bay1", 0, 2 * begun_ms) == 7
    assert reader.events_left_out("bay1", 0, begun_ms) == 0
    assert reader.events_left_out("bay3", 0, 2 * begun_ms) == 0


# A visit goes on after a restart.


def open_visit(folder: Path, *visits: VisitSummary, boot: str = "a") -> None:
    kept = store(folder, boot)
    records = [packed(VisitRecord(t_ns=BEGUN_NS + n, visit=visit)) for n, visit in enumerate(visits)]
    kept.append(records_block(1, records or [packed(TickRecord(t_ns=0))]), 0, begins=True)
    kept.close()


def test_the_visit_that_was_open_is_found_in_the_recording(tmp_path: Path) -> None:
    open_ = replace(VISIT, end=VisitEnd.OPEN)
    assert recording.open_visit(tmp_path, "now") is None
    open_visit(tmp_path, open_)
    assert recording.open_visit(tmp_path, "now") == open_
    open_visit(tmp_path, replace(open_, length_s=70.0), boot="b")
    assert recording.open_visit(tmp_path, "now") == replace(open_, length_s=70.0)
    assert recording.open_visit(tmp_path, "b") is None, "only the recorder was started again"
    open_visit(tmp_path, boot="c")
    assert recording.open_visit(tmp_path, "now") == replace(open_, length_s=70.0)
    open_visit(tmp_path, open_, VISIT, boot="d")
    assert recording.open_visit(tmp_path, "now") is None


def test_an_open_visit_is_recorded_every_ten_seconds_and_at_the_end() -> None:
    collector = Collector(lambda: UNIX_NS)
    open_ = replace(VISIT, end=VisitEnd.OPEN)
    state = StateVector("bay1")
    for second in range(25):
        collector(Tick() if second else None, replace(state, t_ns=second * S + 1), [], lambda: open_)
    collector(None, replace(state, t_ns=26 * S), [], lambda: open_)
    taken = []
    while (chunk := collector.take()) is not None:
        taken += [msgspec.msgpack.decode(record) for record in chunk.records]
    assert [record["t_ns"] // S for record in taken if record["is"] == "visit"] == [0, 10, 20, 26]


def test_the_recorder_hears_that_a_visit_is_over() -> None:
    collector = Collector(lambda: UNIX_NS)
    state = StateVector("bay1", t_ns=1)
    collector(None, state, [])
    collector(Tick(), replace(state, t_ns=2), [Event(EventKind.VISIT_ENDED, "bay1", 2, state)])
    quiet = collector.take()
    collector(Tick(), replace(state, t_ns=3), [Event(EventKind.VISIT, "bay1", 3, state, summary=VISIT)])
    ended = collector.take()
    assert quiet is not None
    assert ended is not None
    assert (quiet.visit_ended, ended.visit_ended) == (False, True)


# The web process may only read files.


def _read_confined(folder: str, result: "multiprocessing.Queue[object]") -> None:
    seccomp.refuse()
    result.put(len(IndexReader(Path(folder)).events("bay1", 0, 10**15, 5)))


def test_a_process_that_may_only_read_files_can_ask_while_it_is_written(tmp_path: Path) -> None:
    recorded(tmp_path)
    index = Index(tmp_path)
    work(index)
    context = multiprocessing.get_context("fork")
    result: multiprocessing.Queue[object] = context.Queue()
    child = context.Process(target=_read_confined, args=(str(tmp_path), result))
    child.start()
    assert result.get(timeout=60) == 5
    child.join()
    index.close()


def test_the_verb_lists_what_is_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recorded(tmp_path)
    (first, _) = sorted((tmp_path / "bay1").glob("*.seg"))
    first.with_name(first.name + ".pin").touch()
    assert main(["records", "list", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("bay1: 2 files, ")
    assert lines[0].endswith(", 1 pinned")
    assert "2 segments" in lines[1]
    assert lines[2] == f"  pinned: {first.name}"
    assert main(["records", "rebuild", str(tmp_path)]) == 0
    assert content(tmp_path)["visits"]
    assert main(["records", "list", str(tmp_path / "none")]) == 2
