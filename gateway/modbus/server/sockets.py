"""Listening sockets with bounded buffers, that notice a peer that vanished; and what is said when there is none."""

import asyncio
import errno
import resource
import socket
from functools import partial

from gateway.config import ModbusConfig
from gateway.errors import ConfigError, GatewayError, LinkError

BACKLOG = 64  # connections that the kernel completes before they are accepted; a storm of them is taken in such bites
RECEIVE_BYTES = 8 * 1024  # a Modbus request has at most 260 bytes; the kernel doubles this
SEND_BYTES = 32 * 1024
KEEPALIVE_PROBES = 4
OTHER_FILES = 256  # what the rest of the gateway may have open: cameras, rings, logs, the broker


async def listen(config: ModbusConfig, port: int) -> list[socket.socket]:
    """One socket for each address of `config.host`, bound, all on the same port. Raises OSError or ValueError."""
    # socket's own resolver, on every event loop: the errors that `bind_error` knows are its.
    resolve = partial(socket.getaddrinfo, config.host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    found = await asyncio.get_running_loop().run_in_executor(None, resolve)
    made: list[socket.socket] = []
    try:
        for family, address in dict.fromkeys((family, address) for family, *_, address in found):
            # Port 0 and a name with several addresses (localhost): all take the first one's free port.
            same_port = made[0].getsockname()[1] if made else address[1]
            sock = socket.socket(family, socket.SOCK_STREAM)
            made.append(sock)
            sock.setblocking(False)
            _options(sock, config)
            sock.bind((address[0], same_port, *address[2:]))
    except (OSError, ValueError):
        for sock in made:
            sock.close()
        raise
    return made


def _options(sock: socket.socket, config: ModbusConfig) -> None:
    """Set before listening: the connections inherit them, which saves system calls under a storm."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    if sock.family == socket.AF_INET6:
        sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    # Quiet for keepalive_s, then probed, given up after as long again.
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, config.keepalive_s)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, max(1, config.keepalive_s // KEEPALIVE_PROBES))
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, KEEPALIVE_PROBES)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 2000 * config.keepalive_s)


def bind_error(config: ModbusConfig, error: Exception, port: int | None = None) -> GatewayError:
    """What the operator is told when listening fails with `error`: ConfigError where trying again would not help."""
    kind: type[GatewayError] = LinkError
    match error:
        case PermissionError():
            kind = ConfigError
            why = (
                "not permitted. Ports below 1024 need a privilege: take a port from 1024 up (modbus.port), or allow "
                "it with `sudo setcap cap_net_bind_service=+ep` on the Python executable, or with "
                "AmbientCapabilities=CAP_NET_BIND_SERVICE in the systemd unit"
            )
        case socket.gaierror() if error.errno == socket.EAI_AGAIN:
            why = f"the name can't be resolved now: {error.strerror}"
        case socket.gaierror() | ValueError():
            kind = ConfigError
            why = f"modbus.host is neither an address nor a known name: {getattr(error, 'strerror', error)}"
        case OSError(errno=errno.EADDRINUSE):
            why = "another program listens there already (another gateway?); `ss -ltnp` shows it"
        case OSError(errno=errno.EADDRNOTAVAIL):
            why = "this machine does not have that address (yet)"
        case _:
            why = getattr(error, "strerror", None) or str(error)
    return kind(f"modbus: cannot listen on {config.host} port {config.port if port is None else port}: {why}")


def allow_open_files(config: ModbusConfig) -> None:
    """Raise this process's limit of open files to what max_connections needs. Raises ConfigError where it can't be."""
    listeners = config.plain + (config.tls is not None)  # each may have max_connections
    needed = listeners * config.max_connections + OTHER_FILES
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return
    if hard != resource.RLIM_INFINITY and hard < needed:
        raise ConfigError(
            f"modbus.max_connections = {config.max_connections}: needs {needed} open files, this process may have "
            f"{hard} (`ulimit -Hn`; LimitNOFILE= in the systemd unit): allow more, or take at most "
            f"{max(1, (hard - OTHER_FILES) // listeners)}"
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
