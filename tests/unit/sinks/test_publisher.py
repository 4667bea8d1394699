"""The publisher against a broker made of memory, in virtual time: hours of outage cost nothing."""

import asyncio
import json
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from gateway.config import MqttConfig
from gateway.core.events import EventKind
from gateway.core.readings import Quality
from gateway.core.state import Reason
from gateway.errors import ConfigError
from gateway.hub import Hub
from gateway.sinks.contract import BayAlarms, ShownAlarm
from gateway.sinks.mqtt.publisher import MqttPublisher
from tests import virtual_time
from tests.mqtt_messages import checked
from tests.sink_context import sink_context
from tests.unit.sinks.mqtt_stand_ins import Plant, in_virtual_time, now_s
from tests.virtual_time import LoopClock


@pytest.mark.one_interpreter
@in_virtual_time
async def test_online_is_published_only_when_every_bay_s_state_is_new() -> None:
    plant = Plant("bay1", "bay2", "bay3")
    plant.broker.ack_s = 0.1
    async with plant.running():
        await asyncio.sleep(0.45)
        first = [message.topic for message in plant.broker.received[:7]]
    assert sorted(first[:3]) == ["r/site/bay1/state", "r/site/bay2/state", "r/site/bay3/state"]
    assert sorted(first[3:6]) == ["r/site/bay1/alarms", "r/site/bay2/alarms", "r/site/bay3/alarms"]
    assert first[6] == "r/site/gw/status"
    assert plant.broker.received[6].at_s == pytest.approx(plant.broker.received[0].at_s + 0.2)
    assert plant.broker.received[6].json["status"] == "online"
    assert plant.broker.received[6].json["delivery"]["published"] == 6
    assert all(message.retain for message in plant.broker.received)


@in_virtual_time
async def test_a_state_without_urgent_changes_is_published_once_a_period() -> None:
    plant = Plant(state_period_s=0.5)
    async with plant.running():
        await asyncio.sleep(10.1)
    times = [message.at_s for message in plant.broker.on("/state")]
    assert len(times) == 21
    assert {round(b - a, 6) for a, b in pairwise(times)} == {0.5}


def alarm(state: str, *, active: bool) -> ShownAlarm:
    return ShownAlarm(
        "bay1.camera_down", "camera_down", "Camera down", "high", state, state == "unacknowledged", active, 0
    )


@in_virtual_time
async def test_alarms_are_published_when_they_change_and_again_and_none_stays_after_the_end() -> None:
    plant, known = Plant(), [BayAlarms((alarm("normal", active=False),), (), True)]
    plant.publisher._alarms = lambda bay, now_ns: known[0]
    async with plant.running():
        await asyncio.sleep(1.01)
        known[0] = BayAlarms((alarm("unacknowledged", active=True),), (), True)
        await asyncio.sleep(15)
        known[0] = BayAlarms()  # nothing evaluates them any more
        await asyncio.sleep(1)
        assert await plant.publisher.close(1.0) is True
    found = plant.broker.on("/alarms")
    seen = [(m.json["evaluated"], m.json["active"], m.json["alarms"] and m.json["alarms"][0]["state"]) for m in found]
    raised = (True, 1, "unacknowledged")
    assert seen == [(True, 0, []), raised, raised, (False, None, None), (False, None, None)]
    assert found[1].at_s - found[0].at_s == pytest.approx(1.5)
    assert found[2].at_s - found[1].at_s == pytest.approx(10)
    assert all(message.retain for message in found)
    assert found[1].json["highest_priority"] == "high"


@in_virtual_time
async def test_each_value_has_a_topic_of_its_own_where_that_is_configured() -> None:
    plant = Plant(state_period_s=60, values=True, values_period_s=5, area="packing")
    plant.broker.check = lambda topic, text: {"": json.loads(text)} if "/value/" in topic else checked(topic, text)
    async with plant.running():
        await asyncio.sleep(1)
        plant.change(stop=False)
        await asyncio.sleep(1)
    stops = plant.broker.on("/value/stop")
    assert [message.json[""] for message in stops] == [True, False]
    assert {(message.topic, message.retain) for message in stops} == {("r/site/packing/bay1/value/stop", False)}


@pytest.mark.parametrize(
    "change",
    [
        {"stop": False},
        {"may_move": True},
        {"reason": Reason.NO_ECHO},
        {"vision": Quality.NO_TARGET},
        {"range": Quality.STUCK},
    ],
    ids=lambda change: next(iter(change)),
)
def test_an_urgent_change_is_published_at_once(change: dict[str, Any]) -> None:
    async def scenario() -> None:
        plant = Plant(state_period_s=60)
        state = plant.hub.state("bay1")
        values = {k: replace(getattr(state, k), quality=v) if isinstance(v, Quality) else v for k, v in change.items()}
        async with plant.running():
            await asyncio.sleep(7.01)
            before_s = now_s()
            plant.change(**values)
            await asyncio.sleep(1)
        found = plant.broker.on("/state")
        assert len(found) == 2
        assert found[1].at_s == before_s
        for key, value in change.items():
            published = found[1].json[key]
            name = published["quality"]["name"] if key in ("vision", "range") else published
            assert (name["name"] if key == "reason" else name) == getattr(value, "name", value)

    virtual_time.run(scenario())


@in_virtual_time
async def test_to_a_slow_broker_the_newest_state_is_published_one_at_a_time() -> None:
    plant = Plant(state_period_s=0.5)
    async with plant.running():
        await asyncio.sleep(1.01)
        plant.broker.ack_s = 3.0
        for _ in range(100):
            await asyncio.sleep(0.1)
            plant.change(stop=not plant.hub.state("bay1").stop)
            assert plant.broker.unacknowledged <= 2  # a state and a status
        plant.broker.ack_s = 0.0
        await asyncio.sleep(4)
        last = plant.broker.on("/state")[-1].json["seq"]
        assert 0 <= plant.hub.state("bay1").seq - last <= 25
    seqs = [message.json["seq"] for message in plant.broker.on("/state")]
    assert seqs == sorted(set(seqs))
    assert plant.link_errors == []


@in_virtual_time
async def test_a_bay_that_is_not_computed_any_more_does_not_look_alive() -> None:
    plant = Plant("bay1", "bay2", state_period_s=0.5)
    async with plant.running():
        await asyncio.sleep(1)
        plant.change(stop=False, may_move=True, reason=Reason.NONE)
        died_s = now_s()
        plant.computing.remove("bay1")
        await asyncio.sleep(10)
        published = [message for message in plant.broker.on("bay1/state") if message.at_s > died_s]
        dead = [message for message in published if message.json["reason"]["name"] == "GATEWAY_FAULT"]
        assert 3.0 < dead[0].at_s - died_s <= 3.11
        for message in published:
            is_dead = message.at_s >= dead[0].at_s
            assert (message.json["stop"], message.json["may_move"]) == (is_dead, not is_dead)
        assert plant.broker.on("bay2/state")[-1].json["reason"]["name"] == "STARTING"
        plant.computing.add("bay1")
        back_s = now_s()
        await asyncio.sleep(0.03)
        assert plant.broker.on("bay1/state")[-1].json["may_move"] is True
        assert plant.broker.on("bay1/state")[-1].at_s == pytest.approx(back_s + 0.02, abs=0.001)


@in_virtual_time
async def test_a_status_every_half_keepalive() -> None:
    plant = Plant(keepalive_s=10, state_period_s=60)
    async with plant.running():
        await asyncio.sleep(21)
    assert [round(message.at_s - plant.broker.received[0].at_s) for message in plant.broker.on("/status")] == [
        0,
        5,
        10,
        15,
        20,
    ]


@in_virtual_time
async def test_events_are_published_in_order_and_are_not_retained() -> None:
    plant = Plant("bay1", "bay2")
    plant.broker.ack_s = 0.2
    async with plant.running():
        await asyncio.sleep(1)
        kinds = [EventKind.TARGET_FOUND, EventKind.STOP_RAISED, EventKind.STOP_CLEARED, EventKind.TARGET_LOST]
        for number, kind in enumerate(kinds):
            plant.happen(kind, f"bay{1 + number % 2}")
        await asyncio.sleep(2)
    found = plant.broker.on("/event")
    assert [message.json["kind"] for message in found] == [kind.value for kind in kinds]
    assert [message.topic for message in found] == ["r/site/bay1/event", "r/site/bay2/event"] * 2
    assert [message.json["id"].split("-")[1] for message in found] == ["1", "2", "3", "4"]
    # The first of each topic alone, and the second of the connection after its first.
    assert [round(b.at_s - a.at_s, 6) for a, b in pairwise(found)] == [0.2, 0.0, 0.2]
    assert not any(message.retain for message in found)


@pytest.mark.one_interpreter
@in_virtual_time
async def test_an_event_carries_the_time_it_happened_not_the_time_it_was_delivered() -> None:
    plant = Plant()
    plant.broker.refuses = True
    async with plant.running(plant.keep_delivering):
        await asyncio.sleep(5)
        happened_ms = plant.clock.wall_ns() // 1_000_000
        plant.happen(EventKind.STOP_RAISED)
        await asyncio.sleep(3600)
        plant.broker.refuses = False
        await asyncio.sleep(2)
    assert plant.broker.on("/event")[0].json["timestamp_ms"] == happened_ms


@in_virtual_time
async def test_what_was_not_acknowledged_is_published_again_unchanged() -> None:
    plant = Plant()
    async with plant.running():
        await asyncio.sleep(1)
        plant.broker.hung = True
        plant.happen(EventKind.STOP_RAISED)
        plant.happen(EventKind.STOP_CLEARED)
        await asyncio.sleep(5)
        plant.broker.hung = False
        await asyncio.sleep(5)
    found = plant.broker.on("/event")
    assert [message.json["kind"] for message in found] == ["stop_raised", "stop_raised", "stop_cleared"]
    assert found[0].json == found[1].json
    assert plant.broker.ends[0] == "cut"
    assert plant.publisher.stats.failed >= 1
    assert plant.publisher.stats.reconnects == 1
    assert plant.publisher.stats.queued == 0


@in_virtual_time
async def test_a_hung_broker_is_noticed_within_one_and_a_half_keepalives() -> None:
    """With states so rare that only the status can notice."""
    plant = Plant(keepalive_s=10, state_period_s=60)
    async with plant.running():
        await asyncio.sleep(20.5)  # just after a status
        plant.broker.hung = True
        async with asyncio.timeout(12.6):
            await plant.failed.wait()
    assert plant.link_errors == ["no acknowledgement"]


@in_virtual_time
async def test_a_lost_connection_is_one_link_error_at_once() -> None:
    plant = Plant("bay1", "bay2", "bay3")
    connected = [plant.publisher.link.connected]
    async with plant.running():
        await asyncio.sleep(1)
        connected.append(plant.publisher.link.connected)
        plant.broker.lose()
        await asyncio.sleep(0)
        await asyncio.sleep(0.01)
        assert plant.link_errors == ["connection lost"]
        connected.append(plant.publisher.link.connected)
        await asyncio.sleep(2)
        assert plant.broker.connections == 2
        assert [*connected, plant.publisher.link.connected] == [False, True, False, True]
        assert plant.broker.ends == ["cut"]


@in_virtual_time
async def test_a_bug_is_not_taken_for_a_lost_link() -> None:
    plant = Plant()
    plant.broker.bug = ZeroDivisionError("a bug")
    with pytest.raises(ExceptionGroup) as caught:
        await plant.publisher.deliver()
    assert caught.value.subgroup(ZeroDivisionError) is not None
    assert plant.broker.ends == ["cut"]


@pytest.mark.failure_mode("Q1")
@in_virtual_time
async def test_events_wait_while_there_is_no_broker_and_stops_are_dropped_last() -> None:
    plant = Plant(outbox_events=10)
    plant.broker.refuses = True
    async with plant.running():
        await asyncio.sleep(1)
        for _ in range(4):
            plant.happen(EventKind.STOP_RAISED)
            plant.happen(EventKind.STOP_CLEARED)
        await asyncio.sleep(1)
        for _ in range(5):
            plant.happen(EventKind.TARGET_FOUND)
        await asyncio.sleep(1)
        assert plant.publisher.stats.queued == 10
        assert plant.publisher.stats.dropped == 3
        plant.broker.refuses = False
        await asyncio.sleep(3)
    assert plant.broker.kinds() == ["stop_raised", "stop_cleared"] * 4 + ["target_found"] * 2
    assert [int(name.split("-")[1]) for name in plant.broker.ids()] == [*range(1, 9), 12, 13]
    assert plant.broker.on("/status")[0].json["delivery"]["dropped"] == 3


@in_virtual_time
async def test_events_are_in_the_outbox_before_any_task_runs() -> None:
    plant = Plant(outbox_events=10)
    for _ in range(13):
        plant.happen(EventKind.STOP_RAISED)
    assert plant.publisher.stats.dropped == 3
    assert plant.publisher.stats.queued == 10


@in_virtual_time
async def test_events_from_before_the_first_task_runs_are_not_missed() -> None:
    plant = Plant()
    plant.happen(EventKind.START)
    async with plant.running():
        await asyncio.sleep(0.1)
    assert plant.broker.kinds() == ["start"]


def final_messages(plant: Plant) -> list[tuple[str, str]]:
    """Topic and content of each message since closing began: the shutdown state is the first."""
    start = next(i for i, h in enumerate(plant.broker.received) if h.json.get("reason", {}).get("name") == "SHUTDOWN")
    return [
        (h.topic, h.json.get("kind") or h.json.get("cause") or f"stop {h.json['stop']}")
        for h in plant.broker.received[start:]
        if not h.topic.endswith("/alarms")
    ]


@in_virtual_time
async def test_closing_beside_a_live_connection() -> None:
    plant = Plant("bay1", "bay2")
    async with plant.running():
        await asyncio.sleep(1)
        plant.change("bay1", stop=False, may_move=True, reason=Reason.NONE)
        plant.happen(EventKind.SHUTDOWN, "bay2")
        assert await plant.publisher.close(1.0) is True
        assert plant.broker.ends == ["disconnected"]
        await asyncio.sleep(100)  # nothing more is published, and nothing connects again
    assert final_messages(plant) == [
        ("r/site/bay1/state", "stop True"),
        ("r/site/bay2/state", "stop True"),
        ("r/site/gw/status", "shutdown"),
    ]
    assert plant.broker.kinds() == ["shutdown"]  # was on its way already
    assert plant.broker.connections == 1
    assert plant.link_errors == []


@in_virtual_time
async def test_an_event_in_flight_when_closing_begins_is_published_once() -> None:
    plant = Plant()
    plant.broker.ack_s = 0.1
    async with plant.running():
        await asyncio.sleep(1)
        for _ in range(3):
            plant.happen(EventKind.STOP_RAISED)
        await asyncio.sleep(0.05)
        plant.happen(EventKind.SHUTDOWN)
        assert await plant.publisher.close(1.0) is True
    assert plant.broker.kinds() == ["stop_raised"] * 3 + ["shutdown"]


@in_virtual_time
async def test_closing_without_a_connection_makes_one() -> None:
    plant = Plant()
    plant.happen(EventKind.STOP_RAISED)
    plant.happen(EventKind.SHUTDOWN)
    assert await plant.publisher.close(1.0) is True
    assert final_messages(plant) == [
        ("r/site/bay1/state", "stop True"),
        ("r/site/bay1/event", "stop_raised"),
        ("r/site/bay1/event", "shutdown"),
        ("r/site/gw/status", "shutdown"),
    ]
    assert plant.broker.ends == ["disconnected"]
    await plant.publisher.deliver()  # returns: there is nothing left to do
    assert await plant.publisher.close(1.0) is True
    assert plant.broker.connections == 1


@in_virtual_time
async def test_closing_between_two_tries_to_connect() -> None:
    plant = Plant()
    plant.broker.refuses = True
    async with plant.running():
        await asyncio.sleep(2.5)
        plant.broker.refuses = False
        assert await plant.publisher.close(1.0) is True
        await asyncio.sleep(10)
    assert plant.broker.connections == 1
    assert plant.broker.ends == ["disconnected"]


@in_virtual_time
async def test_closing_to_a_hung_broker_ends_in_time_and_leaves_it_to_the_will() -> None:
    plant = Plant()
    async with plant.running():
        await asyncio.sleep(1)
        plant.happen(EventKind.SHUTDOWN)
        plant.broker.hung = True
        begun_s = now_s()
        assert await plant.publisher.close(0.75) is False
        assert now_s() - begun_s == pytest.approx(0.75)
    assert plant.broker.ends == ["cut"]


@in_virtual_time
async def test_closing_without_a_broker_ends_at_once() -> None:
    plant = Plant()
    plant.broker.refuses = True
    begun_s = now_s()
    assert await plant.publisher.close(1.0) is False
    assert now_s() == begun_s


@in_virtual_time
async def test_closing_to_a_slow_broker_publishes_the_states_first() -> None:
    plant = Plant("bay1", "bay2")
    for _ in range(50):
        plant.happen(EventKind.TARGET_FOUND)
    plant.broker.ack_s = 0.2
    assert await plant.publisher.close(1.0) is False
    assert [message.topic for message in plant.broker.received[:2]] == ["r/site/bay1/state", "r/site/bay2/state"]
    assert plant.broker.kinds() == ["target_found"] * (1 + 2 + 4)  # twice as many with every answer
    assert plant.broker.ends == ["cut"]


@in_virtual_time
async def test_a_connection_that_breaks_during_closing_ends_it_at_once() -> None:
    plant = Plant()
    plant.broker.hung = True
    begun_s = now_s()
    asyncio.get_running_loop().call_later(0.1, plant.broker.lose)
    assert await plant.publisher.close(1.0) is False
    assert now_s() - begun_s == pytest.approx(0.1)


@in_virtual_time
async def test_a_connection_that_breaks_during_closing_is_tried_once_more() -> None:
    plant = Plant()
    plant.broker.ack_s = 0.1
    async with plant.running():
        await asyncio.sleep(1)
        plant.happen(EventKind.SHUTDOWN)
        closing = asyncio.get_running_loop().create_task(plant.publisher.close(1.0))
        await asyncio.sleep(0.05)
        plant.broker.lose()
        assert await closing is True
    assert plant.broker.ends == ["cut", "disconnected"]
    assert plant.broker.on("/status")[-1].json["cause"] == "shutdown"
    assert plant.broker.kinds()[-1] == "shutdown"


@in_virtual_time
async def test_a_cancelled_delivery_cuts_its_connection() -> None:
    plant = Plant()
    async with plant.running():
        await asyncio.sleep(1)
    assert plant.broker.ends == ["cut"]
    assert plant.broker.on("/status")[-1].json["status"] == "online"


@pytest.mark.parametrize("settings", [{"url": "mqtt://broker:0"}, {"root": "a//b"}])
def test_what_can_never_work_is_a_config_error_at_once(settings: dict[str, str]) -> None:
    config = MqttConfig(**({"url": "mqtt://broker"} | settings))
    with pytest.raises(ConfigError, match=r"^mqtt\."):
        MqttPublisher(sink_context(config, Hub(["bay1"]), LoopClock()))


def test_two_starts_have_different_boot_numbers() -> None:
    async def boot() -> str:
        plant = Plant()
        await plant.publisher.close(1.0)
        return str(plant.broker.on("/status")[-1].json["boot"])

    first, second = virtual_time.run(boot()), virtual_time.run(boot())
    assert first != second
    assert len(first) == len(second) == 16
