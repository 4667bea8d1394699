"""The index of a gateway's recordings: one SQLite file, made of the segments and never the other way round. IO.

It holds the rows of `index_rows` and the list of files, and follows the files: what is deleted there goes here. The
visits and minutes of a segment that is over are put into a file of rows (`row_files`), which outlives the segment. It
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
from gateway.records import row_files
from gateway.records.files import files_in
from gateway.records.index_rows import SegmentRows
from gateway.records.index_tables import (
    OF_SEGMENT,
    SCHEMA,
    VERSION,
    delete_rows,
    files_known,
    forget_rows,
    forget_segment,
    insert,
    is_kept,
    keep,
    transaction,
)
from gateway.records.names import ROWS, SEGMENT, FileName
from gateway.records.retention import StoredFile
from gateway.records.segment import Block, BlockKind, DamagedBytes, batch_of, blocks, head_of

NAME = "index.sqlite"
COMMIT_NS = 60 * 1_000_000_000
KEPT_AT_ONCE = 5  # segments' rows: some milliseconds


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
    written: dict[str, int] = field(default_factory=lambda: dict.fromkeys(OF_SEGMENT, 0))  # rows in the file


@dataclass(slots=True)
class Index:
    """Of `folder`, which holds one folder for each bay. `fault`: why it cannot be written now; empty: it can."""

    folder: Path
    fault: str = ""
    set_aside: int = 0  # times the file was damaged, and begun anew
    _db: sqlite3.Connection | None = None
    _lock: int | None = None
    _tails: dict[str, _Reading] = field(default_factory=dict)  # by bay: the segment that is being written
    _soon: set[str] = field(default_factory=set)  # bays
    _work: Iterator[None] | None = None
    _due_ns: int = 0

    def soon(self, bay: str) -> None:
        """Do not wait a minute for what was written of this bay: a visit is over."""
        self._soon.add(bay)

    def work(self, budget_ns: int) -> bool:
        """Do some of what there is to do, once a minute all of it; is more left? Raises nothing that a disk may do."""
        end_ns = machine_ns() + budget_ns
        if self._work is None:
            bays = None
            if machine_ns() >= self._due_ns:
                self._due_ns = machine_ns() + COMMIT_NS
            elif self._soon:
                bays = frozenset(self._soon)
            else:
                return False
            self._soon.clear()
            self._work = self._all(bays, final=False)
        try:
            for _ in self._work:
                if machine_ns() >= end_ns:
                    return True
            self.fault = ""
        except (sqlite3.Error, OSError) as error:
            self._failed(error)
        self._work = None
        return bool(self._soon)

    def rebuild(self) -> None:
        """Anew, all of it; the newest segments are over, too. Raises BlockingIOError while a gateway writes it,
        OSError and sqlite3.Error."""
        self._take_lock()
        (self.folder / NAME).unlink(missing_ok=True)
        for _ in self._all(None, final=True):
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
            db.executescript(f"BEGIN; {SCHEMA} COMMIT;")
        elif db.execute("PRAGMA quick_check(1)").fetchone() != ("ok",):
            raise sqlite3.DatabaseError("it is damaged")
        return db

    def _take_lock(self) -> None:
        if self._lock is None:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o750)
            self._lock = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # OSError: another process writes it

    def _all(self, only: frozenset[str] | None, *, final: bool) -> Iterator[None]:
        """Of these bays, None: of all. In steps of some milliseconds."""
        db = self._opened()
        bays = sorted(entry.name for entry in os.scandir(self.folder) if entry.is_dir(follow_symlinks=False))
        for (gone,) in db.execute("SELECT bay FROM files UNION SELECT bay FROM row_files").fetchall():
            if gone not in bays:
                self._forget(db, gone, [])
        for bay in bays if only is None else sorted(only.intersection(bays)):
            files = files_in(self.folder / bay)
            for file in files:
                if file.name.kind == ROWS:
                    yield from self._take_rows(db, bay, file.name, file.size_bytes)
            self._forget(db, bay, files)
            yield from self._bay(db, bay, files, final=final)

    def _forget(self, db: sqlite3.Connection, bay: str, files: list[StoredFile]) -> None:
        """The rows of files that are gone."""
        there = {(file.name.number, file.name.kind) for file in files}
        for number, kind in sorted(files_known(db, bay) - there):
            with transaction(db):
                if kind == ROWS:
                    forget_rows(db, bay, number)
                elif kind == SEGMENT:
                    forget_segment(db, bay, number)
                else:
                    db.execute("DELETE FROM files WHERE bay = ? AND number = ? AND kind = ?", (bay, number, kind))

    def _take_rows(self, db: sqlite3.Connection, bay: str, name: FileName, size_bytes: int) -> Iterator[None]:
        """What the file of rows has that is not here."""
        query = "SELECT taken, damaged FROM row_files WHERE bay = ? AND number = ? AND name = ?"
        taken, damaged = db.execute(query, (bay, name.number, str(name))).fetchone() or (0, 0)
        if size_bytes == taken:
            return
        if size_bytes < taken:  # it is another one
            taken = damaged = 0
        found = row_files.read(self.folder / bay / str(name), taken)
        if not taken:
            with transaction(db):
                forget_rows(db, bay, name.number)
        for n in range(0, len(found.rows), KEPT_AT_ONCE):
            with transaction(db):
                for rows in found.rows[n : n + KEPT_AT_ONCE]:
                    keep(db, bay, name.number, rows)
            yield
        with transaction(db):
            insert(db, "row_files", [(bay, name.number, str(name), found.end, damaged + found.damaged)])

    def _keep(self, db: sqlite3.Connection, reading: _Reading) -> None:
        """Put the rows of a segment that is over into a file of rows, and from there here."""
        rows, bay = reading.rows, reading.bay
        if rows is None or is_kept(db, bay, reading.number, rows.begun_ms):
            return
        if (kept := row_files.of_segment(rows)) is not None:
            name = row_files.append(self.folder / bay, kept)
            for _ in self._take_rows(db, bay, name, (self.folder / bay / str(name)).stat().st_size):
                pass

    def _bay(self, db: sqlite3.Connection, bay: str, files: list[StoredFile], *, final: bool) -> Iterator[None]:
        query = "SELECT number, kind FROM files WHERE bay = ? AND complete = 1"
        complete = set(db.execute(query, (bay,)).fetchall())
        segments = [file for file in files if file.name.kind == SEGMENT]
        for file in files:
            number, kind = file.name.number, file.name.kind
            if (number, kind) in complete or kind == ROWS:
                continue
            path = self.folder / bay / str(file.name)
            if kind != SEGMENT:
                begun_ms = file.name.unix_s * 1000
                row = (bay, number, kind, path.name, begun_ms, begun_ms, "", 0, 0, 0, 0, 1)
                insert(db, "files", [row])
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
        of: dict[str, list[tuple[object, ...]]] = {}
        if complete:
            reading.damaged += max(0, reading.length - reading.offset)
            if rows is not None:
                rows.finish()
            self._keep(db, reading)
        if rows is not None:
            begun_ms, ended_ms, lost, left_out = rows.begun_ms, rows.end_ms, rows.lost, rows.events_left_out
            of["events"] = [(bay, e[0], number, place, *e[1:]) for place, e in enumerate(rows.events)]
            if not is_kept(db, bay, number, begun_ms):
                of["visits"] = [(bay, begun, ended, number, text) for begun, ended, text in rows.visits]
                of["minutes"] = [(bay, *minute, number) for minute in rows.minutes]
        with transaction(db):
            if not any(reading.written.values()):
                delete_rows(db, of, bay, number)
            for table, values in of.items():
                insert(db, table, values[reading.written[table] :])
            row = (
                bay, number, SEGMENT, reading.path.name, begun_ms, ended_ms, reading.boot, reading.newest, lost,
                reading.damaged, left_out, int(complete),
            )  # fmt: skip
            insert(db, "files", [row])
        reading.written |= {table: len(values) for table, values in of.items()}


def _read(reading: _Reading) -> Iterator[None]:
    """What has been written to the segment since; a step after each block."""
    with reading.path.open("rb") as file:
        file.seek(reading.offset)
        data = file.read()
    begin, end = reading.offset, 0
    reading.length = begin + len(data)
    for block in blocks(data):
        if isinstance(block, DamagedBytes):
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
