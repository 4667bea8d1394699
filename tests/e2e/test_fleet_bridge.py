"""The bridge of docs/fleet.md, word for word but for addresses and secrets, between two real brokers."""

import asyncio
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion

from gateway.core.events import EventKind
from tests.e2e.brokers import Mosquitto, Subscriber
from tests.e2e.fleet_bridge import PAGE, bridge_lines
from tests.e2e.mqtt_plant import Plant
from tests.e2e.sparkplug_plant import SparkPlant, host_state, rebirth_request

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def brokers(tmp_path: Path) -> Iterator[tuple[Mosquitto, Mosquitto]]:
    """The site's and the cluster's."""
    for name in ("site", "cluster"):
        (tmp_path / name).mkdir()
    with (
        Mosquitto(tmp_path / "cluster") as cluster,
        Mosquitto(tmp_path / "site", lines=bridge_lines(cluster.port)) as site,
    ):
        yield site, cluster


def say(broker: Mosquitto, topic: str, payload: bytes, *, retain: bool = False, user: str = "", word: str = "") -> None:
    client = mqtt.Client(CallbackAPIVersion.VERSION2, "scada-speaks")
    if user:
        client.username_pw_set(user, word)
    client.connect("127.0.0.1", broker.port)
    client.loop_start()
    client.publish(topic, payload, qos=1, retain=retain).wait_for_publish(20)
    client.disconnect()
    client.loop_stop()


async def seen(subscriber: Subscriber, *parts: str, timeout_s: float = 30.0) -> Any:
    """A message whose topic and text hold all parts."""
    return await asyncio.to_thread(
        subscriber.wait_for, lambda m: all(part in f"{m.topic} {m.text}" for part in parts), timeout_s
    )


def bridged(subscriber: Subscriber) -> None:
    subscriber.wait_for(lambda m: m.topic == "bridges/cement-north/state" and m.text == "1", 30)


def test_states_status_and_events_arrive_and_the_retained_ones_stay(brokers: tuple[Mosquitto, Mosquitto]) -> None:
    site, cluster = brokers

    async def life() -> None:
        plant = Plant(site.url, keepalive_s=2)
        with Subscriber(cluster, "loading/#", "bridges/#") as far:
            await asyncio.to_thread(bridged, far)
            async with plant.running():
                await seen(far, "/status", '"online"')
                await seen(far, "/state")
                plant.happen(EventKind.STOP_RAISED)
                await seen(far, "/event", "stop_raised")
                with Subscriber(cluster, "loading/#") as late:
                    found = await seen(late, "/status", '"online"')
                    assert found.retained
                    found = await seen(late, "/state")
                    assert found.retained
            await seen(far, "/status", '"connection lost"')  # the site's broker tells the last will, too

    asyncio.run(life())


def test_a_state_expires_at_the_cluster_as_well(brokers: tuple[Mosquitto, Mosquitto]) -> None:
    """MQTT 5 all the way: what `stale_after_ms` allows passes the bridge."""
    site, cluster = brokers

    async def life() -> None:
        plant = Plant(site.url, keepalive_s=2, state_period_s=0.5)
        with Subscriber(cluster, "bridges/#") as far:
            await asyncio.to_thread(bridged, far)
        async with plant.running():
            with Subscriber(cluster, "loading/+/+/state", args=("-V", "5")) as far:
                limit_ms = (await seen(far, "/state")).json["stale_after_ms"]
        for _ in range(200):
            with Subscriber(cluster, "loading/#", args=("-V", "5")) as late:
                await seen(late, "/status")
                await asyncio.sleep(0.2)
                if not late.on("/state"):
                    return
        raise AssertionError(f"still there, {limit_ms} ms and more after the gateway died")

    asyncio.run(life())


@pytest.mark.long
def test_events_of_a_time_without_the_cluster_arrive_afterwards_in_order(brokers: tuple[Mosquitto, Mosquitto]) -> None:
    site, cluster = brokers

    async def life() -> list[str]:
        plant = Plant(site.url, keepalive_s=2)
        with Subscriber(cluster, "loading/#", "bridges/#") as far:
            await asyncio.to_thread(bridged, far)
            async with plant.running():
                await seen(far, "/status", '"online"')
                cluster.kill()
                for n in range(50):
                    plant.happen(EventKind.STOP_RAISED if n % 2 == 0 else EventKind.STOP_CLEARED)
                await plant.until(lambda: plant.publisher.stats.queued == 0, 30)  # the site's broker has them all
                before = len(far.messages)
                cluster.start()
                last = plant.publisher.stats.published
                assert last >= 50
                await asyncio.to_thread(
                    far.wait_until,
                    lambda: len({m.json["id"] for m in far.messages[before:] if m.topic.endswith("/event")}) >= 50,
                    60,
                )
            return [m.json["id"] for m in far.messages[before:] if m.topic.endswith("/event")]

    counts = [int(name.rsplit("-", 1)[1]) for name in asyncio.run(life())]
    once = list(dict.fromkeys(counts))
    assert once == list(range(once[0], once[0] + 50))


def test_a_dead_site_broker_is_told_at_the_cluster(brokers: tuple[Mosquitto, Mosquitto]) -> None:
    """And nothing else tells it there: the gateways' last wills died with their broker."""
    site, cluster = brokers

    async def life() -> None:
        plant = Plant(site.url, keepalive_s=2, protocol="3.1.1")
        with Subscriber(cluster, "loading/#", "bridges/#") as far:
            await asyncio.to_thread(bridged, far)
            async with plant.running():
                await seen(far, "/status", '"online"')
                site.kill()
                found = await asyncio.to_thread(
                    far.wait_for, lambda m: m.topic == "bridges/cement-north/state" and m.text == "0", 60
                )
                assert found
        with Subscriber(cluster, "loading/+/+/status", "bridges/#") as late:
            assert '"online"' in (await seen(late, "/status")).text  # a lie that only the second rule finds out
            assert (await seen(late, "bridges/")).text == "0"

    asyncio.run(life())


def test_sparkplug_passes_the_bridge_in_both_directions(brokers: tuple[Mosquitto, Mosquitto]) -> None:
    site, cluster = brokers

    def births(subscriber: Subscriber) -> list[Any]:
        return [m for m in subscriber.messages if "/NBIRTH/" in m.topic]

    async def life() -> None:
        with Subscriber(cluster, "bridges/#") as far:
            await asyncio.to_thread(bridged, far)
        plant = SparkPlant(site.port, group="cement-north", primary_host="scada")
        # Hexadecimal: payloads are bytes, and the reader goes by lines.
        hexed = ("-F", "| %r %q %t %x")
        with Subscriber(cluster, "spBv1.0/+/NBIRTH/#", "spBv1.0/+/DBIRTH/#", "spBv1.0/+/DDATA/#", "spBv1.0/+/NDEATH/#",
                        args=hexed) as far:  # fmt: skip
            async with plant.running():
                say(cluster, "spBv1.0/STATE/scada", host_state(online=True, timestamp=1000), retain=True)
                await asyncio.to_thread(far.wait_until, lambda: len(births(far)) == 1, 30)
                await asyncio.to_thread(
                    far.wait_until, lambda: [m for m in far.messages if "/DBIRTH/" in m.topic][1:], 30
                )
                plant.see("bay1", 200.0, 250.0)
                await seen(far, "/DDATA/")
                say(cluster, "spBv1.0/cement-north/NCMD/gw", rebirth_request())
                await asyncio.to_thread(far.wait_until, lambda: len(births(far)) == 2, 30)
                with Subscriber(site, "spBv1.0/STATE/#") as near:
                    found = await seen(near, "STATE/scada")
                    assert found.retained  # a gateway that comes later finds it
                    assert json.loads(found.text)["online"] is True
                await plant.publisher.close(10.0)
            await seen(far, "/NDEATH/")

    asyncio.run(life())


def test_with_the_pages_rights_a_gateway_speaks_for_its_own_bay_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GATEWAY_WORD", "a")
    (rights,) = re.findall(r"```acl\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "acl").write_text(
        rights.replace("loading/cement-north", "loading/site1") + "\nuser scada\ntopic readwrite #\n"
    )
    users = {"gw": "a", "bay1": "b", "scada": "c"}
    lines = [f"acl_file {tmp_path / 'acl'}"]

    async def life(broker: Mosquitto) -> None:
        own = f"mqtt://bay1:b@127.0.0.1:{broker.port}"
        plant = Plant(own, "bay1", instance="bay1", keepalive_s=2)
        spark = SparkPlant(broker.port, group="cement-north", username="gw", password_env="GATEWAY_WORD")
        hexed = ("-F", "| %r %q %t %x", "-u", "scada", "-P", "c")
        with Subscriber(broker, "loading/#", "spBv1.0/+/NBIRTH/#", args=hexed) as far:
            async with plant.running(), spark.running():
                await seen(far, "loading/site1/bay1/status")
                await seen(far, "loading/site1/bay1/state")
                await seen(far, "NBIRTH/gw")
                say(broker, "spBv1.0/cement-north/NCMD/gw", rebirth_request(), user="scada", word="c")
                await asyncio.to_thread(
                    far.wait_until, lambda: [m for m in far.messages if "NBIRTH" in m.topic][1:], 30
                )
        stranger = Plant(own, "bay2", instance="bay2", keepalive_s=2)  # with bay1's password
        with Subscriber(broker, "loading/+/bay2/#", args=hexed) as far:
            async with stranger.running():
                await stranger.until(lambda: stranger.link_errors > 0, 30)  # MQTT 5 says so: not authorized
            assert far.messages == []

    with Mosquitto(tmp_path, users=users, lines=lines) as broker:
        asyncio.run(life(broker))


def test_the_pages_bridge_is_read_whole() -> None:
    lines = bridge_lines(1)
    assert [line for line in lines if line.startswith("connection")] == ["connection to-cluster"]
    assert sum(line.startswith("topic ") for line in lines) == 14
    assert not any("#" in line.split(" ", 2)[-1] for line in lines if not line.startswith("topic"))
