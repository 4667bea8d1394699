"""The files of a recording on a disk that fills, fails and forgets; and how they are read again."""

import errno
import os
from pathlib import Path

import msgspec
import pytest

from gateway.errors import ConfigError
from gateway.records import recording
from gateway.records.completeness import Verified, verified
from gateway.records.files import files_in
from gateway.records.names import PICTURES, PIN, parsed
from gateway.records.record import Gap, TickRecord, packed
from gateway.records.recording import MissingItem
from gateway.records.retention import RetentionLimits
from gateway.records.segment import Head, PictureHead, SegmentBefore, picture_block, records_block
from gateway.records.store import SEGMENT_NS, Store, digest
from tests.unit.records.test_segment import HEAD

UNLIMITED = RetentionLimits(10**15, 0, 0)


def store(folder: Path, limits: RetentionLimits = UNLIMITED, boot: str = "a", unix_s: int = 1_800_000_000) -> Store:
    def head(number: int) -> Head:
        return msgspec.structs.replace(HEAD, number=number, boot=boot, unix_ns=unix_s * 10**9)

    return Store(folder, limits, 0.0, head)


def ticks(number: int) -> bytes:
    return records_block(number, [packed(TickRecord(t_ns=number))])


def read(folder: Path) -> tuple[list[int], list[str]]:
    """Times of the ticks, and what is missing."""
    items = list(recording.records(recording.segments_of([folder])))
    return [i[1].t_ns for i in items if isinstance(i, tuple)], [i.why for i in items if isinstance(i, MissingItem)]


def test_a_new_segment_begins_at_a_checkpoint_after_a_quarter_of_an_hour(tmp_path: Path) -> None:
    kept = store(tmp_path / "bay1")
    for number, (t_ns, begins) in enumerate(
        [(0, False), (SEGMENT_NS, False), (SEGMENT_NS + 1, True), (SEGMENT_NS + 2, True)], 1
    ):
        kept.append(ticks(number), t_ns, begins=begins)
    kept.close()
    names = [str(f.name) for f in files_in(tmp_path / "bay1")]
    assert names == ["00000001-20270115T080000Z.seg", "00000002-20270115T080000Z.seg"]
    assert read(tmp_path / "bay1") == ([1, 2, 3, 4], [])


def test_numbers_go_on_over_restarts_whatever_the_clock_says(tmp_path: Path) -> None:
    for n, unix_s in enumerate((1_800_000_000, 0, 1_900_000_000), 1):
        kept = store(tmp_path, boot=str(n), unix_s=unix_s)
        kept.append(ticks(n), 0, begins=True)
        kept.close()
    assert [f.name.number for f in files_in(tmp_path)] == [1, 2, 3]
    assert read(tmp_path)[0] == [1, 2, 3]


def test_none_begins_while_a_recorder_that_was_replaced_may_still_write_the_one_before(tmp_path: Path) -> None:
    replaced, kept = store(tmp_path), store(tmp_path, boot="b")
    replaced.append(ticks(1), 0, begins=True)
    with pytest.raises(BlockingIOError, match="the recorder before this one still writes 00000001-"):
        kept.append(ticks(1), 0, begins=True)
    replaced.append(ticks(2), 1, begins=False)
    replaced.close()  # as at the end of its process
    kept.append(ticks(1), 0, begins=True)
    kept.close()
    assert verified(recording.segments_of([tmp_path])) == Verified((), 1, 0)


def test_each_segment_names_the_one_before_it_also_over_a_restart(tmp_path: Path) -> None:
    for boot in ("a", "b"):
        kept = store(tmp_path, RetentionLimits(0, 0, 0), boot=boot)
        kept.append(ticks(1), 0, begins=True)
        kept.append(ticks(2), SEGMENT_NS, begins=True)
        kept.close()
        kept.pictures([picture_block(PictureHead(1, 1, 1, "png"), b"x")], matter=False)
    paths = recording.segments_of([tmp_path])
    known = [head.before for path in paths if (head := recording.head_in(path)) is not None]
    expected = [SegmentBefore(path.name, path.stat().st_size, digest(path)) for path in paths]
    assert known == [SegmentBefore(), *expected[:-1]]
    kept.delete_surplus(None)  # nothing may stay, but the next segment must name the newest one
    kept.append(ticks(3), 0, begins=True)
    kept.close()
    head = recording.head_in(recording.segments_of([tmp_path])[-1])
    assert head is not None
    assert head.before == expected[-1]


def test_a_segment_that_cannot_be_read_again_stops_no_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = store(tmp_path)
    kept.append(ticks(1), 0, begins=True)
    monkeypatch.setattr(
        "gateway.records.store.digest", lambda _: (_ for _ in ()).throw(OSError(errno.EIO, "I/O error"))
    )
    kept.append(ticks(2), SEGMENT_NS, begins=True)
    kept.close()
    assert read(tmp_path) == ([1, 2], [])


def test_a_block_that_was_written_twice_is_read_once(tmp_path: Path) -> None:
    for first in (1, 2):  # the second recorder begins with what was not acknowledged
        kept = store(tmp_path)
        for number in range(first, first + 3):
            kept.append(ticks(number), 0, begins=False)
        kept.close()
    assert read(tmp_path) == ([1, 2, 3, 4], [])


@pytest.mark.parametrize("call", ["write", "fdatasync"])
def test_after_a_fault_of_the_disk_another_segment_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    kept = store(tmp_path)
    kept.append(ticks(1), 0, begins=True)
    kept.sync()
    with monkeypatch.context() as broken:

        def refused(*_: object) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

        broken.setattr(os, call, refused)
        with pytest.raises(OSError, match="No space"):  # noqa: PT012 - whichever of both comes to the disk
            kept.append(ticks(2), 0, begins=False)
            kept.sync()
    kept.append(ticks(2), 0, begins=False)
    kept.append(ticks(3), 0, begins=False)
    kept.close()
    assert [f.name.number for f in files_in(tmp_path)] == [1, 2]
    assert read(tmp_path) == ([1, 2, 3], [])


def test_a_disk_that_takes_only_a_part_of_a_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = store(tmp_path)
    kept.append(ticks(1), 0, begins=True)
    real = os.write
    with monkeypatch.context() as broken:
        room = [10]

        def short(fd: int, data: memoryview) -> int:
            if not room[0]:
                raise OSError(errno.ENOSPC, "No space left on device")
            room[0] -= (taken := min(room[0], len(data)))
            return real(fd, data[:taken])

        broken.setattr(os, "write", short)
        with pytest.raises(OSError, match="No space"):
            kept.append(ticks(2), 0, begins=False)
    kept.append(ticks(2), 0, begins=False)
    kept.close()
    times, missing = read(tmp_path)
    assert times == [1, 2]
    assert len(missing) == 1
    assert "10 bytes" in missing[0]


def test_pictures_are_complete_or_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = store(tmp_path)
    blocks = [picture_block(PictureHead(n, n, n, "png"), b"x" * 100) for n in range(3)]
    with monkeypatch.context() as broken:
        broken.setattr(os, "fdatasync", lambda fd: (_ for _ in ()).throw(OSError(errno.EIO, "I/O error")))
        with pytest.raises(OSError, match="I/O"):
            kept.pictures(blocks, matter=False)
    assert list(tmp_path.iterdir()) == []
    path = kept.pictures(blocks, matter=False)
    assert [p.head.frame_id for p in recording.pictures(path) if not isinstance(p, MissingItem)] == [0, 1, 2]
    name = parsed(path.name)
    assert name is not None
    assert name.kind == PICTURES
    assert recording.pictures_in(tmp_path) == [path]


def test_what_is_over_the_limits_is_deleted_with_its_pin(tmp_path: Path) -> None:
    kept = store(tmp_path, RetentionLimits(0, 0, 0))
    for n in range(1, 5):
        kept.append(ticks(n), 0, begins=True)
        kept.close()
    (tmp_path / (files_in(tmp_path)[1].name.__str__() + PIN)).touch()
    (tmp_path / "notes.txt").write_text("of a person")
    assert [f.name.number for f in kept.delete_surplus(None)] == [1, 3, 2]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["00000004-20270115T080000Z.seg", "notes.txt"]


def test_what_others_need_of_the_disk_is_left_to_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = store(tmp_path)
    kept.min_free_share = 0.1
    free = [1000]

    class Disk:
        f_blocks, f_frsize = 5000, 1  # 500 bytes must be left

        @property
        def f_bavail(self) -> int:
            return free[0]

    monkeypatch.setattr(os, "statvfs", lambda _: Disk())
    kept.append(ticks(1), 0, begins=True)
    free[0] = 500 + len(ticks(2)) - 1
    with pytest.raises(OSError, match=r"less than 10 % of the disk would be free"):
        kept.append(ticks(2), 0, begins=False)
    with pytest.raises(OSError, match=r"less than 10 %"):
        kept.pictures([bytes(1000)], matter=True)
    free[0] = 1000
    kept.append(ticks(2), 0, begins=False)
    kept.close()
    assert [f.name.number for f in files_in(tmp_path)] == [1, 2]
    assert read(tmp_path) == ([1, 2], [])


def test_near_the_limit_of_the_disk_new_pictures_take_the_place_of_the_oldest_of_the_least_kind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk on which what is deleted becomes free. The store is a new one: it learns the kinds from the files."""

    class Disk:
        f_blocks, f_frsize = 20_000, 1  # 2000 bytes must be left

        @property
        def f_bavail(self) -> int:
            return 12_000 - sum(path.stat().st_size for path in tmp_path.iterdir())

    def written(why: str) -> int:
        block = picture_block(PictureHead(1, 1, 1, "png", (why,)), bytes(1500))
        name = parsed(kept.pictures([block], matter=why != "stop_raised").name)
        assert name is not None
        return name.number

    def there() -> list[int]:
        return [file.name.number for file in files_in(tmp_path) if file.name.kind == PICTURES]

    monkeypatch.setattr(os, "statvfs", lambda _: Disk())
    kept = store(tmp_path)
    for why in ("moved", "stop_raised", "alarm camera_down", "stop_raised", "stop_raised"):
        written(why)
    kept = store(tmp_path)
    kept.min_free_share = 0.1
    assert [written("stop_raised"), there()] == [6, [1, 3, 4, 5, 6]]
    assert [written("rolling"), there()] == [7, [1, 3, 5, 6, 7]]
    assert [written("moved"), written("moved"), there()] == [8, 9, [1, 3, 7, 8, 9]]
    with pytest.raises(OSError, match="less than 10 %"):
        written("stop_raised")  # it takes the place of nothing that matters
    assert [written("operator_mark"), there()] == [10, [3, 7, 8, 9, 10]]


def test_new_records_take_the_place_of_the_oldest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Disk:
        f_blocks, f_frsize = 10_000, 1  # 1000 bytes must be left

        @property
        def f_bavail(self) -> int:
            return 3000 - sum(path.stat().st_size for path in tmp_path.iterdir())

    monkeypatch.setattr(os, "statvfs", lambda _: Disk())
    kept = store(tmp_path)
    kept.min_free_share = 0.1
    for n in range(1, 12):
        kept.append(ticks(n), n * SEGMENT_NS, begins=True)
    kept.close()
    there = [file.name.number for file in files_in(tmp_path)]
    assert there == list(range(12 - len(there), 12))
    assert len(there) < 11


def test_one_file_that_cannot_be_deleted_stops_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = store(tmp_path, RetentionLimits(0, 0, 0))
    for n in range(1, 4):
        kept.append(ticks(n), 0, begins=True)
        kept.close()
    real = Path.unlink

    def stubborn(path: Path, missing_ok: bool = False) -> None:
        if path.name.startswith("00000001"):
            raise PermissionError(errno.EPERM, "Operation not permitted")
        real(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", stubborn)
    assert [f.name.number for f in kept.delete_surplus(None)] == [2]


def test_reading_tells_what_is_missing_and_goes_on(tmp_path: Path) -> None:
    kept = store(tmp_path)
    kept.append(ticks(1), 0, begins=True)
    kept.append(records_block(2, [packed(Gap(t_ns=5, lost=12, why="not written in time"))]), 0, begins=False)
    kept.append(ticks(3), 0, begins=False)
    kept.close()
    (path,) = recording.segments_of([tmp_path])
    data = bytearray(path.read_bytes())
    data[-3] ^= 1
    path.write_bytes(bytes(data) + ticks(4))
    times, missing = read(tmp_path)
    assert times == [1, 5, 4]
    at = len(data) - len(ticks(3))
    damaged = f"a part of {path.name}: {len(ticks(3))} bytes at {at} are damaged"
    assert missing == [f"in {path.name}, 12 records: not written in time", damaged]
    path.write_bytes(b"")
    assert read(tmp_path) == ([], [f"all of {path.name}: its head is damaged"])


def test_what_is_no_recording_is_an_error_that_names_it(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no segment"):
        recording.segments_of([tmp_path])
    with pytest.raises(ConfigError, match=r"x\.txt: neither a folder"):
        recording.segments_of([tmp_path / "x.txt"])
