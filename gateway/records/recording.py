"""Reads what was recorded of a bay: the records of many segments as one series. IO.

A segment that cannot be read or is not there, a damaged part of one, records that were never written: each is one
Missing in its place, and reading goes on behind it.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import ValidationError

from gateway.config import GatewayConfig
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.errors import ConfigError, ProtocolError
from gateway.records import names
from gateway.records import sentences as say
from gateway.records.files import files_in
from gateway.records.names import PICTURES, SEGMENT
from gateway.records.record import AnyRecord, Checkpoint, Gap, VisitRecord, observed
from gateway.records.segment import (
    Block,
    BlockKind,
    DamagedBytes,
    Head,
    RecordedPicture,
    batch_of,
    blocks,
    head_of,
    picture_of,
)

BEGINS = -1
HEAD_BYTES = 1 << 20  # of a file; its head is smaller


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


@dataclass(slots=True)
class Continuity:
    """Follows records in their order, and says where some are not there: by the segment that a head names as the one
    before it, and by the number of the state at each Checkpoint, which counts the steps. `name`: of the segment.
    `recording`, `boot`: of the newest head that could be read; empty: of none yet. `newest`: the segment of each
    recording, as folders may have been merged. `steps`: None: not known until the next Checkpoint; BEGINS: a start of
    the gateway is expected. `batch`: the newest of this start."""

    name: str = ""
    recording: str = ""
    boot: str = ""
    newest: dict[str, str] = field(default_factory=dict)
    steps: int | None = None
    batch: int = 0

    def begins(self, path: Path, head: Head | None) -> str:
        """Another segment, with its head as far as that can be read: what is missing before it, or that it is of
        another recording; empty: it goes on."""
        self.name = path.name
        if head is None:
            self.steps = None
            self.newest = dict.fromkeys(self.newest, path.name)  # of which recording it is, is not known
            return ""
        before, boot = self.recording, self.boot
        self.recording, self.boot = head.recording, head.boot
        of_another = before not in ("", head.recording)
        if not before or of_another or boot != head.boot:
            self.batch = 0
            self.steps = None if not before or of_another else BEGINS
        expected, self.newest[head.recording] = self.newest.get(head.recording), path.name
        if expected is not None and head.before is not None and head.before.name != expected:
            self.steps = None
            return say.BETWEEN(expected, path.name)
        return say.OF_ANOTHER(path.name, head.recording, before) if of_another else ""

    def follows(self, record: AnyRecord) -> str:
        """Another record of that segment: what is missing before it; empty: nothing, as far as that can be known."""
        expected = self.steps
        if not isinstance(record, Checkpoint):
            if expected not in (None, BEGINS) and observed(record) is not None:
                self.steps = expected + 1
            return ""
        self.steps = record.state.seq
        if not record.follows or expected in (None, self.steps):
            return ""
        if expected == BEGINS:
            return say.START_BEFORE(self.name)
        return say.STEPS_BEFORE(self.steps - expected, self.name)


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


def records(
    paths: Iterable[Path], read: Callable[[Path], bytes] = Path.read_bytes, continuity: Continuity | None = None
) -> Iterator[Item | MissingItem]:
    """All records of these segments, in order; each batch once. `continuity`: of the segments before them, which is
    carried on. Raises OSError for a file that can't be read."""
    continuity = Continuity() if continuity is None else continuity
    for path in paths:
        head: Head | None = None
        number = 0
        for block in blocks(data := read(path)):
            if isinstance(block, DamagedBytes):
                continuity.steps = None
                yield _damaged(path, block, len(data))
                continue
            try:
                if block.kind == BlockKind.HEAD:
                    head = head_of(block.payload)
                    if why := continuity.begins(path, head):
                        yield MissingItem(why)
                elif block.kind == BlockKind.RECORDS and head is not None:
                    batch, found = batch_of(block.payload)
                    if batch <= continuity.batch:
                        continue  # written twice: the recorder died before it could acknowledge it
                    continuity.batch = batch
                    for record in found:
                        if why := continuity.follows(record):
                            yield MissingItem(why)
                        yield Place(path, head, number), record
                        number += 1
                        if isinstance(record, Gap):
                            continuity.steps = None
                            yield MissingItem(say.RECORDS_LOST(path.name, record.lost, record.why))
            except ProtocolError as error:
                continuity.steps = None
                yield MissingItem(say.PART_OF(path.name, error))
        if head is None:
            continuity.begins(path, None)
            yield MissingItem(say.HEAD_DAMAGED(path.name))


def _damaged(path: Path, block: DamagedBytes, size_bytes: int) -> MissingItem:
    if block.offset + block.length == size_bytes:
        return MissingItem(say.CUT_OFF(path.name, block.length))
    return MissingItem(say.DAMAGED(path.name, block.length, block.offset))


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
    for block in blocks(data := path.read_bytes()):
        if isinstance(block, DamagedBytes):
            yield _damaged(path, block, len(data))
        elif block.kind == BlockKind.PICTURE:
            try:
                yield picture_of(block.payload)
            except ProtocolError as error:
                yield MissingItem(say.PART_OF(path.name, error))


def head_in(path: Path) -> Head | None:
    """As `head_from`. Raises OSError."""
    with path.open("rb") as file:
        return head_from(file.read(HEAD_BYTES))


def head_from(data: bytes) -> Head | None:
    """Of a segment's bytes. None: it is damaged, or of a later version."""
    for block in blocks(data[:HEAD_BYTES]):
        if isinstance(block, Block) and block.kind == BlockKind.HEAD:
            with suppress(ProtocolError):
                return head_of(block.payload)
    return None


def config_of(head: Head) -> GatewayConfig:
    """The configuration that a segment was recorded with. Raises ConfigError where this version refuses it."""
    try:
        return GatewayConfig.model_validate_json(head.config)
    except ValidationError as error:
        why = "; ".join(f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}" for fault in error.errors())
        raise ConfigError(f"the recorded configuration of {head.gateway_version} does not fit: {why}") from None
