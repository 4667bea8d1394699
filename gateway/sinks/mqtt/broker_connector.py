"""How a connection to the configured broker is opened: its certificates, and a version of MQTT that it knows. IO."""

import contextlib
from collections.abc import AsyncIterator

from gateway.config import MqttConfig
from gateway.sinks.mqtt import credentials
from gateway.sinks.mqtt.address import Broker
from gateway.sinks.mqtt.broker_link import BrokerLink, Message, NotGreetedError, connect
from gateway.sinks.mqtt.protocol_versions import Versions

# A hung broker is noticed within 1.25 keepalives: a sign of life every half, three quarters for its acknowledgement.
ACK_SHARE = 0.75


class Door:
    """For one client id. Raises CredentialsError for certificates that can't be used.

    Certificates are read once, here: from disk, and not while a bay is being watched.
    """

    def __init__(self, config: MqttConfig, broker: Broker, client_id: str, *, will_at_goodbye: bool = False) -> None:
        self._config = config
        self._broker = broker
        self._client_id = client_id
        self._will_at_goodbye = will_at_goodbye
        self._tls = credentials.tls_context(config, broker)
        self._versions = Versions(config.protocol)

    @contextlib.asynccontextmanager
    async def open(self, will: Message) -> AsyncIterator[BrokerLink]:
        """A connection; see `broker_link.connect`. What it was refused with decides what is tried next time."""
        try:
            async with connect(
                self._broker,
                client_id=self._client_id,
                will=will,
                keepalive_s=self._config.keepalive_s,
                ack_s=ACK_SHARE * self._config.keepalive_s,
                tls=self._tls,
                protocol=self._versions.next,
                will_at_goodbye=self._will_at_goodbye,
            ) as link:
                self._versions.greeted()
                yield link
        except NotGreetedError as error:
            self._versions.failed(certain=error.certain)
            raise
