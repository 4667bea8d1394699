"""The index of a gateway's recordings: one SQLite file, made of the segments and never the other way round. IO.

It holds the rows of `index_rows` and the list of files, and follows the files: what is deleted there goes here. It
reads the segments themselves, a few milliseconds at a time, so that it is the same whether it was made while they were
being written or afterwards, and catches up by itself after any fault. Nothing waits for it.
"""

import contextlib
import fcntl
import os
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from gateway.clock import machine_ns
from gateway.errors import ProtocolError
from gateway.records.index_rows import MINUTE_COLUMNS, SegmentRows
from gateway.records.names import SEGMENT
from gateway.records.retention import StoredFile
from gateway.records.segment import Block, BlockKind, Damage, batch_of, blocks, head_of
from gateway.records.store import files_in

NAME = "index.sqlite"
VERSION = 1
COMMIT_NS = 60 * 1_000_000_000
_SCHEMA = f"""
CREATE TABLE files(bay TEXT, number INTEGER, kind TEXT, name TEXT, begun_ms INTEGER, ended_ms INTEGER, boot TEXT,
  newest_batch INTEGER, lost INTEGER, damaged INTEGER, events_left_out INTEGER, complete INTEGER,
  PRIMARY KEY(bay, number, kind)) WITHOUT ROWID;
CREATE TABLE visits(bay TEXT, begun_ms INTEGER, ended_ms INTEGER, segment INTEGER, summary TEXT,
  PRIMARY KEY(bay, begun_ms, segment)) WITHOUT ROWID;
CREATE TABLE events(bay TEXT, t_ms INTEGER, segment INTEGER, place INTEGER, kind TEXT, sensor TEXT, quality TEXT,
  detail TEXT, PRIMARY KEY(bay, t_ms, segment, place)) WITHOUT ROWID;
CREATE TABLE minutes(bay TEXT, {", ".join(MINUTE_COLUMNS)}, segment INTEGER,
  PRIMARY KEY(bay, minute, segment)) WITHOUT ROWID;
PRAGMA user_version = {VERSION};
"""
TABLES = ("files", "visits", "events", "minutes")
_OF_SEGMENT = ("visits", "events", "minutes")


@dataclass(slots=True)
class _Reading:
    """A segment that is being read."""

    path: Path
    bay: str
    number: int
    boot: str = ""  # of the segment before, and its newest batch: a batch is counted once
    newest: int = 0
    offset: int = 0
    length: int = 0
    damaged: int = 0  # bytes
    rows: SegmentRows | None = None
    written: dict[str, int] = field(default_factory=lambda: dict.fromkeys(_OF_SEGMENT, 0))  # rows in the file


@dataclass(slots=True)
class Index:
    """Of `folder`, which holds one folder for each bay. `fault`: why it cannot be written now; empty: it can."""

    folder: Path
    fault: str = ""
    set_aside: int = 0  # times the file was damaged, and begun anew
    _db: sqlite3.Connection | None = None
    _lock: int | None = None
    _tails: dict[str, _Reading] = field(default_factory=dict)  # by bay: the segment that is being written
    _work: Iterator[None] | None = None
    _due_ns: int = 0

    def work(self, budget_ns: int) -> bool:
        """Do some of what there is to do, once a minute all of it; is more left? Raises nothing that a disk may do."""
        end_ns = machine_ns() + budget_ns
        if self._work is None:
            if machine_ns() < self._due_ns:
                return False
            self._due_ns = machine_ns() + COMMIT_NS
            self._work = self._all(final=False)
        try:
            for _ in self._work:
                if machine_ns() >= end_ns:
                    return True
            self.fault = ""
        except (sqlite3.Error, OSError) as error:
            self._failed(error)
        self._work = None
        return False

    def rebuild(self) -> None:
        """Anew, all of it; the newest segments are over, too. Raises BlockingIOError while a gateway writes it,
        OSError and sqlite3.Error."""
        self._take_lock()
        (self.folder / NAME).unlink(missing_ok=True)
        for _ in self._all(final=True):
            pass
        self.close()

    def close(self) -> None:
        self._tails.clear()
        if self._db is not None:
            db, self._db = self._db, None
            with contextlib.suppress(sqlite3.Error):
                db.close()
        if self._lock is not None:
            lock, self._lock = self._lock, None
            os.close(lock)

    def _failed(self, error: Exception) -> None:
        self.close()
        self.fault = f"{NAME}: {error}"
        damaged = isinstance(error, sqlite3.DatabaseError) and not isinstance(error, sqlite3.OperationalError)
        if damaged:
            self.set_aside += 1
            with contextlib.suppress(OSError):
                (self.folder / NAME).replace(self.folder / f"{NAME}.damaged")
                self._remove_journal()
            self._due_ns = 0

    def _remove_journal(self) -> None:
        for end in ("-wal", "-shm"):
            (self.folder / f"{NAME}{end}").unlink(missing_ok=True)

    def _opened(self) -> sqlite3.Connection:
        if self._db is not None:
            return self._db
        self._take_lock()
        path = self.folder / NAME
        if not path.exists():
            self._remove_journal()
        db = self._db = sqlite3.connect(path, timeout=0.2, isolation_level=None)
        db.execute("PRAGMA journal_mode = WAL")
        db.execute("PRAGMA synchronous = NORMAL")
        (version,) = db.execute("PRAGMA user_version").fetchone()
        if version != VERSION:
            if version or db.execute("SELECT 1 FROM sqlite_master").fetchone():
                raise sqlite3.DatabaseError(f"it is of version {version}, not {VERSION}")
            db.executescript(f"BEGIN; {_SCHEMA} COMMIT;")
        elif db.execute("PRAGMA quick_check(1)").fetchone() != ("ok",):
            raise sqlite3.DatabaseError("it is damaged")
        return db

    def _take_lock(self) -> None:
        if self._lock is None:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o750)
            self._lock = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # OSError: another process writes it

    def _all(self, *, final: bool) -> Iterator[None]:
        """In steps of some milliseconds."""
        db = self._opened()
        bays = sorted(entry.name for entry in os.scandir(self.folder) if entry.is_dir(follow_symlinks=False))
        for (gone,) in db.execute("SELECT DISTINCT bay FROM files").fetchall():
            if gone not in bays:
                self._forget(db, gone, [])
        for bay in bays:
            files = files_in(self.folder / bay)
            self._forget(db, bay, files)
            yield from self._bay(db, bay, files, final=final)

    def _forget(self, db: sqlite3.Connection, bay: str, files: list[StoredFile]) -> None:
        """The rows of files that are gone."""
        there = {(file.name.number, file.name.kind) for file in files}
        known = db.execute("SELECT number, kind FROM files WHERE bay = ?", (bay,)).fetchall()
        if gone := [(number, kind) for number, kind in known if (number, kind) not in there]:
            with _transaction(db):
                for number, kind in gone:
                    db.execute("DELETE FROM files WHERE bay = ? AND number = ? AND kind = ?", (bay, number, kind))
                    if kind == SEGMENT:
                        _delete_rows(db, bay, number)

    def _bay(self, db: sqlite3.Connection, bay: str, files: list[StoredFile], *, final: bool) -> Iterator[None]:
        query = "SELECT number, kind FROM files WHERE bay = ? AND complete = 1"
        complete = set(db.execute(query, (bay,)).fetchall())
        segments = [file for file in files if file.name.kind == SEGMENT]
        for file in files:
            number, kind = file.name.number, file.name.kind
            if (number, kind) in complete:
                continue
            path = self.folder / bay / str(file.name)
            if kind != SEGMENT:
                begun_ms = file.name.unix_s * 1000
                row = (bay, number, kind, path.name, begun_ms, begun_ms, "", 0, 0, 0, 0, 1)
                db.execute(f"INSERT OR REPLACE INTO files VALUES ({_marks(row)})", row)
                continue
            reading = self._tails.pop(bay, None)
            if reading is None or reading.number != number:
                reading = self._begun(db, path, bay, number)
            try:
                yield from _read(reading)
            except FileNotFoundError:
                continue  # deleted meanwhile
            ended = final or number != segments[-1].name.number
            self._store(db, reading, complete=ended)
            if not ended:
                self._tails[bay] = reading

    def _begun(self, db: sqlite3.Connection, path: Path, bay: str, number: int) -> _Reading:
        before = db.execute(
            "SELECT boot, newest_batch FROM files WHERE bay = ? AND kind = ? AND number < ? AND complete = 1"
            " ORDER BY number DESC LIMIT 1",
            (bay, SEGMENT, number),
        ).fetchone()
        return _Reading(path, bay, number, *(before or ("", 0)))

    def _store(self, db: sqlite3.Connection, reading: _Reading, *, complete: bool) -> None:
        rows, bay, number = reading.rows, reading.bay, reading.number
        begun_ms = ended_ms = lost = left_out = 0
        with _transaction(db):
            if not any(reading.written.values()):
                _delete_rows(db, bay, number)
            if rows is not None:
                if complete:
                    rows.finish()
                    reading.damaged += max(0, reading.length - reading.offset)
                begun_ms, ended_ms = rows.head.unix_ns // 1_000_000, rows.end_ms
                lost, left_out = rows.lost, rows.events_left_out
                of: dict[str, list[tuple[object, ...]]] = {
                    "visits": [(bay, begun, ended, number, text) for begun, ended, text in rows.visits],
                    "events": [(bay, e[0], number, place, *e[1:]) for place, e in enumerate(rows.events)],
                    "minutes": [(bay, *minute, number) for minute in rows.minutes],
                }
                for table, values in of.items():
                    for value in values[reading.written[table] :]:
                        db.execute(f"INSERT OR REPLACE INTO {table} VALUES ({_marks(value)})", value)
            row = (
                bay, number, SEGMENT, reading.path.name, begun_ms, ended_ms, reading.boot, reading.newest, lost,
                reading.damaged, left_out, int(complete),
            )  # fmt: skip
            db.execute(f"INSERT OR REPLACE INTO files VALUES ({_marks(row)})", row)
        if rows is not None:
            reading.written = {"visits": len(rows.visits), "events": len(rows.events), "minutes": len(rows.minutes)}


def _read(reading: _Reading) -> Iterator[None]:
    """What has been written to the segment since; a step after each block."""
    with reading.path.open("rb") as file:
        file.seek(reading.offset)
        data = file.read()
    begin, end = reading.offset, 0
    reading.length = begin + len(data)
    for block in blocks(data):
        if isinstance(block, Damage):
            if block.offset + block.length < len(data):  # what is at the end may still be written
                reading.damaged += block.length
            continue
        end = block.offset + block.size
        with contextlib.suppress(ProtocolError):
            _take(reading, block)
        yield
    reading.offset = begin + end


def _take(reading: _Reading, block: Block) -> None:
    if block.kind == BlockKind.HEAD:
        head = head_of(block.payload)
        if head.boot != reading.boot:
            reading.boot, reading.newest = head.boot, 0
        reading.rows = SegmentRows(head)
    elif block.kind == BlockKind.RECORDS and reading.rows is not None:
        batch, found = batch_of(block.payload)
        if batch > reading.newest:
            reading.newest = batch
            for record in found:
                reading.rows.add(record)


def _delete_rows(db: sqlite3.Connection, bay: str, number: int) -> None:
    for table in _OF_SEGMENT:
        db.execute(f"DELETE FROM {table} WHERE bay = ? AND segment = ?", (bay, number))


def _marks(values: tuple[object, ...]) -> str:
    return ", ".join("?" * len(values))


@contextlib.contextmanager
def _transaction(db: sqlite3.Connection) -> Iterator[None]:
    db.execute("BEGIN IMMEDIATE")
    try:
        yield
    except BaseException:
        with contextlib.suppress(sqlite3.Error):
            db.execute("ROLLBACK")
        raise
    db.execute("COMMIT")
