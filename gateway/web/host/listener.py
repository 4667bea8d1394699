"""The listening sockets of the pages. They belong to the main process: the web process may come and go behind them."""

import errno
import ipaddress
import socket
from collections.abc import Iterator
from contextlib import contextmanager

from gateway.config.sections.hmi import HmiConfig
from gateway.errors import ConfigError, GatewayError, LinkError

BACKLOG = 128


@contextmanager
def listening_sockets(config: HmiConfig) -> Iterator[tuple[socket.socket, ...]]:
    """Bound and listening, one socket an address, all on one port. Raises LinkError or ConfigError when it can't be."""
    made: list[socket.socket] = []
    try:
        try:
            found = socket.getaddrinfo(config.host, config.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
            for family, address in dict.fromkeys((family, address) for family, *_, address in found):
                port = made[0].getsockname()[1] if made else address[1]
                sock = socket.socket(family, socket.SOCK_STREAM)
                made.append(sock)
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if family == socket.AF_INET6:
                    sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                sock.bind((address[0], port, *address[2:]))
                sock.listen(BACKLOG)
                sock.setblocking(False)
        except (OSError, ValueError) as error:
            raise _explained(config, error) from error
        yield tuple(made)
    finally:
        for sock in made:
            sock.close()


def _explained(config: HmiConfig, error: Exception) -> GatewayError:
    where = f"hmi: {config.host} port {config.port}"
    match error:
        case socket.gaierror() | ValueError():
            return ConfigError(f"hmi.host = {config.host!r}: no address of this machine: {error}")
        case OSError(errno=errno.EADDRINUSE):
            return LinkError(f"{where}: another program listens there; another hmi.port, or 0 for a free one")
        case OSError(errno=errno.EACCES):
            return ConfigError(f"{where}: not permitted; ports below 1024 need CAP_NET_BIND_SERVICE")
        case OSError(errno=errno.EADDRNOTAVAIL):
            return LinkError(f"{where}: this machine has no such address (now)")
        case _:
            return LinkError(f"{where}: {error}")


def url(config: HmiConfig, sockets: tuple[socket.socket, ...]) -> str:
    """What a person types into a browser on this machine or, where `host` is an address, on another."""
    host = config.host
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        pass
    else:
        if address.is_unspecified:
            host = "localhost"
        elif address.version == 6:
            host = f"[{host}]"
    scheme = "https" if config.tls_cert else "http"
    return f"{scheme}://{host}:{sockets[0].getsockname()[1]}/"
