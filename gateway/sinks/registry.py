"""The registered sinks, and the configured ones of them.

MQTT and Sparkplug have their own sections; any other sink is configured by a table `[sinks.<name>]`. It is loaded only
then, and is found in the list below or from an entry point of the group `gateway.sinks` in another distribution.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial

from pydantic import ValidationError

from gateway.clock import Clock
from gateway.config import GatewayConfig, reference
from gateway.config.strict.errors import explain
from gateway.config.strict.section import Section
from gateway.errors import ConfigError, SettingError
from gateway.registry import Registry, imported
from gateway.sinks.contract import AlarmSource, AlarmStep, Bays, Sink, SinkContext, SinkType, no_alarm_steps, no_alarms
from gateway.values.gateway_values import GatewayFacts


def _mqtt_checks(config: GatewayConfig) -> Sequence[Callable[[], object]]:
    if (mqtt := config.mqtt) is None:
        return ()
    from gateway.sinks.mqtt.broker import brokers_of, certificates_of  # noqa: PLC0415 - only where it is configured
    from gateway.sinks.mqtt.topics import Topics  # noqa: PLC0415

    return (
        lambda: certificates_of(mqtt, brokers_of(mqtt)),
        partial(Topics.of_config, mqtt, config.site, config.instance),
    )


MQTT = SinkType(
    "mqtt",
    imported("gateway.sinks.mqtt.publisher:MqttPublisher"),  # its libraries only where it is configured
    settings=lambda config: config.mqtt if config.mqtt is not None and config.mqtt.plain_topics else None,
    checks=_mqtt_checks,
)
SPARKPLUG = SinkType(
    "sparkplug",
    imported("gateway.sinks.sparkplug.publisher:SparkplugPublisher"),
    settings=lambda config: config.mqtt if config.mqtt is not None and config.mqtt.sparkplug is not None else None,
)
TYPES: tuple[SinkType, ...] = (MQTT, SPARKPLUG)
GROUP = "gateway.sinks"
OWN = {"postgresql": "gateway.sinks.postgresql.sink:POSTGRESQL"}
OTHERS = Registry("sink", GROUP, OWN)


def opened(
    config: GatewayConfig,
    bays: Bays,
    clock: Clock,
    boot: str,
    resources: ExitStack,
    alarms: AlarmSource = no_alarms,
    listen_to_alarms: Callable[[Callable[[AlarmStep], None]], None] = no_alarm_steps,
    facts: Callable[[], GatewayFacts] = GatewayFacts,
) -> list[Sink]:
    """The configured sinks. Raises ConfigError for a sink that is not known, and for settings that can't work."""
    return [
        kind.open(SinkContext(config, settings, bays, clock, boot, resources, alarms, listen_to_alarms, facts))
        for kind, settings in _configured(config)
    ]


def checks(config: GatewayConfig) -> Iterator[Callable[[], object]]:
    """What can be checked without connecting to anything; each raises SettingError."""
    yield from (partial(_settings, config, name) for name in config.sinks)
    for kind in TYPES:
        yield from kind.checks(config)
    for name in config.sinks:
        with contextlib.suppress(SettingError):  # which the first of these reports
            yield from _settings(config, name)[0].checks(config)


def sections() -> Iterator[tuple[str, type[Section]]]:
    """The tables `[sinks.<name>]` of the gateway's own sinks: title and model."""
    for name, section in known_sections(GatewayConfig()).items():
        yield f"[sinks.{name}]", section


def known_sections(config: GatewayConfig) -> dict[str, type[Section]]:
    """Model of each table `[sinks.<name>]`: of the gateway's own sinks, and of others that `config` names."""
    found: dict[str, type[Section]] = {}
    for name in dict.fromkeys([*OWN, *config.sinks]):
        with contextlib.suppress(SettingError):
            if (section := _named(name).section) is not None:
                found[name] = section
    return found


def settings_of(config: GatewayConfig) -> Iterator[tuple[str, Section]]:
    """What the tables `[sinks.<name>]` set, by the name of the table. Raises SettingError."""
    for name in config.sinks:
        yield f"sinks.{name}", _settings(config, name)[1]


def shown_settings(config: GatewayConfig) -> Iterator[tuple[str, str]]:
    """Every key with its value, those of the sinks included, as `reference.flat` shows them. Raises SettingError."""
    yield from reference.flat(config)
    for name, section in settings_of(config):
        yield from reference.flat(section, f"{name}.")


def _configured(config: GatewayConfig) -> Iterator[tuple[SinkType, object]]:
    for kind in TYPES:
        if (settings := kind.settings(config)) is not None:
            yield kind, settings
    for name in config.sinks:
        yield _settings(config, name)


def _settings(config: GatewayConfig, name: str) -> tuple[SinkType, Section]:
    """The type of sink that `[sinks.<name>]` configures, and its settings."""
    kind = _named(name)
    if kind.section is None:
        raise SettingError(f"sinks.{name}", "has its own section (docs/config.md)")
    try:
        return kind, kind.section.model_validate(config.sinks[name])
    except ValidationError as error:
        faults = [line.removeprefix(": ") for line in explain(error, source="", text="", model=kind.section)]
        fault = SettingError(f"sinks.{name}", "; ".join(faults))
    raise fault  # outside `except`: the checker's error quotes values, which may be passwords


def _named(name: str) -> SinkType:
    known = {kind.name: kind for kind in TYPES}
    if name in known:
        return known[name]
    if name in OTHERS:
        try:
            found: object = OTHERS.load(name)
        except ConfigError as error:
            raise SettingError(f"sinks.{name}", str(error)) from error
        if isinstance(found, SinkType):
            return found
        raise SettingError(f"sinks.{name}", f"the entry point {OTHERS.place(name)} is not a SinkType")
    names = sorted({kind.name for kind in TYPES if kind.section is not None} | {*OTHERS.names()})
    raise SettingError(f"sinks.{name}", f"no such sink; known here: {', '.join(names) or 'none'}")
