"""The outbox's file: one SQLite table, held by one gateway at a time. IO; may wait for the disk."""

import contextlib
import fcntl
import os
import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path

from gateway.sinks.outbox.outbox import Entry

LAYOUT = 1  # PRAGMA user_version
KEPT_ASIDE = 3  # corrupt files kept for somebody to look at; older ones go
_CREATE = """CREATE TABLE IF NOT EXISTS events (
    place INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE, topic TEXT NOT NULL, payload BLOB NOT NULL,
    precious INTEGER NOT NULL, unix_ms INTEGER NOT NULL)"""


class StoreError(Exception):
    """The file can't be used now; the text says why. `corrupt`: what stands in it is no database any more."""

    def __init__(self, text: str, *, corrupt: bool = False) -> None:
        super().__init__(text)
        self.corrupt = corrupt


class EventFile:
    """The open database, and the lock that keeps a second gateway out of it. Every method raises StoreError."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = -1
        try:
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            self._lock = os.open(path.with_name(path.name + ".lock"), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.close(os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600))  # events are not for everybody
        except BlockingIOError:
            self._unlock()
            raise StoreError(f"{path}: another gateway uses it") from None
        except OSError as error:
            self._unlock()
            raise StoreError(f"{path}: {error.strerror or error}") from error
        try:
            with self._told():
                self._db = sqlite3.connect(path, timeout=0, isolation_level=None, check_same_thread=False)
                self._prepare()
        except StoreError:
            self.close()
            raise

    def _prepare(self) -> None:
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = FULL")  # a commit survives a power cut
        (layout,) = self._db.execute("PRAGMA user_version").fetchone()
        if layout not in (0, LAYOUT):
            raise StoreError(f"{self.path}: written by another version of the gateway (layout {layout})")
        self._db.execute(_CREATE)
        self._db.execute(f"PRAGMA user_version = {LAYOUT}")

    def entries(self) -> list[Entry]:
        """Everything in it, oldest first. A row that we can't have written makes the file a corrupt one."""
        with self._told():
            # Text as bytes: what is no UTF-8 any more must be told from a disk that fails.
            rows = self._db.execute(
                "SELECT CAST(id AS BLOB), CAST(topic AS BLOB), payload, precious, unix_ms FROM events ORDER BY place"
            ).fetchall()
        try:
            return [_entry(*row) for row in rows]
        except ValueError as error:
            raise StoreError(f"{self.path}: {error}", corrupt=True) from error

    def write(self, added: Iterable[Entry], removed: Iterable[str], *, instead: bool = False) -> None:
        """One transaction, on disk when it returns. `instead`: `added` is all there shall be."""
        with self._told():
            self._db.execute("BEGIN IMMEDIATE")
            try:
                if instead:
                    self._db.execute("DELETE FROM events")
                self._db.executemany(
                    "INSERT OR IGNORE INTO events (id, topic, payload, precious, unix_ms) VALUES (?, ?, ?, ?, ?)",
                    [(e.id, e.topic, e.payload, e.precious, e.unix_ms) for e in added],
                )
                self._db.executemany("DELETE FROM events WHERE id = ?", [(i,) for i in removed])
                self._db.execute("COMMIT")
            except sqlite3.Error:
                with contextlib.suppress(sqlite3.Error):
                    self._db.execute("ROLLBACK")
                raise

    def close(self) -> None:
        with contextlib.suppress(AttributeError, sqlite3.Error):
            self._db.close()
        self._unlock()

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            code = getattr(error, "sqlite_errorcode", 0) & 0xFF
            corrupt = code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
            raise StoreError(f"{self.path}: {error}", corrupt=corrupt) from error

    def _unlock(self) -> None:
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1


def _entry(name: object, topic: object, payload: object, precious: object, unix_ms: object) -> Entry:
    """SQLite keeps whatever type a damaged row says. Raises ValueError."""
    match name, topic, payload, precious, unix_ms:
        case bytes(), bytes(), bytes(), 0 | 1, int():
            return Entry(name.decode(), topic.decode(), payload, bool(precious), unix_ms)
    raise ValueError("a row that is no event")


def put_aside(path: Path) -> Path:
    """Move a corrupt file, and what belongs to it, out of the way. Raises StoreError."""
    try:
        taken = sorted(
            (p for p in path.parent.glob(f"{path.name}.corrupt-*") if p.suffix[9:].isdecimal()),
            key=lambda p: int(p.suffix[9:]),
        )
        number = int(taken[-1].suffix[9:]) + 1 if taken else 1
        for old in taken[: len(taken) + 1 - KEPT_ASIDE]:
            old.unlink(missing_ok=True)
        aside = path.with_name(f"{path.name}.corrupt-{number}")
        path.rename(aside)
        for tail in ("-wal", "-shm"):
            path.with_name(path.name + tail).unlink(missing_ok=True)
    except OSError as error:
        raise StoreError(f"{path}: is corrupt, and cannot be put aside: {error.strerror or error}") from error
    return aside
