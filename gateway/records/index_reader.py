"""Questions to the index of the recordings, for a process that may only read files. IO.

Each opens the file, asks and closes. Raises LinkError where there is no index, or it cannot be read now. Times: Unix
time, ms.
"""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import msgspec

from gateway.core.visit_summary import VisitSummary
from gateway.errors import LinkError
from gateway.records.index import NAME, VERSION
from gateway.records.index_rows import MINUTE_COLUMNS

MINUTE_MS = 60_000


@dataclass(frozen=True, slots=True)
class IndexReader:
    """`folder`: of a gateway's recordings."""

    folder: Path

    def visits(self, bay: str, since_ms: int, until_ms: int, limit: int) -> list[VisitSummary]:
        """Those that ended after `since_ms` and began before `until_ms`; the newest first."""
        query = (
            "SELECT summary FROM visits WHERE bay = ? AND begun_ms < ? AND ended_ms >= ?"
            " ORDER BY begun_ms DESC, segment DESC LIMIT ?"
        )
        with self._asking() as db:
            return [_visit(text) for (text,) in db.execute(query, (bay, until_ms, since_ms, limit))]

    def visit(self, bay: str, begun_ms: int) -> VisitSummary | None:
        """None: there is no such visit."""
        query = "SELECT summary FROM visits WHERE bay = ? AND begun_ms = ? ORDER BY segment DESC LIMIT 1"
        with self._asking() as db:
            found = db.execute(query, (bay, begun_ms)).fetchone()
        return None if found is None else _visit(found[0])

    def minutes(self, bay: str, since_ms: int, until_ms: int, limit: int) -> list[dict[str, object]]:
        """By MINUTE_COLUMNS, the oldest first; a minute in two segments is two rows."""
        query = "SELECT * FROM minutes WHERE bay = ? AND minute >= ? AND minute < ? ORDER BY minute, segment LIMIT ?"
        span = (since_ms // MINUTE_MS, -(-until_ms // MINUTE_MS))
        with self._asking() as db:
            return [dict(zip(MINUTE_COLUMNS, row[1:], strict=False)) for row in db.execute(query, (bay, *span, limit))]

    def events(self, bay: str, since_ms: int, until_ms: int, limit: int) -> list[dict[str, object]]:
        """t_ms, kind, sensor, quality, detail and the segment's file name; the oldest first."""
        query = (
            "SELECT t_ms, e.kind, sensor, quality, detail, name FROM events e JOIN files f"
            " ON f.bay = e.bay AND f.number = segment AND f.kind = '.seg'"
            " WHERE e.bay = ? AND t_ms >= ? AND t_ms < ? ORDER BY t_ms, segment, place LIMIT ?"
        )
        names = ("t_ms", "kind", "sensor", "quality", "detail", "file")
        with self._asking() as db:
            return [dict(zip(names, row, strict=True)) for row in db.execute(query, (bay, since_ms, until_ms, limit))]

    @contextmanager
    def _asking(self) -> Iterator[sqlite3.Connection]:
        path = self.folder / NAME
        try:
            with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=1.0)) as db:
                if db.execute("PRAGMA user_version").fetchone() != (VERSION,):
                    raise LinkError(f"{path}: it is of another version")
                yield db
        except (sqlite3.Error, msgspec.DecodeError) as error:
            raise LinkError(f"{path}: {error}") from None


def _visit(text: str) -> VisitSummary:
    return msgspec.json.decode(text, type=VisitSummary)
