"""Sparkplug B 3.0: a table of all assertions of the specification that an edge node can meet, each with its check.

One recorded life of an edge node on a real broker is looked at from all sides: births, data, a device's death and
return, a rebirth, a cut connection, a primary host that comes and goes, and a proper end. The recorder takes the MQTT
packets apart; payloads are decoded by code that the Protocol Buffers compiler made from the specification's layout.
bench/reports/sparkplug.md lists the assertions.
"""

import asyncio
import json
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion
from pydantic import ValidationError

from gateway.config import BayConfig, GatewayConfig, SparkplugConfig
from gateway.sinks.sparkplug.bd_seq import BdSeq
from tests.e2e.brokers import Mosquitto
from tests.e2e.mqtt_packets import Packet, Tap
from tests.e2e.sparkplug_plant import SparkPlant, decode, host_state, kind, rebirth_request, values

pytestmark = pytest.mark.xdist_group("sparkplug")  # all look at two recorded lives

NODE = "gw"
GROUP = "Plant 7"
ASSERTIONS = 299  # that the specification marks as testable
PAGE = Path(__file__).parents[2] / "bench" / "reports" / "sparkplug.md"


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
        await plant.publisher.close(10.0)


async def hosted_life(tap: Tap, host: Host) -> None:
    """With a primary host that is offline first, comes, goes, and comes again."""
    topic = "spBv1.0/STATE/scada"
    host.say(topic, host_state(online=False, timestamp=1000), qos=1, retain=True)
    plant = SparkPlant(tap.port, primary_host="scada", start=254, protocol="5", datatypes_in_data=False)
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
        await plant.publisher.close(10.0)


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


# What is read of a recorded life.


def metric(payload: Any, name: str) -> Any:
    (found,) = [m for m in payload.metrics if m.name == name]
    return found


def all_of(life: Life, *kinds: str) -> list[Any]:
    found = [decode(p.payload) for p in life.sent(*kinds)]
    assert found, f"no {kinds} was sent"
    return found


def metrics_of(life: Life, *kinds: str) -> list[Any]:
    return [m for payload in all_of(life, *kinds) for m in payload.metrics]


def names_of(life: Life, *kinds: str) -> set[str]:
    return {m.name for p in life.sent(*kinds) for m in decode(p.payload).metrics}


def wills(life: Life) -> list[Any]:
    return [decode(c.will_payload) for c in life.connects]


def bd_seqs(payloads: list[Any]) -> list[int]:
    return [metric(p, "bdSeq").long_value for p in payloads]


def rebirths(life: Life) -> list[Any]:
    return [metric(p, "Node Control/Rebirth") for p in all_of(life, "NBIRTH")]


def level(life: Life, number: int, *kinds: str) -> set[str]:
    return {p.topic.split("/")[number] for p in life.sent(*kinds)}


def depths(life: Life, *kinds: str) -> set[int]:
    return {len(p.topic.split("/")) for p in life.sent(*kinds)}


def qos(life: Life, *kinds: str) -> set[int]:
    return {p.qos for p in life.sent(*kinds)}


def retained(life: Life, *kinds: str) -> set[bool]:
    return {p.retain for p in life.sent(*kinds)}


def order(life: Life, connection: int) -> list[str]:
    return [kind(p) for p in life.publishes(connection)]


def subscribes(life: Life) -> list[Packet]:
    return [p for p in life.packets if p.kind == "SUBSCRIBE"]


def property_sets(life: Life) -> list[Any]:
    return [m.properties for m in metrics_of(life, "DBIRTH") if m.HasField("properties")]


def qualities(life: Life) -> list[Any]:
    """The values of the property `Quality`. Distance Vision is not configured: null and not good."""
    return [
        value
        for found in property_sets(life)
        for name, value in zip(found.keys, found.values, strict=True)
        if name == "Quality"
    ]


def datatypes(life: Life) -> dict[tuple[str, str], int]:
    """Of every metric by device and name, as the births state them."""
    return {
        (p.topic.split("/")[-1], m.name): m.datatype
        for p in life.sent("NBIRTH", "DBIRTH")
        for m in decode(p.payload).metrics
    }


def sequenced(life: Life, connection: int) -> list[tuple[str, int]]:
    """Kind and sequence number of everything of a connection that must carry one."""
    return [(kind(p), decode(p.payload).seq) for p in life.publishes(connection) if kind(p) != "NDEATH"]


def whole(metrics: Iterable[Any]) -> Iterator[bool]:
    return (bool(m.name) and m.HasField("datatype") and bool(m.is_null or m.WhichOneof("value")) for m in metrics)


def in_order(payloads: Iterable[Any]) -> Iterator[bool]:
    for payload in payloads:
        times = [m.timestamp for m in payload.metrics if not m.is_historical]
        yield times == sorted(times)


# The table: every assertion that is met, and its check.

Check = Callable[[Life, Life], None]
CHECKS: dict[str, Check] = {}
SENT = ("NBIRTH", "NDATA", "DBIRTH", "DDATA", "DDEATH")


def assertions(*names: str) -> Callable[[Check], Check]:
    """The function checks these: `tck-id-` and the name is the assertion's id."""

    def register(check: Check) -> Check:
        for name in names:
            assert f"tck-id-{name}" not in CHECKS, name
            CHECKS[f"tck-id-{name}"] = check
        return check

    return register


def equal(read: Callable[[Life, Life], object], expected: object, *names: str) -> None:
    def check(life: Life, hosted: Life) -> None:
        assert read(life, hosted) == expected

    assertions(*names)(check)


def hold(read: Callable[[Life, Life], Iterable[object]], *names: str) -> None:
    """There is at least one, and all are true."""

    def check(life: Life, hosted: Life) -> None:
        found = list(read(life, hosted))
        assert found
        assert all(found), found

    assertions(*names)(check)


def counts_on(kinds: tuple[str, ...], *names: str) -> None:
    """Each message of `kinds` carries one more than the message before it, 0 after 255."""

    def check(life: Life, hosted: Life) -> None:
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

    assertions(*names)(check)


def refuses_characters(make: Callable[[str], object], good: str, *names: str) -> None:
    def check(life: Life, hosted: Life) -> None:
        assert make(good)
        for character in "+#/\x00\n":
            with pytest.raises(ValidationError):
                make(f"a{character}b")

    assertions(*names)(check)


# `a` is the life without a primary host, `b` the one with it.
# fmt: off

# Sections 1 and 2: names and principles.

equal(lambda a, b: level(a, 1, *SENT, "NDEATH"), {GROUP}, "intro-group-id-string")
equal(lambda a, b: level(a, 3, *SENT, "NDEATH"), {NODE}, "intro-edge-node-id-string")
equal(lambda a, b: level(a, 4, "DBIRTH", "DDATA", "DDEATH"), {"bay1", "bay2"}, "intro-device-id-string",
      "topic-structure-namespace-device-id-associated-message-types")
refuses_characters(lambda text: SparkplugConfig(group_id=text), "Werk Süd", "intro-group-id-chars",
                   "topic-structure-namespace-valid-group-id")
refuses_characters(lambda text: SparkplugConfig(edge_node_id=text), "Tor Süd", "intro-edge-node-id-chars",
                   "topic-structure-namespace-valid-edge-node-id")
refuses_characters(lambda text: BayConfig(name=text), "north-1", "intro-device-id-chars",  # a device has its bay's name
                   "topic-structure-namespace-valid-device-id")

# Section 4: topics and messages.

equal(lambda a, b: {p.topic.split("/")[0] for p in a.packets if p.out and p.topic}, {"spBv1.0"},
      "topic-structure-namespace-a")
hold(lambda a, b: [depths(a, "NBIRTH", "NDEATH", "NDATA") == {4}],
     "topic-structure-namespace-device-id-non-associated-message-types")
for name, pattern, more in (
    ("NBIRTH", f"spBv1.0/{GROUP}/NBIRTH/{NODE}", ["message-flow-edge-node-birth-publish-nbirth-topic"]),
    ("NDATA", f"spBv1.0/{GROUP}/NDATA/{NODE}", []),
    ("NDEATH", f"spBv1.0/{GROUP}/NDEATH/{NODE}", []),
    ("DBIRTH", f"spBv1.0/{GROUP}/DBIRTH/{NODE}/bay[12]", ["message-flow-device-birth-publish-dbirth-topic"]),
    ("DDATA", f"spBv1.0/{GROUP}/DDATA/{NODE}/bay[12]", []),
    ("DDEATH", f"spBv1.0/{GROUP}/DDEATH/{NODE}/bay2", []),
):
    hold(lambda a, b, name=name, pattern=pattern: [re.fullmatch(pattern, p.topic) for p in a.sent(name)],  # type: ignore[misc]
         f"topics-{name.lower()}-topic", *more)
for name, numbers, flags in (
    ("NBIRTH", ["message-flow-edge-node-birth-publish-nbirth-qos", "payloads-nbirth-qos"],
     ["message-flow-edge-node-birth-publish-nbirth-retained", "payloads-nbirth-retain"]),
    ("DBIRTH", ["message-flow-device-birth-publish-dbirth-qos", "payloads-dbirth-qos"],
     ["message-flow-device-birth-publish-dbirth-retained", "payloads-dbirth-retain"]),
    ("NDATA", ["payloads-ndata-qos"], ["payloads-ndata-retain"]),
    ("DDATA", ["payloads-ddata-qos"], ["payloads-ddata-retain"]),
    ("DDEATH", [], []),
):
    equal(lambda a, b, name=name: (qos(a, name), retained(a, name)), ({0}, {False}),  # type: ignore[misc]
          *([f"topics-{name.lower()}-mqtt"] if name != "NBIRTH" else []))
    equal(lambda a, b, name=name: qos(a, name), {0}, *numbers)  # type: ignore[misc]
    equal(lambda a, b, name=name: retained(a, name), {False}, *flags)  # type: ignore[misc]
equal(lambda a, b: [(qos(one, "NBIRTH"), retained(one, "NBIRTH")) for one in (a, b)], [({0}, {False})] * 2,
      "topics-nbirth-mqtt")
equal(lambda a, b: [p.HasField("seq") and p.seq for p in all_of(a, "NBIRTH")], [0, 0, 0], "topics-nbirth-seq-num",
      "message-flow-edge-node-birth-publish-nbirth-payload-seq", "payloads-sequence-num-req-nbirth",
      "payloads-nbirth-seq")
for name in ("nbirth", "ndata", "dbirth", "ddata"):
    hold(lambda a, b, name=name: [p.timestamp > 1_700_000_000_000 for p in all_of(a, name.upper())],  # type: ignore[misc]
         f"topics-{name}-timestamp")
for name in ("nbirth", "ndata", "dbirth", "ddata", "ddeath"):
    hold(lambda a, b, name=name: [p.HasField("timestamp") for p in all_of(a, name.upper())],  # type: ignore[misc]
         f"payloads-{name}-timestamp")
for name in ("ndata", "dbirth", "ddata", "ddeath"):
    hold(lambda a, b, name=name: [p.HasField("seq") for p in all_of(a, name.upper())],  # type: ignore[misc]
         f"payloads-{name}-seq")
for name in ("NBIRTH", "DBIRTH"):
    hold(lambda a, b, name=name: whole(metrics_of(a, name)), f"topics-{name.lower()}-metrics")  # type: ignore[misc]
hold(lambda a, b: [names_of(a, "NDATA") <= {m.name for m in all_of(a, "NBIRTH")[0].metrics}],
     "topics-nbirth-metric-reqs")
hold(lambda a, b: [names_of(a, "DDATA") <= {m.name for m in all_of(a, "DBIRTH")[0].metrics}],
     "topics-dbirth-metric-reqs", "operational-behavior-data-publish-dbirth")
equal(lambda a, b: {metric(p, "bdSeq").datatype for p in all_of(a, "NBIRTH")}, {4}, "topics-nbirth-bdseq-included",
      "payloads-nbirth-bdseq")
equal(lambda a, b: {(m.datatype, m.boolean_value, m.HasField("alias")) for m in rebirths(a)}, {(11, False, False)},
      "topics-nbirth-rebirth-metric")
equal(lambda a, b: {m.name for p in [*all_of(a, "NDEATH"), *wills(a)] for m in p.metrics}, {"bdSeq"},
      "topics-ndeath-payload")
equal(lambda a, b: {p.HasField("seq") for p in [*all_of(a, "NDEATH"), *wills(a)]}, {False}, "topics-ndeath-seq",
      "payloads-ndeath-seq")
counts_on(("DBIRTH",), "topics-dbirth-seq", "message-flow-device-birth-publish-dbirth-payload-seq",
          "payloads-dbirth-seq-inc")
counts_on(("NDATA",), "topics-ndata-seq-num", "payloads-ndata-seq-inc")
counts_on(("DDATA",), "topics-ddata-seq-num", "payloads-ddata-seq-inc")
counts_on(("DDEATH",), "topics-ddeath-seq-num", "payloads-ddeath-seq-inc", "payloads-ddeath-seq-number")

# Section 5: operational behaviour.

equal(lambda a, b: {(c.level, c.clean) for c in a.connects}, {(4, True)}, "principles-persistence-clean-session-311")
equal(lambda a, b: {order(a, n)[:3] == ["NBIRTH", "DBIRTH", "DBIRTH"] for n in a.connections}, {True},
      "principles-birth-certificates-order", "payloads-dbirth-order")
hold(lambda a, b: [c.will_topic and c.will_payload for c in a.connects],
     "message-flow-edge-node-birth-publish-will-message")
equal(lambda a, b: {c.will_topic for c in a.connects}, {f"spBv1.0/{GROUP}/NDEATH/{NODE}"},
      "message-flow-edge-node-birth-publish-will-message-topic", "payloads-ndeath-will-message")
equal(lambda a, b: {len(p.metrics) for p in wills(a)}, {1}, "message-flow-edge-node-birth-publish-will-message-payload")
hold(lambda a, b: [m.datatype == 4 and 0 <= m.long_value <= 255 for m in [metric(wills(a)[0], "bdSeq")]],
     "message-flow-edge-node-birth-publish-will-message-payload-bdseq")
equal(lambda a, b: {c.will_qos for c in a.connects + b.connects}, {1},
      "message-flow-edge-node-birth-publish-will-message-qos", "payloads-ndeath-will-message-qos")
equal(lambda a, b: {c.will_retain for c in a.connects + b.connects}, {False},
      "message-flow-edge-node-birth-publish-will-message-will-retained", "payloads-ndeath-will-message-retain")
hold(lambda a, b: [any(topic.startswith(f"spBv1.0/{GROUP}/DCMD/{NODE}/") and n == 1 for topic, n in p.filters)
                   for p in subscribes(a)], "message-flow-device-dcmd-subscribe")
hold(lambda a, b: [("spBv1.0/STATE/scada", 1) in subscribes(b)[0].filters],
     "message-flow-edge-node-birth-publish-phid-wait-id")
equal(lambda a, b: len(b.sent("NBIRTH", connection=0)), 1, "message-flow-edge-node-birth-publish-phid-wait-online")
equal(lambda a, b: decode(b.sent("NBIRTH")[0].payload).seq, 0,  # `hosted_life`: an older online brought no birth
      "message-flow-edge-node-birth-publish-phid-wait-timestamp")
equal(lambda a, b: (order(b, 0)[-1], [p.kind for p in b.packets if p.out and p.connection == 0][-1]),
      ("NDEATH", "DISCONNECT"), "message-flow-edge-node-birth-publish-phid-offline")
hold(lambda a, b: [len(b.connects) >= 2, order(b, 0)[-1] == "NDEATH"],
     "operational-behavior-edge-node-termination-host-offline")
hold(lambda a, b: [p.HasField("timestamp") and p.HasField("seq") and p.metrics for p in all_of(a, "NBIRTH")],
     "message-flow-edge-node-birth-publish-nbirth-payload")
equal(lambda a, b: bd_seqs(all_of(a, "NBIRTH")), [0, 0, 1], "message-flow-edge-node-birth-publish-nbirth-payload-bdseq")
hold(lambda a, b: [order(a, n).index("NBIRTH") < order(a, n).index("DBIRTH") for n in a.connections],
     "message-flow-device-birth-publish-nbirth-wait")
equal(lambda a, b: [level(a, n, "DBIRTH") for n in (1, 3)], [{GROUP}, {NODE}],
      "message-flow-device-birth-publish-dbirth-match-edge-node-topic")
hold(lambda a, b: [p.HasField("timestamp") and p.metrics for p in all_of(a, "DBIRTH")],
     "message-flow-device-birth-publish-dbirth-payload")
equal(lambda a, b: order(a, 1)[-1], "NDEATH", "operational-behavior-edge-node-intentional-disconnect-ndeath")
equal(lambda a, b: [(p.kind, kind(p)) for p in a.packets
                    if p.out and p.connection == 1 and p.kind in ("PUBLISH", "DISCONNECT")][-2:],
      [("PUBLISH", "NDEATH"), ("DISCONNECT", "")], "operational-behavior-edge-node-intentional-disconnect-packet")
equal(lambda a, b: [values(p).get("Bays/Alive") for p in all_of(a, "NBIRTH", "NDATA")], [2, 1, 2, 2, 2],
      "operational-behavior-data-publish-nbirth", "operational-behavior-data-publish-nbirth-change")
hold(lambda a, b: [m.is_null or m.WhichOneof("value") for m in metrics_of(a, "NBIRTH")],
     "operational-behavior-data-publish-nbirth-values")
hold(lambda a, b: in_order(all_of(a, "NBIRTH")), "operational-behavior-data-publish-nbirth-order")
hold(lambda a, b: in_order(all_of(a, "DBIRTH", "DDATA")), "operational-behavior-data-publish-dbirth-order")
equal(lambda a, b: [values(decode(a.sent("DBIRTH")[0].payload))[name]
                    for name in ("Stop", "May Move", "Marker/Radius", "Distance")], [False, True, 100.0, 800.0],
      "operational-behavior-data-publish-dbirth-values")
hold(lambda a, b: rebirths(a), "operational-behavior-data-commands-rebirth-name")
equal(lambda a, b: {m.HasField("alias") for m in metrics_of(a, "NBIRTH", "DBIRTH", "DDATA")}, {False},
      "operational-behavior-data-commands-rebirth-name-aliases")
equal(lambda a, b: {m.datatype for m in rebirths(a)}, {11}, "operational-behavior-data-commands-rebirth-datatype")
equal(lambda a, b: {m.boolean_value for m in rebirths(a)}, {False},
      "operational-behavior-data-commands-rebirth-value", "payloads-nbirth-rebirth-req")
equal(lambda a, b: [kind(p) for p in a.publishes(0) if p.at_s >= a.sent("NBIRTH", connection=0)[1].at_s][:3],
      ["NBIRTH", "DBIRTH", "DBIRTH"], "operational-behavior-data-commands-rebirth-action-1")
equal(lambda a, b: [len(a.sent(name, connection=0)) for name in ("NBIRTH", "DBIRTH")],
      [2, 5],  # two devices, one that came back, two
      "operational-behavior-data-commands-rebirth-action-2")
equal(lambda a, b: bd_seqs([decode(p.payload) for p in a.sent("NBIRTH", connection=0)]), [0, 0],
      "operational-behavior-data-commands-rebirth-action-3", "payloads-nbirth-bdseq-repeat")

# Section 6: payloads.

hold(lambda a, b: [1_700_000_000_000 < p.timestamp < 4_000_000_000_000 for p in all_of(a, *SENT)],
     "payloads-timestamp-in-utc")
hold(lambda a, b: [p.HasField("seq") for p in all_of(a, *SENT)], "payloads-sequence-num-always-included")
counts_on(("NDATA", "DBIRTH", "DDATA", "DDEATH"), "payloads-sequence-num-incrementing")
hold(lambda a, b: [m.name for m in metrics_of(a, *SENT[:-1], "NDEATH")], "payloads-name-requirement")
hold(lambda a, b: [m.HasField("timestamp") for m in metrics_of(a, *SENT[:-1])],
     "payloads-name-birth-data-requirement")
hold(lambda a, b: [1_700_000_000_000 < m.timestamp <= p.timestamp for p in all_of(a, "DDATA") for m in p.metrics],
     "payloads-metric-timestamp-in-utc")
# The decoder knows the field by its number and its type: another type would leave it out.
hold(lambda a, b: [0 < datatype < 2**32 for datatype in datatypes(a).values()], "payloads-metric-datatype-value-type")
hold(lambda a, b: [datatype in range(1, 35) for datatype in datatypes(a).values()], "payloads-metric-datatype-value")
equal(lambda a, b: {m.HasField("datatype") for m in metrics_of(b, "DDATA")}, {False},  # on request alone
      "payloads-metric-datatype-not-req")
hold(lambda a, b: [len(s.keys) == len(s.values) for s in property_sets(a)], "payloads-propertyset-keys-array-size",
     "payloads-propertyset-values-array-size")
hold(lambda a, b: [0 < v.type < 2**32 for s in property_sets(a) for v in s.values],
     "payloads-metric-propertyvalue-type-type")
hold(lambda a, b: [v.HasField("type") for s in property_sets(a) for v in s.values],
     "payloads-metric-propertyvalue-type-req")
hold(lambda a, b: [v.type in {*range(1, 15), 20, 21} for s in property_sets(a) for v in s.values],
     "payloads-metric-propertyvalue-type-value")
equal(lambda a, b: {q.type for q in qualities(a)}, {3}, "payloads-propertyset-quality-value-type")
hold(lambda a, b: [q.WhichOneof("value") == "int_value" and q.int_value in (0, 192, 500) for q in qualities(a)],
     "payloads-propertyset-quality-value-value")
hold(lambda a, b: [order(a, n).index("DDATA") > order(a, n).index("DBIRTH") + 1 for n in a.connections],
     "payloads-ddata-order")
hold(lambda a, b: [order(a, 0).index("NDATA") > order(a, 0).index("NBIRTH")], "payloads-ndata-order")
equal(lambda a, b: [values(p) for p in all_of(a, "NDATA")], [{"Bays/Alive": 1}, {"Bays/Alive": 2}],
      "topics-ndata-payload")
equal(lambda a, b: len(a.sent("NDEATH", connection=1)), 1, "payloads-ndeath-will-message-publisher")
equal(lambda a, b: [p.kind for p in a.packets if p.out and p.connection == 1][-1], "DISCONNECT",
      "payloads-ndeath-will-message-publisher-disconnect-mqtt311")
equal(lambda a, b: {p.reason for p in b.packets if p.out and p.kind == "DISCONNECT"},
      {4},  # `Disconnect with will message`
      "payloads-ndeath-will-message-publisher-disconnect-mqtt50")

# fmt: on

# Those that take more than one expression.


@assertions("topic-structure")
def _topic_structure(life: Life, hosted: Life) -> None:
    for packet in life.sent(*SENT, "NDEATH") + hosted.sent("NBIRTH", "DBIRTH"):
        levels = packet.topic.split("/")
        assert levels[:2] == ["spBv1.0", GROUP]
        assert levels[3] == NODE
        assert len(levels) == (5 if levels[2].startswith("D") else 4)
    assert all(not p.topic or kind(p) for p in life.packets if p.out)  # and nothing else


@assertions("topic-structure-namespace-unique-device-id")
def _unique_devices(life: Life, hosted: Life) -> None:
    births = [p.topic for p in life.sent("DBIRTH", connection=1)]
    assert len(set(births)) == len(births) == 2


@assertions("topics-nbirth-bdseq-matching", "payloads-ndeath-bdseq")
def _bd_seq_of_birth_and_will(life: Life, hosted: Life) -> None:
    for one in (life, hosted):
        for connect, number in zip(one.connects, bd_seqs(wills(one)), strict=True):
            births = [decode(p.payload) for p in one.sent("NBIRTH", connection=connect.connection)]
            assert bd_seqs(births) == [number] * len(births)


@assertions("topics-nbirth-bdseq-increment")
def _bd_seq_counts(life: Life, hosted: Life) -> None:
    assert bd_seqs(wills(life)) == [0, 1]
    assert bd_seqs(wills(hosted))[:3] == [254, 255, 0][: len(hosted.connects)]
    name = "test-bdseq"
    first = BdSeq(name)()
    assert [BdSeq(name)() for _ in range(3)] == [(first + n) % 256 for n in (1, 2, 3)]


@assertions("topics-ddata-payload", "operational-behavior-data-publish-dbirth-change", "principles-rbe-recommended")
def _only_what_changed(life: Life, hosted: Life) -> None:
    """The plant publishes its states twenty times a second; what does not change is not sent."""
    known: dict[str, dict[str, Any]] = {}
    for packet in life.sent("DBIRTH", "DDATA", connection=0):
        payload = decode(packet.payload)
        assert payload.metrics
        now = values(payload, historical=False)
        bay = known.setdefault(packet.topic.split("/")[4], {})
        if kind(packet) == "DDATA":
            assert {name: value for name, value in now.items() if bay[name] == value} == {}
        bay.update(now)
    assert known["bay1"]["Stop"] is True


@assertions("case-sensitivity-sparkplug-ids")
def _bay_names_differ(life: Life, hosted: Life) -> None:
    """As far as one gateway knows: two bays."""
    assert GatewayConfig.model_validate({"bays": [{"name": "bay1"}, {"name": "bay2", "unit_id": 2}]})
    with pytest.raises(ValidationError, match="an earlier bay has the name Bay1, too"):
        GatewayConfig.model_validate({"bays": [{"name": "bay1"}, {"name": "Bay1", "unit_id": 2}]})


@assertions("case-sensitivity-metric-names")
def _metric_names_differ(life: Life, hosted: Life) -> None:
    for payload in all_of(life, "NBIRTH", "DBIRTH"):
        names = [m.name.lower() for m in payload.metrics]
        assert len(set(names)) == len(names)


@assertions("principles-persistence-clean-session-50")
def _clean_session_of_mqtt_5(life: Life, hosted: Life) -> None:
    assert {(c.level, c.clean) for c in hosted.connects} == {(5, True)}
    assert {c.session_expiry_s for c in hosted.connects} <= {None, 0}


@assertions("message-flow-edge-node-birth-publish-connect", "message-flow-edge-node-ncmd-subscribe")
def _connected_and_subscribed_first(life: Life, hosted: Life) -> None:
    for connection in life.connections:
        packets = [p for p in life.packets if p.connection == connection]
        kinds = [p.kind for p in packets]
        assert kinds.index("CONNACK") < kinds.index("PUBLISH")
        (subscribe,) = [p for p in packets if p.kind == "SUBSCRIBE"]
        assert (f"spBv1.0/{GROUP}/NCMD/{NODE}", 1) in subscribe.filters
        assert kinds.index("SUBACK") < next(n for n, p in enumerate(packets) if p.out and p.kind == "PUBLISH")


@assertions("message-flow-edge-node-birth-publish-phid-wait")
def _waits_for_the_host(life: Life, hosted: Life) -> None:
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


@assertions("operational-behavior-edge-node-termination-host-offline-timestamp")
def _late_will_of_the_host(life: Life, hosted: Life) -> None:
    """The late will of an earlier life of the host (timestamp 1500) ended nothing; the one of 2000 did."""
    offline = [p for p in hosted.packets if not p.out and b'"online": false' in p.payload and p.connection == 0]
    assert [json.loads(p.payload)["timestamp"] for p in offline] == [1000, 1500, 2000]
    death = hosted.sent("NDEATH", connection=0)[0]
    assert offline[1].at_s < offline[2].at_s <= death.at_s


@assertions("operational-behavior-edge-node-termination-host-offline-reconnect")
def _next_server(life: Life, hosted: Life) -> None:
    """There is one server, so the next one is the same."""
    ended = next(p for p in hosted.packets if p.out and p.connection == 0 and p.kind == "DISCONNECT")
    assert any(p.connection == 1 and p.at_s > ended.at_s for p in hosted.connects)


@assertions("operational-behavior-primary-application-state-with-multiple-servers-state-subs")
def _state_subscriptions(life: Life, hosted: Life) -> None:
    for connection in hosted.connections:
        (subscribe,) = [p for p in subscribes(hosted) if p.connection == connection]
        assert ("spBv1.0/STATE/scada", 1) in subscribe.filters


@assertions("operational-behavior-primary-application-state-with-multiple-servers-single-server")
def _single_server(life: Life, hosted: Life) -> None:
    """Each connection has ended before the next one begins."""
    for earlier, later in pairwise(hosted.connects):
        (ended,) = [p for p in hosted.packets if p.connection == earlier.connection and p.kind == "DISCONNECT"]
        assert ended.at_s <= later.at_s


@assertions("operational-behavior-edge-node-birth-sequence-wait")
def _birth_after_online(life: Life, hosted: Life) -> None:
    for connection in hosted.connections:
        if publishes := hosted.publishes(connection):
            online = next(
                p for p in hosted.packets if not p.out and p.connection == connection and b'"online": true' in p.payload
            )
            assert online.at_s <= publishes[0].at_s


@assertions("operational-behavior-device-ddeath")
def _birth_after_death(life: Life, hosted: Life) -> None:
    (death,) = life.sent("DDEATH")
    after = [p for p in life.publishes(0) if p.at_s > death.at_s and p.topic.endswith("/bay2")]
    assert kind(after[0]) == "DBIRTH"  # and nothing of a dead device in between


@assertions("payloads-metric-datatype-req")
def _values_of_their_datatypes(life: Life, hosted: Life) -> None:
    """And what is carried is of it, in data too."""
    assert all(m.HasField("datatype") for m in metrics_of(life, "NBIRTH", "DBIRTH"))
    carried = {3: "int_value", 4: "long_value", 10: "double_value", 11: "boolean_value", 12: "string_value"}
    types = datatypes(life)
    for packet in life.sent("NBIRTH", "DBIRTH", "DDATA"):
        for found in decode(packet.payload).metrics:
            datatype = types[packet.topic.split("/")[-1], found.name]
            assert found.is_null or found.WhichOneof("value") == carried[datatype]


@pytest.mark.parametrize("name", CHECKS)
def test_assertion(name: str, life: Life, hosted: Life) -> None:
    CHECKS[name](life, hosted)


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


def test_data_carry_the_datatypes_of_the_birth(life: Life) -> None:
    types = datatypes(life)
    for packet in life.sent("DDATA"):
        found = {(packet.topic.split("/")[-1], m.name): m.datatype for m in decode(packet.payload).metrics}
        assert found == {key: types[key] for key in found}


def test_the_sequence_number_goes_round(life: Life) -> None:
    assert any(seq == 255 for name, seq in sequenced(life, 0) if name == "DDATA")


def test_commands_that_are_none_change_nothing(life: Life) -> None:
    assert len(life.sent("NBIRTH", connection=0)) == 2


def test_every_assertion_that_is_tested_stands_on_the_page_and_the_other_way_round() -> None:
    rows = re.findall(r"^\| `(tck-id-[A-Za-z0-9-]+)` \| ([a-z ]+) \| (.+) \|$", PAGE.read_text("utf-8"), re.MULTILINE)
    assert len({name for name, _, _ in rows}) == len(rows) == ASSERTIONS
    assert {name.lower() for name, status, _ in rows if status == "tested"} == set(CHECKS)
    assert {status for _, status, _ in rows} <= {"tested", "not applicable", "not met"}
