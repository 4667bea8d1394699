"""The configured server: its address, the user and password there, and the certificates. IO: reads small files.

No error here quotes a secret, and neither the text nor the repr of a `Server` contains its password.
"""

import re
import ssl
from dataclasses import dataclass, field, replace
from urllib.parse import unquote, urlsplit

from gateway.errors import SettingError
from gateway.passwords import ESCAPED, password
from gateway.sinks.credentials import client_context
from gateway.sinks.postgresql.settings import PostgresqlAccess, PostgresqlConfig

SECTION = "sinks.postgresql"
PORT = 5432
SHAPE = "postgresql://[user[:password]@]host[:port]/database"


@dataclass(frozen=True, slots=True)
class Server:
    """`host` with a leading slash is the folder of a Unix socket."""

    host: str
    port: int
    database: str
    user: str
    password: str | None = field(default=None, repr=False)

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"postgresql://{host}:{self.port}/{self.database}"


def server_of(settings: PostgresqlConfig) -> Server:
    """The address with user and password. Raises SettingError naming the key, never the secret."""
    return server_at(settings.url, f"{SECTION}.url", settings, SECTION)


def server_at(url: str, url_key: str, settings: PostgresqlAccess, section: str) -> Server:
    """Likewise, where the address is the value of `url_key`."""
    server = _parse(url, url_key)
    if settings.username is not None:
        if server.user:
            raise SettingError(f"{section}.username", "the url names a user, too; keep one of them")
        server = replace(server, user=settings.username)
    if not server.user:
        raise SettingError(url_key, f"names no user; expected {SHAPE}, or username beside it")
    secret = password(section, settings.password_file, settings.password_env)
    if secret is None:
        return server
    if server.password is not None:
        raise SettingError(url_key, "holds a password beside password_file or password_env; keep one of them")
    return replace(server, password=secret)


def tls_of(settings: PostgresqlAccess, section: str = SECTION) -> ssl.SSLContext | None:
    """None without TLS. Raises SettingError for a file that can't be used."""
    return None if settings.tls is None else client_context(f"{section}.tls", settings.tls)


def _parse(url: str, key: str) -> Server:
    """Raises SettingError, which never quotes the URL: a password may be anywhere in a damaged one."""
    try:
        url.encode()
        parts = urlsplit(url)
        port = parts.port
        host = parts.netloc.rpartition("@")[2]
        host = host[1:].partition("]")[0] if host.startswith("[") else host.partition(":")[0]
        texts = [unquote(text or "", errors="strict") for text in (host, parts.path[1:], parts.username)]
        secret = None if parts.password is None else unquote(parts.password, errors="strict")
    except ValueError:  # its text may quote the password, as may its chained form
        raise _url_error(key, f"not a URL with a host and a port from 1 to 65535; {ESCAPED}") from None
    host, database, user = texts
    if parts.query or parts.fragment or "?" in url or "#" in url:
        raise _url_error(key, f"nothing may follow the database; {ESCAPED}")
    if not host or not database or "/" in parts.path[1:]:
        raise _url_error(key, "names no host or no database")
    if re.search(r"[\s\x00-\x1f\x7f]", url) or "\0" in "".join([*texts, secret or ""]):
        raise _url_error(key, "contains blanks or control characters")
    if port == 0:
        raise _url_error(key, "port 0 cannot be connected to")
    return Server(host, port or PORT, database, user, secret)


def _url_error(key: str, fault: str) -> SettingError:
    return SettingError(key, f"{fault}; expected {SHAPE}")
