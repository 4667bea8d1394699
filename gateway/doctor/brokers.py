"""The configured MQTT brokers, one by one. IO."""

import asyncio
from collections.abc import Coroutine, Iterator

from gateway.config import GatewayConfig
from gateway.config.strict.errors import without_password
from gateway.errors import GatewayError
from gateway.sinks.mqtt.probe import probe
from gateway.web.ipc.devices import Finding, Verdict

LIMIT_S = 30.0  # all tries of one broker


def brokers(config: GatewayConfig) -> Iterator[Finding]:
    mqtt = config.mqtt
    if mqtt is None:
        return
    for url in mqtt.brokers:
        name = without_password(url)
        tried = "log in, publish, read it back"
        try:
            result = asyncio.run(in_time(probe(mqtt, config.site, config.instance, url)))
        except GatewayError as error:
            result = str(error).removeprefix(f"{name}: ")
            yield Finding("broker", name, Verdict.FAULT, tried, result, _remedy(result))
        except TimeoutError:
            yield Finding("broker", name, Verdict.FAULT, tried, f"no answer in {LIMIT_S:g} s", "is it alive?")
        else:
            yield Finding("broker", name, Verdict.OK, tried, result)


async def in_time(work: Coroutine[None, None, str]) -> str:
    async with asyncio.timeout(LIMIT_S):
        return await work


def _remedy(result: str) -> str:
    if "retained message" in result:
        return "allow its topics to this user in the broker's ACL (docs/mqtt.md)"
    if "authori" in result.lower() or "password" in result.lower() or "credentials" in result.lower():
        return "correct mqtt.username and its password"
    if "certificate" in result:
        return "set mqtt.tls.ca_file to the authority of the broker's certificate"
    return "is the address right, does the broker run, does a firewall stop the way?"
