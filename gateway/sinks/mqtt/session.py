"""One client's connections to the configured broker, one at a time: version, last will, loss and orderly end. IO.

Every publisher over MQTT has one `BrokerSession`. What may depend on the broker (its address, certificates and version
of MQTT) is decided here; what is published, and when, is the publisher's.

MQTT 5 is tried first. A broker that does not support it replies so, or closes the connection without an answer; 3.1.1
is tried then. After a timeout the next attempt uses the other version, because the broker may only have been slow. A
version that was accepted is kept.
"""

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AbstractAsyncContextManager
from typing import Literal

from gateway.config import MqttConfig
from gateway.errors import LinkError
from gateway.sinks.mqtt import broker_link
from gateway.sinks.mqtt.broker import broker_of, tls_context
from gateway.sinks.mqtt.broker_link import BrokerLink, NotAcceptedError, Version
from gateway.sinks.mqtt.topics import Message

log = logging.getLogger(__name__)

# A hung broker is noticed within 1.25 keepalives: a message every half, three quarters for its acknowledgement.
ACKNOWLEDGE_SHARE = 0.75
Connect = Callable[..., AbstractAsyncContextManager[BrokerLink]]  # parameters: see broker_link.connect
Received = Callable[[BrokerLink, Message], Awaitable[None]]


class VersionChoice:
    """`next` is the version to connect with; report its result."""

    def __init__(self, configured: Literal["auto", "5", "3.1.1"]) -> None:
        self._fixed = configured != "auto"
        self._accepted = False
        self.next: Version = "5" if configured == "auto" else configured

    def accepted(self) -> None:
        """The broker has accepted `next`."""
        self._accepted = True

    def failed(self, *, certain: bool) -> None:
        """It has not. `certain`: because it does not support that version."""
        if self._fixed or (self._accepted and not certain):
            return
        self._accepted = False
        self.next = "3.1.1" if self.next == "5" else "5"


class BrokerSession:
    """Under one client id. Raises SettingError for an address, a password or certificates that can't be used.

    Certificates are read once, here: from disk, and not while a bay is being watched.
    `will_at_disconnect`: an MQTT 5 broker publishes the last will even when the connection ends properly.
    """

    def __init__(
        self, config: MqttConfig, client_id: str, *, will_at_disconnect: bool = False, connect: Connect | None = None
    ) -> None:
        self.broker = broker_of(config)
        self.closing = asyncio.Event()  # set by `close`: end the connection there is, and begin no other
        self.connected = False
        self.connections = 0  # since the start
        self._config = config
        self._client_id = client_id
        self._will_at_disconnect = will_at_disconnect
        self._tls = tls_context(config, self.broker)
        self._versions = VersionChoice(config.protocol)
        self._connect = connect or broker_link.connect
        self._lock = asyncio.Lock()  # one client id, one connection

    @contextlib.asynccontextmanager
    async def connection(self, will: Message, received: Received | None = None) -> AsyncIterator[BrokerLink]:
        """A connection with this last will. `received` is awaited for each message of a subscribed topic.

        When the connection is lost, the body ends at once, and all that failed with it is one LinkError. A body that
        ends normally sends DISCONNECT; after any other end the broker publishes the will.
        """
        with _single_link_error():
            async with self._lock, self._opened(will) as link, asyncio.TaskGroup() as group:
                self.connections += 1
                self.connected = True
                log.info("%s: connected as %s", self.broker, self._client_id)
                try:
                    receiving = group.create_task(_receive(link, received))
                    yield link
                    receiving.cancel()
                finally:
                    self.connected = False

    async def close(self) -> None:
        """Returns when the connection there is has ended; its body must watch `closing`."""
        self.closing.set()
        async with self._lock:
            pass

    @contextlib.asynccontextmanager
    async def _opened(self, will: Message) -> AsyncIterator[BrokerLink]:
        """A refusal decides which version is tried next time."""
        try:
            async with self._connect(
                self.broker,
                client_id=self._client_id,
                will=will,
                keepalive_s=self._config.keepalive_s,
                acknowledge_s=ACKNOWLEDGE_SHARE * self._config.keepalive_s,
                tls=self._tls,
                version=self._versions.next,
                will_at_disconnect=self._will_at_disconnect,
            ) as link:
                self._versions.accepted()
                yield link
        except NotAcceptedError as error:
            self._versions.failed(certain=error.certain)
            raise


async def _receive(link: BrokerLink, received: Received | None) -> None:
    """Until the connection is lost; without subscriptions no message should arrive."""
    async for message in link.incoming():
        if received is not None:
            await received(link, message)


@contextlib.contextmanager
def _single_link_error() -> Iterator[None]:
    """A task group wraps what its tasks raise; a lost link is raised as the one LinkError that it is."""
    try:
        yield
    except BaseExceptionGroup as group:
        links, others = group.split(LinkError)
        if links is None or others is not None:
            raise
        raise LinkError(str(_first(links))) from _first(links)


def _first(error: BaseException) -> BaseException:
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error
