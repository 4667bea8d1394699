"""The file of an outbox: one SQLite table, held by one gateway at a time. IO.

The same class serves twice: on disk, where every call may wait for the disk; and as the journal in shared memory,
which survives the process, not a power cut, and waits for nothing.
"""

import contextlib
import fcntl
import os
import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path

from gateway.sinks.outbox.outbox import OutboxEntry

LAYOUT = 1  # PRAGMA user_version
SPARE_BYTES = 1_000_000  # empty room in the file that is left there
SPARE_SHARE = 0.75  # of the file is empty where it is made smaller: what is rewritten is never more than a quarter
CORRUPT_FILES_KEPT = 3  # for inspection; older ones are removed
_CREATE = """CREATE TABLE IF NOT EXISTS events (
    place INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE, topic TEXT NOT NULL, payload BLOB NOT NULL,
    precious INTEGER NOT NULL, unix_ms INTEGER NOT NULL)"""


class StoreError(Exception):
    """The file can't be used now; the text has the reason. `corrupt`: not a database of ours. `locked`: another gateway
    uses it."""

    def __init__(self, text: str, *, corrupt: bool = False, locked: bool = False) -> None:
        super().__init__(text)
        self.corrupt = corrupt
        self.locked = locked


class EventFile:
    """The open database, and the lock that keeps a second gateway out of it. Every method raises StoreError.

    `synced`: a commit survives a power cut.
    """

    def __init__(self, path: Path, *, synced: bool = True) -> None:
        self.path = path
        self._synced = synced
        self._lock = -1
        self._db: sqlite3.Connection | None = None
        try:
            while not self._locked(path.with_name(path.name + ".lock")):
                self._unlock()
            os.close(os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600))  # only for the gateway's user
            if os.fstat(self._lock).st_uid != os.geteuid() or path.stat().st_uid != os.geteuid():
                raise PermissionError(0, "belongs to another user")
        except BlockingIOError:
            self._unlock()
            raise StoreError(f"{path}: another gateway uses it", locked=True) from None
        except OSError as error:
            self._unlock()
            raise StoreError(f"{path}: {error.strerror or error}") from error
        try:
            with self._errors():
                self._open()
        except StoreError:
            self.close()
            raise

    def _locked(self, path: Path) -> bool:
        """False: the file was removed, by the gateway that had it, just before it was locked here."""
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        self._lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
        fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        with contextlib.suppress(FileNotFoundError):
            return os.path.samestat(os.fstat(self._lock), os.stat(path, follow_symlinks=False))
        return False

    def _open(self) -> None:
        self._db = sqlite3.connect(self.path, timeout=0, isolation_level=None, check_same_thread=False)
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute(f"PRAGMA synchronous = {'FULL' if self._synced else 'OFF'}")
        (layout,) = self._db.execute("PRAGMA user_version").fetchone()
        if layout not in (0, LAYOUT):
            raise StoreError(f"{self.path}: written by another version of the gateway (layout {layout})")
        self._db.execute(_CREATE)
        if not layout:  # else nothing is written: there may be no room for it
            self._db.execute(f"PRAGMA user_version = {LAYOUT}")

    @property
    def left_out(self) -> int:
        """Events for which there was no room, as `write` has noted it last."""
        with self._errors() as db:
            return int(db.execute("PRAGMA application_id").fetchone()[0])

    def entries(self) -> list[OutboxEntry]:
        """Everything in it, oldest first. A row that is not an event makes the file corrupt."""
        with self._errors() as db:
            return _entries(db, self.path)

    def write(
        self,
        added: Collection[OutboxEntry],
        removed: Collection[str],
        *,
        instead: bool = False,
        left_out: int | None = None,
    ) -> None:
        """One transaction, on disk when it returns. `instead`: `added` is all there shall be; only what differs from
        that is written."""
        with self._errors() as db:
            db.execute("BEGIN IMMEDIATE")
            try:
                if instead:
                    found = {name for (name,) in db.execute("SELECT id FROM events")}
                    removed = found.difference(entry.id for entry in added)
                    added = [entry for entry in added if entry.id not in found]
                db.executemany(
                    "INSERT OR IGNORE INTO events (id, topic, payload, precious, unix_ms) VALUES (?, ?, ?, ?, ?)",
                    [(e.id, e.topic, e.payload, e.drop_last, e.unix_ms) for e in added],
                )
                db.executemany("DELETE FROM events WHERE id = ?", [(i,) for i in removed])
                if left_out is not None:
                    db.execute(f"PRAGMA application_id = {left_out}")  # a number of the header, free for any use
                db.execute("COMMIT")
            except sqlite3.Error:
                with contextlib.suppress(sqlite3.Error):
                    db.execute("ROLLBACK")
                raise

    def shrink(self) -> None:
        """Give back to the disk what a flood has taken, where most of the file is empty. What is left is rewritten.

        VACUUM and not auto_vacuum: that costs every write a page more, and older files have to be rewritten for it.
        """
        with self._errors() as db:
            pages, empty, size = (
                db.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "freelist_count", "page_size")
            )
            if empty * size > SPARE_BYTES and empty > SPARE_SHARE * pages:
                db.execute("PRAGMA temp_store = MEMORY")
                db.execute("VACUUM")
                db.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()

    def close(self) -> None:
        if self._db is not None:
            with contextlib.suppress(sqlite3.Error):
                self._db.close()
        self._unlock()

    def remove(self) -> None:
        """Delete it and close it."""
        self.delete(self.path)
        self.close()

    @staticmethod
    def delete(path: Path) -> None:
        """The file and what belongs to it."""
        for tail in ("", "-wal", "-shm", ".lock"):
            path.with_name(path.name + tail).unlink(missing_ok=True)

    @contextlib.contextmanager
    def _errors(self) -> Iterator[sqlite3.Connection]:
        with _told(self.path):
            yield self._db  # type: ignore[misc]  # None only while it is being opened

    def _unlock(self) -> None:
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1


def entries_in(path: Path) -> list[OutboxEntry]:
    """What is in a file that can't be opened, as its disk is full or read-only: read where it is. Raises StoreError."""
    log = path.with_name(f"{path.name}-wal")
    with _told(path):
        whole = not (log.is_file() and log.stat().st_size)  # else a kill has left something there
        uri = f"{path.absolute().as_uri()}?mode=ro{'&immutable=1' if whole else ''}"
        with contextlib.closing(sqlite3.connect(uri, timeout=0, uri=True)) as db:
            return _entries(db, path)


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    try:
        yield
    except (sqlite3.Error, OSError) as error:
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        corrupt = code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
        raise StoreError(f"{path}: {error}", corrupt=corrupt) from error


def _entries(db: sqlite3.Connection, path: Path) -> list[OutboxEntry]:
    # Text as bytes: invalid UTF-8 must not look like a failing disk.
    rows = db.execute(
        "SELECT CAST(id AS BLOB), CAST(topic AS BLOB), payload, precious, unix_ms FROM events ORDER BY place"
    ).fetchall()
    try:
        return [_entry(*row) for row in rows]
    except ValueError as error:
        raise StoreError(f"{path}: {error}", corrupt=True) from error


def _entry(name: object, topic: object, payload: object, drop_last: object, unix_ms: object) -> OutboxEntry:
    """SQLite keeps any type of a damaged row. Raises ValueError."""
    match name, topic, payload, drop_last, unix_ms:
        case bytes(), bytes(), bytes(), 0 | 1, int():
            return OutboxEntry(name.decode(), topic.decode(), payload, bool(drop_last), unix_ms)
    raise ValueError("a row that is no event")


def put_aside(path: Path) -> Path:
    """Rename a corrupt file, and remove what belongs to it. Raises StoreError."""
    try:
        taken = sorted(
            (p for p in path.parent.glob(f"{path.name}.corrupt-*") if p.suffix[9:].isdecimal()),
            key=lambda p: int(p.suffix[9:]),
        )
        number = int(taken[-1].suffix[9:]) + 1 if taken else 1
        for old in taken[: len(taken) + 1 - CORRUPT_FILES_KEPT]:
            old.unlink(missing_ok=True)
        aside = path.with_name(f"{path.name}.corrupt-{number}")
        path.rename(aside)
        for tail in ("-wal", "-shm"):
            path.with_name(path.name + tail).unlink(missing_ok=True)
    except OSError as error:
        raise StoreError(f"{path}: is corrupt, and cannot be renamed: {error.strerror or error}") from error
    return aside
