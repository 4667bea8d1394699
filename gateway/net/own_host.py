"""The names and addresses of this machine, by which browsers reach its pages. IO: they may change at any time."""

import ipaddress
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from gateway.config.sections.hmi import host_name
from gateway.net.listener import url
from gateway.net.rate_limit import plain_address

# Under ProtectHostname= the kernel tells the service the name that the machine had when the service was started.
HOSTNAME_FILE = Path("/etc/hostname")
MDNS_SOCKET = Path("/run/avahi-daemon/socket")
MDNS_NUMBERS = range(2, 10)  # what Avahi appends where another machine has the name already


def own_names() -> tuple[str, ...]:
    """Host names as a Host header is compared, that of mDNS first."""
    found: dict[str, None] = {}
    for text in _host_names():
        with suppress(ValueError):
            name = host_name(text)
            found |= dict.fromkeys((f"{name.partition('.')[0]}.local", name))
    return tuple(found)


def own_addresses() -> list[str]:
    """IPv4 addresses of this machine, loopback last; none where the system does not tell them."""
    import psutil  # noqa: PLC0415 - half a megabyte, and only where the pages' addresses are shown

    try:
        interfaces = psutil.net_if_addrs().values()
    except OSError:  # no netlink for this service, or no memory for its answer
        return []
    found = [a.address for each in interfaces for a in each if a.family == socket.AF_INET]
    return sorted(set(found), key=lambda address: (ipaddress.ip_address(address).is_loopback, address))


def request_hosts(reached_at: str) -> set[str]:
    """The Host headers of requests that came to this address of the machine. A foreign site has no such name."""
    names = own_names()
    numbered = {name.replace(".local", f"-{n}.local") for name in names for n in MDNS_NUMBERS}
    return {plain_address(reached_at), *names, *numbered}


def page_urls(port: int) -> list[str]:
    """What to enter into a browser on another machine; here, where this one has no network. A name for mDNS is listed
    where Avahi runs."""
    names = [name for name in own_names() if name.endswith(".local")][:1] if MDNS_SOCKET.exists() else []
    outside = [address for address in own_addresses() if not ipaddress.ip_address(address).is_loopback]
    return [url("https", host, port) for host in [*names, *outside] or ["localhost"]]


def _host_names() -> Iterator[str]:
    with suppress(OSError, UnicodeDecodeError):
        yield HOSTNAME_FILE.read_text().strip()
    yield socket.gethostname()
