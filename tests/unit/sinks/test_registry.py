"""Sinks and MQTT topics from outside the package, in the real app and the real publisher; what the registry refuses."""

import asyncio
import json
import os
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from gateway import app, config_check, parts
from gateway.clock import SystemClock
from gateway.config import GatewayConfig, parse
from gateway.core.events import EventKind
from gateway.core.readings import Quality
from gateway.core.state import Reason, StateVector
from gateway.errors import ConfigError
from gateway.hub import Hub
from gateway.sinks import registry
from gateway.sinks.mqtt import publisher
from gateway.sinks.mqtt.topic_plan import PLAN, TopicKind
from gateway.sinks.mqtt.topics import Gateway
from gateway.supervisor import Task
from gateway.vision.source.specs import FileSpec
from tests.historian_sink import TABLES
from tests.unit.sinks.mqtt_stand_ins import Plant
from tests.unit.test_app import Sensors
from tests.virtual_time import run


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another distribution with two entry points, one of which is no sink."""
    folder = tmp_path / "historian-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: historian\nVersion: 1.0\n")
    points = "historian = tests.historian_sink:HISTORIAN\nwrong = tests.historian_sink:TABLES\n"
    (folder / "entry_points.txt").write_text(f"[{registry.GROUP}]\n{points}")
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures("installed")
def test_a_sink_of_another_distribution_gets_states_and_events_of_the_real_app(monkeypatch: pytest.MonkeyPatch) -> None:
    for service in ("VisionService", "RangerService"):
        monkeypatch.setattr(parts, service, Sensors)
    monkeypatch.setattr(app, "SHUTDOWN_SHOWN_S", 0.01)
    text = '[sinks.historian]\ntable = "plant"\n'
    document = {
        "instance": f"test-sink-{os.getpid()}",
        "state_dir": "",
        "modbus": {"port": 0},
        "fusion": {"decision": "plain"},
        "sinks": {"historian": {"table": "plant"}},
    }
    config = parse(document, text=text)
    config_check.check(config, source="g.toml", text=text)

    async def main() -> None:
        stop = asyncio.Event()

        def extra_tasks(hub: Hub) -> list[Task]:
            async def ends() -> None:
                seq = -1
                while not any(state.may_move for state in TABLES["plant"].states):
                    seq = await hub.newer("bay1", seq)
                stop.set()

            return [Task("ends", ends)]

        ports = parts.Ports(camera={"bay1": FileSpec("nothing")}, ranger={"bay1": [""]})
        await app.run(config, ports, SystemClock(), stop=stop, extra_tasks=extra_tasks)

    asyncio.run(asyncio.wait_for(main(), 60))
    rows = TABLES.pop("plant")
    seqs = [state.seq for state in rows.states]
    assert seqs == sorted(seqs)
    assert (rows.states[-1].reason, rows.states[-1].stop) == (Reason.SHUTDOWN, True)
    kinds = [event.kind for event in rows.events]
    assert (kinds[0], kinds[-1]) == (EventKind.START, EventKind.SHUTDOWN)
    assert EventKind.STOP_CLEARED in kinds


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize(
    ("sinks", "expected"),
    [
        ({"historien": {}}, "sinks.historien: no such sink; known here: historian, postgresql, wrong"),
        ({"wrong": {}}, "sinks.wrong: the entry point tests.historian_sink:TABLES is not a SinkType"),
        ({"mqtt": {}}, "sinks.mqtt: has its own section (docs/config.md)"),
        ({"historian": {"tabel": "x"}}, 'sinks.historian: tabel = "x": unknown key (misspelt?); known here: table'),
        ({"historian": {"table": ""}}, 'sinks.historian: table = "": String should have at least 1 character'),
    ],
)
def test_what_is_not_known_is_an_error_that_names_it(sinks: dict[str, dict[str, Any]], expected: str) -> None:
    config = GatewayConfig(sinks=sinks)
    with ExitStack() as resources, pytest.raises(ConfigError) as caught:
        registry.opened(config, Hub(["bay1"]), SystemClock(), "b", resources)
    assert str(caught.value) == expected
    text = "".join(f"\n[sinks.{name}]\n" for name in sinks)
    with pytest.raises(ConfigError) as caught:
        config_check.check(config, source="g.toml", text=text)
    assert str(caught.value) == f"g.toml:2: {expected}"


class DistancePayload(BaseModel):
    distance_mm: float | None
    stop: bool


def distance(state: StateVector, gateway: Gateway, offset_ns: int, stale_after_ms: int) -> DistancePayload:
    good = state.range.quality is Quality.GOOD
    return DistancePayload(distance_mm=state.range.distance_mm if good else None, stop=state.stop)


DISTANCE = TopicKind("distance", True, True, DistancePayload, "the distance alone", distance)


def test_a_topic_of_another_module_is_published_with_every_state(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(publisher, "PLAN", (*PLAN, DISTANCE))

    async def scene() -> None:
        plant = Plant("bay1", "bay2")
        plant.broker.check = lambda topic, payload: json.loads(payload)
        async with plant.running():
            await asyncio.sleep(1.9)  # between two publications
        for bay in ("bay1", "bay2"):
            states, distances = plant.broker.on(f"{bay}/state"), plant.broker.on(f"{bay}/distance")
            assert len(distances) == len(states) > 2
            assert {message.topic for message in distances} == {f"r/site/{bay}/distance"}
            assert all(message.retain and message.json == {"distance_mm": None, "stop": True} for message in distances)

    run(scene())


def mqtt(**settings: Any) -> GatewayConfig:
    return parse({"mqtt": {"url": "mqtt://127.0.0.1:9", "outbox_file": "", **settings}}, text="")


@pytest.mark.parametrize(
    ("settings", "names"),
    [
        ({}, ["mqtt"]),
        ({"sparkplug": {}}, ["mqtt", "sparkplug"]),
        ({"sparkplug": {}, "plain_topics": False}, ["sparkplug"]),
    ],
)
def test_plain_topics_and_sparkplug_are_configured_apart(settings: dict[str, Any], names: list[str]) -> None:
    config = mqtt(**settings)
    with ExitStack() as resources:
        sinks = registry.opened(config, Hub(["bay1"]), SystemClock(), "00" * 8, resources)
        assert [sink.link.sink for sink in sinks] == names
        assert [sink.task for sink in sinks] == [{"mqtt": "mqtt.deliver"}.get(name, "mqtt.sparkplug") for name in names]


def test_without_plain_topics_the_broker_is_still_checked() -> None:
    config = mqtt(sparkplug={}, plain_topics=False, password_file="/missing", username="joe")
    faults = []
    for part in registry.checks(config):
        try:
            part()
        except ConfigError as error:
            faults.append(str(error))
    assert faults == ['mqtt.password_file = "/missing": No such file or directory']


@pytest.mark.parametrize(
    ("settings", "fault"),
    [
        ({"plain_topics": False}, r"plain_topics.*nothing would be published"),
        ({"plain_topics": False, "sparkplug": {}, "home_assistant": True}, r"home_assistant.*plain_topics is false"),
    ],
)
def test_plain_topics_that_something_needs_cannot_be_off(settings: dict[str, Any], fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        mqtt(**settings)
