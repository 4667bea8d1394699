"""Events on their way: in order, several at once; topics without a subscriber, refused ones, ones that end connections.

In virtual time, against a broker made of memory.
"""

import asyncio
import json
from typing import Any

import pytest

from gateway.alarms.definition import GatewayConditions, GatewayInputs
from gateway.alarms.table import ALARM_DEFINITIONS
from gateway.core.events import EventKind
from gateway.sinks.contract import LinkStatus
from gateway.sinks.mqtt.event_delivery import Window
from gateway.sinks.mqtt.topic_answers import TopicAnswers
from tests.unit.sinks.mqtt_stand_ins import Plant, in_virtual_time, now_s

EVENT, EVENT_2 = "r/site/bay1/event", "r/site/bay2/event"


def quick(*bays: str, **settings: Any) -> Plant:
    """Its messages are not checked against their schemas, which other tests do: here there are many."""
    plant = Plant(*bays, **settings)
    plant.broker.check = lambda _, payload: json.loads(payload)
    return plant


def numbers(plant: Plant, bay: str = "bay1") -> list[int]:
    """Of the events that arrived, each copy."""
    return [int(message.json["id"].split("-")[1]) for message in plant.broker.on(f"{bay}/event")]


def figures(plant: Plant, *names: str) -> list[int]:
    found: dict[str, Any] = plant.publisher.link.figures
    return [found[name] for name in names]


def refused(link: LinkStatus) -> str:
    return link.alarms.get("messages_refused", "")


def unsubscribed(link: LinkStatus) -> str:
    return link.alarms.get("events_unsubscribed", "")


def happen(plant: Plant, count: int, bay: str = "bay1", kind: EventKind = EventKind.TARGET_FOUND) -> None:
    for _ in range(count):
        plant.happen(kind, bay)


# Several at once.


@pytest.mark.parametrize(("in_flight", "most"), [(20, 15), (64, 48), (3, 2), (1, 1)])
def test_three_quarters_of_what_may_be_on_its_way_are_events_in_order(in_flight: int, most: int) -> None:
    @in_virtual_time
    async def scenario() -> None:
        plant = quick(state_period_s=60)
        plant.broker.ack_s, plant.broker.in_flight = 0.1, in_flight
        seen = 0
        async with plant.running():
            await asyncio.sleep(1)
            happen(plant, 200)
            begun_s = now_s()
            while figures(plant, "outbox_events") != [0]:
                seen = max(seen, plant.broker.unacknowledged)
                await asyncio.sleep(0.01)
        assert numbers(plant) == list(range(1, 201))
        assert most <= seen <= most + 1  # a status
        if most == 48:
            assert now_s() - begun_s < 1.2  # one after the other: 20 s
        if most == 1:
            assert now_s() - begun_s >= 20.0

    scenario()


@in_virtual_time
async def test_the_first_event_of_a_topic_goes_alone_and_other_topics_do_not_wait_for_it() -> None:
    plant = quick("bay1", "bay2", state_period_s=60)
    async with plant.running():
        await asyncio.sleep(1)
        happen(plant, 1, "bay2")
        for _ in range(6):
            plant.broker.ack_s = 0.0
            happen(plant, 1, "bay2")
            await asyncio.sleep(0.01)
        plant.broker.ack_s = 0.1
        happen(plant, 3)
        happen(plant, 3, "bay2")
        begun_s = now_s()
        await asyncio.sleep(1)
    assert [round(m.at_s - begun_s, 6) for m in plant.broker.on("bay1/event")] == [0.0, 0.1, 0.1]
    assert [round(m.at_s - begun_s, 6) for m in plant.broker.on("bay2/event")[-3:]] == [0.0, 0.0, 0.0]


@in_virtual_time
async def test_after_a_break_all_that_was_on_its_way_is_sent_again_in_order() -> None:
    plant = quick(state_period_s=60)
    plant.broker.ack_s = 0.1
    async with plant.running():
        await asyncio.sleep(1)
        happen(plant, 8)
        await asyncio.sleep(0.25)  # 1 is acknowledged, then 2 and 3; 4 to 7 are on their way
        plant.broker.lose()
        await asyncio.sleep(5)
    assert numbers(plant) == [1, 2, 3, 4, 5, 6, 7, 4, 5, 6, 7, 8]
    assert figures(plant, "outbox_events", "events_dropped") == [0, 0]


def test_the_window_grows_by_one_and_is_halved_when_the_link_is_slow() -> None:
    window = Window(10, slow_ns=1000)
    sizes = []
    for took_ns in (10, 10, 999, 10, 10, 10, 10, 10, 10, 10, 10, 1000, 10, 2000, 2000, 2000):
        window.acknowledged(took_ns)
        sizes.append(window.size)
    assert sizes == [2, 3, 4, 5, 6, 7, 8, 9, 10, 10, 10, 5, 6, 3, 1, 1]
    assert Window(0, 1).size == 1


# Nobody subscribes.


@pytest.mark.one_interpreter
@in_virtual_time
async def test_what_nobody_receives_is_kept_and_the_oldest_tried_again_with_longer_waits() -> None:
    plant = quick("bay1", "bay2", state_period_s=60)
    plant.broker.unsubscribed = {EVENT}
    async with plant.running():
        await asyncio.sleep(1)
        begun_s = now_s()
        happen(plant, 3)
        await asyncio.sleep(100)
        tries = [round(message.at_s - begun_s) for message in plant.broker.on("bay1/event")]
        assert tries == [0, 1, 3, 7, 15, 31, 61, 91]
        assert set(numbers(plant)) == {1}
        happen(plant, 2, "bay2")  # has a subscriber: at once
        await asyncio.sleep(0.1)
        assert numbers(plant, "bay2") == [4, 5]
        assert figures(plant, "events_held", "events_dropped", "events_unsubscribed") == [3, 0, 0]
        plant.broker.unsubscribed = set()
        await asyncio.sleep(25)
        assert numbers(plant)[-3:] == [1, 2, 3]
        assert figures(plant, "events_held", "outbox_events") == [0, 0]
    assert plant.link_errors == []


@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_subscriber_to_one_bay_makes_the_others_be_tried_at_once() -> None:
    plant = quick("bay1", "bay2", state_period_s=60)
    plant.broker.unsubscribed = {EVENT, EVENT_2}
    async with plant.running():
        await asyncio.sleep(1)
        happen(plant, 1)
        await asyncio.sleep(20)
        happen(plant, 1, "bay2")
        await asyncio.sleep(50)
        plant.broker.unsubscribed = set()
        await asyncio.sleep(30)
    first, second = plant.broker.on("bay1/event")[-1], plant.broker.on("bay2/event")[-1]
    assert abs(first.at_s - second.at_s) < 0.1


@in_virtual_time
async def test_a_new_connection_tries_at_once() -> None:
    """Its broker may be another, or know its subscribers again."""
    plant = quick(state_period_s=60)
    plant.broker.unsubscribed = {EVENT}
    async with plant.running():
        await asyncio.sleep(1)
        happen(plant, 2)
        await asyncio.sleep(40)
        plant.broker.unsubscribed = set()
        plant.broker.lose()
        await asyncio.sleep(1.1)
        assert numbers(plant)[-2:] == [1, 2]


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_without_any_subscriber_the_oldest_expire_no_event_is_lost_and_no_alarm_is_raised() -> None:
    plant = quick(state_period_s=60, unsubscribed_h=0.1, outbox_events=50)
    plant.broker.unsubscribed = {EVENT}
    async with plant.running():
        await asyncio.sleep(1)
        for _ in range(30):
            happen(plant, 1)
            await asyncio.sleep(30)
        assert figures(plant, "events_held", "events_unsubscribed") == [12, 18]  # six minutes'
        happen(plant, 60, kind=EventKind.STOP_RAISED)  # more than there is room for
        link = plant.publisher.link
        assert figures(plant, "events_held", "events_unsubscribed") == [50, 40]
    assert (link.events_lost, unsubscribed(link), refused(link)) == (0, "", "")
    states = plant.broker.on("/state")
    assert len(states) == pytest.approx(15, abs=2)


@in_virtual_time
async def test_what_nobody_uses_takes_no_room_of_what_somebody_waits_for() -> None:
    """50 changes of stop of a bay without a subscriber; the visits of the other wait for a slow broker."""
    plant = quick("bay1", "bay2", state_period_s=60, outbox_events=50)
    plant.broker.unsubscribed = {EVENT}
    async with plant.running():
        await asyncio.sleep(1)
        happen(plant, 50, kind=EventKind.STOP_RAISED)
        await asyncio.sleep(1)
        happen(plant, 20, "bay2", EventKind.VISIT_ENDED)
        await asyncio.sleep(1)
    assert numbers(plant, "bay2") == list(range(51, 71))
    assert figures(plant, "events_dropped", "events_unsubscribed", "events_held") == [0, 20, 30]


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_subscriber_that_is_lost_is_reported_until_it_is_not_expected_any_more() -> None:
    plant = quick(state_period_s=60, unsubscribed_h=0.1, outbox_events=20)
    async with plant.running():
        await asyncio.sleep(1)
        happen(plant, 1)
        await asyncio.sleep(1)
        assert unsubscribed(plant.publisher.link) == ""
        plant.broker.unsubscribed = {EVENT}
        happen(plant, 1)
        await asyncio.sleep(1)
        assert unsubscribed(plant.publisher.link) == EVENT
        happen(plant, 25)  # somebody is expected to miss them
        assert figures(plant, "events_dropped", "events_unsubscribed") == [6, 0]
        await asyncio.sleep(360 + 60)
        assert unsubscribed(plant.publisher.link) == ""
        assert figures(plant, "events_dropped", "events_unsubscribed", "events_held") == [6, 20, 0]


@in_virtual_time
async def test_with_0_h_an_event_that_nobody_receives_counts_as_delivered() -> None:
    plant = quick(unsubscribed_h=0)
    plant.broker.unsubscribed = {EVENT}
    async with plant.running():
        await asyncio.sleep(1)
        happen(plant, 3)
        await asyncio.sleep(1)
    assert numbers(plant) == [1, 2, 3]
    assert figures(plant, "outbox_events", "events_held") == [0, 0]


@in_virtual_time
async def test_closing_tries_what_nobody_received_once_and_keeps_it() -> None:
    plant = quick(state_period_s=60)
    plant.broker.unsubscribed = {EVENT}
    async with plant.running():
        await asyncio.sleep(1)
        happen(plant, 3)
        await asyncio.sleep(5)
        begun_s = now_s()
        assert await plant.publisher.close(1.0) is True
        assert now_s() == begun_s
    assert plant.broker.ends == ["disconnected"]
    assert figures(plant, "events_held") == [3]


# Refused.


@in_virtual_time
async def test_refused_events_wait_and_everything_else_goes_on() -> None:
    plant = quick("bay1", "bay2", state_period_s=0.5)
    plant.broker.faults = {EVENT: "Not authorized (0x87)"}
    async with plant.running():
        await asyncio.sleep(1)
        happen(plant, 2)
        happen(plant, 2, "bay2")
        states = len(plant.broker.on("bay1/state"))
        await asyncio.sleep(14)
        assert len(plant.broker.on("bay1/state")) - states == 28
        assert numbers(plant, "bay2") == [3, 4]
        assert numbers(plant) == [1, 1, 1, 1]
        assert refused(plant.publisher.link) == "r/site/bay1/event is refused: Not authorized (0x87)"
        assert figures(plant, "events_held", "refused", "events_dropped") == [2, 0, 0]
        plant.broker.faults = {}
        await asyncio.sleep(16)
        assert numbers(plant)[-2:] == [1, 2]
        assert refused(plant.publisher.link) == ""
    assert plant.link_errors == []


@in_virtual_time
async def test_refused_states_and_announcements_are_dropped_and_counted() -> None:
    plant = quick("bay1", "bay2", state_period_s=0.5, home_assistant=True)
    config = "homeassistant/device/loading_site_bay1/config"
    plant.broker.faults = {config: "6000 bytes; the broker accepts 4000 (0x95)", "r/site/bay2/state": "Quota (0x97)"}
    async with plant.running():
        await asyncio.sleep(10.1)
        assert len(plant.broker.on("bay1/state")) == 21
        assert len(plant.broker.on("bay2/state")) == 4  # at once, after 1, 2 and 4 s
        assert len(plant.broker.on(config)) == 1
        assert len(plant.broker.on("/status")) == 3
        assert "6000 bytes" in refused(plant.publisher.link)
        assert "r/site/bay2/state is refused: Quota (0x97)" in refused(plant.publisher.link)
        assert figures(plant, "refused") == [1 + 21]
        plant.broker.faults = {}
        await asyncio.sleep(10)
        assert "bay2" not in refused(plant.publisher.link)
    assert plant.link_errors == []


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_topic_after_which_the_broker_ends_the_connection_is_found_and_held() -> None:
    """As MQTT 3.1.1 brokers do, which have no other way to refuse a message."""
    plant = quick("bay1", "bay2", "bay3", state_period_s=4)
    plant.broker.ending, plant.broker.ack_s = {EVENT_2}, 0.01
    async with plant.running(plant.keep_delivering):
        await asyncio.sleep(1)
        happen(plant, 1)
        happen(plant, 2, "bay2")
        await asyncio.sleep(15)
        breaks = len(plant.link_errors)
        assert breaks == 6  # two, then four with one message at a time
        told = "r/site/bay2/event is refused: the connection ends after it (connection lost)"
        assert refused(plant.publisher.link) == told
        happen(plant, 5)
        happen(plant, 5, "bay3")
        begun_s = now_s()
        await asyncio.sleep(40)
        assert len(plant.link_errors) == breaks
        assert sorted(set(numbers(plant))) == [1, 4, 5, 6, 7, 8]
        assert numbers(plant, "bay3") == [9, 10, 11, 12, 13]
        since = [message for message in plant.broker.on("bay3/state") if message.at_s > begun_s]
        assert len(since) == pytest.approx(10, abs=1)
        await asyncio.sleep(600)  # tried again after 1, 2, 4 and 8 minutes
        assert len(plant.link_errors) - breaks == 3
        plant.broker.ending = set()
        await asyncio.sleep(600)
        assert numbers(plant, "bay2")[-2:] == [2, 3]
        assert refused(plant.publisher.link) == ""
    assert figures(plant, "events_dropped") == [0]


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_broker_that_ends_the_connection_after_a_refusal_does_so_once() -> None:
    """mosquitto 2.0.11 does. It did so nine times in 14 s."""
    plant = quick("bay1", "bay2", state_period_s=1)
    plant.broker.faults, plant.broker.ends_after_refusal = {EVENT: "Not authorized (0x87)"}, True
    async with plant.running(plant.keep_delivering):
        await asyncio.sleep(1)
        happen(plant, 2)
        happen(plant, 2, "bay2")
        await asyncio.sleep(55)
        assert len(plant.link_errors) == 1
        assert numbers(plant, "bay2")[-2:] == [3, 4]
        assert (
            refused(plant.publisher.link)
            == "r/site/bay1/event is refused: Not authorized (0x87); the connection ends after it"
        )
        await asyncio.sleep(200)  # tried again after 1 and 2 minutes
        assert len(plant.link_errors) == 3
        plant.broker.faults = {}
        await asyncio.sleep(250)
        assert numbers(plant)[-2:] == [1, 2]
        assert refused(plant.publisher.link) == ""
    assert figures(plant, "events_dropped") == [0]


@in_virtual_time
async def test_a_state_after_which_the_broker_ends_the_connection_does_not_stop_the_others() -> None:
    plant = quick("bay1", "bay2", "bay3", state_period_s=0.5)
    plant.broker.ending, plant.broker.ack_s = {"r/site/bay1/state"}, 0.01
    async with plant.running():
        await asyncio.sleep(15)
        assert len(plant.link_errors) == 6
        assert refused(plant.publisher.link).startswith("r/site/bay1/state is refused: ")
        begun_s = now_s()
        await asyncio.sleep(20)
        for bay in ("bay2", "bay3"):
            since = [message for message in plant.broker.on(f"{bay}/state") if message.at_s > begun_s]
            assert len(since) == pytest.approx(40, abs=2)
        assert plant.broker.on("/status")[-1].at_s > begun_s


@in_virtual_time
async def test_a_network_that_breaks_now_and_then_holds_nothing() -> None:
    plant = quick(state_period_s=0.5)
    plant.broker.ack_s = 0.1
    async with plant.running():
        for _ in range(40):
            happen(plant, 2)
            await asyncio.sleep(0.75)
            plant.broker.lose()
            await asyncio.sleep(1.5)
        await asyncio.sleep(5)
        assert refused(plant.publisher.link) == ""
        assert figures(plant, "outbox_events") == [0]
    assert list(dict.fromkeys(numbers(plant))) == list(range(1, 81))


@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_broker_that_is_silent_is_not_blamed_on_a_topic() -> None:
    plant = quick(keepalive_s=2)
    async with plant.running():
        await asyncio.sleep(1)
        plant.broker.hung = True
        happen(plant, 1)
        await asyncio.sleep(200)
        assert len(plant.link_errors) > 10
        assert refused(plant.publisher.link) == ""
        plant.broker.hung = False
        await asyncio.sleep(10)
        assert figures(plant, "outbox_events") == [0]


def test_only_so_many_topics_are_named() -> None:
    answers = TopicAnswers()
    for number in range(5):
        answers.refused(f"t{number}", "no", 0)
    assert answers.alarms["messages_refused"] == "t0 is refused: no; t1 is refused: no; t2 is refused: no, and 2 more"


@pytest.mark.parametrize("name", ["messages_refused", "events_unsubscribed"])
def test_the_alarms_say_what(name: str) -> None:
    alarm = ALARM_DEFINITIONS[name]
    now = GatewayConditions(sink_alarms={"messages_refused": "t: why", "events_unsubscribed": "t2"})
    detail = {"messages_refused": "t: why", "events_unsubscribed": "t2"}[name]
    assert alarm.condition(GatewayInputs(now, now))  # type: ignore[arg-type]
    assert alarm.detail(GatewayInputs(now, now)) == detail  # type: ignore[arg-type]
    assert not alarm.condition(GatewayInputs(GatewayConditions(), now))  # type: ignore[arg-type]
