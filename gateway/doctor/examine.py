"""All of an examination: what is on this machine first, what may keep one waiting last. IO."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress

from gateway.clock import SystemClock
from gateway.config import BayConfig, GatewayConfig
from gateway.doctor import machine, network, plc, sensors, settings
from gateway.doctor.brokers import brokers
from gateway.doctor.databases import databases
from gateway.doctor.exposure import exposure
from gateway.doctor.permissions import permissions
from gateway.errors import LinkError
from gateway.shared_state import SharedStateReader, SharedVector, attachable
from gateway.web.host import releases
from gateway.web.ipc.devices import Finding, Verdict


def findings(config: GatewayConfig, seconds: float, *, beside: bool = False) -> Iterator[Finding]:
    """One after another, as they are found. `seconds`: how long each sensor is measured. `beside`: this gateway runs
    here with this very configuration, so no device of a bay is opened, whatever it shares of its state."""
    clock = SystemClock()
    vectors = _running(config)
    pid = next((vector.pid for vector in vectors.values()), None)
    parts: list[tuple[str, str, Iterable[Finding]]] = [
        ("versions", "", _one(machine.versions)),
        ("settings", "", _settings(config)),
        *(
            ("bay", bay.name, _bay(config, bay, vectors.get(bay.name), clock, seconds, beside=beside))
            for bay in config.bays
        ),
        ("permission", "", permissions(config)),
        ("port", "", network.ports(config, running=beside or bool(vectors))),
        ("plc", "", _one(lambda: network.reached(config.modbus.host))),
        ("plc", "", network.routes(config)),
        ("certificate", "", network.certificates(config, clock)),
        ("clock", "", _one(machine.clock)),
        ("disk", "", machine.folders(config)),
        ("processor", "", _one(machine.processors)),
        ("priority", "", _one(lambda: machine.priority(pid))),
        ("broker", "", brokers(config)),
        ("database", "", databases(config)),
    ]
    for part, name, found in parts:
        try:
            yield from found
        except OSError as error:  # one part that can't be examined is a finding, and hides no other
            yield Finding(part, name, Verdict.FAULT, "examine it", error.strerror or str(error), "look at that first")


def _one(part: Callable[[], Finding]) -> Iterator[Finding]:
    """Not before it is its turn."""
    yield part()


def _settings(config: GatewayConfig) -> Iterator[Finding]:
    for line in settings.warnings(config):
        yield Finding("settings", "", Verdict.WARNING, "read them", line, "edit the file, unless it is meant so")
    for bay, why in releases.warnings(config):
        remedy = "try the bay, and sign its checklist on the page Release"
        yield Finding("release", bay, Verdict.WARNING, "compare with what was signed", why, remedy)


def _bay(
    config: GatewayConfig,
    bay: BayConfig,
    vector: SharedVector | None,
    clock: SystemClock,
    seconds: float,
    *,
    beside: bool,
) -> Iterator[Finding]:
    if vector is not None:
        yield from sensors.running(bay, vector, clock.now_ns())
        yield from plc.of_bay(config, bay, config.modbus.port)
        if not beside:
            yield from exposure(bay)
    elif beside:
        remedy = "look at its log; its state vector is in /dev/shm"
        yield Finding("bay", bay.name, Verdict.FAULT, "ask the running gateway", "it shares no state of it", remedy)
    else:
        yield from sensors.camera(bay, clock, seconds)
        yield from exposure(bay)
        for sensor in bay.ranger.sensors:
            yield from sensors.ranger(bay.name, sensor, clock, max(seconds, sensors.HELLO_S))


def _running(config: GatewayConfig) -> dict[str, SharedVector]:
    """By bay, the newest state of this gateway where it runs already."""
    found: dict[str, SharedVector] = {}
    for instance, bay in attachable():
        if instance == config.instance:
            with suppress(LinkError), SharedStateReader(instance, bay) as reader:
                found[bay] = reader.read()
    return found
