"""Listening TCP sockets: one for each address of a host, all on one port; and the error where there is none. IO."""

import errno
import ipaddress
import resource
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from gateway.errors import ConfigError, GatewayError, LinkError

OTHER_FILES = 256  # what the rest of the gateway may have open: cameras, rings, logs, the broker


def bound_sockets(
    section: str, host: str, port: int, options: Callable[[socket.socket], None] = lambda _: None
) -> tuple[socket.socket, ...]:
    """Bound, not listening yet, non-blocking; `options` is applied to each before. May block: it resolves `host`.

    `section` of the configuration, for the error: ConfigError where the operator must act, LinkError where waiting may
    help.
    """
    made: list[socket.socket] = []
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        for family, address in dict.fromkeys((family, address) for family, *_, address in found):
            # Port 0 and a name with several addresses (localhost): all take the first one's free port.
            same_port = made[0].getsockname()[1] if made else address[1]
            sock = socket.socket(family, socket.SOCK_STREAM)
            made.append(sock)
            sock.setblocking(False)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            options(sock)
            sock.bind((address[0], same_port, *address[2:]))
    except (OSError, ValueError) as error:
        for sock in made:
            sock.close()
        raise bind_error(section, host, port, error) from error
    return tuple(made)


@contextmanager
def listening(section: str, host: str, port: int, backlog: int = 128) -> Iterator[tuple[socket.socket, ...]]:
    """`bound_sockets`, listening until the block is left."""
    sockets = bound_sockets(section, host, port)
    try:
        try:
            for sock in sockets:
                sock.listen(backlog)
        except OSError as error:
            raise bind_error(section, host, port, error) from error
        yield sockets
    finally:
        for sock in sockets:
            sock.close()


def from_here(host: str) -> str:
    """Where a program of this machine connects to what listens on `host`."""
    return {"0.0.0.0": "127.0.0.1", "::": "::1", "": "localhost"}.get(host, host)


def bind_error(section: str, host: str, port: int, error: Exception) -> GatewayError:
    """The error to report when listening fails with `error`."""
    kind: type[GatewayError] = LinkError
    match error:
        case PermissionError():
            kind = ConfigError
            why = (
                f"not permitted. Ports below 1024 need a privilege: take a port from 1024 up ({section}.port), or "
                "allow it with `sudo setcap cap_net_bind_service=+ep` on the Python executable, or with "
                "AmbientCapabilities=CAP_NET_BIND_SERVICE in the systemd unit"
            )
        case socket.gaierror() if error.errno == socket.EAI_AGAIN:
            why = f"the name can't be resolved now: {error.strerror}"
        case socket.gaierror() | ValueError():
            kind = ConfigError
            why = f"{section}.host is neither an address nor a known name: {getattr(error, 'strerror', error)}"
        case OSError(errno=errno.EADDRINUSE):
            why = "another program listens there already (another gateway?); `ss -ltnp` shows it"
        case OSError(errno=errno.EADDRNOTAVAIL):
            why = "this machine does not have that address (yet)"
        case _:
            why = getattr(error, "strerror", None) or str(error)
    return kind(f"{section}: cannot listen on {host} port {port}: {why}")


def allow_open_files(key: str, connections: int, listeners: int) -> None:
    """Raise this process's limit of open files to what `connections` at each of the listeners need.

    Raises ConfigError, naming `key`, where it can't be raised.
    """
    needed = listeners * connections + OTHER_FILES
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return
    if hard != resource.RLIM_INFINITY and hard < needed:
        raise ConfigError(
            f"{key} = {connections}: needs {needed} open files, this process may have {hard} (`ulimit -Hn`; "
            "LimitNOFILE= in the systemd unit): allow more, or take at most "
            f"{max(1, (hard - OTHER_FILES) // listeners)}"
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))


def url(scheme: str, host: str, port: int) -> str:
    """What to type into a browser on this machine or, where `host` is an address, on another."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        pass
    else:
        if address.is_unspecified:
            host = "localhost"
        elif address.version == 6:
            host = f"[{host}]"
    return f"{scheme}://{host}:{port}/"
