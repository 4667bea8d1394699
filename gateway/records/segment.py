"""The file format of recordings: append-only segments of blocks, each with its length and CRC. Pure.

A segment is MAGIC, a head block and any number of further blocks. It stands alone: its head says of which gateway, bay,
version and configuration it is, and its first records block begins with a Checkpoint. A block is

    MARK (4 bytes) | kind (1) | length of the payload (4) | CRC-32 of kind, length and payload (4) | payload

so that a reader notices every part that is missing or damaged, and finds the next good block by its mark. Numbers are
little-endian.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

import msgspec

from gateway.errors import ProtocolError
from gateway.records.record import AnyRecord, array_of, unpacked

MAGIC = b"LGRECORD1\n"
MARK = b"\xf5\x9dLG"
HEADER = struct.Struct("<4sBII")
MAX_PAYLOAD = 64 * 1024 * 1024  # a picture of 20 megapixels, uncompressed
MAX_RECORDS_BYTES = 64 * 1024 * 1024  # of one block, unpacked


class BlockKind(IntEnum):
    """Never renumber, only add."""

    HEAD = 1
    RECORDS = 2
    PICTURE = 3
    ROWS = 4  # in a file of its own: row_files


class SegmentBefore(msgspec.Struct, frozen=True):
    """The bay's segment before another one, as it was on the disk when that was begun. `name`: of the file; empty:
    there was none. `sha256`: of the whole file, hexadecimal; empty: it could not be read."""

    name: str = ""
    size_bytes: int = 0
    sha256: str = ""


class Head(msgspec.Struct, frozen=True, kw_only=True):
    """What a segment's records are of. `config`: the gateway's configuration with this bay only, without passwords, as
    JSON. `boot`: a random number of the gateway's start; `number` counts the bay's segments. `before`: None: of a
    version that did not chain them."""

    bay: str
    number: int
    boot: str
    site: str
    instance: str
    gateway_version: str
    python_version: str
    t_ns: int  # monotonic, when the segment began
    unix_ns: int  # the same moment
    config: str
    before: SegmentBefore | None = None

    @property
    def recording(self) -> str:
        """Of which gateway and bay."""
        return f"{self.site}.{self.instance}/{self.bay}"


class Batch(msgspec.Struct, frozen=True, array_like=True):
    """The payload of a records block before compression. `number` counts the batches of one `boot`, for a batch that
    was written twice."""

    number: int
    records: msgspec.Raw


class PictureHead(msgspec.Struct, frozen=True, array_like=True):
    """Of one picture; the payload of its block is this and the bytes of the file that follow it."""

    frame_id: int
    t_ns: int  # capture, monotonic
    unix_ns: int
    encoding: str  # "png": lossless
    why: tuple[str, ...] = ()  # what happened round it
    changed: str = ""  # "": as it came from the camera; "blurred": outside the region of interest


@dataclass(frozen=True, slots=True)
class RecordedPicture:
    head: PictureHead
    data: bytes


@dataclass(frozen=True, slots=True)
class DamagedBytes:
    """Bytes of a segment that are not a block: the end of a file that was being written, or a fault of the disk."""

    offset: int
    length: int


@dataclass(frozen=True, slots=True)
class Block:
    kind: int
    payload: bytes
    offset: int

    @property
    def size(self) -> int:
        """In the file."""
        return HEADER.size + len(self.payload)


_HEAD = msgspec.json.Decoder(Head)
_BATCH = msgspec.msgpack.Decoder(Batch)


def head_block(head: Head) -> bytes:
    """The beginning of a segment."""
    return MAGIC + block(BlockKind.HEAD, msgspec.json.encode(head))


def records_block(number: int, records: list[bytes]) -> bytes:
    """One block of packed records."""
    batch = msgspec.msgpack.encode(Batch(number, msgspec.Raw(array_of(records))))
    return block(BlockKind.RECORDS, zlib.compress(batch, 6))


def picture_block(head: PictureHead, data: bytes) -> bytes:
    packed = msgspec.msgpack.encode(head)
    return block(BlockKind.PICTURE, struct.pack("<I", len(packed)) + packed + data)


def block(kind: BlockKind, payload: bytes) -> bytes:
    crc = zlib.crc32(payload, zlib.crc32(struct.pack("<BI", kind, len(payload))))
    return HEADER.pack(MARK, kind, len(payload), crc) + payload


def blocks(data: bytes) -> Iterator[Block | DamagedBytes]:
    """All of a segment's blocks, in order, and what lies between them. Never raises, whatever the bytes.

    Raises nothing for a file that is not a segment either: all of it is then Damage.
    """
    at = good = len(MAGIC) if data.startswith(MAGIC) else 0
    while at < len(data):
        found = _block_at(data, at)
        if found is None:
            at = data.find(MARK, at + 1)
            if at < 0:
                break
            continue
        if at > good:
            yield DamagedBytes(good, at - good)
        yield found
        at = good = at + found.size
    if good < len(data):
        yield DamagedBytes(good, len(data) - good)


def _block_at(data: bytes, at: int) -> Block | None:
    if len(data) - at < HEADER.size:
        return None
    mark, kind, length, crc = HEADER.unpack_from(data, at)
    begin = at + HEADER.size
    if mark != MARK or length > MAX_PAYLOAD or begin + length > len(data):
        return None
    payload = data[begin : begin + length]
    if zlib.crc32(payload, zlib.crc32(struct.pack("<BI", kind, length))) != crc:
        return None
    return Block(kind, payload, at)


def head_of(payload: bytes) -> Head:
    """Raises ProtocolError."""
    try:
        return _HEAD.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ProtocolError(f"not a head of this version or an earlier one: {error}") from None


def batch_of(payload: bytes) -> tuple[int, list[AnyRecord]]:
    """The number and the records of a records block. Raises ProtocolError."""
    try:
        data = zlib.decompressobj().decompress(payload, MAX_RECORDS_BYTES)
        batch = _BATCH.decode(data)
    except (zlib.error, msgspec.DecodeError, RecursionError) as error:
        raise ProtocolError(f"not a records block of this version or an earlier one: {error}") from None
    return batch.number, unpacked(bytes(batch.records))


def picture_of(payload: bytes) -> RecordedPicture:
    """Raises ProtocolError."""
    head = picture_head_of(payload)
    return RecordedPicture(head, payload[4 + struct.unpack_from("<I", payload)[0] :])


def picture_head_of(payload: bytes) -> PictureHead:
    """Of a picture block's payload, or of its beginning. Raises ProtocolError."""
    try:
        (length,) = struct.unpack_from("<I", payload)
        return msgspec.msgpack.decode(payload[4 : 4 + length], type=PictureHead)
    except (struct.error, msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ProtocolError(f"not a picture block of this version or an earlier one: {error}") from None
