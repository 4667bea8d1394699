"""How a connection to the configured broker is opened: its certificates, and a version of MQTT that it supports. IO.

MQTT 5 is tried first. A broker that does not support it replies so, or closes the connection without an answer; 3.1.1
is tried then. After a timeout the next attempt uses the other version, because the broker may only have been slow. A
version that was accepted is kept.
"""

import contextlib
from collections.abc import AsyncIterator, Iterator
from typing import Literal

from gateway.config import MqttConfig
from gateway.errors import LinkError
from gateway.sinks.mqtt import broker_link
from gateway.sinks.mqtt.broker import Broker, tls_context
from gateway.sinks.mqtt.broker_link import BrokerLink, Message, NotAcceptedError, ProtocolVersion

# A hung broker is noticed within 1.25 keepalives: a message every half, three quarters for its acknowledgement.
ACKNOWLEDGE_SHARE = 0.75


class VersionChoice:
    """`next` is the version to connect with; report its result."""

    def __init__(self, configured: Literal["auto", "5", "3.1.1"]) -> None:
        self._fixed = configured != "auto"
        self._accepted = False
        self.next = ProtocolVersion.V5 if configured == "auto" else ProtocolVersion(configured)

    def accepted(self) -> None:
        """The broker has accepted `next`."""
        self._accepted = True

    def failed(self, *, certain: bool) -> None:
        """It has not. `certain`: because it does not support that version."""
        if self._fixed or (self._accepted and not certain):
            return
        self._accepted = False
        self.next = ProtocolVersion.V311 if self.next is ProtocolVersion.V5 else ProtocolVersion.V5


class BrokerConnector:
    """For one client id. Raises SettingError for certificates that can't be used.

    Certificates are read once, here: from disk, and not while a bay is being watched.
    """

    def __init__(self, config: MqttConfig, broker: Broker, client_id: str, *, will_at_disconnect: bool = False) -> None:
        self._config = config
        self._broker = broker
        self._client_id = client_id
        self._will_at_disconnect = will_at_disconnect
        self._tls = tls_context(config, broker)
        self._versions = VersionChoice(config.protocol)

    @contextlib.asynccontextmanager
    async def connect(self, will: Message) -> AsyncIterator[BrokerLink]:
        """A connection; see `broker_link.connect`. A refusal decides which version is tried next time."""
        try:
            async with broker_link.connect(
                self._broker,
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


@contextlib.contextmanager
def single_link_error() -> Iterator[None]:
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
