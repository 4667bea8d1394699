"""The Node-RED flow's functions and the Grafana dashboard's fields, with what a real broker really delivers."""

import asyncio
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from gateway.core.detection import Circle
from gateway.core.events import EventKind
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Reason
from tests.e2e.brokers import Mosquitto, Received, Subscriber
from tests.e2e.mqtt_plant import Plant
from tests.node_function import run_function
from tests.unit.sinks.test_scada_grafana import PANELS, extracted, kind_of, shown

FLOW = Path(__file__).parents[2] / "docs" / "scada" / "node-red-loading-bays.json"


def function(name: str) -> str:
    (found,) = [node["func"] for node in json.loads(FLOW.read_text(encoding="utf-8")) if node.get("id") == name]
    return str(found)


def as_node_red_gets_it(messages: list[Received]) -> list[tuple[int, dict[str, Any]]]:
    """With the milliseconds since the message before."""
    out, before_s = [], messages[0].arrived_s
    for message in messages:
        later_ms = round((message.arrived_s - before_s) * 1000)
        out.append((later_ms, {"topic": message.topic, "payload": message.text, "retain": message.retained}))
        before_s = message.arrived_s
    return out


async def life(broker: Mosquitto) -> list[Received]:
    """A bay that starts, sees a truck, lets it go, and whose gateway is cut off."""
    plant = Plant(broker.url, keepalive_s=2)
    with Subscriber(broker, "loading/#") as subscriber:
        async with plant.running():
            await asyncio.to_thread(subscriber.wait_for, lambda m: '"online"' in m.text, 30)
            now_ns = plant.clock.now_ns()
            seen = VisionReading(now_ns, Quality.GOOD, Circle(320.0, 240.0, 200.0))
            near = RangeReading(now_ns, Quality.GOOD, 250.0)
            truck: dict[str, Any] = {"vision": seen, "range": near, "d": True, "stop": True, "may_move": False}
            plant.happen(EventKind.STOP_RAISED, **truck, reason=Reason.TARGET_REACHED)
            await asyncio.to_thread(subscriber.wait_for, lambda m: "stop_raised" in m.text and "event" in m.topic, 30)
        await asyncio.to_thread(subscriber.wait_for, lambda m: '"connection lost"' in m.text, 30)
        return list(subscriber.messages)


def test_what_the_broker_delivers_is_understood(tmp_path: Path) -> None:
    with Mosquitto(tmp_path) as broker:
        messages = asyncio.run(life(broker))
    fed = as_node_red_gets_it(messages)

    judged = run_function(function("lgb-judge"), fed)
    alarms = [found["payload"] for (_, told), _ in judged for found in told]
    assert alarms[0]["dead"] is True  # a state before any status
    assert any(not found["dead"] for found in alarms)
    assert (alarms[-1]["dead"], alarms[-1]["reason"]) == (True, "GATEWAY_OFFLINE")

    events = [message for _, message in fed if message["topic"].endswith("/event")]
    once = run_function(function("lgb-once"), [(0, message) for message in [*events, *events]])
    passed = [out[0]["payload"]["id"] for out, _ in once if out[0] is not None]
    assert passed == [json.loads(message["payload"])["id"] for message in events]
    assert once[-1][1] == f"{len(events)} repeated, 0 late, 0 damaged"

    for panel in PANELS:
        suffix = kind_of(panel).pattern.rsplit("/", 1)[1]
        newest = [found for found in messages if found.topic.endswith(f"/{suffix}")][-1].json
        aliases = dict(extracted(panel))
        for path in [*aliases.values(), *(shown(panel) - set(aliases))]:
            value: Any = newest
            for name in path.split("."):
                assert name in value, (panel["title"], path)
                value = value[name]


def test_a_state_left_behind_by_a_dead_gateway_looks_dead_to_a_newcomer(tmp_path: Path) -> None:
    """The first thing a Node-RED hears that starts after a gateway died."""
    with Mosquitto(tmp_path) as broker:

        async def until_cut() -> None:
            plant = Plant(broker.url, keepalive_s=2, protocol="3.1.1")  # its retained state stays for ever
            with Subscriber(broker, "loading/#") as subscriber:
                async with plant.running():
                    await asyncio.to_thread(subscriber.wait_for, lambda m: '"online"' in m.text, 30)
                await asyncio.to_thread(subscriber.wait_for, lambda m: '"connection lost"' in m.text, 30)

        asyncio.run(until_cut())
        with Subscriber(broker, "loading/#") as late:
            late.wait_until(lambda: late.on("/state") and late.on("/status"), 30)
            messages = [replace(found, arrived_s=0.0) for found in late.messages]
    assert all(found.retained for found in messages)
    judged = run_function(function("lgb-judge"), as_node_red_gets_it(messages))
    views = [found["payload"] for (told, _), _ in judged for found in told]
    assert views
    assert not any(view["alive"] or view["may_move"] for view in views)
