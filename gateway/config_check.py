"""What a configuration's addresses, ports and files say about each other, found without opening a device or a port."""

import re
from collections.abc import Callable, Iterator
from functools import partial

from gateway.config import SHARED_SECTIONS, BayConfig, GatewayConfig, ModbusConfig, RangerConfig
from gateway.config.strict.errors import ConfigFault, FaultsError, located
from gateway.errors import ConfigError, SettingError
from gateway.files import device_at
from gateway.net import tls
from gateway.net.tls import TlsFiles
from gateway.ranger.ranger_service import check_port
from gateway.sinks import registry as sink_registry
from gateway.vision.detect import registry as detection_methods
from gateway.vision.source.specs import check_exposure, source_spec
from gateway.web import languages

PLACES = r"^(modbus\.tls\.|opcua\b\.?|camera\.url|camera\.exposure|ranger port)\b[:= ]*"


def check(config: GatewayConfig, source: str, text: str) -> None:
    """What can be checked of ports and addresses without opening them. Raises FaultsError, one line per fault.

    `text` is the TOML that `config` was read from, and `source` its name, so that each fault is reported with its line.
    """
    faults: list[ConfigFault] = []

    def look(place: tuple[str | int, ...], part: Callable[[], object]) -> None:
        try:
            part()
        except ConfigError as error:
            message = re.sub(PLACES, "", str(error))
            if isinstance(error, SettingError):  # it knows its key, within the bay
                place, message = (*place[:2], *error.place), error.fault
            fault = located(place, message, source=source, text=text, shared=SHARED_SECTIONS)
            if fault not in faults:  # a shared section is checked once per bay
                faults.append(fault)

    for n, bay in enumerate(config.bays):
        look(("bays", n, "camera", "url"), partial(source_spec, bay.camera))
        look(("bays", n, "camera", "exposure"), partial(check_exposure, bay.camera))
        look(("bays", n, "ranger", "port"), partial(check_port, bay.ranger))
        for m, ranger in enumerate(bay.ranger.more):
            look(("bays", n, "ranger", "more", m, "port"), partial(check_port, ranger))
        look(("bays", n, "vision", "proposals"), partial(detection_methods.method(bay.vision.method).check, bay.vision))
        for place, what in _beyond_range(n, bay, config):
            faults.append(located(place, what, source=source, text=text, shared=SHARED_SECTIONS))
        look(("modbus", "handshake", "trigger_timeout_s"), partial(_check_trigger, config.modbus, bay.ranger))
    if config.modbus.tls is not None:
        look(("modbus", "tls"), partial(tls.check, TlsFiles.of_modbus(config.modbus.tls)))
    if config.opcua is not None:
        from gateway.opcua import prerequisites  # noqa: PLC0415 - only where it is configured

        look(("opcua",), partial(prerequisites.check, config.opcua))
    for part in sink_registry.checks(config):
        look((), part)
    if config.hmi.enabled and not config.hmi.own_certificate:
        try:
            tls.check(TlsFiles.of_pages(config))
        except ConfigError as error:
            key, _, message = str(error).partition(": ")
            faults.append(located(tuple(key.split(".")), message, source=source, text=text))
    if not faults:
        faults = [
            located(place, what, source=source, text=text, shared=SHARED_SECTIONS) for place, what in _shared(config)
        ]
    if faults:
        raise FaultsError(faults)


def _check_trigger(modbus: ModbusConfig, ranger: RangerConfig) -> None:
    """Raises ConfigError where a triggered measurement would end before the ranger can have a result for it."""
    cycle_s, timeout_s = ranger.period_s, modbus.handshake.trigger_timeout_s
    if modbus.writes and cycle_s is not None and timeout_s < ranger.median * cycle_s:
        raise ConfigError(
            f"{timeout_s:g} is too short for a result: ranger.median = {ranger.median} readings younger than the "
            f"trigger take {ranger.median * cycle_s:g} s"
        )


def _beyond_range(n: int, bay: BayConfig, config: GatewayConfig) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Distances that the bay's ranger can't measure: no truck would ever be there."""
    farthest_mm = bay.ranger.max_range_mm
    if farthest_mm is None:
        return
    distances: list[tuple[tuple[str | int, ...], float | None]] = [
        (("bays", n, "fusion", "distance_threshold_mm"), bay.fusion.distance_threshold_mm),
        (("bays", n, "visit", "leave_distance_mm"), bay.visit.leave_distance_mm),
    ]
    for m, recipe in enumerate(config.recipes):
        distances.append((("recipes", m, "fusion", "distance_threshold_mm"), recipe.fusion.distance_threshold_mm))
    for place, distance_mm in distances:
        if distance_mm is not None and distance_mm > farthest_mm:
            yield place, f"the ranger of bay {bay.name!r} ({bay.ranger.type}) measures up to {farthest_mm:g} mm"


def check_languages(config: GatewayConfig, *, source: str, text: str) -> None:
    """A plant's own languages: by itself, as the gateway starts without one that is faulty. Raises FaultsError."""
    found: list[ConfigError] = []
    if config.hmi.enabled:
        languages.own(config, found.append)
    if found:
        raise FaultsError([located(("hmi", "languages_folder"), str(one), source=source, text=text) for one in found])


def _shared(config: GatewayConfig) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """What two bays or two servers would have to share: place and fault. A bay on another one's sensor would report
    the wrong truck."""
    for key, devices in (
        ("camera.url", [(n, str(bay.camera.url)) for n, bay in enumerate(config.bays)]),
        ("ranger.port", [(n, one.port) for n, bay in enumerate(config.bays) for one in bay.ranger.sensors]),
    ):
        places = [device_at(device) for _, device in devices]
        for index, (n, device) in enumerate(devices):
            if (first := places.index(places[index])) != index:
                owner = config.bays[devices[first][0]].name
                what = f"is that of bay {owner!r}, too: each bay needs its own"
                if owner == config.bays[n].name:
                    what = "is that of two of its rangers: each needs its own"
                yield ("bays", n, "name"), f"its {key}, {device}, {what}"
    yield from _ports(config)


def _ports(config: GatewayConfig) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Of two servers on one port, whatever their addresses. 0 is any free one."""
    modbus, hmi, opcua = config.modbus, config.hmi, config.opcua
    servers = [
        ("modbus", "", modbus.port if modbus.plain else 0),
        ("modbus.tls", "", 0 if modbus.tls is None else modbus.tls.port),
        ("hmi", "the pages need their own", hmi.port if hmi.enabled else 0),
        ("opcua", "the OPC UA server needs its own", 0 if opcua is None else opcua.port),
    ]
    taken: dict[int, str] = {}
    for section, why, port in servers:
        if port and why and port in taken:
            yield (section, "port"), f"the port of [{taken[port]}], too: {why}"
        taken.setdefault(port, section)
