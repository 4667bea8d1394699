"""One client's connections to the configured brokers, one at a time: fail-over, last will, loss and orderly end. IO.

Every publisher over MQTT has one `BrokerSession`. What may depend on the broker (its address, certificates and version
of MQTT) is decided here; what is published, and when, is the publisher's.

A connection is sought in one round through all addresses of all configured brokers (`endpoints`): one that does not
answer, refuses, or loses a connection later is tried last from then on. While a broker other than the preferred one is
connected, those before it in the configuration are checked by a connection under another client id; when one accepts,
the connection is ended without DISCONNECT, so that its last will replaces the retained `online` there, and the next
round begins with the preferred broker.

MQTT 5 is tried first. A broker that does not support it replies so, and 3.1.1 is tried at once, or closes the
connection without an answer; 3.1.1 is tried in the next round then. After a timeout the next attempt at that address
uses the other version, because the broker may only have been slow. A version that was accepted is kept.
"""

import asyncio
import contextlib
import logging
import random
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AbstractAsyncContextManager, AsyncExitStack, aclosing
from typing import NoReturn

from gateway.clock import Clock, SystemClock
from gateway.config import MqttConfig
from gateway.durations import NS_PER_S
from gateway.errors import LinkError
from gateway.sinks.mqtt import broker_link
from gateway.sinks.mqtt.broker import brokers_of, certificates_of
from gateway.sinks.mqtt.broker_link import BrokerLink, NotAcceptedError
from gateway.sinks.mqtt.broker_socket import certificate_of, open_socket
from gateway.sinks.mqtt.endpoints import Endpoint, Endpoints, ReturnPace
from gateway.sinks.mqtt.lookup import Lookup, in_daemon_thread
from gateway.sinks.mqtt.takeovers import Takeovers
from gateway.sinks.mqtt.topics import MqttMessage

log = logging.getLogger(__name__)

CERTIFICATES_S = 60.0  # how often it is looked whether they were renewed on disk, while there is a connection
HANDSHAKE_EVERY = 60  # of these, while a certificate should be renewed
READ_S = 5.0  # for reading them, from a disk that may hang
# A hung broker is noticed within 1.25 keepalives: a message every half, three quarters for its acknowledgement.
ACKNOWLEDGE_SHARE = 0.75
Connect = Callable[..., AbstractAsyncContextManager[BrokerLink]]  # parameters: see broker_link.connect
Received = Callable[[BrokerLink, MqttMessage], Awaitable[None]]


class BrokerSession:
    """Under one client id. Raises SettingError for an address, a password or certificates that can't be used.

    Certificates are read here, and in a thread when they have changed on disk: the next connection uses those.
    `will_at_disconnect`: an MQTT 5 broker publishes the last will even when the connection ends properly.
    """

    def __init__(
        self,
        config: MqttConfig,
        client_id: str,
        *,
        will_at_disconnect: bool = False,
        connect: Connect | None = None,
        clock: Clock | None = None,
    ) -> None:
        self.closing = asyncio.Event()  # set by `close`: end the connection there is, and begin no other
        self.connections = 0  # since the start
        self.failovers = 0  # of these, to another address than the one before
        self._config = config
        self._client_id = client_id
        self._will_at_disconnect = will_at_disconnect
        brokers = list(brokers_of(config))
        if config.urls_shuffled:
            random.Random(client_id).shuffle(brokers)  # the same after each start
        self._endpoints = Endpoints(brokers, Lookup().addresses, config.protocol)
        self._certificates = certificates_of(config, self._endpoints.brokers)
        self._reading: asyncio.Future[ssl.SSLContext] | None = None
        self._clock = clock or SystemClock()
        self._takeovers = Takeovers(client_id)
        self._connect = connect or broker_link.connect
        self._lock = asyncio.Lock()  # one client id, one connection
        self._connected: Endpoint | None = None
        self._last: Endpoint | None = None  # the one connected before
        self._limits: dict[Endpoint, str] = {}  # as last reported in the log
        self._pace = ReturnPace(config.return_s)
        self.fault = ""  # why there is no connection

    @property
    def connected(self) -> bool:
        return self._connected is not None

    @property
    def peer(self) -> str:
        """The broker that is connected, or all that are configured; without user and password."""
        return str(self._connected or ", ".join(map(str, self._endpoints.brokers)))

    @property
    def figures(self) -> dict[str, int]:
        """Counters and gauges, as in LinkStatus."""
        place = 0 if self._connected is None else self._connected.rank + 1
        found = {"connected": int(self.connected), "broker": place, "failovers": self.failovers}
        if self._certificates is not None:
            days = self._certificates.days_left(self._clock.wall_ns())
            found |= {} if days is None else {"certificate_days": days}
        return found

    @property
    def alarms(self) -> dict[str, str]:
        """As in LinkStatus."""
        expiring = "" if self._certificates is None else self._certificates.warning(self._clock.wall_ns())
        found = {"certificate_expiring": expiring, "client_id_shared": self._takeovers.detail(self._clock.now_ns())}
        return {alarm: detail for alarm, detail in found.items() if detail}

    @contextlib.asynccontextmanager
    async def connection(self, will: MqttMessage | None, received: Received | None = None) -> AsyncIterator[BrokerLink]:
        """A connection with this last will. `received` is awaited for each message of a subscribed topic.

        When the connection is lost, the body ends at once, and all that failed with it is one LinkError. A body that
        ends normally sends DISCONNECT; after any other end the broker publishes the will.
        """
        with _single_link_error():
            async with self._lock, self._opened(will) as (endpoint, link), asyncio.TaskGroup() as group:
                watching = [
                    group.create_task(_receive(link, received)),
                    group.create_task(self._watch_certificates(endpoint)),
                ]
                if endpoint.rank:
                    watching.append(group.create_task(self._until_return(endpoint, link)))
                yield link
                for task in watching:
                    task.cancel()

    async def close(self) -> None:
        """Returns when the connection there is has ended; its body must watch `closing`."""
        self.closing.set()
        async with self._lock:
            pass

    @contextlib.asynccontextmanager
    async def _opened(self, will: MqttMessage | None) -> AsyncIterator[tuple[Endpoint, BrokerLink]]:
        async with AsyncExitStack() as stack:
            endpoint, link = await self._first_that_accepts(stack, will)
            begun_ns = self._clock.now_ns()
            self._note(endpoint, link.limits)
            if self._certificates is not None:
                self._certificates.use_peer(str(endpoint), link.certificate)
            try:
                yield endpoint, link
            except* _ReturnError:
                self._pace.returned()
                raise
            except* LinkError as lost:
                self.fault = str(_first(lost))
                self._endpoints.failed(endpoint)
                lasted_ns = self._clock.now_ns() - begun_ns
                self._pace.ended(lasted_ns / NS_PER_S)
                if news := self._takeovers.lost(self._clock.now_ns(), lasted_ns, link.end):
                    log.warning("%s: %s", endpoint, news)
                raise
            finally:
                self._connected = None

    def _note(self, endpoint: Endpoint, limits: str) -> None:
        self._connected = endpoint
        self.fault = ""
        self.connections += 1
        if self._last not in (None, endpoint):
            self.failovers += 1
        self._last = endpoint
        self._pace.connected(endpoint.rank)
        log.info("%s: connected as %s", endpoint, self._client_id)
        if limits and self._limits.get(endpoint) != limits:
            log.warning("%s: supports %s", endpoint, limits)
        self._limits[endpoint] = limits

    async def _first_that_accepts(self, stack: AsyncExitStack, will: MqttMessage | None) -> tuple[Endpoint, BrokerLink]:
        """One round. The connection is left with `stack`. Raises LinkError with what each has failed with."""
        faults: list[LinkError] = []
        tls = await self._tls()
        async with aclosing(self._endpoints.in_order(faults)) as endpoints:
            async for endpoint in endpoints:
                try:
                    link = await self._accepted(stack, endpoint, tls, self._client_id, will)
                except LinkError as error:
                    self._endpoints.failed(endpoint)
                    self._takeovers.refused()
                    faults.append(error)
                else:
                    self._endpoints.accepted(endpoint)
                    return endpoint, link
        self.fault = "; ".join(map(str, faults))
        raise faults[0] if len(faults) == 1 else LinkError(self.fault)

    async def _accepted(
        self,
        stack: AsyncExitStack,
        endpoint: Endpoint,
        tls: ssl.SSLContext | None,
        client_id: str,
        will: MqttMessage | None,
    ) -> BrokerLink:
        """A refusal decides which version is tried next time; that of a version, which is tried at once, as is another
        last will after that of a last will."""
        versions, last = self._endpoints.versions(endpoint), False
        while True:
            try:
                link = await stack.enter_async_context(
                    self._connect(
                        endpoint,
                        client_id=client_id,
                        will=will,
                        keepalive_s=self._config.keepalive_s,
                        acknowledge_s=ACKNOWLEDGE_SHARE * self._config.keepalive_s,
                        tls=tls,
                        version=versions.next,
                        will_at_disconnect=self._will_at_disconnect and will is not None,
                    )
                )
            except NotAcceptedError as error:
                if error.will not in (None, will):
                    will = error.will
                    continue
                if last or not (versions.failed(certain=error.certain) and error.certain):
                    raise
                last = True
            else:
                versions.accepted()
                return link

    async def _tls(self) -> ssl.SSLContext | None:
        """With the certificates that are on disk now. A disk that hangs holds up nothing: the last ones are used."""
        if self._certificates is None:
            return None
        if self._reading is None or self._reading.done():
            self._reading = in_daemon_thread(self._certificates.current, "mqtt-tls")
        await asyncio.wait([self._reading], timeout=READ_S)
        return self._certificates.newest

    async def _watch_certificates(self, endpoint: Endpoint) -> NoReturn:
        """So that the days left are those of the files on disk. Whether the broker has renewed its own, only another
        handshake shows."""
        while True:
            for _ in range(HANDSHAKE_EVERY):
                await asyncio.sleep(CERTIFICATES_S)
                tls = await self._tls()
            if self._certificates is not None and "certificate_expiring" in self.alarms:
                with (
                    contextlib.suppress(LinkError),
                    contextlib.closing(await open_socket(endpoint, tls, broker_link.CONNECT_S)) as sock,
                ):
                    self._certificates.use_peer(str(endpoint), certificate_of(sock))

    async def _until_return(self, endpoint: Endpoint, link: BrokerLink) -> NoReturn:
        """Raises _ReturnError when a broker before that of `endpoint` accepts connections again."""
        while True:
            await asyncio.sleep(random.uniform(0.5, 1.5) * self._pace.wait_s)  # not all gateways at once
            for rank in range(0 if self.closing.is_set() else endpoint.rank):
                if (better := await self._checked(rank)) is not None:
                    await link.quiet()
                    raise _ReturnError(f"{endpoint}: left, because {better} accepts connections again")

    async def _checked(self, rank: int) -> Endpoint | None:
        """An address of this broker that accepts a connection with MQTT. The connection ends with DISCONNECT."""
        tls = await self._tls()
        with contextlib.suppress(LinkError):
            for endpoint in await self._endpoints.of(rank):
                self._endpoints.forget(endpoint)  # a version that was tried while it hung says nothing
                try:
                    async with AsyncExitStack() as stack:
                        await self._accepted(stack, endpoint, tls, f"{self._client_id}-check", None)
                except LinkError as error:
                    log.debug("%s: checked, and not returned to: %s", endpoint, error)
                    self._endpoints.failed(endpoint)
                else:
                    return endpoint
        return None


class _ReturnError(LinkError):
    """The connection is ended for the sake of a preferred broker."""


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
