"""Sparkplug B 3.0: one test for each assertion of the specification that an edge node can meet.

One recorded life of an edge node on a real broker is looked at from all sides: births, data, a device's death and
return, a rebirth, a cut connection, a primary host that comes and goes, and a proper end. The recorder takes the MQTT
packets apart; payloads are decoded by code that the Protocol Buffers compiler made from the specification's layout.
The name of a test is the id of its assertion; docs/sparkplug.md lists them.
"""

import asyncio
import json
import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion
from pydantic import ValidationError

from gateway.config import BayConfig, GatewayConfig, SparkplugConfig
from gateway.sinks.sparkplug.bd_seq import next_bd_seq
from tests.e2e.brokers import Mosquitto
from tests.e2e.mqtt_packets import Packet, Tap
from tests.e2e.sparkplug_plant import SparkPlant, decode, host_state, kind, rebirth_request, values

pytestmark = pytest.mark.xdist_group("sparkplug")  # all look at two recorded lives

NODE = "gw"
GROUP = "Plant 7"
ASSERTIONS = 299  # that the specification marks as testable
PAGE = Path(__file__).parents[2] / "docs" / "sparkplug.md"


@dataclass
class Life:
    """All that a recorded edge node sent, by connection."""

    packets: list[Packet]

    def sent(self, *kinds: str, connection: int | None = None) -> list[Packet]:
        return [
            p for p in self.packets
            if p.out and p.kind == "PUBLISH" and kind(p) in kinds and connection in (None, p.connection)
        ]  # fmt: skip

    def publishes(self, connection: int) -> list[Packet]:
        return [p for p in self.packets if p.out and p.kind == "PUBLISH" and p.connection == connection]

    @property
    def connects(self) -> list[Packet]:
        return [p for p in self.packets if p.kind == "CONNECT"]

    @property
    def connections(self) -> range:
        return range(len(self.connects))


class Host:
    """A host application's client; it speaks for itself, not through the recorder."""

    def __init__(self, port: int) -> None:
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, "host")
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()

    def say(self, topic: str, payload: bytes, *, qos: int = 0, retain: bool = False) -> None:
        self._client.publish(topic, payload, qos=qos, retain=retain).wait_for_publish(10)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


async def plain_life(tap: Tap, host: Host) -> None:
    """No primary host. Connection 0: births, data, death and return of a device, rebirth; cut. 1: after it; the end."""
    plant = SparkPlant(tap.port, protocol="3.1.1")
    sent = tap.sent

    def count(name: str, connection: int | None = None) -> int:
        return sum(kind(p) == name for p in sent(connection=connection))

    async with plant.running():
        await plant.until(lambda: count("DBIRTH") == 2)
        for n in range(261):  # so that the sequence number goes round; changes of stop go out at once
            before = count("DDATA")
            near = n % 2 == 0
            plant.see("bay1", 200.0 + n if near else 100.0 + n / 10, 250.0 if near else 800.0)
            await plant.until(lambda b=before: count("DDATA") > b)  # type: ignore[misc]
        plant.die("bay2")
        await plant.until(lambda: count("DDEATH") == 1)
        plant.live("bay2")
        await plant.until(lambda: count("DBIRTH") == 3)
        host.say(f"spBv1.0/{GROUP}/NCMD/{NODE}", rebirth_request())
        await plant.until(lambda: count("NBIRTH") == 2)
        host.say(f"spBv1.0/{GROUP}/NCMD/{NODE}", b"\xff\xff no command")
        host.say(f"spBv1.0/{GROUP}/NCMD/{NODE}", rebirth_request(value=False))
        host.say(f"spBv1.0/{GROUP}/DCMD/{NODE}/bay1", rebirth_request())
        await plant.until(lambda: plant.publisher.node.stats.refused == 3)
        tap.cut()
        plant.see("bay1", 100.0)  # while nobody can be told: stop ends, begins and ends
        plant.see("bay1", 200.0, 250.0)
        plant.see("bay1", 100.0)
        await plant.until(lambda: count("DBIRTH", 1) == 2)
        plant.see("bay2", 150.0)
        await plant.until(lambda: any(p.topic.endswith("bay2") and kind(p) == "DDATA" for p in sent(connection=1)))
        await plant.publisher.farewell(10.0)


async def hosted_life(tap: Tap, host: Host) -> None:
    """With a primary host that is offline first, comes, goes, and comes again."""
    topic = "spBv1.0/STATE/scada"
    host.say(topic, host_state(online=False, timestamp=1000), qos=1, retain=True)
    plant = SparkPlant(tap.port, primary_host="scada", start=254, protocol="5")
    async with plant.running():
        await plant.until(lambda: tap.sent("SUBSCRIBE"))
        await asyncio.sleep(0.5)  # a node that does not wait would have sent its births by now
        assert tap.sent() == []
        host.say(topic, b"no JSON", qos=1)
        host.say(topic, host_state(online=True, timestamp=999), qos=1)  # older than what it said before
        await plant.until(lambda: plant.publisher.node.stats.refused == 1)
        await asyncio.sleep(0.2)
        assert tap.sent() == []
        host.say(topic, host_state(online=True, timestamp=2000), qos=1, retain=True)
        await plant.until(lambda: sum(kind(p) == "DBIRTH" for p in tap.sent()) == 2)
        host.say(topic, host_state(online=False, timestamp=1500), qos=1)  # a late will of an earlier life
        await asyncio.sleep(0.3)
        assert len(tap.sent("CONNECT")) == 1
        host.say(topic, host_state(online=False, timestamp=2000), qos=1, retain=True)
        await plant.until(lambda: len(tap.sent("CONNECT")) >= 2)
        plant.see("bay1", 200.0, 250.0)
        host.say(topic, host_state(online=True, timestamp=3000), qos=1, retain=True)
        await plant.until(lambda: sum(kind(p) == "NBIRTH" for p in tap.sent()) == 2)
        await plant.until(lambda: sum(kind(p) == "DDATA" for p in tap.sent(connection=1)) >= 1)
        await plant.publisher.farewell(10.0)


@pytest.fixture(scope="module")
def lives(tmp_path_factory: pytest.TempPathFactory) -> tuple[Life, Life]:
    found = []
    with Mosquitto(tmp_path_factory.mktemp("sparkplug")) as broker:
        host = Host(broker.port)
        for life in (plain_life, hosted_life):
            with Tap(broker.port) as tap:
                asyncio.run(life(tap, host))
                tap.wait_for(lambda p: p.kind == "DISCONNECT")
                found.append(Life(list(tap.packets)))
        host.close()
    return found[0], found[1]


@pytest.fixture
def life(lives: tuple[Life, Life]) -> Life:
    return lives[0]


@pytest.fixture
def hosted(lives: tuple[Life, Life]) -> Life:
    return lives[1]


def metric(payload: Any, name: str) -> Any:
    (found,) = [m for m in payload.metrics if m.name == name]
    return found


def datatypes(life: Life) -> dict[tuple[str, str], int]:
    """Of every metric by device and name, as the births tell them."""
    return {
        (p.topic.split("/")[-1], m.name): m.datatype
        for p in life.sent("NBIRTH", "DBIRTH")
        for m in decode(p.payload).metrics
    }


def all_of(life: Life, *kinds: str) -> list[Any]:
    found = [decode(p.payload) for p in life.sent(*kinds)]
    assert found, f"no {kinds} was sent"
    return found


def sequenced(life: Life, connection: int) -> list[tuple[str, int]]:
    """Kind and sequence number of everything of a connection that must carry one."""
    return [(kind(p), decode(p.payload).seq) for p in life.publishes(connection) if kind(p) != "NDEATH"]


def assert_counts_on(life: Life, *kinds: str) -> None:
    """Each message of `kinds` carries one more than the message before it, 0 after 255."""
    seen = 0
    for connection in life.connections:
        last = None
        for name, seq in sequenced(life, connection):
            assert 0 <= seq <= 255
            if name in kinds:
                assert last is not None
                assert seq == (last + 1) % 256
                seen += 1
            last = seq
    assert seen, f"no {kinds} was sent"


def assert_topics(life: Life, name: str, pattern: str) -> None:
    found = {p.topic for p in life.sent(name)}
    assert found
    assert all(re.fullmatch(pattern, topic) for topic in found), found


def assert_plain(life: Life, *kinds: str) -> None:
    found = life.sent(*kinds)
    assert found
    assert {(p.qos, p.retain) for p in found} == {(0, False)}


# Sections 1 and 2: names and principles.


def test_tck_id_intro_group_id_string(life: Life) -> None:
    assert {p.topic.split("/")[1] for p in life.sent("NBIRTH", "DBIRTH", "DDATA", "DDEATH", "NDEATH")} == {GROUP}


@pytest.mark.parametrize("character", ["+", "#", "/", "\x00", "\n"])
def test_tck_id_intro_group_id_chars(character: str) -> None:
    assert SparkplugConfig(group_id="Werk Süd").group_id == "Werk Süd"
    with pytest.raises(ValidationError):
        SparkplugConfig(group_id=f"a{character}b")


def test_tck_id_intro_edge_node_id_string(life: Life) -> None:
    assert {p.topic.split("/")[3] for p in life.sent("NBIRTH", "DBIRTH", "DDATA", "DDEATH", "NDEATH")} == {NODE}


@pytest.mark.parametrize("character", ["+", "#", "/", "\x00", "\n"])
def test_tck_id_intro_edge_node_id_chars(character: str) -> None:
    assert SparkplugConfig(edge_node_id="Tor Süd").edge_node_id == "Tor Süd"
    with pytest.raises(ValidationError):
        SparkplugConfig(edge_node_id=f"a{character}b")


def test_tck_id_intro_device_id_string(life: Life) -> None:
    assert {p.topic.split("/")[4] for p in life.sent("DBIRTH", "DDATA", "DDEATH")} == {"bay1", "bay2"}


@pytest.mark.parametrize("character", ["+", "#", "/", "\x00", "\n"])
def test_tck_id_intro_device_id_chars(character: str) -> None:
    """A device carries its bay's name."""
    assert BayConfig(name="north-1").name == "north-1"
    with pytest.raises(ValidationError):
        BayConfig(name=f"a{character}b")


def test_tck_id_principles_rbe_recommended(life: Life) -> None:
    """The plant publishes its states twenty times a second; what does not change is not sent."""
    test_tck_id_topics_ddata_payload(life)
    assert life.sent("NDATA") == []


# Section 4: topics and messages.


def test_tck_id_topic_structure(life: Life, hosted: Life) -> None:
    for packet in life.sent("NBIRTH", "NDEATH", "DBIRTH", "DDEATH", "DDATA") + hosted.sent("NBIRTH", "DBIRTH"):
        levels = packet.topic.split("/")
        assert levels[:2] == ["spBv1.0", GROUP]
        assert levels[3] == NODE
        assert len(levels) == (5 if levels[2].startswith("D") else 4)
    assert all(not p.topic or kind(p) for p in life.packets if p.out)  # and nothing else


def test_tck_id_topic_structure_namespace_a(life: Life) -> None:
    assert {p.topic.split("/")[0] for p in life.packets if p.out and p.topic} == {"spBv1.0"}


def test_tck_id_topic_structure_namespace_device_id_associated_message_types(life: Life) -> None:
    for packet in life.sent("DBIRTH", "DDEATH", "DDATA"):
        assert packet.topic.split("/")[4] in ("bay1", "bay2")


def test_tck_id_topic_structure_namespace_device_id_non_associated_message_types(life: Life) -> None:
    for packet in life.sent("NBIRTH", "NDEATH", "NDATA"):
        assert len(packet.topic.split("/")) == 4


def test_tck_id_topic_structure_namespace_unique_device_id(life: Life) -> None:
    births = [p.topic for p in life.sent("DBIRTH", connection=1)]
    assert len(set(births)) == len(births) == 2


def test_tck_id_topic_structure_namespace_valid_group_id() -> None:
    for character in "+/#":
        test_tck_id_intro_group_id_chars(character)


def test_tck_id_topic_structure_namespace_valid_edge_node_id() -> None:
    for character in "+/#":
        test_tck_id_intro_edge_node_id_chars(character)


def test_tck_id_topic_structure_namespace_valid_device_id() -> None:
    for character in "+/#":
        test_tck_id_intro_device_id_chars(character)


def test_tck_id_topics_nbirth_topic(life: Life) -> None:
    assert_topics(life, "NBIRTH", f"spBv1.0/{GROUP}/NBIRTH/{NODE}")


def test_tck_id_topics_nbirth_mqtt(life: Life, hosted: Life) -> None:
    assert_plain(life, "NBIRTH")
    assert_plain(hosted, "NBIRTH")


def test_tck_id_topics_nbirth_seq_num(life: Life) -> None:
    assert {p.seq for p in all_of(life, "NBIRTH")} == {0}
    assert all(p.HasField("seq") for p in all_of(life, "NBIRTH"))


def test_tck_id_topics_nbirth_timestamp(life: Life) -> None:
    assert all(p.timestamp > 1_700_000_000_000 for p in all_of(life, "NBIRTH"))


def test_tck_id_topics_nbirth_metric_reqs(life: Life) -> None:
    born = {m.name for m in all_of(life, "NBIRTH")[0].metrics}
    assert {m.name for p in life.sent("NDATA") for m in decode(p.payload).metrics} <= born


def test_tck_id_topics_nbirth_metrics(life: Life) -> None:
    for payload in all_of(life, "NBIRTH"):
        for found in payload.metrics:
            assert found.name
            assert found.HasField("datatype")
            assert found.is_null or found.WhichOneof("value")


def test_tck_id_topics_nbirth_bdseq_included(life: Life) -> None:
    assert all(metric(p, "bdSeq").datatype == 4 for p in all_of(life, "NBIRTH"))


def test_tck_id_topics_nbirth_bdseq_matching(life: Life, hosted: Life) -> None:
    for one in (life, hosted):
        for connect in one.connects:
            will = metric(decode(connect.will_payload), "bdSeq").long_value
            for birth in one.sent("NBIRTH", connection=connect.connection):
                assert metric(decode(birth.payload), "bdSeq").long_value == will


def test_tck_id_topics_nbirth_bdseq_increment(life: Life, hosted: Life) -> None:
    def numbers(one: Life) -> list[int]:
        return [metric(decode(c.will_payload), "bdSeq").long_value for c in one.connects]

    assert numbers(life) == [0, 1]
    assert numbers(hosted)[:3] == [254, 255, 0][: len(hosted.connects)]
    name = "test-bdseq"
    first = next_bd_seq(name)
    assert [next_bd_seq(name) for _ in range(3)] == [(first + n) % 256 for n in (1, 2, 3)]


def test_tck_id_topics_nbirth_rebirth_metric(life: Life) -> None:
    for payload in all_of(life, "NBIRTH"):
        found = metric(payload, "Node Control/Rebirth")
        assert (found.datatype, found.boolean_value) == (11, False)
        assert not found.HasField("alias")


def test_tck_id_topics_ndeath_topic(life: Life) -> None:
    assert_topics(life, "NDEATH", f"spBv1.0/{GROUP}/NDEATH/{NODE}")
    assert {c.will_topic for c in life.connects} == {f"spBv1.0/{GROUP}/NDEATH/{NODE}"}


def test_tck_id_topics_ndeath_payload(life: Life) -> None:
    for payload in [*all_of(life, "NDEATH"), *(decode(c.will_payload) for c in life.connects)]:
        assert [m.name for m in payload.metrics] == ["bdSeq"]


def test_tck_id_topics_ndeath_seq(life: Life) -> None:
    for payload in [*all_of(life, "NDEATH"), *(decode(c.will_payload) for c in life.connects)]:
        assert not payload.HasField("seq")


def test_tck_id_topics_dbirth_topic(life: Life) -> None:
    assert_topics(life, "DBIRTH", f"spBv1.0/{GROUP}/DBIRTH/{NODE}/bay[12]")


def test_tck_id_topics_dbirth_mqtt(life: Life) -> None:
    assert_plain(life, "DBIRTH")


def test_tck_id_topics_dbirth_seq(life: Life) -> None:
    assert_counts_on(life, "DBIRTH")


def test_tck_id_topics_dbirth_timestamp(life: Life) -> None:
    assert all(p.timestamp > 1_700_000_000_000 for p in all_of(life, "DBIRTH"))


def test_tck_id_topics_dbirth_metric_reqs(life: Life) -> None:
    born = {m.name for m in all_of(life, "DBIRTH")[0].metrics}
    told = {m.name for p in all_of(life, "DDATA") for m in p.metrics}
    assert told <= born


def test_tck_id_topics_dbirth_metrics(life: Life) -> None:
    for payload in all_of(life, "DBIRTH"):
        for found in payload.metrics:
            assert found.name
            assert found.HasField("datatype")
            assert found.is_null or found.WhichOneof("value")


def test_tck_id_topics_ddata_topic(life: Life) -> None:
    assert_topics(life, "DDATA", f"spBv1.0/{GROUP}/DDATA/{NODE}/bay[12]")


def test_tck_id_topics_ddata_mqtt(life: Life) -> None:
    assert_plain(life, "DDATA")


def test_tck_id_topics_ddata_seq_num(life: Life) -> None:
    assert_counts_on(life, "DDATA")
    assert any(seq == 255 for _, seq in sequenced(life, 0))  # it went round


def test_tck_id_topics_ddata_timestamp(life: Life) -> None:
    assert all(p.timestamp > 1_700_000_000_000 for p in all_of(life, "DDATA"))


def test_tck_id_topics_ddata_payload(life: Life) -> None:
    told: dict[str, Any] = {}
    for packet in life.sent("DBIRTH", "DDATA", connection=0):
        payload = decode(packet.payload)
        assert payload.metrics
        now = values(payload, historical=False)
        if kind(packet) == "DDATA":
            same = {name: value for name, value in now.items() if told[packet.topic.split("/")[4]][name] == value}
            assert same == {}
        told.setdefault(packet.topic.split("/")[4], {}).update(now)
    assert told["bay1"]["Stop"] is True


def test_tck_id_topics_ddeath_topic(life: Life) -> None:
    assert_topics(life, "DDEATH", f"spBv1.0/{GROUP}/DDEATH/{NODE}/bay2")


def test_tck_id_topics_ddeath_mqtt(life: Life) -> None:
    assert_plain(life, "DDEATH")


def test_tck_id_topics_ddeath_seq_num(life: Life) -> None:
    assert_counts_on(life, "DDEATH")


# Section 5: operational behaviour.


def test_tck_id_case_sensitivity_sparkplug_ids() -> None:
    """As far as one gateway knows: two bays."""
    assert GatewayConfig.model_validate({"bays": [{"name": "bay1"}, {"name": "bay2", "unit_id": 2}]})
    with pytest.raises(ValidationError, match="an earlier bay has the name Bay1, too"):
        GatewayConfig.model_validate({"bays": [{"name": "bay1"}, {"name": "Bay1", "unit_id": 2}]})


def test_tck_id_case_sensitivity_metric_names(life: Life) -> None:
    for payload in all_of(life, "NBIRTH", "DBIRTH"):
        names = [m.name.lower() for m in payload.metrics]
        assert len(set(names)) == len(names)


def test_tck_id_principles_persistence_clean_session_311(life: Life) -> None:
    assert {(c.level, c.clean) for c in life.connects} == {(4, True)}


def test_tck_id_principles_persistence_clean_session_50(hosted: Life) -> None:
    assert {(c.level, c.clean) for c in hosted.connects} == {(5, True)}
    assert {c.session_expiry_s for c in hosted.connects} <= {None, 0}


def test_tck_id_principles_birth_certificates_order(life: Life) -> None:
    for connection in life.connections:
        assert [kind(p) for p in life.publishes(connection)][:3] == ["NBIRTH", "DBIRTH", "DBIRTH"]


def test_tck_id_message_flow_edge_node_birth_publish_connect(life: Life) -> None:
    for connection in life.connections:
        order = [p.kind for p in life.packets if p.connection == connection]
        assert order.index("CONNACK") < order.index("PUBLISH")


def test_tck_id_message_flow_edge_node_birth_publish_will_message(life: Life) -> None:
    assert all(c.will_topic and c.will_payload for c in life.connects)


def test_tck_id_message_flow_edge_node_birth_publish_will_message_topic(life: Life) -> None:
    assert {c.will_topic for c in life.connects} == {f"spBv1.0/{GROUP}/NDEATH/{NODE}"}


def test_tck_id_message_flow_edge_node_birth_publish_will_message_payload(life: Life) -> None:
    assert all(len(decode(c.will_payload).metrics) == 1 for c in life.connects)


def test_tck_id_message_flow_edge_node_birth_publish_will_message_payload_bdseq(life: Life) -> None:
    found = metric(decode(life.connects[0].will_payload), "bdSeq")
    assert found.datatype == 4
    assert 0 <= found.long_value <= 255


def test_tck_id_message_flow_edge_node_birth_publish_will_message_qos(life: Life, hosted: Life) -> None:
    assert {c.will_qos for c in life.connects + hosted.connects} == {1}


def test_tck_id_message_flow_edge_node_birth_publish_will_message_will_retained(life: Life, hosted: Life) -> None:
    assert {c.will_retain for c in life.connects + hosted.connects} == {False}


def test_tck_id_message_flow_edge_node_ncmd_subscribe(life: Life) -> None:
    for connection in life.connections:
        order = [p for p in life.packets if p.connection == connection]
        (subscribe,) = [p for p in order if p.kind == "SUBSCRIBE"]
        assert (f"spBv1.0/{GROUP}/NCMD/{NODE}", 1) in subscribe.filters
        granted = next(n for n, p in enumerate(order) if p.kind == "SUBACK")
        assert granted < next(n for n, p in enumerate(order) if p.out and p.kind == "PUBLISH")


def test_tck_id_message_flow_device_dcmd_subscribe(life: Life) -> None:
    for subscribe in (p for p in life.packets if p.kind == "SUBSCRIBE"):
        assert any(topic.startswith(f"spBv1.0/{GROUP}/DCMD/{NODE}/") and qos == 1 for topic, qos in subscribe.filters)


def test_tck_id_message_flow_edge_node_birth_publish_phid_wait(hosted: Life) -> None:
    """Offline, then damaged, then an older online: no birth. `hosted_life` looked at it on the way."""
    first = hosted.publishes(0)[0]
    online = [
        json.loads(p.payload)
        for p in hosted.packets
        if not p.out and p.topic == "spBv1.0/STATE/scada" and p.connection == 0 and p.at_s < first.at_s
        if p.payload.startswith(b"{")
    ]
    assert online[-1] == {"online": True, "timestamp": 2000}
    assert kind(first) == "NBIRTH"


def test_tck_id_message_flow_edge_node_birth_publish_phid_wait_id(hosted: Life) -> None:
    (subscribe, *_) = [p for p in hosted.packets if p.kind == "SUBSCRIBE"]
    assert ("spBv1.0/STATE/scada", 1) in subscribe.filters


def test_tck_id_message_flow_edge_node_birth_publish_phid_wait_online(hosted: Life) -> None:
    assert len(hosted.sent("NBIRTH", connection=0)) == 1


def test_tck_id_message_flow_edge_node_birth_publish_phid_wait_timestamp(hosted: Life) -> None:
    """`hosted_life`: online with an older timestamp brought no birth."""
    assert decode(hosted.sent("NBIRTH")[0].payload).seq == 0


def test_tck_id_message_flow_edge_node_birth_publish_phid_offline(hosted: Life) -> None:
    assert [kind(p) for p in hosted.publishes(0)][-1] == "NDEATH"
    assert [p.kind for p in hosted.packets if p.out and p.connection == 0][-1] == "DISCONNECT"


def test_tck_id_operational_behavior_edge_node_termination_host_offline(hosted: Life) -> None:
    assert len(hosted.connects) >= 2
    assert kind(hosted.publishes(0)[-1]) == "NDEATH"


def test_tck_id_operational_behavior_edge_node_termination_host_offline_timestamp(hosted: Life) -> None:
    """The late will of an earlier life of the host (timestamp 1500) ended nothing; the one of 2000 did."""
    offline = [p for p in hosted.packets if not p.out and b'"online": false' in p.payload and p.connection == 0]
    assert [json.loads(p.payload)["timestamp"] for p in offline] == [1000, 1500, 2000]
    death = hosted.sent("NDEATH", connection=0)[0]
    assert offline[1].at_s < offline[2].at_s <= death.at_s


def test_tck_id_operational_behavior_edge_node_termination_host_offline_reconnect(hosted: Life) -> None:
    """There is one server, so the next one is the same."""
    ended = next(p for p in hosted.packets if p.out and p.connection == 0 and p.kind == "DISCONNECT")
    assert any(p.connection == 1 and p.at_s > ended.at_s for p in hosted.connects)


def test_tck_id_operational_behavior_primary_application_state_with_multiple_servers_state_subs(hosted: Life) -> None:
    for connection in hosted.connections:
        (subscribe,) = [p for p in hosted.packets if p.kind == "SUBSCRIBE" and p.connection == connection]
        assert ("spBv1.0/STATE/scada", 1) in subscribe.filters


def test_tck_id_operational_behavior_primary_application_state_with_multiple_servers_single_server(
    hosted: Life,
) -> None:
    """Each connection has ended before the next one begins."""
    for earlier, later in pairwise(hosted.connects):
        (ended,) = [p for p in hosted.packets if p.connection == earlier.connection and p.kind == "DISCONNECT"]
        assert ended.at_s <= later.at_s


def test_tck_id_operational_behavior_edge_node_birth_sequence_wait(hosted: Life) -> None:
    for connection in hosted.connections:
        publishes = hosted.publishes(connection)
        if not publishes:
            continue
        heard = [
            p for p in hosted.packets if not p.out and p.connection == connection and b'"online": true' in p.payload
        ]
        assert heard[0].at_s <= publishes[0].at_s


def test_tck_id_message_flow_edge_node_birth_publish_nbirth_topic(life: Life) -> None:
    assert_topics(life, "NBIRTH", f"spBv1.0/{GROUP}/NBIRTH/{NODE}")


def test_tck_id_message_flow_edge_node_birth_publish_nbirth_payload(life: Life) -> None:
    for payload in all_of(life, "NBIRTH"):
        assert payload.HasField("timestamp")
        assert payload.HasField("seq")
        assert payload.metrics


def test_tck_id_message_flow_edge_node_birth_publish_nbirth_payload_bdseq(life: Life) -> None:
    assert [metric(p, "bdSeq").long_value for p in all_of(life, "NBIRTH")] == [0, 0, 1]


def test_tck_id_message_flow_edge_node_birth_publish_nbirth_payload_seq(life: Life) -> None:
    assert [p.seq for p in all_of(life, "NBIRTH")] == [0, 0, 0]


def test_tck_id_message_flow_edge_node_birth_publish_nbirth_qos(life: Life) -> None:
    assert {p.qos for p in life.sent("NBIRTH")} == {0}


def test_tck_id_message_flow_edge_node_birth_publish_nbirth_retained(life: Life) -> None:
    assert {p.retain for p in life.sent("NBIRTH")} == {False}


def test_tck_id_message_flow_device_birth_publish_nbirth_wait(life: Life) -> None:
    for connection in life.connections:
        order = [kind(p) for p in life.publishes(connection)]
        assert order.index("NBIRTH") < order.index("DBIRTH")


def test_tck_id_message_flow_device_birth_publish_dbirth_topic(life: Life) -> None:
    assert_topics(life, "DBIRTH", f"spBv1.0/{GROUP}/DBIRTH/{NODE}/bay[12]")


def test_tck_id_message_flow_device_birth_publish_dbirth_match_edge_node_topic(life: Life) -> None:
    node = life.sent("NBIRTH")[0].topic.split("/")
    for packet in life.sent("DBIRTH"):
        levels = packet.topic.split("/")
        assert (levels[1], levels[3]) == (node[1], node[3])


def test_tck_id_message_flow_device_birth_publish_dbirth_payload(life: Life) -> None:
    assert all(p.HasField("timestamp") and p.metrics for p in all_of(life, "DBIRTH"))


def test_tck_id_message_flow_device_birth_publish_dbirth_payload_seq(life: Life) -> None:
    assert_counts_on(life, "DBIRTH")


def test_tck_id_message_flow_device_birth_publish_dbirth_qos(life: Life) -> None:
    assert {p.qos for p in life.sent("DBIRTH")} == {0}


def test_tck_id_message_flow_device_birth_publish_dbirth_retained(life: Life) -> None:
    assert {p.retain for p in life.sent("DBIRTH")} == {False}


def test_tck_id_operational_behavior_edge_node_intentional_disconnect_ndeath(life: Life) -> None:
    assert kind(life.publishes(1)[-1]) == "NDEATH"


def test_tck_id_operational_behavior_edge_node_intentional_disconnect_packet(life: Life) -> None:
    last = [p for p in life.packets if p.out and p.connection == 1 and p.kind in ("PUBLISH", "DISCONNECT")][-2:]
    assert [(p.kind, kind(p)) for p in last] == [("PUBLISH", "NDEATH"), ("DISCONNECT", "")]


def test_tck_id_operational_behavior_device_ddeath(life: Life) -> None:
    (death,) = life.sent("DDEATH")
    after = [p for p in life.publishes(0) if p.at_s > death.at_s and p.topic.endswith("/bay2")]
    assert kind(after[0]) == "DBIRTH"  # and nothing of a dead device in between


def test_tck_id_operational_behavior_data_publish_nbirth(life: Life) -> None:
    assert life.sent("NDATA") == []  # no metric of the node ever changes within a session


def test_tck_id_operational_behavior_data_publish_nbirth_change(life: Life) -> None:
    assert life.sent("NDATA") == []


def test_tck_id_operational_behavior_data_publish_nbirth_values(life: Life) -> None:
    assert all(m.WhichOneof("value") for p in all_of(life, "NBIRTH") for m in p.metrics)


def test_tck_id_operational_behavior_data_publish_nbirth_order(life: Life) -> None:
    for payload in all_of(life, "NBIRTH"):
        times = [m.timestamp for m in payload.metrics]
        assert times == sorted(times)


def test_tck_id_operational_behavior_data_publish_dbirth(life: Life) -> None:
    born = {m.name for m in all_of(life, "DBIRTH")[0].metrics}
    assert all({m.name for m in p.metrics} <= born for p in all_of(life, "DDATA"))


def test_tck_id_operational_behavior_data_publish_dbirth_values(life: Life) -> None:
    found = values(decode(life.sent("DBIRTH")[0].payload))
    assert (found["Stop"], found["Permit"], found["Marker/Radius"], found["Distance"]) == (False, True, 100.0, 800.0)


def test_tck_id_operational_behavior_data_publish_dbirth_change(life: Life) -> None:
    test_tck_id_topics_ddata_payload(life)


def test_tck_id_operational_behavior_data_publish_dbirth_order(life: Life) -> None:
    for payload in all_of(life, "DBIRTH", "DDATA"):
        times = [m.timestamp for m in payload.metrics if not m.is_historical]
        assert times == sorted(times)


def test_tck_id_operational_behavior_data_commands_rebirth_name(life: Life) -> None:
    assert all(metric(p, "Node Control/Rebirth") for p in all_of(life, "NBIRTH"))


def test_tck_id_operational_behavior_data_commands_rebirth_name_aliases(life: Life) -> None:
    assert not any(m.HasField("alias") for p in all_of(life, "NBIRTH", "DBIRTH", "DDATA") for m in p.metrics)


def test_tck_id_operational_behavior_data_commands_rebirth_datatype(life: Life) -> None:
    assert {metric(p, "Node Control/Rebirth").datatype for p in all_of(life, "NBIRTH")} == {11}


def test_tck_id_operational_behavior_data_commands_rebirth_value(life: Life) -> None:
    assert {metric(p, "Node Control/Rebirth").boolean_value for p in all_of(life, "NBIRTH")} == {False}


def test_tck_id_operational_behavior_data_commands_rebirth_action_1(life: Life) -> None:
    second = life.sent("NBIRTH", connection=0)[1]
    after = [kind(p) for p in life.publishes(0) if p.at_s >= second.at_s]
    assert after[:3] == ["NBIRTH", "DBIRTH", "DBIRTH"]


def test_tck_id_operational_behavior_data_commands_rebirth_action_2(life: Life) -> None:
    assert len(life.sent("NBIRTH", connection=0)) == 2
    assert len(life.sent("DBIRTH", connection=0)) == 5  # two, one that came back, two


def test_tck_id_operational_behavior_data_commands_rebirth_action_3(life: Life) -> None:
    first, second = (decode(p.payload) for p in life.sent("NBIRTH", connection=0))
    assert metric(first, "bdSeq").long_value == metric(second, "bdSeq").long_value == 0


# Section 6: payloads.


def test_tck_id_payloads_timestamp_in_utc(life: Life) -> None:
    for payload in all_of(life, "NBIRTH", "DBIRTH", "DDATA", "DDEATH"):
        assert 1_700_000_000_000 < payload.timestamp < 4_000_000_000_000


def test_tck_id_payloads_sequence_num_always_included(life: Life) -> None:
    assert all(p.HasField("seq") for p in all_of(life, "NBIRTH", "DBIRTH", "DDATA", "DDEATH"))


def test_tck_id_payloads_sequence_num_req_nbirth(life: Life) -> None:
    assert {p.seq for p in all_of(life, "NBIRTH")} == {0}


def test_tck_id_payloads_sequence_num_incrementing(life: Life) -> None:
    assert_counts_on(life, "DBIRTH", "DDATA", "DDEATH")


def test_tck_id_payloads_name_requirement(life: Life) -> None:
    assert all(m.name for p in all_of(life, "NBIRTH", "DBIRTH", "DDATA", "NDEATH") for m in p.metrics)


def test_tck_id_payloads_name_birth_data_requirement(life: Life) -> None:
    assert all(m.HasField("timestamp") for p in all_of(life, "NBIRTH", "DBIRTH", "DDATA") for m in p.metrics)


def test_tck_id_payloads_metric_timestamp_in_utc(life: Life) -> None:
    for payload in all_of(life, "DDATA"):
        assert all(1_700_000_000_000 < m.timestamp <= payload.timestamp for m in payload.metrics)


def test_tck_id_payloads_metric_datatype_value_type(life: Life) -> None:
    """The decoder knows the field by its number and its type: another type would leave it out."""
    assert all(0 < datatype < 2**32 for datatype in datatypes(life).values())


def test_tck_id_payloads_metric_datatype_value(life: Life) -> None:
    assert set(datatypes(life).values()) <= set(range(1, 35))


def test_tck_id_payloads_metric_datatype_req(life: Life) -> None:
    """And what is carried is of it, in data too."""
    assert all(m.HasField("datatype") for p in all_of(life, "NBIRTH", "DBIRTH") for m in p.metrics)
    carried = {4: "long_value", 7: "int_value", 10: "double_value", 11: "boolean_value", 12: "string_value"}
    types = datatypes(life)
    for packet in life.sent("NBIRTH", "DBIRTH", "DDATA"):
        for found in decode(packet.payload).metrics:
            datatype = types[packet.topic.split("/")[-1], found.name]
            assert found.is_null or found.WhichOneof("value") == carried[datatype]


def test_tck_id_payloads_metric_datatype_not_req(life: Life) -> None:
    assert not any(m.HasField("datatype") for p in all_of(life, "DDATA") for m in p.metrics)


def test_tck_id_payloads_propertyset_keys_array_size(life: Life) -> None:
    sets = [m.properties for p in all_of(life, "DBIRTH") for m in p.metrics if m.HasField("properties")]
    assert sets
    assert all(len(s.keys) == len(s.values) for s in sets)


def test_tck_id_payloads_propertyset_values_array_size(life: Life) -> None:
    test_tck_id_payloads_propertyset_keys_array_size(life)


def test_tck_id_payloads_metric_propertyvalue_type_type(life: Life) -> None:
    sets = [m.properties for p in all_of(life, "DBIRTH") for m in p.metrics if m.HasField("properties")]
    assert sets
    assert all(0 < v.type < 2**32 for s in sets for v in s.values)


def test_tck_id_payloads_metric_propertyvalue_type_req(life: Life) -> None:
    sets = [m.properties for p in all_of(life, "DBIRTH") for m in p.metrics if m.HasField("properties")]
    assert all(v.HasField("type") for s in sets for v in s.values)


def test_tck_id_payloads_metric_propertyvalue_type_value(life: Life) -> None:
    sets = [m.properties for p in all_of(life, "DBIRTH") for m in p.metrics if m.HasField("properties")]
    assert {v.type for s in sets for v in s.values} <= set(range(1, 15)) | {20, 21}


def quality_of(found: Any) -> Any:
    for name, value in zip(found.properties.keys, found.properties.values, strict=True):
        if name == "Quality":
            return value
    return None


def test_tck_id_payloads_propertyset_quality_value_type(life: Life) -> None:
    found = [q for p in all_of(life, "DBIRTH") for m in p.metrics if (q := quality_of(m)) is not None]
    assert found  # Distance Vision is not configured: null and not good
    assert {q.type for q in found} == {3}


def test_tck_id_payloads_propertyset_quality_value_value(life: Life) -> None:
    found = [q for p in all_of(life, "DBIRTH") for m in p.metrics if (q := quality_of(m)) is not None]
    assert {q.WhichOneof("value") for q in found} == {"int_value"}
    assert {q.int_value for q in found} <= {0, 192, 500}


def test_tck_id_payloads_nbirth_timestamp(life: Life) -> None:
    assert all(p.HasField("timestamp") for p in all_of(life, "NBIRTH"))


def test_tck_id_payloads_nbirth_seq(life: Life) -> None:
    assert {p.seq for p in all_of(life, "NBIRTH")} == {0}


def test_tck_id_payloads_nbirth_bdseq(life: Life) -> None:
    assert all(metric(p, "bdSeq") for p in all_of(life, "NBIRTH"))


def test_tck_id_payloads_nbirth_bdseq_repeat(life: Life) -> None:
    test_tck_id_operational_behavior_data_commands_rebirth_action_3(life)


def test_tck_id_payloads_nbirth_rebirth_req(life: Life) -> None:
    assert {metric(p, "Node Control/Rebirth").boolean_value for p in all_of(life, "NBIRTH")} == {False}


def test_tck_id_payloads_nbirth_qos(life: Life) -> None:
    assert {p.qos for p in life.sent("NBIRTH")} == {0}


def test_tck_id_payloads_nbirth_retain(life: Life) -> None:
    assert {p.retain for p in life.sent("NBIRTH")} == {False}


def test_tck_id_payloads_dbirth_timestamp(life: Life) -> None:
    assert all(p.HasField("timestamp") for p in all_of(life, "DBIRTH"))


def test_tck_id_payloads_dbirth_seq(life: Life) -> None:
    assert all(p.HasField("seq") for p in all_of(life, "DBIRTH"))


def test_tck_id_payloads_dbirth_seq_inc(life: Life) -> None:
    assert_counts_on(life, "DBIRTH")


def test_tck_id_payloads_dbirth_order(life: Life) -> None:
    test_tck_id_principles_birth_certificates_order(life)


def test_tck_id_payloads_dbirth_qos(life: Life) -> None:
    assert {p.qos for p in life.sent("DBIRTH")} == {0}


def test_tck_id_payloads_dbirth_retain(life: Life) -> None:
    assert {p.retain for p in life.sent("DBIRTH")} == {False}


def test_tck_id_payloads_ddata_timestamp(life: Life) -> None:
    assert all(p.HasField("timestamp") for p in all_of(life, "DDATA"))


def test_tck_id_payloads_ddata_seq(life: Life) -> None:
    assert all(p.HasField("seq") for p in all_of(life, "DDATA"))


def test_tck_id_payloads_ddata_seq_inc(life: Life) -> None:
    assert_counts_on(life, "DDATA")


def test_tck_id_payloads_ddata_order(life: Life) -> None:
    for connection in life.connections:
        order = [kind(p) for p in life.publishes(connection)]
        assert order.index("DDATA") > order.index("DBIRTH") + 1


def test_tck_id_payloads_ddata_qos(life: Life) -> None:
    assert {p.qos for p in life.sent("DDATA")} == {0}


def test_tck_id_payloads_ddata_retain(life: Life) -> None:
    assert {p.retain for p in life.sent("DDATA")} == {False}


def test_tck_id_payloads_ndeath_seq(life: Life) -> None:
    test_tck_id_topics_ndeath_seq(life)


def test_tck_id_payloads_ndeath_will_message(life: Life) -> None:
    assert all(c.will_topic.split("/")[2] == "NDEATH" for c in life.connects)


def test_tck_id_payloads_ndeath_will_message_qos(life: Life) -> None:
    assert {c.will_qos for c in life.connects} == {1}


def test_tck_id_payloads_ndeath_will_message_retain(life: Life) -> None:
    assert {c.will_retain for c in life.connects} == {False}


def test_tck_id_payloads_ndeath_bdseq(life: Life) -> None:
    test_tck_id_topics_nbirth_bdseq_matching(life, life)


def test_tck_id_payloads_ndeath_will_message_publisher(life: Life) -> None:
    assert len(life.sent("NDEATH", connection=1)) == 1


def test_tck_id_payloads_ndeath_will_message_publisher_disconnect_mqtt311(life: Life) -> None:
    assert [p.kind for p in life.packets if p.out and p.connection == 1][-1] == "DISCONNECT"


def test_tck_id_payloads_ndeath_will_message_publisher_disconnect_mqtt50(hosted: Life) -> None:
    """`Disconnect with will message`."""
    assert {p.reason for p in hosted.packets if p.out and p.kind == "DISCONNECT"} == {4}


def test_tck_id_payloads_ddeath_timestamp(life: Life) -> None:
    assert all(p.HasField("timestamp") for p in all_of(life, "DDEATH"))


def test_tck_id_payloads_ddeath_seq(life: Life) -> None:
    assert all(p.HasField("seq") for p in all_of(life, "DDEATH"))


def test_tck_id_payloads_ddeath_seq_inc(life: Life) -> None:
    assert_counts_on(life, "DDEATH")


def test_tck_id_payloads_ddeath_seq_number(life: Life) -> None:
    assert_counts_on(life, "DDEATH")


# Beyond the assertions.


def test_what_changed_while_nobody_could_be_told_comes_as_historical(life: Life, hosted: Life) -> None:
    """And what was sent so shortly before the cut that nobody knows whether it arrived."""
    payloads = [decode(p.payload) for p in life.publishes(1) if kind(p) == "DDATA" and p.topic.endswith("bay1")]
    stops = [m for p in payloads for m in p.metrics if m.name == "Stop" and m.is_historical]
    assert [m.boolean_value for m in stops][-3:] == [False, True, False]
    assert all(first.timestamp <= second.timestamp for first, second in pairwise(stops))
    assert all(m.timestamp <= p.timestamp for p in payloads for m in p.metrics)
    kept = next(decode(p.payload) for p in hosted.publishes(1) if kind(p) == "DDATA")
    assert [m.boolean_value for m in kept.metrics if m.name == "Stop" and m.is_historical] == [False, True]


def test_commands_that_are_none_change_nothing(life: Life) -> None:
    assert len(life.sent("NBIRTH", connection=0)) == 2


def test_every_assertion_that_is_tested_stands_on_the_page_and_the_other_way_round() -> None:
    tests = {name.removeprefix("test_").replace("_", "-") for name in globals() if name.startswith("test_tck_id_")}
    rows = re.findall(r"^\| `(tck-id-[A-Za-z0-9-]+)` \| ([a-z ]+) \| (.+) \|$", PAGE.read_text("utf-8"), re.MULTILINE)
    assert len({name for name, _, _ in rows}) == len(rows) == ASSERTIONS
    assert {name.lower() for name, status, _ in rows if status == "tested"} == tests
    assert {status for _, status, _ in rows} <= {"tested", "not applicable", "not met"}
