"""One connection to the broker: the only module that imports the MQTT client library, paho. IO.

A client object lives for one connection: a message that was not acknowledged stays queued inside it and would be sent
again on a second one.

paho would open its socket while everything waits. So it is handed a socket that is open already (`broker_socket`), and
the event loop calls it when that socket is ready. How the connection ends is a promise: left normally, it sends
DISCONNECT, and the broker discards the last will; left by an exception or a cancellation, the socket is closed, and the
broker publishes the will.

That paho takes an open socket is a private part of it. It is pinned exactly, and tests/unit/sinks/test_broker_link.py
watches that part (docs/decisions/0040-private-parts.md).
"""

import asyncio
import contextlib
import logging
import math
import socket
import ssl
from collections import deque
from collections.abc import AsyncIterator, Sequence
from typing import Any, TypeVar

from paho.mqtt import client as paho
from paho.mqtt.client import MQTT_ERR_SUCCESS
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from gateway.errors import LinkError
from gateway.sinks.mqtt.broker import Broker
from gateway.sinks.mqtt.broker_socket import fault_of, open_socket
from gateway.sinks.mqtt.endpoints import Endpoint, Version
from gateway.sinks.mqtt.takeovers import End
from gateway.sinks.mqtt.topics import MqttMessage
from gateway.sinks.mqtt.web_socket import WebSocket

T = TypeVar("T")

CONNECT_S = 5.0  # for the socket, and again for the CONNACK
MAX_INCOMING = 100  # messages received and not fetched yet
MAX_PACKET_BYTES = 65_536  # one of more ends the connection: MQTT allows 256 MB, which would be memory
MAX_IN_FLIGHT = 64  # messages without acknowledgement at once; more wait their turn
MAX_IN_FLIGHT_311 = 20  # MQTT 3.1.1 brokers state no Receive Maximum
NO_SUBSCRIBERS, PACKET_TOO_LARGE = 0x10, 0x95  # reason codes of MQTT 5

CERTIFICATE_HINT = (
    "; a broker that requires a client certificate, or refuses ours, does so: mqtt.tls.cert_file and mqtt.tls.key_file"
)
REFUSED_SUBSCRIPTION = 128  # SUBACK codes from here on are failures
UNSUPPORTED_PROTOCOL_VERSION = 0x84  # CONNACK; paho has MQTT 5's code for that of 3.1.1, too

SESSION_TAKEN_OVER = 0x8E
KEEP_ALIVE_TIMEOUT = 0x8D

_log = logging.getLogger("mqtt")
_log.addFilter(lambda record: "on socket" not in str(record.msg))  # with each attempt; `End.text` has the reason

_VERSIONS: dict[Version, MQTTProtocolVersion] = {"5": MQTTProtocolVersion.MQTTv5, "3.1.1": MQTTProtocolVersion.MQTTv311}


class NotAcceptedError(LinkError):
    """A peer is there, but did not accept the connection. `certain`: because it does not support this version of
    MQTT."""

    def __init__(self, text: str, *, certain: bool) -> None:
        super().__init__(text)
        self.certain = certain


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
    `newest_refusal`: topic, reason and time of the event loop. `end`: how the other side has ended it. The last three
    are right after the connection has ended, too.
    """

    end: End | None = None

    def __init__(self, client: paho.Client, sock: "_BoundedSocket", endpoint: Endpoint, version: Version) -> None:
        self.version = version
        self.in_flight = MAX_IN_FLIGHT if version == "5" else MAX_IN_FLIGHT_311
        self.unanswered: list[str] = []
        self.newest_refusal: tuple[str, str, float] | None = None
        self._broker = endpoint
        self._sock = sock
        self._acknowledge_s = CONNECT_S
        self._max_packet_bytes: float = math.inf
        self._loop = asyncio.get_running_loop()
        self._opened: asyncio.Future[ReasonCode] = self._loop.create_future()
        self._answers: dict[int, tuple[str, asyncio.Future[ReasonCode]]] = {}  # topic, answer; by packet identifier
        self._granted: dict[int, asyncio.Future[Sequence[ReasonCode]]] = {}
        self._received: deque[MqttMessage] = deque()
        self._news = asyncio.Event()  # something was received, or the connection has ended
        self._over = False
        self._limit = self.in_flight  # now
        self._turns = asyncio.Semaphore(self._limit)
        self._kept_alive: asyncio.Task[None] | None = None
        self._client = client
        client.on_connect, client.on_disconnect = self._on_connect, self._on_disconnect
        client.on_publish, client.on_subscribe = self._on_publish, self._on_subscribe
        client.on_message = self._on_message
        client.on_socket_open, client.on_socket_close = self._on_socket_open, self._on_socket_close
        client.on_socket_register_write = self._on_to_be_written
        client.on_socket_unregister_write = self._on_written
        client._create_socket_connection = lambda: sock  # type: ignore[assignment, method-assign, return-value]  # it would open its own

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

        Raises PublishRefusedError: the broker did not take it; LinkError: the link is of no more use.
        """
        properties = None if self.version == "3.1.1" else _properties(message)
        size, accepted = _packet_bytes(message, properties), self._max_packet_bytes
        if size > accepted:
            fault = f"{size} bytes; the broker accepts {accepted} (0x{PACKET_TOO_LARGE:02x})"
            raise PublishRefusedError(self._broker, message.topic, fault)
        await self._turns.acquire()
        sent = self._client.publish(message.topic, message.payload, message.qos, message.retain, properties)
        if sent.rc != MQTT_ERR_SUCCESS:
            raise LinkError(f"{self._broker}: cannot publish: {self._why(sent.rc)}")
        if sent.is_published():  # QoS 0
            self._turns.release()
            return True
        answer: asyncio.Future[ReasonCode] = self._loop.create_future()
        self._answers[sent.mid] = message.topic, answer
        self.unanswered.append(message.topic)
        reason = await self._answer(answer, "acknowledgement")
        if reason.is_failure:
            raise PublishRefusedError(self._broker, message.topic, _named(reason))
        return bool(reason.value != NO_SUBSCRIBERS)

    async def quiet(self) -> None:
        """Returns when no message waits for its acknowledgement; from then on none is sent."""
        for _ in range(self._limit):
            await self._turns.acquire()

    async def subscribe(self, topics: Sequence[tuple[str, int]]) -> None:
        """Topics with their QoS; returns when the broker has granted them all. Raises LinkError."""
        result, mid = self._client.subscribe([*topics])
        if result != MQTT_ERR_SUCCESS or mid is None:
            raise LinkError(f"{self._broker}: cannot subscribe: {self._why(result)}")
        self._granted[mid] = self._loop.create_future()
        granted = await self._answer(self._granted[mid], "answer to a subscription")
        if any(code.value >= REFUSED_SUBSCRIPTION for code in granted):
            raise LinkError(f"{self._broker}: refuses a subscription to {', '.join(topic for topic, _ in topics)}")

    async def incoming(self) -> AsyncIterator[MqttMessage]:
        """Messages received, until the connection is lost: then LinkError. What is not fetched in time is dropped."""
        while True:
            while self._received:
                yield self._received.popleft()
            if self._over:
                raise LinkError(f"{self._broker}: connection lost{'' if self.end is None else f': {self.end.text}'}")
            self._news.clear()
            await self._news.wait()

    async def open(self, keepalive_s: int, acknowledge_s: float, hint: str) -> None:
        """Returns when the broker has accepted the connection. `hint`: where it ends it without a word. Raises
        NotAcceptedError."""
        self._acknowledge_s = acknowledge_s
        # Nothing in it blocks on an open socket; it only queues the CONNECT.
        broker = self._broker.broker
        self._client.connect(
            broker.host, broker.port, keepalive_s, properties=_packet_limit() if self.version == "5" else None
        )
        try:
            async with asyncio.timeout(CONNECT_S):
                reason = await self._opened
        except TimeoutError:
            fault = f"connected, but no CONNACK within {CONNECT_S:g} s"
            raise NotAcceptedError(f"{self._broker}: {fault}", certain=False) from None
        except LinkError as error:
            bare = hint if self.end is not None and self.end.bare else ""
            raise NotAcceptedError(f"{self._broker}: {error}{bare}", certain=False) from error
        if reason.is_failure:
            fault, certain = f"[code:{reason.value}] {reason}", reason.value == UNSUPPORTED_PROTOCOL_VERSION
            raise NotAcceptedError(f"{self._broker}: {fault}", certain=certain)

    async def disconnect(self, *, publish_will: bool) -> None:
        """The broker discards the last will, or publishes it all the same (MQTT 5)."""
        reason = ReasonCode(PacketTypes.DISCONNECT, "Disconnect with will message") if publish_will else None
        if not self._over and self._client.disconnect(reason) == MQTT_ERR_SUCCESS:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(CONNECT_S):
                    while not self._over:
                        self._news.clear()
                        await self._news.wait()

    def close(self) -> None:
        """Watch the socket no longer; it is closed by who opened it, without DISCONNECT where none was sent."""
        if (sock := self._client.socket()) is not None:
            self._on_written(self._client, None, sock)
            self._on_socket_close(self._client, None, sock)
        self._client.on_socket_close = self._client.on_socket_unregister_write = None

    async def _answer(self, answer: "asyncio.Future[T]", what: str) -> T:
        """Raises UnansweredError."""
        try:
            async with asyncio.timeout(self._acknowledge_s):
                return await answer
        except TimeoutError:
            raise UnansweredError(f"{self._broker}: no {what} within {self._acknowledge_s:g} s") from None

    def _why(self, code: int) -> str:
        return paho.error_string(MQTTErrorCode(code)) if self.end is None else self.end.text

    async def _keep_alive(self) -> None:
        while True:
            if self._client.loop_misc() != MQTT_ERR_SUCCESS:
                return
            await asyncio.sleep(1)

    # paho's callbacks, called on the event loop.

    def _on_socket_open(self, client: paho.Client, _: object, sock: Any) -> None:
        self._loop.add_reader(sock.fileno(), self._read)
        self._kept_alive = self._loop.create_task(self._keep_alive())

    def _on_socket_close(self, client: paho.Client, _: object, sock: Any) -> None:
        self._loop.remove_reader(sock.fileno())
        if self._kept_alive is not None:
            self._kept_alive.cancel()

    def _on_to_be_written(self, client: paho.Client, _: object, sock: Any) -> None:
        self._loop.add_writer(sock.fileno(), client.loop_write)

    def _on_written(self, client: paho.Client, _: object, sock: Any) -> None:
        self._loop.remove_writer(sock.fileno())

    def _read(self) -> None:
        """All that has arrived: of TLS and of WebSockets, some may be in memory and make no socket readable."""
        while self._client.loop_read() == MQTT_ERR_SUCCESS:
            pending = getattr(self._client.socket(), "pending", None)
            if pending is None or pending() == 0:
                break

    def _on_connect(self, client: object, _: object, flags: object, reason: ReasonCode, properties: Any) -> None:
        """MQTT 5 states how many messages the broker takes at once, and how large; it may close the connection on more
        (3.3.4) and on larger ones (3.2.2.3.6)."""
        if self._opened.done():
            return
        self.in_flight = min(self.in_flight, getattr(properties, "ReceiveMaximum", MAX_IN_FLIGHT))
        self._limit, self._turns = self.in_flight, asyncio.Semaphore(self.in_flight)
        self._max_packet_bytes = getattr(properties, "MaximumPacketSize", math.inf)
        self._opened.set_result(reason)

    def _on_disconnect(self, client: object, _: object, flags: Any, reason: ReasonCode, properties: object) -> None:
        """Also before the CONNACK."""
        if reason.is_failure and self.end is None:
            self.end = _end(reason, self._sock.fault, by_packet=flags.is_disconnect_packet_from_server)
        if not self._opened.done():
            why = "closed" if self.end is None else self.end.text
            self._opened.set_exception(LinkError(f"{why}, before a CONNACK arrived"))
        self._over = True
        self._news.set()

    def _on_publish(self, client: object, _: object, mid: int, reason: ReasonCode, properties: object) -> None:
        """MQTT 5 reports whether the broker has taken a message, and whether anybody subscribes. Until then it counts
        as one in flight, whether or not somebody still waits for it."""
        if mid not in self._answers:
            return
        topic, answer = self._answers.pop(mid)
        self.unanswered.remove(topic)
        self._turns.release()
        if reason.is_failure:
            self.newest_refusal = topic, _named(reason), self._loop.time()
        if not answer.done():
            answer.set_result(reason)

    def _on_subscribe(
        self, client: object, _: object, mid: int, granted: Sequence[ReasonCode], properties: object
    ) -> None:
        answer = self._granted.pop(mid, None)
        if answer is not None and not answer.done():
            answer.set_result(granted)

    def _on_message(self, client: object, _: object, message: paho.MQTTMessage) -> None:
        if len(self._received) < MAX_INCOMING:
            self._received.append(MqttMessage(message.topic, bytes(message.payload)))
        self._news.set()


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


def _packet_limit() -> Properties:
    """An MQTT 5 broker drops what is larger, and keeps the connection."""
    properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
    properties.MaximumPacketSize = MAX_PACKET_BYTES
    return properties


def _end(reason: ReasonCode, fault: OSError | None, *, by_packet: bool) -> End:
    """paho's own text for a connection that was closed without a reason is `Unspecified error`, code 128."""
    if by_packet:
        taken_over = reason.value == SESSION_TAKEN_OVER
        return End(f"ended by the broker: {reason}{' by another client' if taken_over else ''}", taken_over=taken_over)
    if fault is not None and not isinstance(fault, ssl.SSLEOFError | ConnectionResetError):
        return End(fault_of(fault))
    if reason.value == KEEP_ALIVE_TIMEOUT:
        return End("no answer to a PINGREQ")
    return End("closed by the broker, or on the way to it, without a reason", bare=True)


class _BoundedSocket:
    """The socket for paho, which reads the rest of a packet at once and keeps room for all of it. An OSError ends the
    connection; `fault`: that of the last read.
    """

    def __init__(self, sock: socket.socket | WebSocket) -> None:
        self._sock = sock
        self.fault: OSError | None = None

    def recv(self, size: int) -> bytes:
        try:
            if size > MAX_PACKET_BYTES:
                raise OSError(f"a packet of more than {size} bytes; {MAX_PACKET_BYTES} are accepted")
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
) -> AsyncIterator[BrokerLink]:
    """Raises LinkError when there is no broker, NotAcceptedError where it does not accept the connection.

    `will_at_disconnect`: an MQTT 5 broker publishes the will even when the connection ends properly.
    """
    try:
        sock = await open_socket(endpoint, tls, CONNECT_S)
    except LinkError as error:
        raise LinkError(f"{endpoint}: {error}") from error
    with contextlib.closing(sock):
        link = BrokerLink(_client(endpoint.broker, client_id, will, version), _BoundedSocket(sock), endpoint, version)
        try:
            await link.open(keepalive_s, acknowledge_s, "" if tls is None else CERTIFICATE_HINT)
            yield link
            await link.disconnect(publish_will=will_at_disconnect and version == "5")
        finally:
            link.close()


def _client(broker: Broker, client_id: str, will: MqttMessage | None, version: Version) -> paho.Client:
    client = paho.Client(
        CallbackAPIVersion.VERSION2, client_id, protocol=_VERSIONS[version], reconnect_on_failure=False
    )
    client.enable_logger(_log)
    client.max_inflight_messages_set(MAX_IN_FLIGHT)
    if broker.username is not None:
        client.username_pw_set(broker.username, broker.password)
    if will is not None:
        client.will_set(will.topic, will.payload, will.qos, will.retain)
    return client
