"""The fleet page's store in a file. SQLite. IO: blocks a thread of its own."""

import asyncio
import contextlib
import sqlite3
import threading
from collections.abc import AsyncIterator
from pathlib import Path

from msgspec import structs

from gateway.errors import ConfigError, LinkError
from gateway.fleet.roster import GatewayChange, Key, Known, decoded
from gateway.fleet.store import MAX_CHANGES, MAX_CHANGES_EACH, SHOWN_CHANGES, SHOWN_SAMPLES, News, Past
from gateway.fleet.trends import TREND_PERIODS, Sample

VERSION = 1
SCHEMA = f"""
CREATE TABLE IF NOT EXISTS statuses(site TEXT, instance TEXT, status TEXT, text BLOB,
  PRIMARY KEY(site, instance)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS changes(number INTEGER PRIMARY KEY, t_ms INTEGER, site TEXT, instance TEXT, what TEXT,
  was TEXT, now TEXT);
CREATE INDEX IF NOT EXISTS changes_of_gateway ON changes(site, instance, number);
CREATE TABLE IF NOT EXISTS trends(site TEXT, instance TEXT, bay TEXT, period INTEGER, veil REAL, visible REAL,
  contrast REAL, PRIMARY KEY(site, instance, bay, period)) WITHOUT ROWID;
PRAGMA user_version = {VERSION};
"""
KEEP_SAMPLE = """
INSERT INTO trends VALUES (?, ?, ?, ?, ?, ?, ?) ON CONFLICT(site, instance, bay, period) DO UPDATE SET
  veil = max(coalesce(veil, excluded.veil), coalesce(excluded.veil, veil)),
  visible = min(coalesce(visible, excluded.visible), coalesce(excluded.visible, visible)),
  contrast = min(coalesce(contrast, excluded.contrast), coalesce(excluded.contrast, contrast))
"""
OLD_CHANGES = """
DELETE FROM changes WHERE site = :site AND instance = :instance AND number <=
  (SELECT number FROM changes WHERE site = :site AND instance = :instance ORDER BY number DESC LIMIT 1 OFFSET :each)
"""


class SqliteStore:
    """Raises ConfigError for a file that can't be used."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()  # a thread that was left goes on
        self._trimmed = 0  # period for which old samples are removed
        try:
            with contextlib.ExitStack() as opened:
                self._db = opened.enter_context(
                    contextlib.closing(sqlite3.connect(path, check_same_thread=False, timeout=5))
                )
                (version,) = self._db.execute("PRAGMA user_version").fetchone()
                if version not in (0, VERSION):
                    raise ConfigError(
                        f"{path}: made by another version of gateway fleet (layout {version}); move it away"
                    )
                self._db.execute("PRAGMA journal_mode = WAL")
                self._db.executescript(SCHEMA)
                opened.pop_all()
        except sqlite3.Error as error:
            raise self._unusable(error) from error

    def close(self) -> None:
        self._db.close()

    @contextlib.asynccontextmanager
    async def opened(self) -> AsyncIterator["SqliteStore"]:
        try:
            yield self
        except sqlite3.Error as error:
            raise LinkError(f"{self._path}: {error}") from error

    async def read(self) -> dict[Key, Known]:
        try:
            kept = await asyncio.to_thread(lambda: self._db.execute("SELECT status, text FROM statuses").fetchall())
        except sqlite3.Error as error:  # pages inside of it are damaged
            raise self._unusable(error) from error
        return known_of(kept)

    async def keep(self, news: News) -> None:
        await asyncio.to_thread(self._keep, news)

    async def past(self, key: Key) -> Past:
        return await asyncio.to_thread(self._past, key)

    def _unusable(self, error: sqlite3.Error) -> ConfigError:
        return ConfigError(f"{self._path}: can't be used as the fleet's database: {error}")

    def _keep(self, news: News) -> None:
        with self._lock, self._db:
            self._db.executemany("DELETE FROM statuses WHERE site = ? AND instance = ?", news.gone)
            self._db.executemany("DELETE FROM trends WHERE site = ? AND instance = ?", news.gone)
            self._db.executemany(
                "INSERT OR REPLACE INTO statuses VALUES (?, ?, ?, ?)",
                ((one.status.site, one.status.instance, one.status.status, one.text) for one in news.known),
            )
            self._db.executemany(
                "INSERT INTO changes(t_ms, site, instance, what, was, now) VALUES (?, ?, ?, ?, ?, ?)",
                ((change.t_ms, *change.key, change.what, change.was, change.now) for change in news.changes),
            )
            self._db.executemany(
                OLD_CHANGES,
                [
                    {"site": site, "instance": instance, "each": MAX_CHANGES_EACH}
                    for site, instance in {change.key for change in news.changes}
                ],
            )
            self._db.execute(
                "DELETE FROM changes WHERE number <= (SELECT max(number) FROM changes) - ?", (MAX_CHANGES,)
            )
            self._db.executemany(
                KEEP_SAMPLE,
                ((*s.key, s.bay, s.period, s.veil, s.visible, s.contrast) for s in news.samples),
            )
            newest = max((one.period for one in news.samples), default=self._trimmed)
            if newest != self._trimmed:
                self._db.execute(
                    "DELETE FROM trends WHERE period NOT BETWEEN ? AND ?", (newest - TREND_PERIODS + 1, newest)
                )
        self._trimmed = newest

    def _past(self, key: Key) -> Past:
        changes = (
            "SELECT t_ms, what, was, now FROM changes WHERE site = ? AND instance = ? ORDER BY number DESC LIMIT ?"
        )
        samples = (
            "SELECT bay, period, veil, visible, contrast FROM trends WHERE site = ? AND instance = ? "
            "ORDER BY bay, period LIMIT ?"
        )
        return Past(
            [
                GatewayChange(t, key, what, was, now)
                for t, what, was, now in self._db.execute(changes, (*key, SHOWN_CHANGES))
            ],
            [Sample(key, *row) for row in self._db.execute(samples, (*key, SHOWN_SAMPLES))],
        )


def known_of(kept: list[tuple[str, bytes]]) -> dict[Key, Known]:
    """Of what a gateway was last, and its last status; what is none is left out."""
    found = {}
    for life, text in kept:
        if (last := decoded(text)) is not None:
            found[last.site, last.instance] = Known(structs.replace(last, status=life), None, last, text)
    return found
