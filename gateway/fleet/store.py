"""What outlives the fleet page's process: each gateway's last status, and what has changed. SQLite. IO: blocks."""

import contextlib
import sqlite3
from collections.abc import Iterable
from pathlib import Path

from msgspec import structs

from gateway.errors import ConfigError
from gateway.fleet.roster import GatewayChange, Key, Known, decoded

VERSION = 1
SCHEMA = f"""
CREATE TABLE IF NOT EXISTS statuses(site TEXT, instance TEXT, status TEXT, text BLOB,
  PRIMARY KEY(site, instance)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS changes(number INTEGER PRIMARY KEY, t_ms INTEGER, site TEXT, instance TEXT, what TEXT,
  was TEXT, now TEXT);
CREATE INDEX IF NOT EXISTS changes_of_gateway ON changes(site, instance, number);
PRAGMA user_version = {VERSION};
"""
MAX_CHANGES = 500_000  # some 60 MB; the oldest go first
SHOWN_CHANGES = 50


class FleetStore:
    """Raises ConfigError for a file that can't be used."""

    def __init__(self, path: Path) -> None:
        self._path = path
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

    def read(self) -> dict[Key, Known]:
        """As they were kept. None of them is alive before it is heard. Raises ConfigError."""
        try:
            kept = self._db.execute("SELECT status, text FROM statuses").fetchall()
        except sqlite3.Error as error:  # pages inside of it are damaged
            raise self._unusable(error) from error
        found = {}
        for life, text in kept:
            if (last := decoded(text)) is not None:
                found[last.site, last.instance] = Known(structs.replace(last, status=life), None, last, text)
        return found

    def _unusable(self, error: sqlite3.Error) -> ConfigError:
        return ConfigError(f"{self._path}: can't be used as the fleet's database: {error}")

    def keep(self, known: Iterable[Known], changes: Iterable[GatewayChange], gone: Iterable[Key] = ()) -> None:
        """Together or not at all. Raises sqlite3.Error."""
        with self._db:
            self._db.executemany("DELETE FROM statuses WHERE site = ? AND instance = ?", gone)
            self._db.executemany(
                "INSERT OR REPLACE INTO statuses VALUES (?, ?, ?, ?)",
                ((one.status.site, one.status.instance, one.status.status, one.text) for one in known if one.text),
            )
            self._db.executemany(
                "INSERT INTO changes(t_ms, site, instance, what, was, now) VALUES (?, ?, ?, ?, ?, ?)",
                ((change.t_ms, *change.key, change.what, change.was, change.now) for change in changes),
            )
            self._db.execute(
                "DELETE FROM changes WHERE number <= (SELECT max(number) FROM changes) - ?", (MAX_CHANGES,)
            )

    def changes(self, key: Key) -> list[GatewayChange]:
        """The newest of a gateway, the newest first. Raises sqlite3.Error."""
        query = "SELECT t_ms, what, was, now FROM changes WHERE site = ? AND instance = ? ORDER BY number DESC LIMIT ?"
        return [
            GatewayChange(t, key, what, was, now)
            for t, what, was, now in self._db.execute(query, (*key, SHOWN_CHANGES))
        ]
