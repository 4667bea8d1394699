"""Tries a broker as a client would: log in, publish a retained message, read it back, delete it. IO."""

import asyncio
import secrets

from gateway.config import MqttConfig
from gateway.errors import LinkError
from gateway.sinks.mqtt.session import BrokerSession
from gateway.sinks.mqtt.topics import MqttMessage, Topics

ANSWER_S = 3.0
TOPIC = "doctor"  # last level, in the place of `status`


async def probe(config: MqttConfig, site: str, instance: str, url: str) -> str:
    """What was achieved with this one of the configured brokers. Raises LinkError with what the broker refuses, and
    SettingError as BrokerSession does."""
    alone = config.model_copy(update={"url": url, "urls": ()})
    topic = Topics.of_config(config, site, instance).of(instance, TOPIC)
    payload = secrets.token_hex(8).encode()
    nothing = MqttMessage(topic, b"", retain=True)  # which deletes the retained message
    session = BrokerSession(alone, f"gateway-{site}-{instance}-doctor")
    returned = asyncio.Event()

    async def received(_: object, message: MqttMessage) -> None:
        if (message.topic, message.payload) == (topic, payload):
            returned.set()

    async with session.connection(nothing, received) as link:
        await link.publish(MqttMessage(topic, payload, retain=True))
        await link.subscribe([(topic, 1)])
        try:
            async with asyncio.timeout(ANSWER_S):
                await returned.wait()
        except TimeoutError:
            raise LinkError(
                f"logged in with MQTT {link.version}, but the retained message on {topic} did not come back: this user "
                "may not write or read there, or the broker keeps none"
            ) from None
        await link.publish(nothing)
        return f"logged in with MQTT {link.version}; a retained message on {topic} came back, and is deleted"
