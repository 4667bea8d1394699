"""One connection to the broker: the only module that imports the MQTT client library, aiomqtt. IO.

A client object lives for one connection: a message that was not acknowledged stays queued inside it and would be sent
again on a second one.

aiomqtt opens its socket in a thread that can't be stopped, leaves it open when the broker never answers, and sends
DISCONNECT even when it is cancelled. So it is handed a socket that is open already (`broker_socket`). How the
connection ends is a promise: left normally, it sends DISCONNECT, and the broker discards the last will; left by an
exception or a cancellation, the socket is closed, and the broker publishes the will.

paho's public callbacks and the socket serve for this wherever they can; four private parts of aiomqtt and of paho are
used for the rest. Both are pinned exactly, and tests/unit/sinks/test_broker_link.py watches each of these parts
(docs/decisions/0040-private-parts.md).
"""

import asyncio
import contextlib
import logging
import math
import socket
import ssl
from collections.abc import AsyncIterator, Sequence
from functools import partial
from typing import Any

import aiomqtt
from aiomqtt.exceptions import MqttCodeError, MqttConnectError
from paho.mqtt.client import MQTT_ERR_SUCCESS
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from gateway.core import details
from gateway.errors import LinkError
from gateway.sinks.mqtt.broker import Broker
from gateway.sinks.mqtt.broker_socket import certificate_of, fault_of, open_socket
from gateway.sinks.mqtt.endpoints import Endpoint, Version
from gateway.sinks.mqtt.takeovers import End
from gateway.sinks.mqtt.topics import MqttMessage
from gateway.sinks.mqtt.web_socket import WebSocket

CONNECT_S = 5.0  # for the socket, and again for the CONNACK
MAX_INCOMING = 100  # messages received and not fetched yet
CROWDED = MAX_INCOMING // 4  # of them: from here on, reading waits for those that fetch them
ROUNDS = 8  # of the event loop at most; aiomqtt needs three to hand over a message
MAX_PACKET_BYTES = 65_536  # one of more ends the connection: MQTT allows 256 MB, which would be memory
MAX_IN_FLIGHT = 64  # messages without acknowledgement at once; more wait their turn
MAX_IN_FLIGHT_311 = 20  # MQTT 3.1.1 brokers state no Receive Maximum
NO_SUBSCRIBERS = 0x10  # reason codes of MQTT 5
RETAIN_NOT_SUPPORTED, QOS_NOT_SUPPORTED = 0x9A, 0x9B

CERTIFICATE_HINT = (
    "; a broker that requires a client certificate, or refuses ours, does so: mqtt.tls.cert_file and mqtt.tls.key_file"
)
REFUSED_SUBSCRIPTION = 128  # SUBACK codes from here on are failures
UNSUPPORTED_PROTOCOL_VERSION = (1, 132)  # CONNACK of MQTT 3.1.1 and of MQTT 5

SESSION_TAKEN_OVER = 0x8E
KEEP_ALIVE_TIMEOUT = 0x8D

_log = logging.getLogger("mqtt")
_log.addFilter(lambda record: "on socket" not in str(record.msg))  # with each attempt; `End.text` has the reason

_VERSIONS: dict[Version, aiomqtt.ProtocolVersion] = {
    "5": aiomqtt.ProtocolVersion.V5,
    "3.1.1": aiomqtt.ProtocolVersion.V311,
}


class NotAcceptedError(LinkError):
    """A peer is there, but did not accept the connection. `certain`: because it does not support this version of
    MQTT. `will`: a last will that it may accept in the place of the one it was given."""

    def __init__(self, text: str, *, certain: bool, will: MqttMessage | None = None) -> None:
        super().__init__(text)
        self.certain = certain
        self.will = will


class PublishRefusedError(LinkError):
    """The broker did not take one message. It may take others: who handles this may go on with the link.
    `fault`: why."""

    def __init__(self, broker: object, topic: str, fault: str) -> None:
        super().__init__(f"{broker}: a message was refused: {topic}: {fault}")
        self.fault = fault


class UnansweredError(LinkError):
    """The broker was silent for too long."""


class BrokerLink:
    """A live connection. Real seconds, not the gateway's clock: the broker has no simulated time.

    `in_flight`: messages that may be without acknowledgement at once. `unanswered`: the topics of those that are.
    `newest_refusal`: topic, reason and time of the event loop. All three are right after the connection has ended, too.
    `limits`: what of the gateway's messages the broker's CONNACK says it does not support; empty: nothing.
    """

    limits: str = ""
    end: End | None = None  # how the other side has ended it
    certificate: bytes | None = None  # of the broker, as DER

    def __init__(self, client: "_Client", endpoint: Endpoint, acknowledge_s: float, version: Version) -> None:
        self.version = version
        self.in_flight = min(MAX_IN_FLIGHT if version == "5" else MAX_IN_FLIGHT_311, client.receive_maximum)
        self.unanswered = client.unanswered
        lacks = {"QoS 0 only": not client.maximum_qos, "no retained messages": not client.retain_available}
        self.limits = ", ".join(what for what, so in lacks.items() if so)
        self._client = client
        self._broker = endpoint
        self._acknowledge_s = acknowledge_s
        self._limit = self.in_flight  # now
        self._turns = asyncio.Semaphore(self._limit)

    @property
    def newest_refusal(self) -> tuple[str, str, float] | None:
        return self._client.newest_refusal

    def narrow(self) -> None:
        """One message at a time, until `widen`. Before anything is published."""
        self._limit, self._turns = 1, asyncio.Semaphore(1)

    def widen(self) -> None:
        for _ in range(self.in_flight - self._limit):
            self._turns.release()
        self._limit = self.in_flight

    async def publish(self, message: MqttMessage) -> bool:
        """Returns when the broker has acknowledged it (QoS 1), or when it is sent (QoS 0). False: nobody subscribes to
        its topic, which only an MQTT 5 broker reports, and not each.

        Raises RefusedError: the broker did not take it; LinkError: the link is of no more use.
        """
        message = message.within(self._client.maximum_qos, retain=self._client.retain_available)
        properties = None if self.version == "3.1.1" else _properties(message)
        size, accepted = _packet_bytes(message, properties), self._client.maximum_packet_bytes
        if size > accepted:
            fault = details.TOO_LARGE(size, accepted)
            raise PublishRefusedError(self._broker, message.topic, fault)
        try:
            async with self._turns, asyncio.timeout(self._acknowledge_s):
                reason = await self._client.send(message, properties)
        except TimeoutError:
            raise UnansweredError(details.NO_ACKNOWLEDGEMENT(self._broker, f"{self._acknowledge_s:g}")) from None
        except aiomqtt.MqttError as error:
            raise LinkError(f"{self._broker}: cannot publish: {self._why(error)}") from error
        if reason is not None and reason.is_failure:
            raise PublishRefusedError(self._broker, message.topic, _named(reason))
        return reason is None or reason.value != NO_SUBSCRIBERS

    async def quiet(self) -> None:
        """Returns when no message waits for its acknowledgement; from then on none is sent."""
        for _ in range(self._limit):
            await self._turns.acquire()

    async def subscribe(self, topics: Sequence[tuple[str, int]]) -> None:
        """Topics with their QoS; returns when the broker has granted them all. Raises LinkError."""
        try:
            async with asyncio.timeout(self._acknowledge_s):
                granted = await self._client.subscribe([(topic, qos) for topic, qos in topics])
        except TimeoutError:
            raise LinkError(f"{self._broker}: no answer to a subscription within {self._acknowledge_s:g} s") from None
        except aiomqtt.MqttError as error:
            raise LinkError(f"{self._broker}: cannot subscribe: {self._why(error)}") from error
        if any(int(code if isinstance(code, int) else code.value) >= REFUSED_SUBSCRIPTION for code in granted):
            raise LinkError(f"{self._broker}: refuses a subscription to {', '.join(topic for topic, _ in topics)}")

    async def unsubscribe(self, topic: str) -> None:
        """Raises LinkError."""
        try:
            async with asyncio.timeout(self._acknowledge_s):
                await self._client.unsubscribe(topic)
        except (TimeoutError, aiomqtt.MqttError) as error:
            raise LinkError(f"{self._broker}: cannot end a subscription: {error}") from error

    @property
    def overflowed(self) -> bool:
        """So many messages were not fetched yet that one may have been dropped."""
        return self._client.overflowed

    async def incoming(self) -> AsyncIterator[MqttMessage]:
        """Messages received, until the connection is lost: then LinkError. What is not fetched in time is dropped
        (`overflowed`)."""
        try:
            async for message in self._client.messages:
                payload = message.payload if isinstance(message.payload, bytes) else str(message.payload).encode()
                yield MqttMessage(str(message.topic), payload, bool(message.retain))
        except aiomqtt.MqttError as error:
            raise LinkError(details.LINK_LOST_WHY(self._broker, self._why(error))) from error
        raise LinkError(details.LINK_LOST(self._broker))

    def _why(self, error: aiomqtt.MqttError) -> object:
        return error.__cause__ or error if self.end is None else self.end.text


def _code(error: MqttConnectError) -> int | None:
    return error.rc.value if isinstance(error.rc, ReasonCode) else error.rc


def _lesser(will: MqttMessage | None, code: int | None) -> MqttMessage | None:
    """Of a last will that was refused for its QoS or its retain flag."""
    if will is None or code not in (QOS_NOT_SUPPORTED, RETAIN_NOT_SUPPORTED):
        return None
    return will.within(0 if code == QOS_NOT_SUPPORTED else will.qos, retain=code != RETAIN_NOT_SUPPORTED)


def _properties(message: MqttMessage) -> Properties:
    properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
    if message.text:
        properties.PayloadFormatIndicator = 1  # UTF-8
        properties.ContentType = "application/json"
    if message.expiry_s is not None:
        properties.MessageExpiryInterval = max(1, message.expiry_s)
    return properties


def _named(reason: ReasonCode) -> str:
    return f"{reason} (0x{reason.value:02x})"


def _packet_bytes(message: MqttMessage, properties: Properties | None) -> int:
    """Of the PUBLISH: MQTT 5, 3.3."""
    packed = len(properties.pack()) if properties is not None else 0  # type: ignore[no-untyped-call]
    remaining = 2 + len(message.topic.encode()) + 2 * bool(message.qos) + packed + len(message.payload)
    return 1 + max(1, -(-remaining.bit_length() // 7)) + remaining


def _packet_limit(most_bytes: int) -> Properties:
    """An MQTT 5 broker drops what is larger, and keeps the connection."""
    properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
    properties.MaximumPacketSize = most_bytes
    return properties


def _end(reason: ReasonCode, fault: OSError | None, *, by_packet: bool) -> End:
    """paho's own text for a connection that was closed without a reason is `Unspecified error`, code 128."""
    if by_packet:
        taken_over = reason.value == SESSION_TAKEN_OVER
        return End(details.BROKER_ENDED(f"{reason}{' by another client' if taken_over else ''}"), taken_over=taken_over)
    if fault is not None and not isinstance(fault, ssl.SSLEOFError | ConnectionResetError):
        return End(fault_of(fault))
    if reason.value == KEEP_ALIVE_TIMEOUT:
        return End(details.NO_PINGRESP())
    return End(details.CLOSED_BARE(), bare=True)


class _BoundedSocket:
    """The socket for paho, which reads the rest of a packet at once and keeps room for all of it. An OSError ends the
    connection; `fault`: that of the last read.
    """

    def __init__(self, sock: socket.socket | WebSocket, most_bytes: int) -> None:
        self._sock = sock
        self._most_bytes = most_bytes
        self.fault: OSError | None = None

    def recv(self, size: int) -> bytes:
        try:
            if size > self._most_bytes:
                raise OSError(f"a packet of more than {size} bytes; {self._most_bytes} are accepted")
            return self._sock.recv(size)
        except (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError):
            raise
        except OSError as error:
            self.fault = error
            raise

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sock, name)


@contextlib.asynccontextmanager
async def connect(
    endpoint: Endpoint,
    *,
    client_id: str,
    will: MqttMessage | None,
    keepalive_s: int,
    acknowledge_s: float,
    tls: ssl.SSLContext | None,
    version: Version = "3.1.1",
    will_at_disconnect: bool = False,
    max_packet_bytes: int = MAX_PACKET_BYTES,
) -> AsyncIterator[BrokerLink]:
    """Raises LinkError when there is no broker, NotAcceptedError where it does not accept the connection.

    `will_at_disconnect`: an MQTT 5 broker publishes the will even when the connection ends properly.
    `max_packet_bytes`: of what is received.
    """
    try:
        sock = await open_socket(endpoint, tls, CONNECT_S)
    except LinkError as error:
        raise LinkError(f"{endpoint}: {error}") from error
    with contextlib.closing(sock):
        broker = endpoint.broker
        client = _Client(
            sock,
            broker,
            client_id=client_id,
            will=will,
            keepalive_s=keepalive_s,
            version=version,
            max_packet_bytes=max_packet_bytes,
        )
        try:
            try:
                await client.open()
            except MqttConnectError as error:
                code = _code(error)
                certain = code in UNSUPPORTED_PROTOCOL_VERSION
                raise NotAcceptedError(f"{endpoint}: {error}", certain=certain, will=_lesser(will, code)) from error
            except aiomqtt.MqttError as error:
                hint = CERTIFICATE_HINT if tls is not None and client.end is not None and client.end.bare else ""
                raise NotAcceptedError(f"{endpoint}: {error}{hint}", certain=False) from error
            link = client.link(endpoint, acknowledge_s, version)
            link.certificate = certificate_of(sock)
            yield link
            if will_at_disconnect and version == "5":
                client.keep_will()
            await client.send_disconnect()  # skipped when the body raises: then the broker must publish the will
        except aiomqtt.MqttError as error:
            raise LinkError(f"{endpoint}: {error}") from error
        finally:
            await client.close()


class _Client(aiomqtt.Client):
    """aiomqtt on a socket that is open already."""

    def __init__(
        self,
        sock: socket.socket | WebSocket,
        broker: Broker,
        *,
        client_id: str,
        will: MqttMessage | None,
        keepalive_s: int,
        version: Version,
        max_packet_bytes: int = MAX_PACKET_BYTES,
    ) -> None:
        self.end: End | None = None  # how the other side has ended the connection
        self._link: BrokerLink | None = None
        super().__init__(
            broker.host,
            broker.port,
            username=broker.username,
            password=broker.password,
            identifier=client_id,
            protocol=_VERSIONS[version],
            will=None if will is None else aiomqtt.Will(will.topic, will.payload, qos=will.qos, retain=will.retain),
            # Its own time limits lose a cancellation that arrives together with a reply (Python 3.11's wait_for).
            timeout=math.inf,
            keepalive=keepalive_s,
            max_queued_incoming_messages=MAX_INCOMING,
            max_inflight_messages=MAX_IN_FLIGHT,
            properties=_packet_limit(max_packet_bytes) if version == "5" else None,
            logger=_log,
        )
        self.receive_maximum = MAX_IN_FLIGHT
        self.maximum_packet_bytes: float = math.inf
        self.maximum_qos, self.retain_available = 2, True
        self.overflowed = False
        self._waited = 0  # rounds of the event loop
        self.unanswered: list[str] = []
        self.newest_refusal: tuple[str, str, float] | None = None
        self._answers: dict[int, tuple[str, asyncio.Future[ReasonCode]]] = {}  # topic, answer; by packet identifier
        self._client.on_publish = self.acknowledged
        self._client.on_socket_open = self.opened
        self._client.on_socket_register_write = self.to_be_written
        self._told: tuple[Any, Any] = self._client.on_connect, self._client.on_disconnect  # aiomqtt's own
        self._client.on_connect, self._client.on_disconnect = self.accepted, self.ended
        for future in (self._connected, self._disconnected):  # its result may not be needed any more
            future.add_done_callback(lambda ended: ended.cancelled() or ended.exception())
        given = _BoundedSocket(sock, max_packet_bytes)
        self._given = given
        self._client._create_socket_connection = lambda: given  # type: ignore[assignment, method-assign, return-value]  # it would open its own
        # Nothing in it blocks on an open socket, so it needs no thread; it only queues the CONNECT.
        super()._client_connect()

    def _client_connect(self) -> None:
        """Called by aiomqtt in a thread; done already."""

    def opened(self, client: Any, userdata: Any, sock: Any) -> None:
        """At once, as below: a socket whose first write fails is closed before a moment later."""
        self._loop.add_reader(sock.fileno(), self.read)
        self._misc_task = self._loop.create_task(self._misc_loop())

    def to_be_written(self, client: Any, userdata: Any, sock: Any) -> None:
        """At once. aiomqtt's own does it a moment later, when the socket may be closed and its number another's."""
        self._loop.add_writer(sock.fileno(), client.loop_write)

    def accepted(self, client: Any, userdata: Any, flags: Any, reason_code: Any, properties: Any = None) -> None:
        """MQTT 5 states how many messages the broker takes at once, how large, and of which QoS, and whether it retains
        any; it may close the connection on others (3.2.2.3, 3.3.4)."""
        self.receive_maximum = min(MAX_IN_FLIGHT, getattr(properties, "ReceiveMaximum", MAX_IN_FLIGHT))
        self.maximum_packet_bytes = getattr(properties, "MaximumPacketSize", math.inf)
        self.maximum_qos = getattr(properties, "MaximumQoS", self.maximum_qos)
        self.retain_available = bool(getattr(properties, "RetainAvailable", True))
        # paho's setter refuses on an open connection; nothing is in flight yet
        self._client._max_inflight_messages = self.receive_maximum
        self._told[0](client, userdata, flags, reason_code, properties)

    def acknowledged(self, client: Any, userdata: Any, mid: int, reason_code: Any, properties: Any) -> None:
        """MQTT 5 reports whether the broker has taken a message, and whether anybody subscribes; aiomqtt ignores it.

        A broker that takes a message and not the one before it has lost that one: nothing of this connection counts
        any more, so that both are sent again, in order.
        """
        if mid in self._answers:
            topic, answer = self._answers[mid]
            if next(open_mid for open_mid, (other, _) in self._answers.items() if other == topic) != mid:
                lost = aiomqtt.MqttError(f"a later message was acknowledged before an earlier one: {topic}")
                for _, waiting in self._answers.values():
                    if not waiting.done():
                        waiting.set_exception(lost)
                self._answers.clear()
                return
            del self._answers[mid]
            self.unanswered.remove(topic)
            if reason_code.is_failure:
                self.newest_refusal = topic, _named(reason_code), self._loop.time()
            if not answer.done():
                answer.set_result(reason_code)

    def ended(self, client: Any, userdata: Any, flags: Any, reason_code: Any, properties: Any = None) -> None:
        """Also before the CONNACK, which aiomqtt would wait for all the same."""
        if reason_code.is_failure and self.end is None:
            self.end = _end(reason_code, self._given.fault, by_packet=flags.is_disconnect_packet_from_server)
            if self._link is not None:
                self._link.end = self.end
        if not self._connected.done():
            why = "closed" if self.end is None else self.end.text
            self._connected.set_exception(aiomqtt.MqttError(f"{why}, before a CONNACK arrived"))
        self._told[1](client, userdata, flags, reason_code, properties)

    def link(self, endpoint: Endpoint, acknowledge_s: float, version: Version) -> BrokerLink:
        self._link = BrokerLink(self, endpoint, acknowledge_s, version)
        return self._link

    def read(self) -> None:
        """All that has arrived: of TLS and of WebSockets, some may be in memory and make no socket readable.

        Called again in each round of the event loop for as long as the socket is readable."""
        if len(self.messages) >= CROWDED and self._waited < ROUNDS:
            self._waited += 1
            return
        self._waited = 0
        while self._client.loop_read() == MQTT_ERR_SUCCESS:
            self.overflowed |= len(self.messages) >= MAX_INCOMING
            pending = getattr(self._client.socket(), "pending", None)
            if pending is None or pending() == 0:
                break

    async def send(self, message: MqttMessage, properties: Properties | None) -> ReasonCode | None:
        """Returns the broker's answer; None at QoS 0. Raises MqttError."""
        sent = self._client.publish(message.topic, message.payload, message.qos, message.retain, properties)
        if sent.rc != MQTT_ERR_SUCCESS:
            raise MqttCodeError(sent.rc, "Could not publish message")
        if sent.is_published():  # QoS 0
            return None
        answer: asyncio.Future[ReasonCode] = self._loop.create_future()
        self._answers[sent.mid] = message.topic, answer
        self.unanswered.append(message.topic)
        return await answer

    async def open(self) -> None:
        """Returns when the broker has accepted the connection. Raises MqttError."""
        try:
            async with asyncio.timeout(CONNECT_S):
                await self.__aenter__()
        except TimeoutError:
            raise aiomqtt.MqttError(f"connected, but no CONNACK within {CONNECT_S:g} s") from None

    def keep_will(self) -> None:
        """The DISCONNECT will have the reason `Disconnect with will message`; aiomqtt gives none."""
        reason = ReasonCode(PacketTypes.DISCONNECT, "Disconnect with will message")
        self._client.disconnect = partial(self._client.disconnect, reason)  # type: ignore[method-assign]

    async def send_disconnect(self) -> None:
        """The broker discards the last will."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CONNECT_S):
                await self.__aexit__(None, None, None)

    async def close(self) -> None:
        """Close the socket without DISCONNECT; nothing is left to do after a proper end."""
        if self._connected.cancelled():  # aiomqtt's callbacks fail on it
            self._connected = self._loop.create_future()
        try:
            await asyncio.sleep(0)  # the loop has begun to watch aiomqtt's socket by now
        finally:
            self._client._sock_close()
