"""Which files are deleted, and in which order."""

import hypothesis.strategies as st
import pytest
from hypothesis import given

from gateway.records.names import PICTURES, SEGMENT, FileName, parsed
from gateway.records.retention import DAY_S, RetentionLimits, StoredFile, surplus

NOW = 1_800_000_000
UNLIMITED = RetentionLimits(10**12, 0, 0)


def stored(number: int, *, days: float = 0, size: int = 100, kind: str = SEGMENT, pinned: bool = False) -> StoredFile:
    return StoredFile(FileName(number, int(NOW - days * DAY_S), kind), size, pinned)


def numbers(files: list[StoredFile]) -> list[int]:
    return [file.name.number for file in files]


def test_a_name_tells_number_time_and_kind() -> None:
    name = FileName(42, 1_763_863_032, SEGMENT)
    assert str(name) == "00000042-20251123T015712Z.seg"
    assert parsed(str(name)) == name
    assert parsed("00000042-20251123T015712Z.pictures") == FileName(42, 1_763_863_032, PICTURES)
    assert parsed("100000042-20251123T015712Z.seg") == FileName(100_000_042, 1_763_863_032, SEGMENT)


@pytest.mark.parametrize("name", ["notes.txt", "1-20251123T015712Z.seg", "00000042-20251323T015712Z.seg", "x.seg.new"])
def test_other_files_are_none_of_it(name: str) -> None:
    assert parsed(name) is None


def test_within_its_limits_nothing_goes() -> None:
    assert surplus([stored(1, days=900), stored(2)], UNLIMITED, NOW) == []
    assert surplus([], UNLIMITED, NOW, 10**9) == []


def test_the_oldest_go_until_it_fits() -> None:
    files = [stored(n) for n in (3, 1, 4, 2)]
    assert numbers(surplus(files, RetentionLimits(250, 0, 0), NOW)) == [1, 2]
    assert numbers(surplus(files, UNLIMITED, NOW, missing_bytes=101)) == [1, 2]
    assert numbers(surplus(files, RetentionLimits(350, 0, 0), NOW, missing_bytes=201)) == [1, 2, 3]


def test_the_newest_is_being_written_and_stays() -> None:
    assert numbers(surplus([stored(1, days=99), stored(2, days=99)], RetentionLimits(50, 1, 1), NOW)) == [1]


def test_an_open_segment_stays_behind_newer_pictures() -> None:
    files = [stored(1), stored(2), stored(3, kind=PICTURES)]
    assert numbers(surplus(files, RetentionLimits(0, 0, 0), NOW, being_written=2)) == [1]


def test_what_is_pinned_goes_last_and_never_for_its_age() -> None:
    files = [stored(1, days=99, pinned=True), stored(2), stored(3), stored(4)]
    assert numbers(surplus(files, RetentionLimits(250, 10, 10), NOW)) == [2, 3]
    assert numbers(surplus(files, RetentionLimits(100, 10, 10), NOW)) == [2, 3, 1]
    assert surplus(files, RetentionLimits(10**6, 10, 10), NOW) == []


def test_pictures_of_routine_stops_go_before_those_that_matter_and_records_when_it_is_their_turn() -> None:
    files = [stored(n, kind=SEGMENT if n in (2, 4) else PICTURES) for n in range(1, 8)]
    asked: list[int] = []

    def matters(file: StoredFile) -> bool:
        asked.append(file.name.number)
        return file.name.number in (1, 5)

    assert numbers(surplus(files, RetentionLimits(600, 0, 0), NOW, matters=matters)) == [3]
    assert asked == [1, 3]
    assert numbers(surplus(files, RetentionLimits(100, 0, 0), NOW, matters=matters)) == [3, 2, 6, 1, 5]
    files = [file for file in files if file.name.number != 2] + [stored(2, kind=PICTURES, pinned=True)]
    assert numbers(surplus(files, RetentionLimits(0, 0, 0), NOW, matters=matters)) == [3, 6, 1, 5, 2]


class NeverCompared(StoredFile):
    def __eq__(self, other: object) -> bool:
        raise AssertionError("with thousands of files this takes minutes")

    __hash__ = StoredFile.__hash__


def test_after_a_long_standstill_the_many_that_are_too_old_are_not_compared_with_each_other() -> None:
    files = [NeverCompared(FileName(n, NOW - (9 - n) * DAY_S, SEGMENT), 100) for n in range(9)]
    assert numbers(surplus(files, RetentionLimits(10**6, 5, 5), NOW)) == [0, 1, 2, 3]


def test_pictures_may_go_earlier_than_records() -> None:
    files = [stored(1, days=5), stored(2, days=5, kind=PICTURES), stored(3, days=11), stored(4)]
    assert numbers(surplus(files, RetentionLimits(10**6, 10, 4), NOW)) == [2, 3]
    assert numbers(surplus(files, RetentionLimits(10**6, 10, 0), NOW)) == [3]
    assert numbers(surplus(files, RetentionLimits(10**6, 0, 4), NOW)) == [2]


def test_a_clock_that_is_not_believed_makes_nothing_old() -> None:
    files = [stored(1, days=99), stored(2)]
    assert surplus(files, RetentionLimits(10**6, 10, 10), None) == []
    assert numbers(surplus(files, RetentionLimits(100, 10, 10), None)) == [1]
    assert surplus(files, RetentionLimits(10**6, 10, 10), 0) == []  # a clock that begins in 1970


@given(
    st.lists(st.tuples(st.integers(1, 20), st.integers(0, 500), st.booleans(), st.floats(0, 100)), max_size=20),
    st.integers(0, 3000),
    st.integers(0, 3000),
)
def test_what_stays_is_within_the_limits_or_cannot_go(
    made: list[tuple[int, int, bool, float]], most: int, missing: int
) -> None:
    files = [stored(n, size=size, pinned=pin, days=days) for n, size, pin, days in made]
    gone = surplus(files, RetentionLimits(most, 30, 30), NOW, missing)
    kept = [file for file in files if file not in gone]
    newest = max((f.name.number for f in files), default=0)
    assert all(f.name.number != newest for f in gone)
    if any(f.name.number != newest for f in kept):
        assert sum(f.size_bytes for f in kept) <= most
        assert sum(f.size_bytes for f in gone) >= missing
    if any(f.pinned for f in gone):
        assert all(f.pinned or f.name.number == newest for f in kept)
