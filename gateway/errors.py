"""Every error the gateway raises on purpose. Anything else is a bug and may crash its task."""


class GatewayError(Exception):
    """Base class; the command line turns it into one line and an exit code."""


class ConfigError(GatewayError):
    """The operator must edit a file or an argument. Never retried; exit code 2."""


class LinkError(GatewayError):
    """A cable, socket, camera or process went away. The supervisor retries with backoff."""


class ProtocolError(GatewayError):
    """The peer is alive but uses another version, which is reported."""
