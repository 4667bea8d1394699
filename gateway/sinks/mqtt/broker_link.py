"""One connection to the broker: the only module that imports the MQTT client library, paho. IO.

A client object lives for one connection: a message that was not acknowledged stays queued inside it and would be sent
again on a second one.

paho opens its socket with a blocking call, so it is handed one that is open already (`broker_socket`); the event loop
calls it when the socket can be read or written. How the connection ends is a promise: left normally, it sends
DISCONNECT, and the broker discards the last will; left by an exception or a cancellation, the socket is closed, and
the broker publishes the will.
"""

import asyncio
import contextlib
import logging
import socket
import ssl
import struct
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, NoReturn, TypeVar

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.exception import MQTTException
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from gateway.errors import LinkError
from gateway.sinks.mqtt.broker import Broker
from gateway.sinks.mqtt.broker_socket import open_socket

CONNECT_S = 5.0  # for the socket, and again for the CONNACK
KEEPALIVE_CHECK_S = 1.0  # how often paho looks whether a PINGREQ is due
MAX_INCOMING = 100  # messages received and not fetched yet
MAX_IN_FLIGHT = 8  # messages without acknowledgement at once; more wait their turn

UNSUPPORTED_PROTOCOL_VERSION = 132  # reason code of a CONNACK; paho converts that of MQTT 3.1.1
NOT_MQTT = (OSError, ValueError, LookupError, TypeError, struct.error, MQTTException)  # paho on damaged bytes

_log = logging.getLogger("mqtt")
T = TypeVar("T")


class ProtocolVersion(Enum):
    """The versions of MQTT that the gateway supports."""

    V5 = "5"
    V311 = "3.1.1"


class NotAcceptedError(LinkError):
    """A peer is there, but did not accept the connection. `certain`: because it does not speak this version of MQTT."""

    def __init__(self, text: str, *, certain: bool) -> None:
        super().__init__(text)
        self.certain = certain


@dataclass(frozen=True, slots=True)
class Message:
    """`expiry_s` (MQTT 5): the broker drops it after so long, retained or not; None: never. `text`: JSON in UTF-8."""

    topic: str
    payload: bytes
    retain: bool
    expiry_s: int | None = None
    qos: int = 1
    text: bool = True


@dataclass(frozen=True, slots=True)
class Incoming:
    """A message received on a subscribed topic."""

    topic: str
    payload: bytes


class BrokerLink:
    """A live connection. Real seconds, not the gateway's clock: the broker knows no simulated time."""

    def __init__(
        self,
        sock: socket.socket,
        broker: Broker,
        *,
        client_id: str,
        will: Message,
        keepalive_s: int,
        acknowledge_s: float,
        version: ProtocolVersion,
    ) -> None:
        self.version = version
        self._broker = broker
        self._keepalive_s = keepalive_s
        self._acknowledge_s = acknowledge_s
        self._loop = asyncio.get_running_loop()
        self._sock = sock
        self._accepted: asyncio.Future[None] = self._loop.create_future()
        self._ended: asyncio.Future[None] = self._loop.create_future()  # without an error after DISCONNECT
        for future in (self._accepted, self._ended):  # perhaps nobody is left who asks how it ended
            future.add_done_callback(lambda done: done.cancelled() or done.exception())
        self._acknowledged: dict[int, asyncio.Future[None]] = {}
        self._granted: dict[int, asyncio.Future[list[ReasonCode]]] = {}
        self._incoming: asyncio.Queue[Incoming | None] = asyncio.Queue()  # None: the connection is gone
        self._in_flight = asyncio.Semaphore(MAX_IN_FLIGHT)
        self._keepalive_check: asyncio.TimerHandle | None = None
        self._client = client = _Client(sock, client_id, version)
        client.enable_logger(_log)
        client.will_set(will.topic, will.payload, will.qos, will.retain)
        if broker.username is not None:
            client.username_pw_set(broker.username, broker.password)
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_publish = self._on_publish
        client.on_subscribe = self._on_subscribe
        client.on_message = self._on_message
        client.on_socket_open = self._on_socket_open
        client.on_socket_close = self._on_socket_close
        client.on_socket_register_write = self._on_socket_register_write
        client.on_socket_unregister_write = self._on_socket_unregister_write

    async def publish(self, message: Message) -> None:
        """Returns when the broker has acknowledged it (QoS 1), or when it is sent (QoS 0).

        Raises LinkError: the link is of no more use.
        """
        try:
            async with self._in_flight, asyncio.timeout(self._acknowledge_s):
                properties = None if self.version is ProtocolVersion.V311 else _properties(message)
                sent = self._client.publish(message.topic, message.payload, message.qos, message.retain, properties)
                if sent.rc != paho.MQTT_ERR_SUCCESS:
                    raise self._lost(f"cannot publish: {paho.error_string(sent.rc)}")
                if not sent.is_published():
                    await self._answer(self._acknowledged, sent.mid)
        except TimeoutError:
            raise LinkError(f"{self._broker}: no acknowledgement within {self._acknowledge_s:g} s") from None

    async def subscribe(self, topics: Sequence[tuple[str, int]]) -> None:
        """Topics with their QoS; returns when the broker has granted them all. Raises LinkError."""
        try:
            async with asyncio.timeout(self._acknowledge_s):
                rc, number = self._client.subscribe(list(topics))
                if rc != paho.MQTT_ERR_SUCCESS or number is None:
                    raise self._lost(f"cannot subscribe: {paho.error_string(rc)}")
                granted = await self._answer(self._granted, number)
        except TimeoutError:
            raise LinkError(f"{self._broker}: no answer to a subscription within {self._acknowledge_s:g} s") from None
        if any(code.is_failure for code in granted):
            raise LinkError(f"{self._broker}: refuses a subscription to {', '.join(topic for topic, _ in topics)}")

    async def incoming(self) -> AsyncIterator[Incoming]:
        """Messages received, until the connection is gone: then LinkError. What is not fetched in time is dropped."""
        while (message := await self._incoming.get()) is not None:
            yield message
        raise self._lost("")

    async def lost(self) -> NoReturn:
        """Waits until the connection is gone, then raises LinkError."""
        await asyncio.wait([self._ended])
        raise self._lost("")

    async def open(self) -> None:
        """Returns when the broker has accepted the connection. Raises NotAcceptedError."""
        try:
            async with asyncio.timeout(CONNECT_S):
                self._client.connect(self._broker.host, self._broker.port, self._keepalive_s)  # only queues the CONNECT
                await self._accepted
        except TimeoutError:
            text = f"{self._broker}: connected, but no CONNACK within {CONNECT_S:g} s"
            raise NotAcceptedError(text, certain=False) from None

    async def disconnect(self, *, with_will: bool) -> None:
        """DISCONNECT: the broker discards the last will, unless it is asked to publish it (MQTT 5)."""
        reason = ReasonCode(PacketTypes.DISCONNECT, "Disconnect with will message") if with_will else None
        self._client.disconnect(reason)
        await asyncio.wait([self._ended], timeout=CONNECT_S)

    def close(self) -> None:
        """Close the socket without DISCONNECT; nothing is left to do after a proper end."""
        self._client.on_socket_close = None
        self._on_socket_close(None, None, self._sock)
        self._sock.close()

    async def _answer(self, waiting: dict[int, asyncio.Future[T]], number: int) -> T:
        waiting[number] = answer = self._loop.create_future()
        try:
            await asyncio.wait((answer, self._ended), return_when=asyncio.FIRST_COMPLETED)
            if not answer.done():
                raise self._lost("")
            result: T = answer.result()
            return result
        finally:
            waiting.pop(number, None)

    def _lost(self, fault: str) -> LinkError:
        error = self._ended.exception() if self._ended.done() else None
        return LinkError(
            f"{self._broker}: connection lost: {error}" if error else f"{self._broker}: {fault or 'closed'}"
        )

    def _end(self, fault: str) -> None:
        """The connection is gone; empty: as intended."""
        if not self._accepted.done():
            text = f"{self._broker}: {fault or 'closed'} before a CONNACK arrived"
            self._accepted.set_exception(NotAcceptedError(text, certain=False))
        if not self._ended.done():
            if fault:
                self._ended.set_exception(LinkError(fault))
            else:
                self._ended.set_result(None)
            self._incoming.put_nowait(None)

    # Called by paho.

    def _on_connect(self, client: Any, data: Any, flags: Any, reason: ReasonCode, properties: Any) -> None:
        if self._accepted.done():
            return
        if reason.is_failure:
            certain = reason.value == UNSUPPORTED_PROTOCOL_VERSION
            error = NotAcceptedError(f"{self._broker}: refused: {reason}", certain=certain)
            self._accepted.set_exception(error)
            return
        # MQTT 5 states how many messages the broker takes at once, and it may close the connection on more
        # (section 3.3.4).
        receive_maximum = getattr(properties, "ReceiveMaximum", MAX_IN_FLIGHT)
        self._in_flight = asyncio.Semaphore(min(MAX_IN_FLIGHT, receive_maximum))
        self._accepted.set_result(None)

    def _on_disconnect(self, client: Any, data: Any, flags: Any, reason: ReasonCode, properties: Any) -> None:
        self._end(str(reason) if reason.is_failure else "")

    def _on_publish(self, client: Any, data: Any, number: int, reason: ReasonCode, properties: Any) -> None:
        if reason.is_failure:  # MQTT 5: the broker has not taken the message
            self._end(f"a message was refused: {reason}")
        elif (answer := self._acknowledged.get(number)) is not None and not answer.done():
            answer.set_result(None)

    def _on_subscribe(self, client: Any, data: Any, number: int, reasons: list[ReasonCode], properties: Any) -> None:
        if (answer := self._granted.get(number)) is not None and not answer.done():
            answer.set_result(reasons)

    def _on_message(self, client: Any, data: Any, message: paho.MQTTMessage) -> None:
        if self._incoming.qsize() < MAX_INCOMING:
            self._incoming.put_nowait(Incoming(message.topic, bytes(message.payload)))

    def _on_socket_open(self, client: Any, data: Any, sock: Any) -> None:
        self._loop.add_reader(sock.fileno(), self._call, self._read)
        self._check_keepalive()

    def _on_socket_close(self, client: Any, data: Any, sock: Any) -> None:
        if sock.fileno() >= 0:
            self._loop.remove_reader(sock.fileno())
            self._loop.remove_writer(sock.fileno())
        if self._keepalive_check is not None:
            self._keepalive_check.cancel()

    def _on_socket_register_write(self, client: Any, data: Any, sock: Any) -> None:
        self._loop.add_writer(sock.fileno(), self._call, self._client.loop_write)

    def _on_socket_unregister_write(self, client: Any, data: Any, sock: Any) -> None:
        if sock.fileno() >= 0:
            self._loop.remove_writer(sock.fileno())

    # Called by the event loop.

    def _read(self) -> None:
        while self._client.loop_read() == paho.MQTT_ERR_SUCCESS:
            if not isinstance(self._sock, ssl.SSLSocket) or self._sock.fileno() < 0 or not self._sock.pending():
                return  # what TLS has decrypted already does not wake the loop

    def _check_keepalive(self) -> None:
        self._keepalive_check = self._loop.call_later(KEEPALIVE_CHECK_S, self._check_keepalive)
        self._call(self._client.loop_misc)

    def _call(self, part: Callable[[], object]) -> None:
        try:
            part()
        except NOT_MQTT as error:
            self._end(f"not MQTT: {error!r}")


class _Client(paho.Client):
    """paho on a socket that is open already. The one private part of it that is overridden; a test watches it."""

    def __init__(self, sock: socket.socket, client_id: str, version: ProtocolVersion) -> None:
        protocol = MQTTProtocolVersion.MQTTv5 if version is ProtocolVersion.V5 else MQTTProtocolVersion.MQTTv311
        super().__init__(CallbackAPIVersion.VERSION2, client_id, protocol=protocol, reconnect_on_failure=False)
        self._open_socket = sock

    def _create_socket_connection(self) -> socket.socket:
        return self._open_socket


def _properties(message: Message) -> Properties:
    properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
    if message.text:
        properties.PayloadFormatIndicator = 1  # UTF-8
        properties.ContentType = "application/json"
    if message.expiry_s is not None:
        properties.MessageExpiryInterval = max(1, message.expiry_s)
    return properties


@contextlib.asynccontextmanager
async def connect(
    broker: Broker,
    *,
    client_id: str,
    will: Message,
    keepalive_s: int,
    acknowledge_s: float,
    tls: ssl.SSLContext | None,
    version: ProtocolVersion = ProtocolVersion.V311,
    will_at_disconnect: bool = False,
) -> AsyncIterator[BrokerLink]:
    """Raises LinkError when there is no broker, NotAcceptedError where it does not accept the connection.

    `will_at_disconnect`: an MQTT 5 broker publishes the will even when the connection ends properly.
    """
    try:
        sock = await open_socket(broker.host, broker.port, tls, CONNECT_S)
    except LinkError as error:
        raise LinkError(f"{broker}: {error}") from error
    with contextlib.closing(sock):
        link = BrokerLink(
            sock,
            broker,
            client_id=client_id,
            will=will,
            keepalive_s=keepalive_s,
            acknowledge_s=acknowledge_s,
            version=version,
        )
        try:
            await link.open()
            yield link
            # Skipped when the body raises: then the broker must publish the will.
            await link.disconnect(with_will=will_at_disconnect and version is ProtocolVersion.V5)
        finally:
            link.close()
