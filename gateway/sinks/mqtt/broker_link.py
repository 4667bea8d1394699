"""One connection to the broker: the only file that knows the MQTT client library. IO.

A client object lives for one connection: a message that was not acknowledged stays queued inside it and would go out
unasked on a second one.

The library opens its socket in a thread that can't be stopped, leaves it open when the broker never answers, and says
goodbye properly even when it is torn down. Here it is handed a socket that is open already (`dial`), and how the
connection ends is a promise: left normally, it disconnects, and the broker forgets the last will; left by an
exception or a cancellation, the socket is cut, and the broker publishes the will.
"""

import asyncio
import contextlib
import logging
import math
import socket
import ssl
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NoReturn

import aiomqtt
from aiomqtt.exceptions import MqttConnectError
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from gateway.errors import LinkError
from gateway.sinks.mqtt.address import Broker
from gateway.sinks.mqtt.broker_socket import dial
from gateway.sinks.mqtt.protocol_versions import Protocol

CONNECT_S = 5.0  # for the socket, and again for the broker's greeting
MAX_INCOMING = 100  # messages that came and were not fetched yet
MAX_IN_FLIGHT = 8  # messages on their way at once; more wait their turn

REFUSED_SUBSCRIPTION = 128  # SUBACK codes from here on are failures
UNKNOWN_PROTOCOL = (1, 132)  # CONNACK of MQTT 3.1.1 and of MQTT 5

_VERSION = {Protocol.V5: aiomqtt.ProtocolVersion.V5, Protocol.V311: aiomqtt.ProtocolVersion.V311}

_log = logging.getLogger("mqtt")


class NotGreetedError(LinkError):
    """There is something, but it did not greet us. `certain`: because it does not speak this version of MQTT."""

    def __init__(self, text: str, *, certain: bool) -> None:
        super().__init__(text)
        self.certain = certain


@dataclass(frozen=True, slots=True)
class Message:
    """`expiry_s` (MQTT 5): the broker forgets it after so long, retained or not; None: never. `text`: JSON in UTF-8."""

    topic: str
    payload: bytes
    retain: bool
    expiry_s: int | None = None
    qos: int = 1
    text: bool = True


@dataclass(frozen=True, slots=True)
class Incoming:
    """Something that came on a topic we subscribed to."""

    topic: str
    payload: bytes


class BrokerLink:
    """A live connection. Real seconds, not the gateway's clock: the broker knows no simulated time."""

    def __init__(self, client: aiomqtt.Client, broker: Broker, ack_s: float, protocol: Protocol) -> None:
        self.protocol = protocol
        self._client = client
        self._broker = broker
        self._ack_s = ack_s
        self._turns = asyncio.Semaphore(MAX_IN_FLIGHT)

    async def publish(self, message: Message) -> None:
        """Returns when the broker has acknowledged it (QoS 1), or when it is on its way (QoS 0).

        Raises LinkError: the link is of no more use.
        """
        try:
            async with self._turns, asyncio.timeout(self._ack_s):
                properties = None if self.protocol is Protocol.V311 else _properties(message)
                await self._client.publish(
                    message.topic, message.payload, qos=message.qos, retain=message.retain, properties=properties
                )
        except TimeoutError:
            raise LinkError(f"{self._broker}: no acknowledgement within {self._ack_s:g} s") from None
        except aiomqtt.MqttError as error:
            raise LinkError(f"{self._broker}: cannot publish: {error}") from error

    async def subscribe(self, topics: Sequence[tuple[str, int]]) -> None:
        """Topics with their QoS; returns when the broker has granted them all. Raises LinkError."""
        try:
            async with asyncio.timeout(self._ack_s):
                granted = await self._client.subscribe([(topic, qos) for topic, qos in topics])
        except TimeoutError:
            raise LinkError(f"{self._broker}: no answer to a subscription within {self._ack_s:g} s") from None
        except aiomqtt.MqttError as error:
            raise LinkError(f"{self._broker}: cannot subscribe: {error}") from error
        if any(int(code if isinstance(code, int) else code.value) >= REFUSED_SUBSCRIPTION for code in granted):
            raise LinkError(f"{self._broker}: refuses a subscription to {', '.join(topic for topic, _ in topics)}")

    async def incoming(self) -> AsyncIterator[Incoming]:
        """What comes, until the connection is gone: then LinkError. What nobody fetches is dropped, newest first."""
        try:
            async for message in self._client.messages:
                payload = message.payload if isinstance(message.payload, bytes) else str(message.payload).encode()
                yield Incoming(str(message.topic), payload)
        except aiomqtt.MqttError as error:
            raise LinkError(f"{self._broker}: connection lost: {error.__cause__ or error}") from error
        raise LinkError(f"{self._broker}: connection lost")

    async def lost(self) -> NoReturn:
        """Waits until the connection is gone, then raises LinkError."""
        try:
            async for _ in self._client.messages:  # nothing is subscribed to, so nothing should come
                pass
        except aiomqtt.MqttError as error:
            raise LinkError(f"{self._broker}: connection lost: {error.__cause__ or error}") from error
        raise LinkError(f"{self._broker}: connection lost")


def _code(error: MqttConnectError) -> int | None:
    return error.rc.value if isinstance(error.rc, ReasonCode) else error.rc


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
    ack_s: float,
    tls: ssl.SSLContext | None,
    protocol: Protocol = Protocol.V311,
    will_at_goodbye: bool = False,
) -> AsyncIterator[BrokerLink]:
    """Raises LinkError when there is no broker, or it refuses us; NotGreetedError where the protocol may be why.

    `will_at_goodbye`: an MQTT 5 broker publishes the will even when the connection ends properly.
    """
    try:
        sock = await dial(broker.host, broker.port, tls, CONNECT_S)
    except LinkError as error:
        raise LinkError(f"{broker}: {error}") from error
    with contextlib.closing(sock):
        client = _Client(sock, broker, client_id=client_id, will=will, keepalive_s=keepalive_s, protocol=protocol)
        try:
            try:
                await client.greet()
            except MqttConnectError as error:
                if _code(error) not in UNKNOWN_PROTOCOL:
                    raise
                raise NotGreetedError(f"{broker}: {error}", certain=True) from error
            except aiomqtt.MqttError as error:
                raise NotGreetedError(f"{broker}: {error}", certain=False) from error
            yield BrokerLink(client, broker, ack_s, protocol)
            if will_at_goodbye and protocol is Protocol.V5:
                client.keep_will()
            await client.say_goodbye()  # skipped when the body raises: then the broker must publish the will
        except aiomqtt.MqttError as error:
            raise LinkError(f"{broker}: {error}") from error
        finally:
            await client.cut()


class _Client(aiomqtt.Client):
    """aiomqtt on a socket that is open already."""

    def __init__(
        self,
        sock: socket.socket,
        broker: Broker,
        *,
        client_id: str,
        will: Message,
        keepalive_s: int,
        protocol: Protocol,
    ) -> None:
        super().__init__(
            broker.host,
            broker.port,
            username=broker.username,
            password=broker.password,
            identifier=client_id,
            protocol=_VERSION[protocol],
            will=aiomqtt.Will(will.topic, will.payload, qos=will.qos, retain=will.retain),
            # Its own time limits lose a cancellation that comes together with an answer (Python 3.11's wait_for).
            timeout=math.inf,
            keepalive=keepalive_s,
            max_queued_incoming_messages=MAX_INCOMING,
            logger=_log,
        )
        for future in (self._connected, self._disconnected):  # nobody may be left who asks how it ended
            future.add_done_callback(lambda ended: ended.cancelled() or ended.exception())
        self._client._create_socket_connection = lambda: sock  # type: ignore[method-assign]  # it would open its own
        # Nothing in it blocks on an open socket, so it needs no thread; it only queues the greeting.
        super()._client_connect()

    def _client_connect(self) -> None:
        """Called by aiomqtt in a thread; done already."""

    def _on_socket_register_write(self, client: Any, userdata: Any, sock: Any) -> None:
        """At once. The library's own does it a moment later, when the socket may be closed and its number another's."""
        self._loop.add_writer(sock.fileno(), client.loop_write)

    def _on_connect(self, client: Any, userdata: Any, flags: Any, reason_code: Any, properties: Any = None) -> None:
        """MQTT 5 tells how many messages the broker bears at once, and it may hang up on more (section 3.3.4)."""
        bears = getattr(properties, "ReceiveMaximum", None)
        if bears is not None:  # the library's own setter refuses on an open connection; nothing is on its way yet
            self._client._max_inflight_messages = min(self._client._max_inflight_messages, bears)
        super()._on_connect(client, userdata, flags, reason_code, properties)

    def _on_publish(self, client: Any, userdata: Any, mid: int, reason_code: Any, properties: Any) -> None:
        """MQTT 5 tells when the broker has not taken a message; the library does not look."""
        if not reason_code.is_failure:
            super()._on_publish(client, userdata, mid, reason_code, properties)
        elif not self._disconnected.done():
            self._disconnected.set_exception(aiomqtt.MqttError(f"a message was refused: {reason_code}"))

    def _on_disconnect(self, client: Any, userdata: Any, flags: Any, reason_code: Any, properties: Any = None) -> None:
        """Also before the greeting, which the library would wait for all the same."""
        if not self._connected.done():
            self._connected.set_exception(aiomqtt.MqttError("the connection was closed before a greeting came"))
        super()._on_disconnect(client, userdata, flags, reason_code, properties)

    async def greet(self) -> None:
        """Returns when the broker has accepted us. Raises MqttError."""
        try:
            async with asyncio.timeout(CONNECT_S):
                await self.__aenter__()
        except TimeoutError:
            raise aiomqtt.MqttError(f"connected, but no greeting within {CONNECT_S:g} s") from None

    def keep_will(self) -> None:
        """The goodbye to come will carry the reason `Disconnect with will message`; the library gives none."""
        reason = ReasonCode(PacketTypes.DISCONNECT, "Disconnect with will message")
        self._client.disconnect = partial(self._client.disconnect, reason)  # type: ignore[method-assign]

    async def say_goodbye(self) -> None:
        """Disconnect: the broker forgets the last will."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CONNECT_S):
                await self.__aexit__(None, None, None)

    async def cut(self) -> None:
        """Close the socket without a goodbye; nothing is left to do after a proper end."""
        if self._connected.cancelled():  # the library's callbacks stumble over it
            self._connected = self._loop.create_future()
        try:
            await asyncio.sleep(0)  # what the library has asked the loop to watch is being watched by now
        finally:
            self._client._sock_close()
