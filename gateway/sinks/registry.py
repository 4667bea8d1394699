"""Which sinks there are, and the configured ones of them.

MQTT and Sparkplug have sections of their own; any other sink is configured by a table `[sinks.<name>]`, and comes from the
list below or from an entry point of the group `loading_gateway.sinks` in another distribution.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from importlib.metadata import entry_points

from pydantic import ValidationError

from gateway.clock import Clock
from gateway.config import GatewayConfig
from gateway.errors import ConfigError
from gateway.sinks.contract import Bays, SettingError, Sink, SinkContext, SinkType
from gateway.sinks.mqtt.publisher import MQTT
from gateway.sinks.sparkplug.publisher import SPARKPLUG

GROUP = "loading_gateway.sinks"
TYPES = (MQTT, SPARKPLUG)


def opened(
    config: GatewayConfig, bays: Bays, clock: Clock, boot: str, resources: ExitStack, types: Sequence[SinkType] = TYPES
) -> list[Sink]:
    """The configured sinks. Raises ConfigError for a sink that is not known, and for settings that can't work."""
    return [
        kind.open(SinkContext(config, settings, bays, clock, boot, resources))
        for kind, settings in _configured(config, types)
    ]


def checks(config: GatewayConfig, types: Sequence[SinkType] = TYPES) -> Iterator[Callable[[], object]]:
    """What can be checked without connecting to anything; each raises SettingError."""
    yield from (partial(_settings, config, name, types) for name in config.sinks)
    for kind in types:
        yield from kind.checks(config)


def _configured(config: GatewayConfig, types: Sequence[SinkType]) -> Iterator[tuple[SinkType, object]]:
    for kind in types:
        if (settings := kind.settings(config)) is not None:
            yield kind, settings
    for name in config.sinks:
        yield _settings(config, name, types)


def _settings(config: GatewayConfig, name: str, types: Sequence[SinkType]) -> tuple[SinkType, object]:
    """The type of sink that `[sinks.<name>]` configures, and its settings."""
    kind = _named(name, types)
    if kind.section is None:
        raise SettingError(f"sinks.{name}", f"is configured by [{name}], not here")
    try:
        return kind, kind.section.model_validate(config.sinks[name])
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        fault = SettingError(f"sinks.{name}", f"{key}: {first['msg'].removeprefix('Value error, ')}")
    raise fault  # outside `except`: the checker's error quotes values, which may be passwords


def _named(name: str, types: Sequence[SinkType]) -> SinkType:
    known = {kind.name: kind for kind in types}
    if name in known:
        return known[name]
    others = entry_points(group=GROUP)
    if name in others.names:
        found: object = others[name].load()
        if not isinstance(found, SinkType):
            raise ConfigError(f"entry point {name} of {GROUP}: {others[name].value} is not a SinkType")
        return found
    names = sorted({kind.name for kind in types if kind.section is not None} | others.names)
    raise SettingError(f"sinks.{name}", f"no such sink; known here: {', '.join(names) or 'none'}")
