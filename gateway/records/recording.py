"""Reads what was recorded of a bay: the records of many segments as one series. IO.

A segment that cannot be read, a damaged part of one, records that were never written: each is one Missing in its place,
and reading goes on behind it.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from gateway.config import GatewayConfig
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.errors import ConfigError, ProtocolError
from gateway.records import names
from gateway.records.files import files_in
from gateway.records.names import PICTURES, SEGMENT
from gateway.records.record import AnyRecord, Gap, VisitRecord
from gateway.records.segment import (
    BlockKind,
    DamagedBytes,
    Head,
    RecordedPicture,
    batch_of,
    blocks,
    head_of,
    picture_of,
)


@dataclass(frozen=True, slots=True)
class Place:
    """Where a record lies: file, its segment's head, and the record's number in the segment, from 0."""

    path: Path
    head: Head
    number: int

    def __str__(self) -> str:
        return f"{self.path.name}, record {self.number}"


@dataclass(frozen=True, slots=True)
class MissingItem:
    """Something is not there. `why` is for people."""

    why: str


Item = tuple[Place, AnyRecord]


def segments_of(paths: Iterable[Path]) -> list[Path]:
    """The segments that are meant, in order: of folders all of them. Raises ConfigError where there is none."""
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            found += _files(path, SEGMENT)
        elif names.parsed(path.name) is not None and path.is_file():
            found.append(path)
        else:
            raise ConfigError(f"{path}: neither a folder of segments nor a segment (*{SEGMENT})")
    if not found:
        raise ConfigError(f"{', '.join(map(str, paths))}: no segment (*{SEGMENT}) is in it")
    return found


def pictures_in(folder: Path) -> list[Path]:
    """The files of pictures in a bay's folder, by number."""
    return _files(folder, PICTURES)


def _files(folder: Path, kind: str) -> list[Path]:
    return [folder / str(file.name) for file in files_in(folder) if file.name.kind == kind]


def records(paths: Iterable[Path]) -> Iterator[Item | MissingItem]:
    """All records of these segments, in order; each batch once. Raises OSError for a file that can't be read."""
    boot, newest = "", 0
    for path in paths:
        head: Head | None = None
        number = 0
        for block in blocks(path.read_bytes()):
            if isinstance(block, DamagedBytes):
                yield MissingItem(f"{path.name}: {block.length} bytes at {block.offset} are damaged or were cut off")
                continue
            try:
                if block.kind == BlockKind.HEAD:
                    head = head_of(block.payload)
                    if head.boot != boot:
                        boot, newest = head.boot, 0
                elif block.kind == BlockKind.RECORDS and head is not None:
                    batch, found = batch_of(block.payload)
                    if batch <= newest:
                        continue  # written twice: the recorder died before it could acknowledge it
                    newest = batch
                    for record in found:
                        yield Place(path, head, number), record
                        number += 1
                        if isinstance(record, Gap):
                            yield MissingItem(f"{path.name}: {record.lost} records were {record.why}")
            except ProtocolError as error:
                yield MissingItem(f"{path.name}: {error}")
        if head is None:
            yield MissingItem(f"{path.name}: its head is damaged")


def open_visit(folder: Path, boot: str) -> VisitSummary | None:
    """The visit that was open at the end of what a gateway of another start has recorded. Raises OSError."""
    for path in reversed(_files(folder, SEGMENT)[-2:]):
        found: VisitSummary | None = None
        for item in records([path]):
            if isinstance(item, MissingItem):
                continue
            place, record = item
            if place.head.boot == boot:
                return None  # only the recorder was started again
            if isinstance(record, VisitRecord):
                found = record.visit
        if found is not None:
            return found if found.end is VisitEnd.OPEN else None
    return None


def pictures(path: Path) -> Iterator[RecordedPicture | MissingItem]:
    """The pictures of one file, oldest first. Raises OSError."""
    for block in blocks(path.read_bytes()):
        if isinstance(block, DamagedBytes):
            yield MissingItem(f"{path.name}: {block.length} bytes at {block.offset} are damaged or were cut off")
        elif block.kind == BlockKind.PICTURE:
            try:
                yield picture_of(block.payload)
            except ProtocolError as error:
                yield MissingItem(f"{path.name}: {error}")


def config_of(head: Head) -> GatewayConfig:
    """The configuration that a segment was recorded with. Raises ConfigError where this version refuses it."""
    try:
        return GatewayConfig.model_validate_json(head.config)
    except ValueError as error:
        raise ConfigError(f"the recorded configuration of {head.gateway_version} does not fit: {error}") from None
