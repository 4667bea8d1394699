"""Visits and minutes outlive their segments: the files of rows, cut, damaged, refused, and the index made of them."""

import errno
import os
from dataclasses import replace
from pathlib import Path

import hypothesis.strategies as st
import msgspec
import pytest
from hypothesis import given

from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.files import write_all
from gateway.records import row_files
from gateway.records.files import files_in
from gateway.records.index import Index
from gateway.records.index_reader import IndexReader
from gateway.records.index_rows import MINUTE_COLUMNS, Minute, MinuteRow
from gateway.records.names import ROWS, FileName
from gateway.records.record import RegisterImage, TickRecord, VisitRecord, packed
from gateway.records.retention import DAY_S, RetentionLimits, StoredFile, surplus
from gateway.records.row_files import KeptRows
from gateway.records.segment import MAGIC, BlockKind, Head, block, records_block
from gateway.records.store import Store
from tests.unit.records.test_index import content, work
from tests.unit.records.test_segment import HEAD

pytestmark = pytest.mark.one_interpreter

S = 10**9
BEGUN_MS = 1_800_000_000_000
MINUTE = BEGUN_MS // 60_000
NOW = BEGUN_MS // 1000


def visit(n: int) -> VisitSummary:
    return VisitSummary(BEGUN_MS + n * 900_000, 60.0, VisitEnd.CLEAR, in_place_s=30.0, times_in_place=1)


def minute(n: int) -> MinuteRow:
    return replace(Minute(MINUTE + n), recorded_ns=60 * S, frames=1800, stops={"no_target": n}).row


def kept(n: int, minutes: int = 1) -> KeptRows:
    """Of segment `n`."""
    text = msgspec.json.encode(visit(n)).decode()
    rows = [minute(15 * n + m) for m in range(minutes)]
    columns = {name: [row[place] for row in rows] for place, name in enumerate(MINUTE_COLUMNS)}
    return KeptRows(n, BEGUN_MS + n * 900_000, [(visit(n).begun_ms, visit(n).last_seen_ms, text)], columns)


def one_file(folder: Path, count: int) -> Path:
    """The rows of segments 1 to `count`."""
    folder.mkdir(parents=True, exist_ok=True)
    (name,) = {row_files.append(folder, kept(n)) for n in range(1, count + 1)}
    return folder / str(name)


def store(folder: Path, unix_ns: int, t_ns: int = 0) -> Store:
    def head(number: int) -> Head:
        return msgspec.structs.replace(HEAD, number=number, boot="a", t_ns=t_ns, unix_ns=unix_ns)

    return Store(folder, RetentionLimits(10**15, 0, 0), 0.0, head)


def recorded(folder: Path, last: int, first: int = 1) -> None:
    """Segments of one bay: a visit and a minute in each."""
    for n in range(first, last + 1):
        unix_ns = visit(n).begun_ms * 10**6
        written = store(folder, unix_ns, unix_ns)
        records = [TickRecord(t_ns=unix_ns), VisitRecord(t_ns=unix_ns + 1, visit=visit(n))]
        written.append(records_block(n, [packed(record) for record in records]), 0, begins=True)
        written.close()


def visits(folder: Path) -> list[VisitSummary]:
    return IndexReader(folder).visits("bay1", 0, 2**60, 100)[::-1]


def test_what_is_read_is_what_was_appended(tmp_path: Path) -> None:
    path = one_file(tmp_path, 3)
    assert path.name == "00000001-20270115T081500Z.rows"
    found = row_files.read(path)
    assert found.rows == [kept(1), kept(2), kept(3)]
    assert (found.end, found.damaged) == (path.stat().st_size, 0)
    assert found.rows[0].minute_rows == [minute(15)]
    assert path.stat().st_mode & 0o777 == 0o640


@pytest.mark.long
def test_cut_at_every_byte_it_holds_what_was_complete_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fdatasync", lambda fd: None)  # what is looked at are the bytes
    path = one_file(tmp_path / "whole", 3)
    data = path.read_bytes()
    ends = [len(MAGIC + b"".join(row_files.rows_block(kept(n)) for n in range(1, upto + 1))) for upto in range(4)]
    assert ends[-1] == len(data)
    cut = tmp_path / "bay1" / path.name
    cut.parent.mkdir()
    for length in range(len(data) + 1):
        cut.write_bytes(data[:length])
        complete = sum(length >= end for end in ends[1:])
        assert row_files.read(cut).rows == [kept(n) for n in range(1, complete + 1)]
        row_files.append(cut.parent, kept(4))
        assert row_files.read(cut).rows == [*(kept(n) for n in range(1, complete + 1)), kept(4)]


def test_an_index_of_a_file_that_was_cut(tmp_path: Path) -> None:
    path = one_file(tmp_path / "bay1", 2)
    data, second = path.read_bytes(), len(row_files.rows_block(kept(2)))
    ends = (len(data) - second, len(data))
    for length in sorted({0, *range(4, len(data), 40), *(end - 1 for end in ends), *ends}):
        path.write_bytes(data[:length])
        Index(tmp_path).rebuild()
        complete = sum(length >= end for end in ends)
        assert visits(tmp_path) == [visit(n) for n in range(1, complete + 1)]
        assert len(content(tmp_path)["minutes"]) == complete


@pytest.mark.parametrize("live", [True, False])
def test_what_was_cut_off_is_made_again_from_its_segments(tmp_path: Path, live: bool) -> None:
    recorded(tmp_path / "bay1", 4)
    Index(tmp_path).rebuild()
    whole = content(tmp_path)
    (path,) = (tmp_path / "bay1").glob("*.rows")
    data = path.read_bytes()
    for length in (0, 5, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:length])
        if live:
            (tmp_path / "index.sqlite").unlink()
            index = Index(tmp_path)
            work(index)
            index.close()
        Index(tmp_path).rebuild()
        for table in ("files", "visits", "minutes", "events"):
            assert content(tmp_path)[table] == whole[table], length
        for segment in (tmp_path / "bay1").glob("*.seg"):
            segment.rename(segment.with_suffix(".away"))
        Index(tmp_path).rebuild()
        assert content(tmp_path)["visits"] == whole["visits"]
        assert content(tmp_path)["minutes"] == whole["minutes"]
        for segment in (tmp_path / "bay1").glob("*.away"):
            segment.rename(segment.with_suffix(".seg"))


def test_whichever_segments_are_deleted_the_index_is_the_same_live_and_made_anew(tmp_path: Path) -> None:
    recorded(tmp_path / "bay1", 6)
    index = Index(tmp_path)
    work(index)
    for gone in ("00000002", "00000005", "00000001"):
        (path,) = (tmp_path / "bay1").glob(f"{gone}*.seg")
        path.unlink()
        work(index)
        live = content(tmp_path)
        index.close()
        assert visits(tmp_path) == [visit(n) for n in range(1, 7)]
        assert len(live["minutes"]) == 5, "the newest is not over"
        (tmp_path / "index.sqlite").unlink()
        index = Index(tmp_path)
        work(index)
        assert content(tmp_path) == live
    index.close()


def test_a_byte_that_changed_costs_its_block_and_where_the_segment_is_nothing(tmp_path: Path) -> None:
    path = one_file(tmp_path / "bay1", 3)
    data = bytearray(path.read_bytes())
    data[len(MAGIC) + 40] ^= 1
    path.write_bytes(data)
    Index(tmp_path).rebuild()
    assert visits(tmp_path) == [visit(2), visit(3)]
    assert content(tmp_path)["row_files"][0][-1] == len(row_files.rows_block(kept(1)))
    recorded(tmp_path / "new", 1)
    (segment,) = (tmp_path / "new").glob("*.seg")
    segment.rename(tmp_path / "bay1" / segment.name)
    Index(tmp_path).rebuild()
    assert visits(tmp_path) == [visit(1), visit(2), visit(3)]


def test_a_segment_that_is_damaged_later_costs_no_visit(tmp_path: Path) -> None:
    recorded(tmp_path / "bay1", 2)
    Index(tmp_path).rebuild()
    whole = content(tmp_path)
    segment = min((tmp_path / "bay1").glob("*.seg"))
    data = bytearray(segment.read_bytes())
    data[-5] ^= 1  # in its records
    segment.write_bytes(data)
    Index(tmp_path).rebuild()
    after = content(tmp_path)
    assert (after["visits"], after["minutes"]) == (whole["visits"], whole["minutes"])
    assert after["files"] != whole["files"], "its damage is counted"


def test_a_file_of_rows_that_became_shorter_is_read_anew(tmp_path: Path) -> None:
    path = one_file(tmp_path / "bay1", 3)
    index = Index(tmp_path)
    work(index)
    data = path.read_bytes()
    path.write_bytes(data[:-1])
    work(index)
    assert visits(tmp_path) == [visit(1), visit(2)]
    path.write_bytes(data)
    work(index)
    index.close()
    assert visits(tmp_path) == [visit(1), visit(2), visit(3)]


def test_a_disk_that_refuses_leaves_the_file_as_it_was_and_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded(tmp_path / "bay1", 2)
    Index(tmp_path).rebuild()
    (path,) = (tmp_path / "bay1").glob("*.rows")
    before = path.read_bytes()
    recorded(tmp_path / "bay1", 3, first=3)

    def full(fd: int, data: bytes) -> None:
        write_all(fd, data[:10])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(row_files, "write_all", full)
    (tmp_path / "index.sqlite").unlink()
    index = Index(tmp_path)
    work(index)
    assert index.fault == ""
    recorded(tmp_path / "bay1", 4, first=4)  # so that the third is over
    work(index)
    assert "No space left" in index.fault
    assert path.read_bytes() == before
    monkeypatch.undo()
    work(index)
    index.close()
    assert index.fault == ""
    assert [rows.segment for rows in row_files.read(path).rows] == [1, 2, 3]


def test_rows_of_a_version_with_fewer_columns_are_read(tmp_path: Path) -> None:
    earlier = kept(1, minutes=2)
    del earlier.minutes["stops"], earlier.minutes["r_min"]
    later = KeptRows(2, BEGUN_MS, [], kept(2).minutes | {"new": [7]})
    for rows in (earlier, later):
        row_files.append(tmp_path, rows)
    (path,) = tmp_path.iterdir()
    first, second = row_files.read(path).rows
    names = dict(zip(MINUTE_COLUMNS, first.minute_rows[1], strict=True))
    assert (names["minute"], names["frames"], names["stops"], names["r_min"]) == (MINUTE + 16, 1800, "{}", None)
    assert second.minute_rows == [minute(30)]


@given(st.lists(st.one_of(st.binary(max_size=40), st.integers(1, 3)), max_size=6), st.data())
def test_no_bytes_raise_anything(parts: list[bytes | int], data: st.DataObject) -> None:
    payloads = [block(BlockKind.ROWS, p) if isinstance(p, bytes) else row_files.rows_block(kept(p)) for p in parts]
    raw = bytearray(b"".join([MAGIC, *payloads]))
    for _ in range(data.draw(st.integers(0, 3))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    folder = Path(os.environ.get("TMPDIR", "/tmp"))
    path = folder / f"rows-{os.getpid()}.rows"
    path.write_bytes(raw)
    try:
        found = row_files.read(path)
    finally:
        path.unlink()
    assert found.end <= len(raw)
    assert all(isinstance(rows, KeptRows) and rows.minute_rows is not None for rows in found.rows)


def test_a_file_that_is_full_or_a_week_old_is_followed_by_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(row_files, "MAX_BYTES", 500)
    for n in (1, 2, 3):
        row_files.append(tmp_path, kept(n))
    numbers = {file.name.number: [r.segment for r in row_files.read(tmp_path / str(file.name)).rows]
               for file in files_in(tmp_path)}  # fmt: skip
    assert numbers == {1: [1, 2], 3: [3]}
    monkeypatch.undo()
    row_files.append(tmp_path, kept(4 * 24 * 7 + 3))
    assert len(files_in(tmp_path)) == 2, "it is not more than a week yet"
    row_files.append(tmp_path, kept(4 * 24 * 7 + 4))
    row_files.append(tmp_path, kept(3))  # a clock that was set back, or an old segment
    assert [file.name.number for file in files_in(tmp_path)] == [1, 3, 676, 677]


def test_numbers_go_on_where_only_rows_are_left(tmp_path: Path) -> None:
    one_file(tmp_path, 3)
    recorded(tmp_path, 1)
    assert [file.name.number for file in files_in(tmp_path) if file.name.kind != ROWS] == [4]


def test_another_segment_of_the_same_number_is_kept_itself(tmp_path: Path) -> None:
    recorded(tmp_path / "bay1", 1)
    Index(tmp_path).rebuild()
    for path in (tmp_path / "bay1").glob("*.seg"):
        path.unlink()
    other = replace(visit(1), begun_ms=visit(9).begun_ms)
    written = store(tmp_path / "bay1", visit(9).begun_ms * 10**6)
    written._number = 0
    written.append(records_block(1, [packed(VisitRecord(t_ns=1, visit=other))]), 0, begins=True)
    written.close()
    Index(tmp_path).rebuild()
    assert visits(tmp_path) == [other]


def test_an_image_of_registers_alone_is_a_minute(tmp_path: Path) -> None:
    assert row_files.newest_segment(tmp_path) == 0
    unix_ns = visit(1).begun_ms * 10**6
    written = store(tmp_path, unix_ns)
    written.append(records_block(1, [packed(RegisterImage(t_ns=1, unix_ns=unix_ns, words=b""))]), 0, begins=True)
    written.close()
    assert row_files.newest_segment(tmp_path) == 0


# Retention.


def stored(number: int, days: float, size: int = 100, kind: str = ROWS) -> StoredFile:
    return StoredFile(FileName(number, int(NOW - days * DAY_S), kind), size)


def gone(
    files: list[StoredFile], limits: RetentionLimits, unix_s: float | None = NOW, missing: int = 0
) -> list[tuple[int, str]]:
    return [(file.name.number, file.name.kind) for file in surplus(files, limits, unix_s, missing)]


def test_rows_stay_when_segments_go() -> None:
    files = [stored(1, 90), stored(1, 90, kind=".seg"), stored(2, 80, kind=".seg"), stored(3, 0, kind=".seg")]
    assert gone(files, RetentionLimits(10**6, 30, 0, 365)) == [(1, ".seg"), (2, ".seg")]
    assert gone(files, RetentionLimits(10**6, 0, 0, 365), missing=10**9) == [(1, ".seg"), (2, ".seg")]


def test_rows_go_when_all_of_a_file_is_too_old_but_the_newest_file() -> None:
    files = [stored(1, 30), stored(5, 20), stored(9, 15)]
    assert gone(files, RetentionLimits(10**6, 1, 1, 19)) == [(1, ROWS)]
    assert gone(files, RetentionLimits(10**6, 1, 1, 14)) == [(1, ROWS), (5, ROWS)]
    assert gone(files, RetentionLimits(10**6, 1, 1, 0)) == []
    assert gone(files, RetentionLimits(10**6, 1, 1, 1), None) == []


def test_a_clock_of_1970_makes_no_rows_old() -> None:
    epoch_days = NOW / DAY_S
    files = [stored(1, 5), stored(5, epoch_days), stored(9, 3)]
    assert gone(files, RetentionLimits(10**6, 0, 0, 10)) == []


def test_rows_have_a_tenth_at_most_and_all_together_what_is_allowed() -> None:
    files = [stored(1, 9), stored(2, 8), stored(3, 7), stored(4, 6, 700, ".seg"), stored(5, 5, 100, ".seg")]
    assert gone(files, RetentionLimits(2000, 0, 0)) == [(1, ROWS)]
    assert gone(files, RetentionLimits(1000, 0, 0)) == [(1, ROWS), (2, ROWS)]
    assert gone(files, RetentionLimits(899, 0, 0)) == [(1, ROWS), (2, ROWS), (4, ".seg")]
