"""The fleet page's process beside gateways and a broker: what it hears, what it keeps, and that it writes nothing."""

import asyncio
import subprocess
from collections.abc import Iterator
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest

from tests.e2e.brokers import Mosquitto, Subscriber, program
from tests.e2e.fleet_process import Fleet
from tests.e2e.mqtt_plant import Plant
from tests.unit.fleet.test_roster import status

pytestmark = pytest.mark.timeout(180)
INVENTORY = '[[gateways]]\nsite = "site1"\ninstance = "gw"\n[[gateways]]\nsite = "site1"\ninstance = "gone"\n'


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    with Mosquitto(tmp_path) as broker:
        yield broker


def test_gateways_are_heard_lost_and_known_after_a_restart(broker: Mosquitto, tmp_path: Path) -> None:
    """Its topics are those of the gateways: it publishes on none of them, nor anywhere else."""
    (tmp_path / "inventory.toml").write_text(INVENTORY)
    inventory = 'inventory = "inventory.toml"'

    async def scenario() -> None:
        with Fleet(tmp_path, broker.url, more=inventory) as fleet:
            assert [(row["instance"], row["life"]) for row in fleet.rows()] == [
                ("gone", "never heard"),
                ("gw", "never heard"),
            ]
            plant = Plant(broker.url, "bay1", "bay2", instance="gw", keepalive_s=4)
            async with plant.running():
                found = await asyncio.to_thread(
                    fleet.until, lambda rows: [row["life"] for row in rows] == ["never heard", "online", "online"]
                )
            assert [row["bay"] for row in found] == ["", "bay1", "bay2"]
            assert [row["ne107"] for row in found[1:]] == ["FUNCTION_CHECK", "FUNCTION_CHECK"], "without sensors"
            await asyncio.to_thread(fleet.until, lambda rows: rows[1]["life"] == "offline")
            detail = fleet.get("/api/fleet/site1/gw")
            assert detail["changes"][0]["now"] == "offline"
            assert detail["status"]["bays"] == ["bay1", "bay2"]
            assert fleet.get("/healthz")["connected"] is True
            metrics = await asyncio.to_thread(fleet.read, "/metrics")
            assert 'loading_fleet_gateway_up{gateway="gw",site="site1"} 0.0' in metrics
        with Fleet(tmp_path, broker.url, more=inventory) as fleet:
            rows = await asyncio.to_thread(fleet.until, lambda rows: rows[1]["life"] == "offline")
            assert [row["bay"] for row in rows] == ["", "bay1", "bay2"]
            assert fleet.get("/api/fleet/site1/gw")["changes"] == detail["changes"]

    with Subscriber(broker, "#") as everything:
        asyncio.run(scenario())
    assert {message.topic.split("/")[2] for message in everything.messages} <= {"gw", "bay1", "bay2"}
    published = [line for line in broker.log.splitlines() if "Received PUBLISH from fleet-" in line]
    assert published == []
    assert "as fleet-" in broker.log


def test_without_a_broker_it_serves_and_connects_when_there_is_one(broker: Mosquitto, tmp_path: Path) -> None:
    broker.stop()
    with Fleet(tmp_path, broker.url) as fleet:
        assert fleet.get("/api/fleet")["connected"] is False
        assert _healthz(fleet) == 503
        broker.start()
        fleet.until(lambda _: _healthz(fleet) == 200)
        assert fleet.get("/api/fleet")["connected"] is True


def _healthz(fleet: Fleet) -> int:
    try:
        with urlopen(f"{fleet.url}/healthz", timeout=20) as answer:
            return int(answer.status)
    except HTTPError as error:
        return error.code


def test_a_large_status_is_read_and_one_that_is_too_large_ends_nothing(broker: Mosquitto, tmp_path: Path) -> None:
    with Fleet(tmp_path, broker.url) as fleet:
        fleet.until(lambda _: fleet.get("/api/fleet")["connected"])
        for name, size in (("huge", 2_000_000), ("large", 200_000), ("too-large", 300_000)):
            message = status(1, site="north", instance=name, filler="x" * size)
            to = ["-h", broker.host, "-p", str(broker.port), "-q", "1", "-t", f"loading/north/{name}/status"]
            subprocess.run([program("mosquitto_pub"), *to, "-s"], input=message, check=True)
        fleet.until(lambda _: "loading_fleet_damaged_messages 1.0" in fleet.read("/metrics"))
        assert [row["instance"] for row in fleet.until(lambda rows: rows != [])] == ["large"]
    assert fleet.log.count(": connected as fleet-") == 1
