"""The rows of visits and minutes, kept for longer than the segments that they were made of. IO; may raise OSError.

A file of rows lies beside the segments of its bay. It is made of the blocks of `segment`, one for each segment that is
over: append-only, each with its length and CRC, so that a file that was cut off loses the newest block alone. That one
is made again from its segment. Only the process that writes the index writes here.

    00000042-20261123T035712Z.rows      begun with the rows of that segment
"""

import contextlib
import os
import zlib
from dataclasses import dataclass
from pathlib import Path

import msgspec

from gateway.errors import ProtocolError
from gateway.files import sync_folder, write_all
from gateway.records.files import files_in
from gateway.records.index_rows import MINUTE_COLUMNS, Minute, MinuteRow, SegmentRows, VisitRow
from gateway.records.names import ROWS, FileName
from gateway.records.segment import MAGIC, MAX_RECORDS_BYTES, BlockKind, DamagedBytes, block, blocks

MAX_BYTES = 1_000_000  # of a file: the oldest is deleted as one, and read as one
MAX_SPAN_S = 7 * 86_400
MS_PER_S = 1000


class KeptRows(msgspec.Struct, frozen=True):
    """The rows of one segment: its number and begin (Unix time), and by column the minutes, so that a later version
    with more of them reads these."""

    segment: int
    begun_ms: int
    visits: list[VisitRow]
    minutes: dict[str, list[int | float | str | None]]

    @property
    def minute_rows(self) -> list[MinuteRow]:
        """As MINUTE_COLUMNS; what an earlier version did not count is as in a minute in which nothing was."""
        absent = dict(zip(MINUTE_COLUMNS, Minute(0).row, strict=True))
        count = min((len(values) for values in self.minutes.values()), default=0)
        columns = [self.minutes.get(name, [absent[name]] * count) for name in MINUTE_COLUMNS]
        return [tuple(column[n] for column in columns) for n in range(count)]


_ROWS = msgspec.msgpack.Decoder(KeptRows)


def of_segment(rows: SegmentRows) -> KeptRows | None:
    """Of a segment that is over; None: nothing of it is to be kept."""
    if not (rows.visits or rows.minutes):
        return None
    columns = {name: [row[n] for row in rows.minutes] for n, name in enumerate(MINUTE_COLUMNS)}
    return KeptRows(rows.head.number, rows.begun_ms, rows.visits, columns)


def rows_block(kept: KeptRows) -> bytes:
    return block(BlockKind.ROWS, zlib.compress(msgspec.msgpack.encode(kept), 9))


@dataclass(frozen=True, slots=True)
class FoundRows:
    """What a file has beyond an offset. `end`: behind the last good block; `damaged`: bytes before it."""

    rows: list[KeptRows]
    end: int
    damaged: int


def read(path: Path, offset: int = 0) -> FoundRows:
    """What a later version has written in another way is left out."""
    with path.open("rb") as file:
        file.seek(offset)
        data = file.read()
    rows, end, damaged, torn = [], 0, 0, 0
    for found in blocks(data):
        if isinstance(found, DamagedBytes):
            torn = found.length
            continue
        end, damaged, torn = found.offset + found.size, damaged + torn, 0
        if found.kind == BlockKind.ROWS:
            with contextlib.suppress(ProtocolError):
                rows.append(_rows_of(found.payload))
    return FoundRows(rows, offset + end, damaged)


def _rows_of(payload: bytes) -> KeptRows:
    try:
        return _ROWS.decode(zlib.decompressobj().decompress(payload, MAX_RECORDS_BYTES))
    except (zlib.error, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ProtocolError(f"damaged rows: {error}") from None


def append(folder: Path, kept: KeptRows) -> FileName:
    """To the newest file of the bay, or to another one; on the disk when it returns. A file that cannot take all of it
    is as before."""
    newest = next((file for file in reversed(files_in(folder)) if file.name.kind == ROWS), None)
    data, unix_s = rows_block(kept), kept.begun_ms // MS_PER_S
    if newest is None or newest.size_bytes >= MAX_BYTES or abs(unix_s - newest.name.unix_s) > MAX_SPAN_S:
        number = kept.segment if newest is None else max(kept.segment, newest.name.number + 1)
        name, data = FileName(number, unix_s, ROWS), MAGIC + data
    else:
        name = newest.name
    fd = os.open(folder / str(name), os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o640)
    try:
        size = os.fstat(fd).st_size
        try:
            write_all(fd, data)
            os.fdatasync(fd)
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(fd, size)
            raise
    finally:
        os.close(fd)
    if data.startswith(MAGIC):
        sync_folder(folder)
    return name


def newest_segment(folder: Path) -> int:
    """The largest number of a segment whose rows are in the newest file; 0: there is none."""
    names = [file.name for file in files_in(folder) if file.name.kind == ROWS]
    return max((rows.segment for name in names[-1:] for rows in read(folder / str(name)).rows), default=0)
