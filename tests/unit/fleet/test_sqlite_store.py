"""The fleet page's store in a file."""

import asyncio
import sqlite3
from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.fleet.sqlite_store import SqliteStore
from gateway.fleet.store import News
from tests.unit.fleet.stores import keeps_what_it_is_given
from tests.unit.fleet.test_roster import alive


def test_it_keeps_what_it_is_given(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path / "fleet.sqlite")
    asyncio.run(keeps_what_it_is_given(store))
    store.close()


def test_a_damaged_row_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "fleet.sqlite"
    SqliteStore(path).close()
    with sqlite3.connect(path) as db:
        db.execute("INSERT INTO statuses VALUES ('north', 'x', 'online', 'no status')")
    db.close()
    store = SqliteStore(path)
    assert asyncio.run(store.read()) == {}
    store.close()


def test_a_file_that_is_damaged_inside_is_named(tmp_path: Path) -> None:
    path = tmp_path / "fleet.sqlite"
    store = SqliteStore(path)
    asyncio.run(store.keep(News(list(alive().known.values()))))
    store.close()
    data = path.read_bytes()
    path.write_bytes(data[:4096] + b"\xaa" * (len(data) - 4096))
    store = SqliteStore(path)
    with pytest.raises(ConfigError, match=r"fleet\.sqlite: can't be used"):
        asyncio.run(store.read())
    store.close()


@pytest.mark.parametrize("kind", ["no database", "another layout", "a folder"])
def test_a_file_that_can_t_be_used_is_named(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "fleet.sqlite"
    if kind == "no database":
        path.write_bytes(b"x" * 5000)
    elif kind == "a folder":
        path.mkdir()
    else:
        with sqlite3.connect(path) as db:
            db.execute("PRAGMA user_version = 99")
        db.close()
    with pytest.raises(ConfigError, match=f"^{path}: "):
        SqliteStore(path)
