"""The fleet page with Debian's PostgreSQL as its store: what is kept, and a server that is away, hangs and returns."""

import asyncio
import subprocess
from collections.abc import Iterator
from pathlib import Path
from uuid import uuid4

import pytest

from gateway.fleet.config import FleetConfig
from gateway.fleet.postgresql_store import PostgresqlStore
from tests.e2e.brokers import Mosquitto, program
from tests.e2e.fleet_process import Fleet
from tests.e2e.postgres import PASSWORD, Postgres
from tests.unit.fleet.stores import keeps_what_it_is_given
from tests.unit.fleet.test_roster import TOPIC, status

pytestmark = pytest.mark.xdist_group("postgresql")


@pytest.fixture(scope="module")
def server() -> Iterator[Postgres]:
    with Postgres() as started:
        yield started


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    with Mosquitto(tmp_path) as running:
        yield running


def publish(broker: Mosquitto, message: bytes) -> None:
    to = ["-h", broker.host, "-p", str(broker.port), "-q", "1", "-r", "-t", TOPIC]
    subprocess.run([program("mosquitto_pub"), *to, "-s"], input=message, check=True)


def versions(fleet: Fleet) -> list[str]:
    """That the gateway has changed to, the newest first."""
    return [change["now"] for change in fleet.get("/api/fleet/north/bay-1")["changes"]]


def test_it_keeps_what_it_is_given(server: Postgres) -> None:
    more = {"database": server.url, "postgresql": {"schema_name": f"t{uuid4().hex[:12]}"}}
    given = {"mqtt": {"url": "mqtt://broker"}, "hmi": {"without_login": "viewer"}} | more
    asyncio.run(keeps_what_it_is_given(PostgresqlStore(FleetConfig.model_validate(given))))


def test_a_lost_server_stops_nothing_and_nothing_that_waits_is_lost(
    server: Postgres, broker: Mosquitto, tmp_path: Path
) -> None:
    more = f'database = "{server.url}"'
    with Fleet(tmp_path, broker.url, more=more) as fleet:
        fleet.until(lambda _: fleet.get("/api/fleet")["connected"])
        for t_ms in (1, 2):
            publish(broker, status(t_ms))
        fleet.until(lambda rows: [row["life"] for row in rows] == ["online"])
        publish(broker, status(3, version="0.3.0"))
        fleet.until(lambda rows: rows[0]["version"] == "0.3.0")
        fleet.until(lambda _: "loading_fleet_changes_waiting 0.0" in fleet.read("/metrics"))
        server.kill()
        publish(broker, status(4, version="0.4.0"))
        fleet.until(lambda rows: rows[0]["version"] == "0.4.0" and not fleet.get("/api/fleet")["kept"])
        detail = fleet.get("/api/fleet/north/bay-1")
        assert (detail["kept"], detail["changes"][0]["now"]) == (False, "0.4.0")
        assert "loading_fleet_changes_waiting 1.0" in fleet.read("/metrics")
        server.start()
        fleet.until(lambda _: versions(fleet) == ["0.4.0", "0.3.0"])
        server.pause()
        try:
            publish(broker, status(5, version="0.5.0"))
            fleet.until(lambda rows: rows[0]["version"] == "0.5.0")
            assert fleet.get("/api/fleet/north/bay-1")["kept"] is False
        finally:
            server.resume()
        fleet.until(
            lambda _: [c["now"] for c in fleet.get("/api/fleet/north/bay-1")["changes"]][1:] == ["0.4.0", "0.3.0"]
        )
    assert PASSWORD not in fleet.log
    with Fleet(tmp_path, broker.url, more=more) as fleet:
        fleet.until(lambda _: fleet.get("/api/fleet")["kept"])
        assert versions(fleet) == ["0.5.0", "0.4.0", "0.3.0"]
        found = fleet.get("/api/fleet/north/bay-1")
    assert [trend["bay"] for trend in found["trends"]] == ["bay-1"]


def test_without_a_server_it_begins_and_remembers_when_there_is_one(
    server: Postgres, broker: Mosquitto, tmp_path: Path
) -> None:
    more = f'database = "{server.url}"\n[postgresql]\nschema_name = "remembered"'
    with Fleet(tmp_path, broker.url, more=more) as fleet:
        publish(broker, status(1))
        fleet.until(lambda rows: len(rows) == 1 and fleet.get("/api/fleet")["kept"])
    broker.stop()
    server.stop()
    try:
        with Fleet(tmp_path, broker.url, more=more) as fleet:
            assert fleet.rows() == []
            server.start()
            fleet.until(lambda rows: [row["instance"] for row in rows] == ["bay-1"])
    finally:
        if server._process is None:
            server.start()
