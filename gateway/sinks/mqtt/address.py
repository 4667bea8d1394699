"""Where the broker is and who we are there, read from one URL. Pure.

The password never leaves this record: it is not in its text, not in its repr, and in no error raised here.
"""

import re
from dataclasses import dataclass, field
from urllib.parse import unquote, urlsplit

from gateway.errors import ConfigError

DEFAULT_PORT = {"mqtt": 1883, "mqtts": 8883}
MAX_BYTES = 65_535  # of any string in MQTT
SHAPE = "mqtt[s]://[user[:password]@]host[:port]"


@dataclass(frozen=True, slots=True)
class Broker:
    host: str
    port: int
    tls: bool
    username: str | None = None
    password: str | None = field(default=None, repr=False)

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'mqtts' if self.tls else 'mqtt'}://{host}:{self.port}"


def parse(url: str) -> Broker:
    """Raises ConfigError, which never quotes the URL: a password may stand anywhere in a damaged one."""
    try:
        url.encode()  # what came over the command line may not be text
        parts = urlsplit(url)
        scheme, host, port = parts.scheme, parts.hostname or "", parts.port
    except ValueError:  # its text may quote the password, as may its chained form
        raise _wrong("not a URL with a host and a port from 1 to 65535") from None
    if scheme not in DEFAULT_PORT:
        raise _wrong("must begin with mqtt:// or mqtts://")
    if parts.path not in ("", "/") or parts.query or parts.fragment or "?" in url or "#" in url:
        raise _wrong("nothing may follow the port; write / ? # in a password as %2F %3F %23")
    if not host or host.startswith(".") or re.search(r"[\s\x00-\x1f\x7f]", url):
        raise _wrong("names no host, or contains blanks")
    if port == 0:
        raise _wrong("port 0 cannot be connected to")
    username, password = _decoded(parts.username), _decoded(parts.password)
    if "\0" in (username or ""):
        raise _wrong("a user name cannot contain %00")
    if password is not None and not username:
        raise _wrong("a password needs a user name (MQTT 3.1.1)")
    return Broker(host, port or DEFAULT_PORT[scheme], scheme == "mqtts", username or None, password)


def _decoded(text: str | None) -> str | None:
    if text is None:
        return None
    try:
        decoded = unquote(text, errors="strict")
    except UnicodeDecodeError:
        raise _wrong("user or password: the %-escapes are not UTF-8") from None
    if len(decoded.encode()) > MAX_BYTES:
        raise _wrong(f"user or password: longer than {MAX_BYTES} bytes")
    return decoded


def _wrong(fault: str) -> ConfigError:
    return ConfigError(f"mqtt.url: {fault}; expected {SHAPE}")
