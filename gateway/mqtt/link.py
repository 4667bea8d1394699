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
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Any, NoReturn

import aiomqtt

from gateway.errors import LinkError
from gateway.mqtt.address import Broker
from gateway.mqtt.dial import dial

CONNECT_S = 5.0  # for the socket, and again for the broker's greeting
MAX_IN_FLIGHT = 8  # messages on their way at once; more wait their turn

_log = logging.getLogger("mqtt")


@dataclass(frozen=True, slots=True)
class Message:
    topic: str
    payload: bytes
    retain: bool


class BrokerLink:
    """A live connection. Real seconds, not the gateway's clock: the broker knows no simulated time."""

    def __init__(self, client: aiomqtt.Client, broker: Broker, ack_s: float) -> None:
        self._client = client
        self._broker = broker
        self._ack_s = ack_s
        self._turns = asyncio.Semaphore(MAX_IN_FLIGHT)

    async def publish(self, message: Message) -> None:
        """Returns when the broker has acknowledged it (QoS 1). Raises LinkError: the link is of no more use."""
        try:
            async with self._turns, asyncio.timeout(self._ack_s):
                await self._client.publish(message.topic, message.payload, qos=1, retain=message.retain)
        except TimeoutError:
            raise LinkError(f"{self._broker}: no acknowledgement within {self._ack_s:g} s") from None
        except aiomqtt.MqttError as error:
            raise LinkError(f"{self._broker}: cannot publish: {error}") from error

    async def lost(self) -> NoReturn:
        """Waits until the connection is gone, then raises LinkError."""
        try:
            async for _ in self._client.messages:  # nothing is subscribed to, so nothing should come
                pass
        except aiomqtt.MqttError as error:
            raise LinkError(f"{self._broker}: connection lost: {error.__cause__ or error}") from error
        raise LinkError(f"{self._broker}: connection lost")


@contextlib.asynccontextmanager
async def connect(
    broker: Broker, *, client_id: str, will: Message, keepalive_s: int, ack_s: float, tls: ssl.SSLContext | None
) -> AsyncIterator[BrokerLink]:
    """Raises LinkError when there is no broker, or it refuses us."""
    try:
        sock = await dial(broker.host, broker.port, tls, CONNECT_S)
    except LinkError as error:
        raise LinkError(f"{broker}: {error}") from error
    with contextlib.closing(sock):
        client = _Client(sock, broker, client_id=client_id, will=will, keepalive_s=keepalive_s)
        try:
            await client.greet()
            yield BrokerLink(client, broker, ack_s)
            await client.say_goodbye()  # skipped when the body raises: then the broker must publish the will
        except aiomqtt.MqttError as error:
            raise LinkError(f"{broker}: {error}") from error
        finally:
            await client.cut()


class _Client(aiomqtt.Client):
    """aiomqtt on a socket that is open already."""

    def __init__(self, sock: socket.socket, broker: Broker, *, client_id: str, will: Message, keepalive_s: int) -> None:
        super().__init__(
            broker.host,
            broker.port,
            username=broker.username,
            password=broker.password,
            identifier=client_id,
            will=aiomqtt.Will(will.topic, will.payload, qos=1, retain=will.retain),
            # Its own time limits lose a cancellation that comes together with an answer (Python 3.11's wait_for).
            timeout=math.inf,
            keepalive=keepalive_s,
            max_queued_incoming_messages=1,
            logger=_log,
        )
        self._client._create_socket_connection = lambda: sock  # type: ignore[method-assign]  # it would open its own
        # Nothing in it blocks on an open socket, so it needs no thread; it only queues the greeting.
        super()._client_connect()

    def _client_connect(self) -> None:
        """Called by aiomqtt in a thread; done already."""

    def _on_socket_register_write(self, client: Any, userdata: Any, sock: Any) -> None:
        """At once. The library's own does it a moment later, when the socket may be closed and its number another's."""
        self._loop.add_writer(sock.fileno(), client.loop_write)

    async def greet(self) -> None:
        """Returns when the broker has accepted us. Raises MqttError."""
        try:
            async with asyncio.timeout(CONNECT_S):
                await self.__aenter__()
        except TimeoutError:
            raise aiomqtt.MqttError(f"connected, but no greeting within {CONNECT_S:g} s") from None

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
        if self._disconnected.done() and not self._disconnected.cancelled():
            self._disconnected.exception()  # seen: else the loop reports it as forgotten
