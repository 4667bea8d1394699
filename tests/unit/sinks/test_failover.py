"""Several brokers, and several addresses of one: which is tried when, and when the preferred one is returned to."""

import asyncio
import contextlib
import random
import socket
import threading
from collections import Counter
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest

from gateway.config import MqttConfig
from gateway.errors import LinkError
from gateway.sinks.mqtt.broker_link import BrokerLink, NotAcceptedError
from gateway.sinks.mqtt.endpoints import SETTLED_S, Endpoint, Endpoints, ReturnPace
from gateway.sinks.mqtt.lookup import LOOKUP_S, Address, Lookup
from gateway.sinks.mqtt.session import BrokerSession
from gateway.sinks.mqtt.topics import MqttMessage
from tests import virtual_time
from tests.mqtt_endpoints import at
from tests.unit.sinks.mqtt_stand_ins import in_virtual_time, now_s

WILL = MqttMessage("will", b"")
SILENT_S = 5.0  # until a connection without an answer is given up


class Link(BrokerLink):
    def __init__(self, lost: asyncio.Event) -> None:
        self._lost = lost
        self.quieted = False

    async def quiet(self) -> None:
        self.quieted = True

    async def incoming(self) -> AsyncIterator[MqttMessage]:
        for message in [MqttMessage("", b"")] * self._lost.is_set():
            yield message
        await self._lost.wait()
        raise LinkError("connection lost")


@dataclass
class Node:
    """`state`: up, refusing, silent, or old (knows only MQTT 3.1.1)."""

    state: str = "up"
    limits: str = ""
    lost: asyncio.Event = field(default_factory=asyncio.Event)
    link: Link | None = None


class Network:
    """Nodes by their IP address; what is tried is kept: seconds since the start, node, client id and version."""

    def __init__(self, **nodes: str) -> None:
        self.nodes = {f"192.0.2.{name.removeprefix('n')}": Node(state) for name, state in nodes.items()}
        self.tried: list[tuple[float, str, str, str]] = []
        self.wills: list[MqttMessage | None] = []
        self._begun_s = now_s()

    def __getitem__(self, number: int) -> Node:
        return self.nodes[f"192.0.2.{number}"]

    def order(self) -> str:
        """The nodes tried for a connection, by their numbers."""
        return "".join(node for _, node, client, _ in self.tried if not client.endswith("-check"))

    def checks(self) -> list[float]:
        return [at_s for at_s, _, client, _ in self.tried if client.endswith("-check")]

    @contextlib.asynccontextmanager
    async def connect(
        self, endpoint: Endpoint, *, client_id: str, version: str, will: MqttMessage | None, **_: object
    ) -> AsyncIterator[Link]:
        ip = endpoint.address[4][0]
        node = self.nodes[ip]
        self.tried.append((now_s() - self._begun_s, ip[-1], client_id, version))
        self.wills.append(will)
        if node.state == "silent":
            await asyncio.sleep(SILENT_S)
            raise NotAcceptedError(f"{endpoint}: no CONNACK", certain=False)
        if node.state == "refusing":
            raise LinkError(f"{endpoint}: refused")
        if node.state == "old" and version == "5":
            raise NotAcceptedError(f"{endpoint}: wrong version", certain=True)
        node.lost = asyncio.Event()
        node.link = Link(node.lost)
        node.link.limits = node.limits
        yield node.link


def session_of(network: Network, *numbers: int, **settings: Any) -> BrokerSession:
    config = MqttConfig(urls=tuple(f"mqtt://192.0.2.{n}" for n in numbers), **settings)
    return BrokerSession(config, "gw", connect=network.connect)


async def keep_connected(session: BrokerSession, faults: list[str]) -> None:
    """As the supervisor would, half a second after each loss."""
    while True:
        try:
            async with session.connection(WILL):
                await session.closing.wait()
        except LinkError as error:
            faults.append(f"{error}")
            await asyncio.sleep(0.5)
        else:
            return


@contextlib.asynccontextmanager
async def kept(session: BrokerSession) -> AsyncIterator[list[str]]:
    faults: list[str] = []
    async with asyncio.TaskGroup() as group:
        task = group.create_task(keep_connected(session, faults))
        yield faults
        task.cancel()


@in_virtual_time
async def test_a_node_that_does_not_answer_costs_one_time_limit_and_the_next_one_serves() -> None:
    network = Network(n1="silent", n2="up", n3="up")
    session = session_of(network, 1, 2, 3)
    assert (session.connected, session.peer) == (
        False,
        "mqtt://192.0.2.1:1883, mqtt://192.0.2.2:1883, mqtt://192.0.2.3:1883",
    )
    async with kept(session):
        await asyncio.sleep(SILENT_S + 0.1)
        assert session.connected
        assert session.peer == "mqtt://192.0.2.2:1883"
        assert session.figures == {"connected": 1, "broker": 2, "failovers": 0}
    assert network.order() == "12"
    assert [version for *_, version in network.tried] == ["5", "5"]  # the silent one decides nothing about the other


@in_virtual_time
async def test_after_a_loss_the_next_one_is_tried_first_and_the_lost_one_last() -> None:
    network = Network(n1="up", n2="up", n3="refusing")
    session = session_of(network, 1, 2, 3, return_s=86_400)
    async with kept(session) as faults:
        await asyncio.sleep(1)
        network[1].lost.set()
        await asyncio.sleep(1)
        assert (network.order(), session.peer) == ("12", "mqtt://192.0.2.2:1883")
        assert (session.connections, session.failovers) == (2, 1)
        network[2].lost.set()
        await asyncio.sleep(1)
        assert network.order() == "12" + "31"
    assert faults == ["connection lost"] * 2


@in_virtual_time
async def test_when_all_were_away_the_preferred_one_is_tried_first_in_every_round() -> None:
    network = Network(n1="refusing", n2="refusing", n3="refusing")
    session = session_of(network, 1, 2, 3)
    async with kept(session) as faults:
        await asyncio.sleep(1.6)
        for number in (1, 2, 3):
            network[number].state = "up"
        await asyncio.sleep(1)
        assert session.peer == "mqtt://192.0.2.1:1883"
    assert network.order() == "123" * 4 + "1"
    assert faults[0] == "mqtt://192.0.2.1:1883: refused; mqtt://192.0.2.2:1883: refused; mqtt://192.0.2.3:1883: refused"


@in_virtual_time
async def test_a_version_that_is_refused_is_followed_by_the_other_one_at_once() -> None:
    network = Network(n1="old", n2="up")
    session = session_of(network, 1, 2)
    async with kept(session):
        await asyncio.sleep(0.1)
        assert session.peer == "mqtt://192.0.2.1:1883"
    assert [version for *_, version in network.tried] == ["5", "3.1.1"]


def test_what_a_broker_does_not_support_is_in_the_log_once(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        network = Network(n1="up")
        network[1].limits = "QoS 0 only, no retained messages"
        async with kept(session_of(network, 1)):
            for _ in range(3):
                await asyncio.sleep(1)
                network[1].lost.set()
            network[1].limits = "QoS 0 only"  # after an update
            await asyncio.sleep(1)
        assert network.order() == "1111"

    virtual_time.run(scenario())
    assert [line for line in caplog.messages if "supports" in line] == [
        "mqtt://192.0.2.1:1883: supports QoS 0 only, no retained messages",
        "mqtt://192.0.2.1:1883: supports QoS 0 only",
    ]


@in_virtual_time
async def test_the_preferred_one_is_returned_to_when_it_accepts_a_check() -> None:
    network = Network(n1="silent", n2="up")
    session = session_of(network, 1, 2, return_s=60)
    async with kept(session) as faults:
        await asyncio.sleep(300)
        assert session.peer == "mqtt://192.0.2.2:1883"  # no check has harmed it
        assert (session.connections, faults) == (1, [])
        gaps = [
            later - former - SILENT_S for former, later in zip(network.checks(), network.checks()[1:], strict=False)
        ]
        assert len(gaps) >= 2
        assert all(30 <= gap <= 90 for gap in gaps)
        network[1].state = "up"
        await asyncio.sleep(SILENT_S + 91)  # a check that has begun waits for its time limit first
        assert session.peer == "mqtt://192.0.2.1:1883"
        assert network[2].link is not None
        assert network[2].link.quieted  # nothing was on its way
        assert faults == ["mqtt://192.0.2.2:1883: left, because mqtt://192.0.2.1:1883 accepts connections again"]
        checks = len(network.checks())
        await asyncio.sleep(300)
        assert len(network.checks()) == checks  # the preferred one is connected: nothing to check
    assert network.order() == "121"
    assert {will for (_, _, client, _), will in zip(network.tried, network.wills, strict=True) if client == "gw"} == {
        WILL
    }
    assert {will for (_, _, client, _), will in zip(network.tried, network.wills, strict=True) if client != "gw"} == {
        None
    }


@pytest.mark.one_interpreter
@pytest.mark.long
@in_virtual_time
async def test_a_preferred_one_that_lets_go_each_time_is_returned_to_less_and_less_often() -> None:
    """It accepts connections, and ends each after 20 s."""
    random.seed(4)
    network = Network(n1="up", n2="up")
    session = session_of(network, 1, 2, return_s=60)

    async def let_go() -> None:
        while True:
            await asyncio.sleep(0.1)
            if session.peer == "mqtt://192.0.2.1:1883":
                await asyncio.sleep(20)
                network[1].lost.set()
                await asyncio.sleep(1)

    async with kept(session), asyncio.TaskGroup() as group:
        task = group.create_task(let_go())
        await asyncio.sleep(24 * 3600)
        task.cancel()
    returns = [at_s for at_s, node, client, _ in network.tried if node == "1" and client == "gw"]
    assert 24 <= len(returns) <= 60  # without the longer and longer waits: about 1,000
    assert min(later - former for former, later in zip(returns[-10:], returns[-9:], strict=False)) > SETTLED_S / 2


def test_the_wait_before_a_check() -> None:
    pace = ReturnPace(60)
    waits = []
    for _ in range(8):
        pace.returned()
        pace.connected(0)
        pace.ended(10)
        waits.append(pace.wait_s)
    assert waits == [120, 240, 480, 960, 1920, 3600, 3600, 3600]
    pace.returned()
    pace.connected(0)
    pace.ended(SETTLED_S)  # it has lasted
    assert pace.wait_s == 60
    pace.ended(10)  # lost, but not after a return
    assert pace.wait_s == 60
    pace.returned()
    pace.connected(1)  # it accepted the check, and then not the connection
    assert pace.wait_s == 120
    assert ReturnPace(86_400).wait_s == 86_400


def test_the_addresses_of_one_name_are_each_tried_and_a_failed_one_last() -> None:
    addresses = [at(f"mqtt://192.0.2.{n}").address for n in (1, 2, 3)]
    broker = at("mqtt://192.0.2.9").broker

    async def look_up(host: str, port: int) -> Sequence[Address]:
        return addresses

    async def scenario() -> None:
        endpoints = Endpoints([broker], look_up)
        one, two, three = [Endpoint(broker, address) for address in addresses]
        assert [e async for e in endpoints.in_order([])] == [one, two, three]
        for failed in (one, three):
            endpoints.versions(failed)
            endpoints.failed(failed)
        assert [e async for e in endpoints.in_order([])] == [two, one, three]
        endpoints.failed(one)  # again
        assert [e async for e in endpoints.in_order([])] == [two, three, one]
        endpoints.accepted(three)
        assert [e async for e in endpoints.in_order([])] == [two, three, one]
        addresses.remove(one.address)  # the name has other addresses now
        assert [e async for e in endpoints.in_order([])] == [two, three]
        addresses.append(one.address)
        assert [e async for e in endpoints.in_order([])] == [two, three, one]
        endpoints.failed(two)
        assert [e async for e in endpoints.in_order([])] == [three, one, two]
        assert str(one) == "mqtt://192.0.2.9:1883 (192.0.2.1)"

    asyncio.run(scenario())


def test_a_name_without_an_answer_is_passed_over() -> None:
    unknown, known = at("mqtt://192.0.2.1").broker, at("mqtt://192.0.2.2")

    async def look_up(host: str, port: int) -> Sequence[Address]:
        if host == unknown.host:
            raise LinkError("not known")
        return [known.address]

    async def scenario() -> None:
        faults: list[LinkError] = []
        endpoints = Endpoints([unknown, known.broker], look_up)
        assert [str(e) async for e in endpoints.in_order(faults)] == ["mqtt://192.0.2.2:1883"]
        assert [str(fault) for fault in faults] == ["mqtt://192.0.2.1:1883: not known"]

    asyncio.run(scenario())


def test_a_slow_lookup_is_waited_for_by_the_next_round(monkeypatch: pytest.MonkeyPatch) -> None:
    """One thread, however often it is asked."""
    calls = []
    found = socket.getaddrinfo("192.0.2.1", 1883, type=socket.SOCK_STREAM)

    def getaddrinfo(host: str, port: int, flags: int = 0, **_: object) -> list[Any]:
        if flags:
            raise socket.gaierror
        calls.append(host)
        release.wait(30)
        return found

    release = threading.Event()
    monkeypatch.setattr(socket, "getaddrinfo", getaddrinfo)
    monkeypatch.setattr("gateway.sinks.mqtt.lookup.LOOKUP_S", 0.05)

    async def scenario() -> None:
        lookup = Lookup()
        for _ in range(3):
            with pytest.raises(LinkError, match=r"no answer to the lookup of the name within 0\.05 s"):
                await lookup.addresses("broker", 1883)
        assert calls == ["broker"]
        monkeypatch.setattr("gateway.sinks.mqtt.lookup.LOOKUP_S", LOOKUP_S)
        release.set()
        assert await lookup.addresses("broker", 1883) == found
        assert await lookup.addresses("broker", 1883) == found
        assert calls == ["broker"] * 2  # what was found is not kept

    asyncio.run(scenario())


def test_a_hundred_gateways_share_the_brokers_where_the_list_is_shuffled() -> None:
    urls = [f"mqtt://192.0.2.{n}" for n in (1, 2, 3)]

    def preferred(*, shuffled: bool) -> Counter[str]:
        config = MqttConfig.model_validate({"urls": urls, "urls_shuffled": shuffled})
        sessions = [BrokerSession(config, f"gateway-site1-bay-{n:03}") for n in range(100)]
        assert {frozenset(session.peer.split(", ")) for session in sessions} == {
            frozenset(f"{url}:1883" for url in urls)
        }
        return Counter(session.peer.split(",")[0] for session in sessions)

    assert preferred(shuffled=False) == {"mqtt://192.0.2.1:1883": 100}
    assert min(preferred(shuffled=True)[f"{url}:1883"] for url in urls) >= 20
    assert preferred(shuffled=True) == preferred(shuffled=True)  # a restart changes nothing
