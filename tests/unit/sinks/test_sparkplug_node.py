"""An edge node without a socket: what was sent on a dying link is sent again; a host's wrong clock does not last."""

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gateway.core.plc import PlcLink
from gateway.core.state import Guidance, GuidanceCode, StateVector
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.sinks.contract import BayAlarms, ShownAlarm
from gateway.sinks.mqtt.topics import MqttMessage
from gateway.sinks.outbox.durable import DurableOutbox
from gateway.sinks.outbox.outbox import MemoryOutbox, Outbox, OutboxEntry, OutboxLimits
from gateway.sinks.sparkplug.history import History
from gateway.sinks.sparkplug.node import EdgeNode, Identity
from gateway.values.gateway_values import GatewayFacts
from tests.e2e.sparkplug_plant import rebirth_request, schema

T0 = 1_700_000_000_000
STATES = {"bay1": StateVector(bay="bay1", stop=True)}


def node(host: str = "", *, history_limit: int = 1000, outbox: Outbox | None = None, boot: str = "ab") -> EdgeNode:
    kept = outbox if outbox is not None else MemoryOutbox(OutboxLimits(max(1, history_limit)))
    history = History(kept, history_limit, boot, STATES)
    return EdgeNode(Identity("group", "node", host), "1.0", history, doubt_ms=20_000)


def change(edge: EdgeNode, *at_ms: int) -> None:
    for n in at_ms:
        edge.changed(StateVector(bay="bay1", stop=n % 2 == 0), T0 + n)


def decoded(message: MqttMessage) -> Any:
    return schema().Payload.FromString(message.payload)


def historical_stops(messages: list[MqttMessage]) -> list[int]:
    """Times, after T0, of the historical values of Stop."""
    found = [metric for message in messages for metric in decoded(message).metrics]
    return [metric.timestamp - T0 for metric in found if metric.is_historical and metric.name == "Stop"]


def session(edge: EdgeNode, at_ms: int) -> list[MqttMessage]:
    edge.will(0, T0 + at_ms)
    return edge.connected(STATES, T0 + at_ms)


def test_history_sent_on_a_dead_link_is_sent_again() -> None:
    edge = node()
    change(edge, 1, 2, 3)

    for at_ms in (1000, 2000, 3000):  # three connections that die with the births
        assert historical_stops(session(edge, at_ms)) == [1, 2, 3]
        edge.lost()

    assert len(edge.history) == 3
    assert edge.history.dropped == 0


def test_what_was_sent_long_before_a_link_was_lost_is_not_sent_again() -> None:
    edge = node()
    change(edge, 1)
    session(edge, 1000)
    change(edge, 2000)
    edge.states(STATES, T0 + 2000)
    edge.states(STATES, T0 + 2000 + 20_001)
    change(edge, 23_000)
    edge.lost()

    assert historical_stops(session(edge, 24_000)) == [23_000]


def test_history_is_sent_in_the_order_of_its_times() -> None:
    edge = node("scada")
    edge.will(0, T0)
    edge.connected(STATES, T0)
    edge.received(edge.identity.state_topic, b'{"online": true, "timestamp": 1}', STATES, T0)
    change(edge, 1, 2)
    edge.received(edge.identity.state_topic, b'{"online": false, "timestamp": 2}', STATES, T0 + 3)
    change(edge, 4)  # after the NDEATH, before the connection is closed
    edge.lost()

    edge.will(1, T0 + 5)
    edge.connected(STATES, T0 + 5)
    births, _ = edge.received(edge.identity.state_topic, b'{"online": true, "timestamp": 3}', STATES, T0 + 6)
    assert historical_stops(births) == [1, 2, 4]


def test_history_keeps_its_limit_and_counts_what_it_drops() -> None:
    edge = node(history_limit=3)
    change(edge, 1, 2, 3)
    session(edge, 10)
    change(edge, 11, 12)
    edge.lost()
    change(edge, 13)

    assert historical_stops(session(edge, 20)) == [11, 12, 13]
    assert edge.history.dropped == 1, "the third; the first two were sent, and made room while the session lasted on"

    edge.lost()
    change(edge, 21, 22)
    assert edge.history.dropped == 3
    assert historical_stops(session(edge, 30)) == [13, 21, 22]


def test_changes_that_cancel_each_other_out_before_they_are_sent_are_history() -> None:
    """The link was slow, or both came in one turn of the event loop: a stop that was on for a moment was on."""
    edge = node()
    session(edge, 0)
    before = edge.stats.data
    change(edge, 5, 6, 7, 8)

    messages = edge.states(STATES, T0 + 10)
    assert historical_stops(messages) == [5, 6, 7, 8]
    assert [decoded(message).seq for message in messages] == [2]
    assert edge.states(STATES, T0 + 20) == []
    assert edge.stats.data == before + 1


def test_a_single_change_is_not_historical() -> None:
    edge = node()
    session(edge, 0)
    edge.changed(replace(STATES["bay1"], stop=False), T0 + 5)
    (message,) = edge.states({"bay1": replace(STATES["bay1"], stop=False)}, T0 + 6)
    assert historical_stops([message]) == []
    (stop,) = [metric for metric in decoded(message).metrics if metric.name == "Stop"]
    assert (stop.is_null, stop.boolean_value) == (False, False)


def test_much_history_is_sent_in_several_numbered_messages() -> None:
    edge = node()
    change(edge, *range(1, 121))
    births = session(edge, 1000)
    assert historical_stops(births) == list(range(1, 121))
    assert [decoded(message).seq for message in births] == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"null",
        b"[]",
        b'"online"',
        b"\xff\xfe\x00",
        b"[" * 100_000,
        '{"online": true, "timestamp": 1}'.encode("utf-32-be"),
        b'{"online": true}',
        b'{"online": 1, "timestamp": 1}',
        b'{"online": true, "timestamp": true}',
        b'{"online": true, "timestamp": NaN}',
        b'{"online": true, "timestamp": 1e3}',
        b'{"online": true, "timestamp": -1}',
        b'{"online": true, "timestamp": 18446744073709551616}',
        b'{"online": true, "timestamp": ' + b"9" * 5000 + b"}",
    ],
)
def test_a_state_that_is_none_is_counted_and_nothing_else(payload: bytes) -> None:
    edge = node("scada")
    edge.will(0, T0)
    edge.connected(STATES, T0)

    assert edge.received(edge.identity.state_topic, payload, STATES, T0) == ([], False)
    assert edge.stats.refused == 1
    births, _ = edge.received(edge.identity.state_topic, b'{"online": true, "timestamp": 0}', STATES, T0)
    assert len(births) == 2


def test_a_host_whose_clock_was_wrong_is_believed_again_in_the_next_session() -> None:
    edge = node("scada")
    edge.will(0, T0)
    edge.connected(STATES, T0)
    edge.received(edge.identity.state_topic, b'{"online": true, "timestamp": 18446744073709551615}', STATES, T0)
    assert edge.received(edge.identity.state_topic, b'{"online": false, "timestamp": 5}', STATES, T0) == ([], False)
    edge.lost()

    edge.will(1, T0 + 1)
    edge.connected(STATES, T0 + 1)
    births, _ = edge.received(edge.identity.state_topic, b'{"online": true, "timestamp": 6}', STATES, T0 + 2)
    assert len(births) == 2


def test_nothing_grows_while_a_link_hangs() -> None:
    edge = node(history_limit=3)
    session(edge, 0)
    change(edge, *range(1, 50))
    assert historical_stops(edge.states(STATES, T0 + 50)) == [47, 48, 49]
    assert (len(edge.history), edge.history.dropped) == (0, 46)


@contextlib.contextmanager
def durable(folder: Path, events: int = 1000) -> Iterator[DurableOutbox]:
    """That of one start of a gateway."""
    with DurableOutbox("test", folder / "history.sqlite", OutboxLimits(events)) as outbox:
        yield outbox


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("gateway.sinks.outbox.durable.folder", lambda: tmp_path)
    return tmp_path


def test_changes_without_a_session_survive_a_restart(folder: Path) -> None:
    with durable(folder) as outbox:
        edge = node(outbox=outbox, boot="aa")
        change(edge, 1, 2)
        edge.visited("bay1", visit(5), T0 + 3)
    with durable(folder) as outbox:
        edge = node(outbox=outbox, boot="bb")
        assert len(edge.history) == 3
        change(edge, 10)
        messages = session(edge, 1000)
        assert historical_stops(messages) == [1, 2, 10]
        assert last_visits(messages, historical=True) == [5]
        stops = [m for one in messages for m in decoded(one).metrics if m.is_historical and m.name == "Stop"]
        assert [metric.boolean_value for metric in stops] == [False, True, True]
    with durable(folder) as outbox:  # killed so soon that nobody knows whether it arrived
        edge = node(outbox=outbox, boot="cc")
        assert historical_stops(session(edge, 2000)) == [1, 2, 10]
        edge.states(STATES, T0 + 2000 + 20_001)
        assert len(outbox) == 0
    with durable(folder) as outbox:
        assert historical_stops(session(node(outbox=outbox, boot="dd"), 30_000)) == []


def test_what_an_earlier_start_kept_and_nobody_can_be_told_is_counted_and_removed() -> None:
    """A bay that is not configured any more, another version's metric, a damaged row."""
    outbox = MemoryOutbox(OutboxLimits(10))
    rows = [("gone", b'{"Stop": [true, 192]}'), ("bay1", b'{"Other": [1, 192]}'), ("bay1", b"junk"), ("bay1", b"[1]")]
    for n, (bay, payload) in enumerate(rows):
        outbox.put(OutboxEntry(f"aa-{n}", bay, payload, True, T0 + n))
    outbox.put(OutboxEntry("aa-9", "bay1", b'{"Stop": [false, 192], "Other": [1, 192]}', True, T0 + 9))
    edge = node(outbox=outbox, boot="bb")
    assert (len(edge.history), edge.history.dropped, len(outbox)) == (1, 4, 1)
    assert historical_stops(session(edge, 100)) == [9]
    edge.lost()
    assert edge.history.dropped == 4


def test_a_history_of_none_keeps_and_counts_nothing_away() -> None:
    edge = node(history_limit=0)
    change(edge, 1, 2)
    assert historical_stops(session(edge, 10)) == []
    change(edge, 11, 12)
    assert historical_stops(edge.states(STATES, T0 + 13)) == []
    assert edge.history.dropped == 2, "without a session"


def test_a_bay_that_comes_late_gets_its_history_with_its_birth() -> None:
    edge = node()
    change(edge, 1, 2)
    edge.will(0, T0 + 5)
    assert kinds(edge.connected({"bay1": None}, T0 + 5)) == ["NBIRTH"]
    messages = edge.states(STATES, T0 + 10)
    assert kinds(messages) == ["DBIRTH", "NDATA", "DDATA"]
    assert historical_stops(messages) == [1, 2]


def test_a_change_just_before_a_bay_died_is_history() -> None:
    edge = node()
    session(edge, 0)
    change(edge, 5)
    messages = edge.states({"bay1": None}, T0 + 10)
    assert kinds(messages) == ["DDATA", "DDEATH", "NDATA"]
    assert historical_stops(messages) == [5]


def ask_for_rebirth(edge: EdgeNode, at_ms: int) -> list[str]:
    """The kinds of what is sent at once."""
    return kinds(edge.received("spBv1.0/group/NCMD/node", rebirth_request(), STATES, T0 + at_ms)[0])


def kinds(messages: list[MqttMessage]) -> list[str]:
    return [message.topic.split("/")[2] for message in messages]


BIRTHS = ["NBIRTH", "DBIRTH"]


def test_twenty_rebirth_requests_are_answered_by_two_birth_sequences() -> None:
    edge = node()
    session(edge, 0)
    assert [ask_for_rebirth(edge, 100 + n) for n in range(20)] == [BIRTHS] + [[]] * 19
    assert not edge.rebirth_due(T0 + 5099)
    assert edge.states(STATES, T0 + 5099) == []
    assert edge.rebirth_due(T0 + 5100)
    assert kinds(edge.states(STATES, T0 + 5100)) == BIRTHS
    assert not edge.rebirth_due(T0 + 60_000)
    assert edge.states(STATES, T0 + 60_000) == []
    assert (edge.stats.births, edge.stats.rebirths, edge.stats.rebirths_deferred) == (3, 20, 19)


def test_requests_that_never_end_get_a_birth_sequence_every_five_seconds() -> None:
    edge = node()
    session(edge, 0)
    births = []
    for at_ms in range(0, 60_000, 100):
        births += [at_ms] * ("NBIRTH" in ask_for_rebirth(edge, at_ms) + kinds(edge.states(STATES, T0 + at_ms)))
    assert births == list(range(0, 60_000, 5000))


def test_a_change_of_stop_does_not_wait_for_a_deferred_rebirth() -> None:
    edge = node()
    session(edge, 0)
    ask_for_rebirth(edge, 100)
    ask_for_rebirth(edge, 200)
    released = {"bay1": replace(STATES["bay1"], stop=False)}
    assert kinds(edge.states(released, T0 + 300)) == ["DDATA"]
    assert kinds(edge.states(released, T0 + 5100)) == BIRTHS


def test_a_deferred_rebirth_ends_with_its_session_and_with_any_other_birth() -> None:
    edge = node()
    session(edge, 0)
    ask_for_rebirth(edge, 100)
    ask_for_rebirth(edge, 200)
    edge.lost()
    assert kinds(session(edge, 300)) == BIRTHS
    assert edge.states(STATES, T0 + 10_000) == []
    assert ask_for_rebirth(edge, 10_100) == BIRTHS


def test_a_clock_set_back_defers_no_rebirth() -> None:
    edge = node()
    session(edge, 0)
    ask_for_rebirth(edge, 100_000)
    assert ask_for_rebirth(edge, 50) == BIRTHS


def visit(n: int) -> VisitSummary:
    return VisitSummary(T0 + n, 60.04, VisitEnd.CLEAR, to_position_s=12.34, times_in_place=1, distance_mm=301.6)


def last_visits(messages: list[MqttMessage], *, historical: bool) -> list[int]:
    """Begins, after T0, of the visits in these messages."""
    found = [metric for message in messages for metric in decoded(message).metrics]
    begun = [m for m in found if m.name == "Visit/Last/Begun" and m.is_historical == historical and not m.is_null]
    return [metric.long_value - T0 for metric in begun]


def test_a_visit_that_ended_is_sent_once_with_nothing_else() -> None:
    edge = node()
    assert last_visits(session(edge, 0), historical=False) == []
    edge.visited("bay1", visit(5), T0 + 1000)
    (message,) = edge.states(STATES, T0 + 1000)
    assert last_visits([message], historical=False) == [5]
    assert {metric.name.rpartition("/")[0] for metric in decoded(message).metrics} == {"Visit/Last"}
    assert edge.states(STATES, T0 + 2000) == []


def test_visits_that_ended_without_a_session_are_history_and_the_newest_is_in_the_birth() -> None:
    edge = node()
    for n in (5, 6):
        edge.visited("bay1", visit(n), T0 + n)
    messages = session(edge, 1000)
    assert last_visits(messages, historical=False) == [6]
    assert last_visits(messages, historical=True) == [5, 6]
    edge.lost()
    assert last_visits(session(edge, 2000), historical=True) == [5, 6], "the link may have been dead"


def test_two_visits_between_two_messages_are_both_sent() -> None:
    edge = node()
    session(edge, 0)
    for n in (5, 6):
        edge.visited("bay1", visit(n), T0 + n)
    messages = edge.states(STATES, T0 + 1000)
    assert last_visits(messages, historical=True) == [5, 6]
    assert last_visits(messages, historical=False) == [6]


def alarm(state: str, *, active: bool) -> BayAlarms:
    waits = state == "unacknowledged"
    shown = ShownAlarm("bay1.camera_down", "camera_down", "Camera down", "high", state, waits, active, 5)
    own = ShownAlarm("broker_lost", "broker_lost", "MQTT broker lost", "medium", "normal", False, False, 0)
    return BayAlarms((shown,), (own,), evaluated=True)


def values(message: MqttMessage) -> dict[str, tuple[Any, int]]:
    """Value (None: null) and quality."""
    found = {}
    for metric in decoded(message).metrics:
        qualities = [v.int_value for k, v in zip(metric.properties.keys, metric.properties.values, strict=True)
                     if k == "Quality"]  # fmt: skip
        value = None if metric.is_null else getattr(metric, metric.WhichOneof("value"))
        found[metric.name] = value, qualities[0] if qualities else 192
    return found


def test_what_the_gateway_says_of_itself_is_born_and_each_change_is_data_of_the_node() -> None:
    edge = node()
    now = [GatewayFacts("a" * 64)]
    edge.facts = lambda: now[0]
    born = values(session(edge, 0)[0])
    names = ("Configuration/In Force", "Configuration/Reviewed", "Configuration/As Reviewed", "Certificates/Days")
    assert [born[name] for name in names] == [("a" * 64, 192), (None, 0), (None, 0), (None, 0)]
    assert edge.states(STATES, T0 + 1) == []
    now[0] = GatewayFacts("a" * 64, "a" * 64, certificate_days={"hmi": 40, "modbus": 30})
    (data,) = edge.states(STATES, T0 + 2)
    assert data.topic == "spBv1.0/group/NDATA/node"
    assert values(data) == {
        "Configuration/Reviewed": ("a" * 64, 192),
        "Configuration/As Reviewed": (True, 192),
        "Certificates/Days": (30, 192),
    }
    assert edge.states(STATES, T0 + 3) == []


def test_alarms_are_metrics_from_the_birth_on_and_each_step_is_data() -> None:
    edge = node()
    now = [alarm("normal", active=False)]
    edge.alarms = lambda bay: now[0]
    born = values(session(edge, 0)[1])
    assert {name: found for name, found in born.items() if name.startswith("Alarms/")} == {
        "Alarms/Unacknowledged": (0, 192),
        "Alarms/Active": (0, 192),
        "Alarms/Active High": (0, 192),
        "Alarms/Active Medium": (0, 192),
        "Alarms/Active Low": (0, 192),
        "Alarms/Highest Priority": ("none", 192),
        "Alarms/State/camera_down": ("normal", 192),
        "Alarms/Gateway State/broker_lost": ("normal", 192),
    }
    now[0] = alarm("unacknowledged", active=True)
    (raised,) = edge.states(STATES, T0 + 1)
    assert values(raised) == {
        "Alarms/Unacknowledged": (1, 192),
        "Alarms/Active": (1, 192),
        "Alarms/Active High": (1, 192),
        "Alarms/Highest Priority": ("high", 192),
        "Alarms/State/camera_down": ("unacknowledged", 192),
    }
    now[0] = alarm("acknowledged", active=True)
    (acknowledged,) = edge.states(STATES, T0 + 2)
    assert values(acknowledged) == {
        "Alarms/Unacknowledged": (0, 192),
        "Alarms/State/camera_down": ("acknowledged", 192),
    }
    now[0] = replace(now[0], evaluated=False)
    (silent,) = edge.states(STATES, T0 + 3)
    assert {name.partition("/")[0] for name in values(silent)} == {"Alarms"}
    assert len(values(silent)) == 8
    assert set(values(silent).values()) == {(None, 500)}


def test_guidance_ne_107_and_the_plc_link_are_data() -> None:
    edge = node()
    session(edge, 0)
    state = replace(
        STATES["bay1"],
        guidance=Guidance(GuidanceCode.SLOW, amount_mm=412.6, closing_mm_s=99.6, to_go_mm=412.6),
        plc=replace(STATES["bay1"].plc, link=PlcLink.LOST, missed=True),
    )
    (message,) = edge.states({"bay1": state}, T0 + 1)
    found = {name: value for name, (value, _) in values(message).items()}
    assert found["Guidance/Code"] == 5
    assert found["Guidance/Name"] == "SLOW"
    assert (found["Guidance/Amount"], found["Guidance/To Go"], found["Guidance/Closing Speed"]) == (413.0, 413.0, 100.0)
    assert found["PLC/Link"] == "LOST"
    assert (found["NE107/Active"], found["NE107/Name"]) == ("FAILURE, FUNCTION_CHECK", "FAILURE")
