"""Every error the gateway raises on purpose. Anything else is a bug and may crash its task."""


class GatewayError(Exception):
    """Base class; the command line turns it into one line and an exit code."""


class ConfigError(GatewayError):
    """The operator must edit a file or an argument. Never retried; exit code 2."""


class SettingError(ConfigError):
    """A value of the configuration that can't work. `place` is its key as a path, with the number
    of an item of a list, `fault` what is wrong with it."""

    def __init__(self, key: str, fault: str, value: str | None = None) -> None:
        super().__init__(f"{key}: {fault}" if value is None else f'{key} = "{value}": {fault}')
        self.place: tuple[str | int, ...] = tuple(int(part) if part.isdigit() else part for part in key.split("."))
        self.fault = fault


class LinkError(GatewayError):
    """A cable, socket, camera or process went away. The supervisor retries with backoff."""


class ProtocolError(GatewayError):
    """The peer is alive but uses another version, which is reported."""
