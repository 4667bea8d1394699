"""The file format: cut, damaged and joined segments; the same bytes in later versions."""

import hypothesis.strategies as st
import pytest
from hypothesis import given

from gateway.core.marker_wear import MarkerWear, WearTrend
from gateway.core.plc import Control, PlcWrite, Writer
from gateway.core.readings import Quality, RangeReading
from gateway.core.state import FunctionCheck, StateVector
from gateway.errors import ProtocolError
from gateway.records.record import (
    Checkpoint,
    DistanceRecord,
    FunctionCheckRecord,
    TickRecord,
    WriteRecord,
    array_of,
    packed,
    unpacked,
)
from gateway.records.segment import (
    MAGIC,
    MARK,
    Block,
    BlockKind,
    DamagedBytes,
    Head,
    PictureHead,
    batch_of,
    block,
    blocks,
    head_block,
    head_of,
    picture_block,
    picture_of,
    records_block,
)

HEAD = Head(
    bay="bay1",
    number=7,
    boot="0123456789abcdef",
    site="site1",
    instance="gateway",
    gateway_version="1.0",
    python_version="3.11.2",
    t_ns=5,
    unix_ns=1_700_000_000_000_000_000,
    config="{}",
)
TICKS = [[packed(TickRecord(t_ns=100 * n + m)) for m in range(3)] for n in range(4)]
PARTS = [head_block(HEAD), *(records_block(n + 1, ticks) for n, ticks in enumerate(TICKS))]
SEGMENT = b"".join(PARTS)
ENDS = [sum(map(len, PARTS[: n + 1])) for n in range(len(PARTS))]


def read(data: bytes) -> tuple[list[int], int]:
    """Numbers of the batches that are readable, and how many bytes are no block."""
    found = list(blocks(data))
    numbers = [batch_of(b.payload)[0] for b in found if isinstance(b, Block) and b.kind == BlockKind.RECORDS]
    return numbers, sum(d.length for d in found if isinstance(d, DamagedBytes))


def test_what_was_written_is_read() -> None:
    head, *rest = blocks(SEGMENT)
    assert isinstance(head, Block)
    assert head_of(head.payload) == HEAD
    assert [batch_of(b.payload)[1] for b in rest if isinstance(b, Block)] == [
        [TickRecord(t_ns=100 * n + m) for m in range(3)] for n in range(4)
    ]


def test_a_power_cut_at_any_byte_loses_only_the_block_that_was_being_written() -> None:
    for length in range(len(SEGMENT) + 1):
        complete = sum(end <= length for end in ENDS)
        numbers, damaged = read(SEGMENT[:length])
        assert numbers == list(range(1, complete)), length
        begin = ENDS[complete - 1] if complete else len(MAGIC) if length >= len(MAGIC) else 0
        assert damaged == length - begin, length


def test_zeros_that_a_file_system_leaves_behind_are_damage() -> None:
    for length in (ENDS[1], ENDS[1] + 5, ENDS[2] - 1):
        numbers, _ = read(SEGMENT[:length] + bytes(4096))
        assert numbers == [1]


@given(at=st.integers(0, len(SEGMENT) - 1), bit=st.integers(0, 7))
def test_one_wrong_bit_costs_one_block(at: int, bit: int) -> None:
    wrong = bytearray(SEGMENT)
    wrong[at] ^= 1 << bit
    hit = next(n for n, end in enumerate(ENDS) if at < end)
    numbers, damaged = read(bytes(wrong))
    assert numbers == [n for n in range(1, len(PARTS)) if n != hit]
    assert damaged >= (len(PARTS[hit]) if hit else 1)


@given(st.binary(max_size=200), st.integers(0, len(SEGMENT)))
def test_whatever_is_written_over_it_nothing_raises_and_what_is_read_is_true(rubbish: bytes, at: int) -> None:
    numbers, _ = read(SEGMENT[:at] + rubbish + SEGMENT[at + len(rubbish) :])
    assert set(numbers) <= {1, 2, 3, 4}
    assert numbers == sorted(numbers)


def test_a_mark_inside_of_a_payload_begins_no_block() -> None:
    inner = records_block(99, TICKS[0])
    outer = block(BlockKind.PICTURE, inner + MARK)
    found = list(blocks(MAGIC + outer + records_block(1, TICKS[1])))
    assert [b.kind for b in found if isinstance(b, Block)] == [BlockKind.PICTURE, BlockKind.RECORDS]


def test_a_block_of_a_later_version_is_passed_over() -> None:
    later = block(200, b"something new")  # type: ignore[arg-type]
    assert read(PARTS[0] + later + PARTS[1]) == ([1], 0)


def test_records_keep_their_values_and_types() -> None:
    writer = Writer("10.0.0.9", "CN=plc", "plc")
    records = [
        DistanceRecord(t_ns=1, reading=RangeReading(1, Quality.GOOD, 0.1 + 0.2, seq=3)),
        WriteRecord(t_ns=2, write=PlcWrite(writer, heartbeat=65535, control=1 << Control.RELEASE)),
        FunctionCheckRecord(t_ns=3, mode=FunctionCheck.MAY_MOVE_KEPT),
        TickRecord(t_ns=4, marker=MarkerWear(10, WearTrend(0.82, -0.015, 8.0), WearTrend(1.2), worn=True)),
        Checkpoint(t_ns=4, state=StateVector("bay1", seq=9), follows=True),
    ]
    assert unpacked(array_of([packed(r) for r in records])) == records


def test_a_field_of_a_later_version_is_passed_over_and_a_missing_one_has_its_default() -> None:
    import msgspec

    later = {"is": "distance", "t_ns": 1, "new": [1, 2], "reading": {"t_ns": 1, "quality": 6, "newer": "x"}}
    assert unpacked(msgspec.msgpack.encode([later])) == [
        DistanceRecord(t_ns=1, reading=RangeReading(1, Quality.NO_ECHO))
    ]


@given(st.binary(max_size=100))
def test_rubbish_with_a_good_crc_is_an_error_with_a_text(payload: bytes) -> None:
    for part in (batch_of, head_of, picture_of):
        with pytest.raises(ProtocolError, match="version"):
            part(b"\xff" + payload)


def test_a_picture_has_its_place_in_time() -> None:
    head = PictureHead(12, 34, 56, "png", ("stop_raised", "in_place"))
    (found,) = blocks(picture_block(head, b"\x89PNG"))
    assert isinstance(found, Block)
    picture = picture_of(found.payload)
    assert (picture.head, picture.data) == (head, b"\x89PNG")
