"""The configured brokers: their addresses, the user and password there, and the certificates. IO: reads small files.

Secrets may be in the URL, in a file, or in an environment variable. No error here quotes one, and neither the text
nor the repr of a `Broker` contains its password.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from urllib.parse import unquote, urlsplit

from gateway.config import MqttConfig
from gateway.errors import SettingError
from gateway.passwords import ESCAPED, MAX_BYTES, password
from gateway.sinks.client_tls import ClientCertificates

DEFAULT_PORT = {"mqtt": 1883, "mqtts": 8883, "ws": 80, "wss": 443}
PROXY_PORT = {"http": 3128}
WEB_SOCKET_PATH = "/mqtt"
SHAPE = "mqtt[s]://[user[:password]@]host[:port] or ws[s]://[user[:password]@]host[:port][/path]"
PROXY_SHAPE = "http://host:port"


@dataclass(frozen=True, slots=True)
class Proxy:
    """An HTTP proxy that connects to the broker."""

    host: str
    port: int
    username: str | None = None
    password: str | None = field(default=None, repr=False)

    def __str__(self) -> str:
        return f"http://{bracketed(self.host)}:{self.port}"


@dataclass(frozen=True, slots=True)
class Broker:
    """`path` of a WebSocket; None: MQTT without one."""

    host: str
    port: int
    tls: bool
    username: str | None = None
    password: str | None = field(default=None, repr=False)
    path: str | None = None
    proxy: Proxy | None = None

    @property
    def reached_at(self) -> tuple[str, int]:
        """Host and port of the TCP connection."""
        return (self.host, self.port) if self.proxy is None else (self.proxy.host, self.proxy.port)

    @property
    def url(self) -> str:
        """Without user and password."""
        scheme = f"{'mqtt' if self.path is None else 'ws'}{'s' if self.tls else ''}"
        return f"{scheme}://{bracketed(self.host)}:{self.port}{self.path or ''}"

    def __str__(self) -> str:
        return self.url if self.proxy is None else f"{self.url} through {self.proxy}"


def bracketed(host: str) -> str:
    """As in a URL."""
    return f"[{host}]" if ":" in host else host


def parse(url: str, key: str = "mqtt.url") -> Broker:
    """Raises SettingError, which never quotes the URL: a password may be anywhere in a damaged one."""
    try:
        return _parse(url, DEFAULT_PORT)
    except ValueError as error:
        fault = f"{error}; expected {SHAPE}"
    raise SettingError(key, fault)  # outside `except`: the chained error may quote the password


def _parse(url: str, default_port: Mapping[str, int]) -> Broker:
    try:
        url.encode()  # an argument of the command line may not be text
        parts = urlsplit(url)
        scheme, host, port = parts.scheme, parts.hostname or "", parts.port
    except ValueError:  # its text may quote the password, as may its chained form
        raise _UrlError(f"not a URL with a host and a port from 1 to 65535; {ESCAPED}") from None
    if scheme not in default_port:
        raise _UrlError(f"must begin with {' or '.join(f'{known}://' for known in default_port)}")
    web_socket = scheme in ("ws", "wss")
    if (parts.path not in ("", "/") and not web_socket) or parts.query or parts.fragment or "?" in url or "#" in url:
        raise _UrlError(f"nothing may follow the port; {ESCAPED}")
    if not host or host.startswith(".") or re.search(r"[\s\x00-\x1f\x7f]", url):
        raise _UrlError("names no host, or contains blanks")
    if port == 0:
        raise _UrlError("port 0 cannot be connected to")
    username, password = _decoded(parts.username), _decoded(parts.password)
    if "\0" in (username or ""):
        raise _UrlError("a user name cannot contain %00")
    if password is not None and not username:
        raise _UrlError("a password needs a user name (MQTT 3.1.1)")
    path = (parts.path or WEB_SOCKET_PATH) if web_socket else None
    return Broker(host, port or default_port[scheme], scheme in ("mqtts", "wss"), username or None, password, path)


def _decoded(text: str | None) -> str | None:
    if text is None:
        return None
    try:
        decoded = unquote(text, errors="strict")
    except UnicodeDecodeError:
        raise _UrlError("user or password: the %-escapes are not UTF-8") from None
    if len(decoded.encode()) > MAX_BYTES:
        raise _UrlError(f"user or password: longer than {MAX_BYTES} bytes")
    return decoded


class _UrlError(ValueError):
    """What is wrong with a URL."""


def brokers_of(config: MqttConfig) -> tuple[Broker, ...]:
    """The addresses with user and password, the preferred one first. Raises SettingError naming the key, never the
    secret."""
    secret = password("mqtt", config.password_file, config.password_env)
    keys = ["mqtt.url"] if config.url is not None else [f"mqtt.urls.{n}" for n in range(len(config.urls))]
    proxy = _proxy_of(config)
    found = tuple(
        replace(_broker_of(config, url, key, secret), proxy=proxy)
        for url, key in zip(config.brokers, keys, strict=True)
    )
    for key, broker in zip(keys, found, strict=True):
        if broker.tls != found[0].tls:
            raise SettingError(key, f"{found[0]} is encrypted and {broker} is not, or the reverse; all must be alike")
        if found.index(broker) != keys.index(key):
            raise SettingError(key, f"{broker} is in the list twice")
    return found


def _proxy_of(config: MqttConfig) -> Proxy | None:
    secret = password("mqtt", config.proxy_password_file, config.proxy_password_env, "proxy_")
    if config.proxy is None:
        if secret is not None or config.proxy_username is not None:
            raise SettingError("mqtt.proxy", f"is missing beside a user or a password for it; expected {PROXY_SHAPE}")
        return None
    fault = ""
    try:
        found = _parse(config.proxy, PROXY_PORT)
    except ValueError as error:
        fault = str(error)
    else:
        if found.username is not None:
            fault = "names a user; that and the password are proxy_username and proxy_password_file"
    if fault:
        raise SettingError("mqtt.proxy", f"{fault}; expected {PROXY_SHAPE}")
    if secret is not None and config.proxy_username is None:
        raise SettingError("mqtt.proxy_username", "is missing; a password needs a user name")
    return Proxy(found.host, found.port, config.proxy_username, secret)


def _broker_of(config: MqttConfig, url: str, key: str, secret: str | None) -> Broker:
    broker = parse(url, key)
    if config.username is not None:
        if broker.username is not None:
            raise SettingError("mqtt.username", f"{key} names a user, too; keep one of them")
        broker = replace(broker, username=config.username)
    if secret is None:
        return broker
    if broker.password is not None:
        raise SettingError(key, "holds a password beside password_file or password_env; keep one of them")
    if broker.username is None:
        raise SettingError("mqtt.username", "is missing; a password needs a user name")
    return replace(broker, password=secret)


def certificates_of(config: MqttConfig, brokers: Sequence[Broker]) -> ClientCertificates | None:
    """None without TLS. Raises SettingError for a file that can't be used. Reads from disk."""
    if not brokers[0].tls:
        if config.tls is not None:
            raise SettingError(
                "mqtt.tls", 'needs url = "mqtts://..." or "wss://..."; with mqtt:// and ws:// nothing is encrypted'
            )
        return None
    return ClientCertificates("mqtt.tls", config.tls)
