"""The reader process's work: an answer from the recordings themselves. IO."""

import io
import json
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from gateway import __version__
from gateway.durations import NS_PER_MS
from gateway.records import account, evidence, names, page, recording
from gateway.records.excerpt import Excerpt
from gateway.records.index_reader import MinutesSummary
from gateway.records.index_rows import MINUTE_COLUMNS, MinuteRow, SegmentRows
from gateway.records.inquiry import Inquiry
from gateway.records.moment import local_name
from gateway.records.picture_search import pictures_near
from gateway.records.questions import EvidenceQuestion, ValuesQuestion, WhyQuestion
from gateway.records.recording import MissingItem
from gateway.records.segment import RecordedPicture

LEAST_BUCKET_MS = 100
PIECE_BYTES = 1 << 18
MOST_EVIDENCE_BYTES = 128_000_000
LONGEST_S = 900 + 60  # of a segment; it ends where a complete state is due


def answer(folder: Path, question: WhyQuestion | ValuesQuestion) -> bytes:
    """`folder`: of all bays. Raises ConfigError where nothing is recorded for it, OSError."""
    bay = folder / question.bay
    match question:
        case WhyQuestion():
            return _why(bay, question)
        case ValuesQuestion():
            return _values(bay, question)


def give_evidence(folder: Path, question: EvidenceQuestion, send: Callable[[bytes], None]) -> None:
    """`send` gets the pieces. Raises as `answer`, and QuestionRefusedError where it is too much."""
    bay = folder / question.bay
    begin_ns, end_ns = question.begin_ms * NS_PER_MS, question.end_ms * NS_PER_MS
    excerpt = Excerpt(bay, recording.segments_of([bay]), begin_ns, end_ns)
    out = io.BufferedWriter(evidence.Pieces(send), PIECE_BYTES)  # type: ignore[type-var]
    name, made = f"evidence-{question.bay}-{local_name(begin_ns)}", _made(pictures=question.pictures)
    evidence.write(out, name, excerpt, made, pictures=question.pictures, most_bytes=MOST_EVIDENCE_BYTES)
    out.flush()
    send(b"")


def _made(*, pictures: bool) -> str:
    made = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, gateway {__version__}"
    return made if pictures else f"{made}; without pictures: records.pictures_for"


def _why(bay: Path, question: WhyQuestion) -> bytes:
    found = Inquiry(bay).at(question.at_ms * NS_PER_MS)
    pictures: list[RecordedPicture] = []
    if question.pictures:
        pictures = list(pictures_near(bay, found.begin_ns, found.end_ns))
    if question.html:
        return page.html(found, pictures, _made(pictures=question.pictures)).encode()
    return json.dumps(account.as_json(found, pictures), allow_nan=False, default=str).encode()


def _values(bay: Path, question: ValuesQuestion) -> bytes:
    """`bucket_ms`, `buckets` by the names of Bucket, and `missing`: what could not be read, in words."""
    length_ms = max(LEAST_BUCKET_MS, -(-(question.until_ms - question.since_ms) // question.points))
    rows: SegmentRows | None = None
    missing: list[str] = []
    for item in recording.records(_segments(bay, question)):
        if isinstance(item, MissingItem):
            missing.append(item.why)
            if rows is not None:
                rows.broken()
            continue
        place, record = item
        if rows is None:
            rows = SegmentRows(place.head, length_ms * NS_PER_MS)
        elif place.head is not rows.head:
            rows.follow(place.head)
        rows.add(record)
    found: list[MinuteRow] = []
    if rows is not None:
        rows.finish()
        found = rows.minutes
    begin, end = question.since_ms // length_ms, -(-question.until_ms // length_ms)
    buckets = [bucket(row, length_ms) for row in found if begin <= int(str(row[0])) < end]
    return msgspec.json.encode({"bucket_ms": length_ms, "buckets": buckets, "missing": missing})


def bucket(row: MinuteRow, length_ms: int) -> MinutesSummary:
    """One row of SegmentRows whose minutes are this long."""
    values = dict(zip(MINUTE_COLUMNS, row, strict=True))
    t_ms = int(str(values.pop("minute"))) * length_ms
    values["stop_s"] = msgspec.json.decode(str(values["stop_s"]))
    return msgspec.convert({"t_ms": t_ms, **values}, MinutesSummary)


def _segments(bay: Path, question: ValuesQuestion) -> list[Path]:
    """Those that may have something of that time, by number. Raises ConfigError where there is none at all."""
    found = []
    for path in recording.segments_of([bay]):
        name = names.parsed(path.name)
        if name is not None and question.since_ms / 1000 - LONGEST_S <= name.unix_s <= question.until_ms / 1000:
            found.append(path)
    return found
