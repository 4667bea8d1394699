"""The tables of the index, and what goes into them together. IO; raises sqlite3.Error."""

import contextlib
import sqlite3
from collections.abc import Iterable, Iterator

from gateway.records.index_rows import MINUTE_COLUMNS
from gateway.records.names import ROWS, SEGMENT
from gateway.records.row_files import KeptRows

VERSION = 3
SCHEMA = f"""
CREATE TABLE files(bay TEXT, number INTEGER, kind TEXT, name TEXT, begun_ms INTEGER, ended_ms INTEGER, boot TEXT,
  newest_batch INTEGER, lost INTEGER, damaged INTEGER, events_left_out INTEGER, complete INTEGER,
  PRIMARY KEY(bay, number, kind)) WITHOUT ROWID;
CREATE TABLE visits(bay TEXT, begun_ms INTEGER, ended_ms INTEGER, segment INTEGER, summary TEXT,
  PRIMARY KEY(bay, begun_ms, segment)) WITHOUT ROWID;
CREATE TABLE events(bay TEXT, t_ms INTEGER, segment INTEGER, place INTEGER, kind TEXT, sensor TEXT, quality TEXT,
  detail TEXT, PRIMARY KEY(bay, t_ms, segment, place)) WITHOUT ROWID;
CREATE TABLE minutes(bay TEXT, {", ".join(MINUTE_COLUMNS)}, segment INTEGER,
  PRIMARY KEY(bay, minute, segment)) WITHOUT ROWID;
CREATE TABLE row_files(bay TEXT, number INTEGER, name TEXT, taken INTEGER, damaged INTEGER,
  PRIMARY KEY(bay, number)) WITHOUT ROWID;
CREATE TABLE kept(bay TEXT, segment INTEGER, begun_ms INTEGER, file INTEGER,
  PRIMARY KEY(bay, segment)) WITHOUT ROWID;
CREATE INDEX visits_of_segment ON visits(bay, segment);
CREATE INDEX events_of_segment ON events(bay, segment);
CREATE INDEX minutes_of_segment ON minutes(bay, segment);
PRAGMA user_version = {VERSION};
"""
TABLES = ("files", "visits", "events", "minutes", "row_files", "kept")
OUTLIVE = ("visits", "minutes")  # their segments
OF_SEGMENT = ("visits", "events", "minutes")


def insert(db: sqlite3.Connection, table: str, values: Iterable[tuple[object, ...]]) -> None:
    for value in values:
        db.execute(f"INSERT OR REPLACE INTO {table} VALUES ({', '.join('?' * len(value))})", value)


def delete_rows(db: sqlite3.Connection, tables: Iterable[str], bay: str, segment: int) -> None:
    for table in tables:
        db.execute(f"DELETE FROM {table} WHERE bay = ? AND segment = ?", (bay, segment))


def is_kept(db: sqlite3.Connection, bay: str, segment: int, begun_ms: int) -> bool:
    """Are the rows of that segment in a file of rows, and here as they are there?"""
    query = "SELECT 1 FROM kept WHERE bay = ? AND segment = ? AND begun_ms = ?"
    return db.execute(query, (bay, segment, begun_ms)).fetchone() is not None


def keep(db: sqlite3.Connection, bay: str, file: int, rows: KeptRows) -> None:
    """Rows out of file number `file`; the newest ones of a segment count."""
    delete_rows(db, OUTLIVE, bay, rows.segment)
    insert(db, "visits", ((bay, begun, ended, rows.segment, text) for begun, ended, text in rows.visits))
    insert(db, "minutes", ((bay, *minute, rows.segment) for minute in rows.minute_rows))
    insert(db, "kept", [(bay, rows.segment, rows.begun_ms, file)])


def forget_segment(db: sqlite3.Connection, bay: str, segment: int) -> None:
    """The segment is gone; what is kept of it stays."""
    db.execute("DELETE FROM files WHERE bay = ? AND number = ? AND kind = ?", (bay, segment, SEGMENT))
    delete_rows(db, ("events",), bay, segment)
    if db.execute("SELECT 1 FROM kept WHERE bay = ? AND segment = ?", (bay, segment)).fetchone() is None:
        delete_rows(db, OUTLIVE, bay, segment)


def forget_rows(db: sqlite3.Connection, bay: str, file: int) -> None:
    """The file of rows is gone; those of segments that are still there stay."""
    query = (
        "SELECT segment FROM kept WHERE bay = ? AND file = ? AND segment NOT IN"
        " (SELECT number FROM files WHERE bay = ? AND kind = ?)"
    )
    for (segment,) in db.execute(query, (bay, file, bay, SEGMENT)).fetchall():
        delete_rows(db, OUTLIVE, bay, segment)
    db.execute("DELETE FROM kept WHERE bay = ? AND file = ?", (bay, file))
    db.execute("DELETE FROM row_files WHERE bay = ? AND number = ?", (bay, file))


def files_known(db: sqlite3.Connection, bay: str) -> set[tuple[int, str]]:
    """Number and kind."""
    found = set(db.execute("SELECT number, kind FROM files WHERE bay = ?", (bay,)).fetchall())
    return found | {(n, ROWS) for (n,) in db.execute("SELECT number FROM row_files WHERE bay = ?", (bay,))}


@contextlib.contextmanager
def transaction(db: sqlite3.Connection) -> Iterator[None]:
    with db:  # commits, or rolls back and raises
        db.execute("BEGIN IMMEDIATE")
        yield
