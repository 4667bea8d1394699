"""All of an examination, in the order in which an electrician would look. IO."""

from collections.abc import Iterator
from contextlib import suppress

from gateway.clock import SystemClock
from gateway.config import GatewayConfig
from gateway.doctor import machine, network, sensors, settings
from gateway.doctor.brokers import brokers
from gateway.doctor.finding import Finding, Verdict
from gateway.errors import LinkError
from gateway.shared_state import SharedStateReader, SharedVector, attachable


def findings(config: GatewayConfig, seconds: float) -> Iterator[Finding]:
    """One after another, as they are found. `seconds`: how long each sensor is measured."""
    clock = SystemClock()
    vectors = _running(config)
    yield machine.versions()
    for line in settings.warnings(config):
        yield Finding("settings", "", Verdict.WARNING, "read them", line, "edit the file, unless it is meant so")
    for bay in config.bays:
        if (vector := vectors.get(bay.name)) is not None:
            yield from sensors.running(bay, vector, clock.now_ns())
        else:
            yield from sensors.camera(bay, clock, seconds)
            yield from sensors.ranger(bay, clock, max(seconds, sensors.HELLO_S))
    yield from network.ports(config, running=bool(vectors))
    yield from network.routes(config)
    yield from brokers(config)
    yield from network.certificates(config, clock.wall_ns())
    yield machine.clock()
    yield from machine.folders(config)
    yield machine.processors()
    yield machine.priority()


def _running(config: GatewayConfig) -> dict[str, SharedVector]:
    """By bay, the newest state of this gateway where it runs already."""
    found: dict[str, SharedVector] = {}
    for instance, bay in attachable():
        if instance == config.instance:
            with suppress(LinkError), SharedStateReader(instance, bay) as reader:
                found[bay] = reader.read()
    return found
