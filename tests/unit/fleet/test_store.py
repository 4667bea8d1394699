"""What outlives the fleet page's process."""

import sqlite3
from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.fleet.roster import GatewayChange, GatewayLife, Roster
from gateway.fleet.store import SHOWN_CHANGES, FleetStore
from tests.unit.fleet.test_roster import KEY, TOPIC, alive, last_will


def test_a_gateway_is_known_after_a_restart_and_not_taken_for_alive(tmp_path: Path) -> None:
    path = tmp_path / "fleet.sqlite"
    store, roster = FleetStore(path), alive()
    _, changes = roster.heard(TOPIC, last_will(), 7_000)
    store.keep(roster.known.values(), changes)
    store.close()
    store = FleetStore(path)
    again = Roster(known=store.read())
    assert again.known[KEY].last == roster.known[KEY].last
    assert again.life(KEY, 7_000) is GatewayLife.OFFLINE
    assert again.heard(TOPIC, last_will(), 9_000) == (KEY, []), "what was known is no change"
    assert store.changes(KEY) == changes
    assert store.changes(("north", "other")) == []
    store.close()


def test_a_gateway_that_is_gone_is_not_known_after_a_restart(tmp_path: Path) -> None:
    store, roster = FleetStore(tmp_path / "fleet.sqlite"), alive()
    store.keep(roster.known.values(), ())
    assert list(store.read()) == [KEY]
    store.keep((), (), [KEY])
    assert store.read() == {}
    store.close()


def test_the_newest_changes_are_shown(tmp_path: Path) -> None:
    store = FleetStore(tmp_path / "fleet.sqlite")
    made = [GatewayChange(n, KEY, "version", str(n), str(n + 1)) for n in range(SHOWN_CHANGES + 5)]
    store.keep((), made)
    assert store.changes(KEY) == made[: -SHOWN_CHANGES - 1 : -1]
    store.close()


def test_a_damaged_row_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "fleet.sqlite"
    FleetStore(path).close()
    with sqlite3.connect(path) as db:
        db.execute("INSERT INTO statuses VALUES ('north', 'x', 'online', 'no status')")
    db.close()
    store = FleetStore(path)
    assert store.read() == {}
    store.close()


def test_a_file_that_is_damaged_inside_is_named(tmp_path: Path) -> None:
    path = tmp_path / "fleet.sqlite"
    store = FleetStore(path)
    store.keep(alive().known.values(), ())
    store.close()
    data = path.read_bytes()
    path.write_bytes(data[:4096] + b"\xaa" * (len(data) - 4096))
    store = FleetStore(path)
    with pytest.raises(ConfigError, match=r"fleet\.sqlite: can't be used"):
        store.read()
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
        FleetStore(path)
